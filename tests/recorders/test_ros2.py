"""Joint states live from ROS 2: publishers and recorders are processes, DDS is between them."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

pytest.importorskip("cyclonedds", reason="needs the extra ros2")

from tests.conftest import Command
from tests.recorders.live_wait import LAST_RESORT_S, wait_until
from tests.recorders.ros2_publisher import (
    NAMES,
    STATES,
    TORQUES,
    expect,
    go_on,
    publishing,
    values_of,
)
from tests.recorders.ros2_recorder import ended, free_domain, recorder
from tunenet_logs import messages
from tunenet_logs.episode import Episode
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.ros2 import graph as subscription
from tunenet_logs.recorders.ros2.graph import Node, take_decoded, take_raw

pytestmark = pytest.mark.live
slow = pytest.mark.slow

_CLOCK_NS = 10_000_000  # what a wall clock may be set by while a test runs


@pytest.fixture
def domain() -> Iterator[int]:
    """A domain of its own, so that no test hears another."""
    with free_domain() as number:
        yield number


def check_states(episode: Episode, first_ns: int, count: int, rate_hz: float = 1000.0) -> None:
    """Check that the log holds the messages 0 to count - 1, each with its stamp and values."""
    stamps_ns = first_ns + np.round(np.arange(count) * 1e9 / rate_hz).astype(np.int64)
    for part, label in enumerate(("position", "velocity", "effort")):
        one = episode.signals[f"{STATES}.{label}"]
        assert one.columns == NAMES
        assert np.array_equal(one.stamps_ns, stamps_ns)
        assert np.array_equal(one.values, [values_of(number)[part] for number in range(count)])


@dataclass(frozen=True)
class Stopped:
    """A recording of 1000 messages at 1 kHz whose recorder was stopped twice meanwhile."""

    log: Path
    first_ns: int
    said: str
    trouble: str


@pytest.fixture(scope="module", params=[signal.SIGINT, pytest.param(signal.SIGTERM, marks=slow)])
def stopped(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Stopped:
    folder = tmp_path_factory.mktemp("stopped")
    plan = {"topics": {STATES: "states"}, "messages": 1000, "pauses": [300, 500, 700, 900]}
    with (
        free_domain() as domain,
        publishing(domain, **plan) as publisher,
        recorder(domain, folder, "--joint-states", STATES) as process,
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


def test_a_recorder_that_is_stopped_twice_has_every_message(stopped: Stopped):
    episode = read_episode(stopped.log)
    check_states(episode, stopped.first_ns, 1000)
    assert not episode.warnings
    assert not stopped.trouble
    assert "1000 messages captured, 1000 written, 0 dropped" in stopped.said
    assert (episode.info.kind, episode.info.source) == ("payload", f"ros2 {STATES}")
    assert episode.info.counts[f"received.{STATES}"] == 1000
    assert episode.info.counts[f"lost.{STATES}"] == 0
    assert episode.info.notes["ended"] == "stopped by a signal"


def test_messages_go_in_as_they_came_with_the_times_of_sending_and_receipt(stopped: Stopped):
    with stopped.log.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = list(reader.iter_messages())
    store = messages.typestore()
    before_ns = 0
    for number, (schema, channel, message) in enumerate(found):
        assert schema is not None
        assert (channel.topic, schema.name) == (STATES, messages.JOINT_STATE)
        state: Any = store.deserialize_cdr(message.data, messages.JOINT_STATE)
        assert message.data == bytes(store.serialize_cdr(state, messages.JOINT_STATE))
        assert state.header.frame_id == "base"
        assert state.position.tolist() == values_of(number)[0]
        stamp_ns = state.header.stamp.sec * 1_000_000_000 + state.header.stamp.nanosec
        assert stamp_ns - _CLOCK_NS < message.publish_time < message.log_time + _CLOCK_NS
        assert message.publish_time > before_ns
        before_ns = message.publish_time
    assert len(found) == 1000


@pytest.mark.parametrize("multicast", [pytest.param(True, marks=slow), False])
def test_a_best_effort_publisher_that_is_killed_leaves_what_came(
    domain: int, tmp_path: Path, multicast: bool
):
    plan = {"messages": 100, "reliable": False, "multicast": multicast}
    with (
        publishing(domain, topics={STATES: "states"}, **plan) as publisher,
        recorder(domain, tmp_path, "--joint-states", STATES, "--timeout", 2) as process,
    ):
        expect(publisher, "matched")
        first_ns = int(expect(publisher, "sent")[0])
        publisher.kill()
        said, trouble = ended(process)
    check_states(read_episode(tmp_path / "a.mcap"), first_ns, 100)
    assert "100 written" in said
    silent = re.search(rf"no message on {STATES} for ([\d.]+) s", said)
    assert silent is not None
    assert float(silent.group(1)) >= 2.0
    assert not trouble


def test_positions_and_torques_apart_as_kinovas_driver_publishes_them(domain: int, tmp_path: Path):
    topics = {STATES: "states", TORQUES: "angles"}
    options = ["--joint-states", STATES, "--joint-states", TORQUES]
    options += ["--joint-names", ",".join(NAMES)]
    with (
        publishing(domain, topics=topics, messages=50, rate_hz=200.0) as publisher,
        recorder(domain, tmp_path, *options) as process,
    ):
        expect(publisher, "matched")
        first_ns = int(expect(publisher, "sent")[0])
        said, trouble = ended(process, signal.SIGTERM)
    assert not trouble
    assert "100 messages captured, 100 written" in said
    episode = read_episode(tmp_path / "a.mcap")
    check_states(episode, first_ns, 50, 200.0)
    torques = episode.signals[f"{TORQUES}.effort"]
    assert torques.columns == NAMES
    assert torques.unit == "N·m"
    assert np.array_equal(torques.values, [values_of(number)[2] for number in range(50)])
    late_ns = torques.stamps_ns - episode.signals[f"{STATES}.effort"].stamps_ns
    assert np.all(late_ns > -_CLOCK_NS)
    counts = episode.info.counts
    assert [counts[f"received.{one}"] for one in topics] == [50, 50]


@pytest.mark.parametrize(
    "names", [pytest.param([], marks=slow), ["--joint-names", ",".join(NAMES)]]
)
def test_a_gripper_that_comes_before_the_arm_is_not_judged_for_it(
    domain: int, tmp_path: Path, names: list[str]
):
    topics = {STATES: "gripper states"}
    with (
        publishing(domain, topics=topics, messages=40, rate_hz=200.0) as publisher,
        recorder(domain, tmp_path, "--joint-states", STATES, *names) as process,
    ):
        expect(publisher, "matched")
        expect(publisher, "sent")
        said, trouble = ended(process, signal.SIGINT)
    assert not trouble
    assert "80 messages captured, 80 written" in said


def test_a_signal_before_anything_is_published_ends_it_without_a_log(domain: int, tmp_path: Path):
    with recorder(domain, tmp_path, "--joint-states", STATES) as process:
        wait_until(lambda: list(tmp_path.iterdir()), "the recorder is there")
        process.send_signal(signal.SIGINT)
        _, trouble = process.communicate(timeout=LAST_RESORT_S)
    assert process.returncode == 1
    assert "stopped by a signal before it was published" in trouble
    assert not list(tmp_path.iterdir())


def test_a_log_that_exists_stays(command: Command, tmp_path: Path):
    (tmp_path / "a.mcap").write_bytes(b"mine")
    result = command(
        "tunenet-record", "--loopback", "--joint-states", STATES, "-o", "a.mcap", cwd=tmp_path
    )
    assert result.returncode == 1
    assert "a.mcap: exists" in result.stderr
    assert (tmp_path / "a.mcap").read_bytes() == b"mine"


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
    assert subscription._PRIVATE_TAKE is not None
    assert len(again) == 20
    assert as_they_came == again


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["--joint-states", "joint states"], "'joint states'"),
        (["--joint-states", ","], "0 topics"),
        (["--joint-states", "a", "--domain", "233"], "'233'"),
        (["--joint-states", "a", "--timeout", "0"], "'0'"),
        (["--joint-states", "a", "--joint-names", "a,,b"], "--joint-names"),
        (["--joint-states", "a", "--joint-names", "a,a"], "twice"),
        (["--joint-states", "a", "--rate", "50"], "--rate"),
        (["--joint-states", "a", "--ball", "red"], "--ball"),
        (["--joint-states", "a", "--height", "1"], "--height"),
        (["--joint-states", "a", "--simulate", "drop"], "--simulate"),
        (["--simulate", "drop", "--domain", "3"], "--domain"),
        (["--camera", "a.mp4", "--loopback"], "--loopback"),
    ],
)
def test_options_that_make_no_sense_are_one_line(
    command: Command, tmp_path: Path, words: list[str], names: str
):
    result = command("tunenet-record", *words, cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert names in result.stderr
    assert not list(tmp_path.iterdir())


def test_a_domain_of_the_environment_is_checked(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("ROS_DOMAIN_ID", "many")
    result = command("tunenet-record", "--joint-states", STATES, cwd=tmp_path)
    assert result.returncode == 2
    assert "ROS_DOMAIN_ID: 'many'" in result.stderr


def test_without_cyclonedds_the_extra_is_named(tmp_path: Path):
    code = (
        "import sys; sys.modules['cyclonedds'] = None; "
        "from tunenet_logs.recorders.cli import main; "
        "sys.exit(main(['--joint-states', '/joint_states']))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert "pip install 'tunenet-logs[ros2]'" in result.stderr
    assert not list(tmp_path.iterdir())
