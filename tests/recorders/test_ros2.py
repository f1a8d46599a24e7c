"""Joint states live from ROS 2: publishers and recorders are processes, DDS is between them."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

pytest.importorskip("cyclonedds", reason="needs the extra ros2")

from tests.recorders.conftest import Record, Refuses
from tests.recorders.live_wait import LAST_RESORT_S, Terminal, ended, recorder, wait_until
from tests.recorders.ros2_publisher import (
    NAMES,
    STATES,
    TORQUES,
    expect,
    free_domain,
    go_on,
    publishing,
    values_of,
)
from tunenet_logs import messages
from tunenet_logs.episode import Episode
from tunenet_logs.errors import UsageError, pip_install
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.ros2 import checked_topic, graph
from tunenet_logs.recorders.ros2.graph import Node, take_decoded, take_raw
from tunenet_logs.recorders.ros2.recording import Pace

pytestmark = pytest.mark.live
slow = pytest.mark.slow

_CLOCK_NS = 10_000_000  # what a wall clock may be set by while a test runs
ALL_NAMES = ("--joint-names", ",".join(NAMES))


@pytest.fixture
def domain() -> Iterator[int]:
    with free_domain() as number:
        yield number


def check_states(
    episode: Episode, first_ns: int, count: int, rate_hz: float, topic: str = STATES, first: int = 0
) -> None:
    stamps_ns = first_ns + np.round(np.arange(count) * 1e9 / rate_hz).astype(np.int64)
    for part, label in enumerate(("position", "velocity", "effort")):
        one = episode.signals[f"{topic}.{label}"]
        assert one.columns == NAMES
        assert np.array_equal(one.stamps_ns, stamps_ns)
        wanted = [values_of(number)[part] for number in range(first, first + count)]
        assert np.array_equal(one.values, wanted)
    assert episode.info.counts[f"received.{topic}"] == count


@dataclass(frozen=True)
class Stopped:
    """A recording of 1000 messages at 1 kHz whose recorder was stopped twice meanwhile."""

    log: Path
    first_ns: int
    said: str
    trouble: str


def heard(domain: int) -> tuple[object, ...]:
    return ("--loopback", "--domain", domain, "--timeout", LAST_RESORT_S)


@pytest.fixture(scope="module", params=[signal.SIGINT, pytest.param(signal.SIGTERM, marks=slow)])
def stopped(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Stopped:
    folder = tmp_path_factory.mktemp("stopped")
    plan = {"topics": {STATES: "states"}, "messages": 1000, "pauses": [300, 500, 700, 900]}
    with (
        free_domain() as domain,
        publishing(domain, **plan) as publisher,
        recorder(folder, *heard(domain), "--joint-states", STATES) as process,
    ):
        expect(publisher, "matched")
        for _ in range(2):
            expect(publisher, "at")
            process.send_signal(signal.SIGSTOP)
            os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
            go_on(publisher)
            expect(publisher, "at")
            process.send_signal(signal.SIGCONT)
            go_on(publisher)
        first_ns = int(expect(publisher, "sent")[0])
        return Stopped(folder / "a.mcap", first_ns, *ended(process, request.param))


def test_a_recorder_that_is_stopped_twice_has_every_message_as_it_came(stopped: Stopped):
    episode = read_episode(stopped.log)
    check_states(episode, stopped.first_ns, 1000, 1000.0)
    assert not episode.warnings
    assert not stopped.trouble
    assert "1000 messages captured, 1000 written, 0 dropped" in stopped.said
    assert (episode.info.kind, episode.info.source) == ("payload", f"ros2 {STATES}")
    assert episode.info.counts[f"lost.{STATES}"] == 0
    assert episode.info.notes["ended"] == "stopped by a signal"
    with stopped.log.open("rb") as file:
        found = [message for _, _, message in make_reader(file, validate_crcs=True).iter_messages()]
    store = messages.typestore()
    before_ns = 0
    for message in found:
        state: Any = store.deserialize_cdr(message.data, messages.JOINT_STATE)
        assert message.data == bytes(store.serialize_cdr(state, messages.JOINT_STATE))
        assert state.header.frame_id == "base"
        stamp_ns = state.header.stamp.sec * 1_000_000_000 + state.header.stamp.nanosec
        assert stamp_ns - _CLOCK_NS < message.publish_time < message.log_time + _CLOCK_NS
        assert message.publish_time > before_ns
        before_ns = message.publish_time


def recorded(
    domain: int, folder: Path, *options: object, end: int = signal.SIGTERM, **plan: Any
) -> tuple[int, str]:
    """Record all that is published; when the first was sent [ns], and what the recorder said.

    A signal ends it, or, where that is 0, the death of the publisher.
    """
    with (
        publishing(domain, **plan) as publisher,
        recorder(folder, *heard(domain), *options) as process,
    ):
        expect(publisher, "matched")
        first_ns = int(expect(publisher, "sent")[0])
        if not end:
            publisher.kill()
        said, trouble = ended(process, end)
    assert not trouble
    return first_ns, said


@pytest.mark.parametrize("multicast", [pytest.param(True, marks=slow), False])
def test_a_best_effort_publisher_that_is_killed_leaves_what_came(domain, tmp_path: Path, multicast):
    plan = {"messages": 100, "reliable": False, "multicast": multicast, "end": 0}
    options = ("--joint-states", STATES, "--timeout", 1)
    first_ns, said = recorded(domain, tmp_path, *options, topics={STATES: "states"}, **plan)
    check_states(read_episode(tmp_path / "a.mcap"), first_ns, 100, 1000.0)
    assert "100 written" in said
    silent = re.search(rf"no message on {STATES} for ([\d.]+) s", said)
    assert silent is not None
    assert float(silent.group(1)) >= 1.0


def test_positions_and_torques_apart_as_kinovas_driver_publishes_them(domain: int, tmp_path: Path):
    topics = {STATES: "states", TORQUES: "angles"}
    options = ("--joint-states", STATES, "--joint-states", TORQUES, *ALL_NAMES)
    plan = {"topics": topics, "messages": 50, "rate_hz": 200.0}
    first_ns, said = recorded(domain, tmp_path, *options, **plan)
    assert "100 messages captured, 100 written" in said
    episode = read_episode(tmp_path / "a.mcap")
    check_states(episode, first_ns, 50, 200.0)
    torques = episode.signals[f"{TORQUES}.effort"]
    assert (torques.columns, torques.unit) == (NAMES, "N·m")
    assert np.array_equal(torques.values, [values_of(number)[2] for number in range(50)])
    late_ns = torques.stamps_ns - episode.signals[f"{STATES}.effort"].stamps_ns
    assert np.all(late_ns > -_CLOCK_NS)
    assert episode.info.counts[f"received.{TORQUES}"] == 50


@pytest.mark.parametrize("names", [pytest.param((), marks=slow), ALL_NAMES])
def test_a_gripper_that_comes_before_the_arm_is_not_judged_for_it(domain, tmp_path: Path, names):
    plan = {"topics": {STATES: "gripper states"}, "messages": 40, "rate_hz": 200.0}
    _, said = recorded(domain, tmp_path, "--joint-states", STATES, *names, **plan)
    assert "80 messages captured, 80 written" in said


def test_a_signal_before_anything_is_published_ends_it_without_a_log(domain: int, tmp_path: Path):
    with recorder(tmp_path, *heard(domain), "--joint-states", STATES) as process:
        wait_until(lambda: list(tmp_path.iterdir()), "the recorder is there")
        _, trouble = ended(process, signal.SIGINT, 1)
    assert "stopped by a signal before it was published" in trouble
    assert not list(tmp_path.iterdir())


def test_raw_bytes_are_what_decoding_and_encoding_gives(domain: int):
    node = Node(domain, is_loopback=True)
    plan = {"messages": 20, "listeners": 2}
    with publishing(domain, topics={STATES: "states"}, **plan) as publisher:
        publisher_of = node.wait_for([STATES], LAST_RESORT_S, lambda: False)[STATES]
        raw, decoded = (node.subscribe(publisher_of, messages.JOINT_STATE) for _ in range(2))
        expect(publisher, "matched")
        expect(publisher, "sent")
        as_they_came = [(data, info.source_timestamp) for data, info in take_raw(raw._reader)]
        again = [(data, info.source_timestamp) for data, info in take_decoded(decoded._reader)]
    assert graph._PRIVATE_TAKE is not None
    assert len(again) == 20
    assert as_they_came == again


# ---- In a domain where much is published all the time

ANGLES = "/arm/out/joint_angles"
# What is published, kinds by topic.
CROWD = {
    "/other": "states",
    "/nameless": "nameless",
    "/new": "xcdr2",
    "/text": "text",
    ANGLES: "angles",
}
_RATE_HZ = 100


@pytest.fixture(scope="module")
def crowd() -> Iterator[int]:
    """A domain in which much is published, all of which this process knows already."""
    with (
        pytest.MonkeyPatch.context() as patch,
        free_domain() as number,
        publishing(number, topics=CROWD, rate_hz=_RATE_HZ, eager=True, longest_s=1200),
    ):
        patch.delenv("ROS_LOCALHOST_ONLY", raising=False)  # this process is there already
        node = Node(number, is_loopback=True)
        found = node.wait_for(CROWD, LAST_RESORT_S, lambda: False)
        assert found.keys() >= CROWD.keys()
        yield number


@pytest.mark.parametrize(
    ("topic", "options", "says"),
    [
        ("/other", (), ""),
        ("/nameless", ALL_NAMES, ""),  # messages without names get those that were told
        (ANGLES, (), f"no torques (effort) in {ANGLES}"),
    ],
)
def test_it_ends_after_so_many_seconds(record: Record, crowd, tmp_path: Path, topic, options, says):
    words = ("--domain", crowd, "-o", "a.mcap", "--seconds", 0.3, "--timeout", LAST_RESORT_S)
    result = record(*words, "--joint-states", topic.removeprefix("/"), *options)
    assert says in result.stderr
    assert result.stderr.count("\n") == bool(says)
    if says:
        return
    episode = read_episode(tmp_path / "a.mcap")
    position = episode.signals[f"{topic}.position"]
    first, count = round(float(position.values[0, 0]) * 1024), len(position.values)
    check_states(episode, int(position.stamps_ns[0]), count, _RATE_HZ, topic, first)
    assert episode.info.counts["captured"] == episode.info.counts["written"] == count
    assert "ended" not in episode.info.notes


def test_a_terminal_shows_rate_gaps_and_losses(crowd: int, tmp_path: Path):
    options = (*heard(crowd), "--joint-states", "/other")
    with (
        closing(Terminal()) as terminal,
        recorder(tmp_path, *options, stderr=terminal.theirs) as process,
    ):
        terminal.wait_for(r"recording: \d+message .*/other [\d.]+ Hz, (no|\d+) gap.*, 0 lost")
        ended(process, signal.SIGINT)


@pytest.mark.parametrize(
    ("topic", "options", "says"),
    [
        ("/nix", "--timeout 0.3", ("/nix", "/other (sensor_msgs/msg/JointState)")),
        ("/text", "", ("/text", "std_msgs/msg/String", "JointAngles")),
        ("/new", "--timeout 0.3", ("/new", "its publisher's encoding")),
        ("/other", f"--joint-names {NAMES[0]},elbow", ("no joint elbow", NAMES[6])),
        ("/nameless", "--joint-names a,b --seconds 0.3", ("7 joints", "has 2")),
        ("/other", "--joint-names elbow --seconds 0.3", "no joint elbow"),
    ],
)
def test_what_cannot_be_recorded_is_one_line(
    refuses: Refuses, crowd, topic: str, options: str, says
):
    asked = ("--domain", crowd, "--joint-states", topic, "--timeout", LAST_RESORT_S)
    refuses(1, *asked, *options.split(), says=says)


def test_where_nothing_is_published(refuses: Refuses, domain, monkeypatch: pytest.MonkeyPatch):
    says = (STATES, "no topic is published", "--domain")
    asked = ("--loopback", "--joint-states", STATES, "--timeout", 0.3)
    refuses(1, *asked, "--domain", domain, says=says)
    monkeypatch.setenv("ROS_DOMAIN_ID", "many")
    refuses(2, *asked, says="ROS_DOMAIN_ID: 'many'")


def test_without_cyclonedds_the_extra_is_named():
    code = (
        "import sys; sys.modules['cyclonedds'] = None; "
        "from tunenet_logs.recorders.cli import main; "
        "sys.exit(main(['--joint-states', '/joint_states']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert pip_install("ros2") in done.stderr


# ---- Rate and gaps of stamps, and the names of topics


def pace_of(stamps_s: np.ndarray) -> Pace:
    pace = Pace()
    for one in stamps_s:
        pace.add(round(one * 1e9))
    return pace


@pytest.mark.parametrize("rate_hz", [10.0, 65.0, 1000.0])
@pytest.mark.parametrize("lost", [(40, 60), (3, 8)])
def test_a_gap_is_found_whenever_it_is(rate_hz: float, lost: tuple[int, int]):
    rng = np.random.default_rng(1)
    stamps_s = (np.arange(500) + rng.uniform(-0.2, 0.2, 500)) / rate_hz
    late = stamps_s + np.where(np.arange(500) > 300, 1.0, 0.0)
    pace = pace_of(np.delete(late, slice(*lost)))
    gap_s = (lost[1] - lost[0] + 1) / rate_hz
    assert pace.gaps == 1 + (gap_s > 0.01)
    assert pace.longest_gap_s == pytest.approx(max(1 + 1 / rate_hz, gap_s), abs=0.5 / rate_hz)
    assert pace.rate_hz == pytest.approx(rate_hz, rel=0.05)
    assert pace.samples == 500 - (lost[1] - lost[0])


def test_nothing_is_said_of_a_few_samples_of_stamps_that_stand_still_and_of_repeats():
    for stamps_s in (np.arange(3.0), np.zeros(1000), np.zeros(0)):
        assert pace_of(stamps_s).in_words() == "0.0 Hz, no gap"
    pace = pace_of(np.repeat(np.arange(100) / 50.0, 3))
    assert (pace.in_words(), pace.samples) == ("50.0 Hz, no gap", 300)


@pytest.mark.parametrize("text", ["", "/", "a b", "/a//b", "/1a", "a/", "~a", "a" * 300, "/a\nb"])
def test_what_is_no_topic_is_refused(text: str):
    with pytest.raises(UsageError, match="topic"):
        checked_topic(text)
