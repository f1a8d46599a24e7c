"""Joint states live from ROS 2: publishers and recorders are processes, DDS is between them."""

from __future__ import annotations

import fcntl
import itertools
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

pytest.importorskip("cyclonedds", reason="needs the extra ros2")

from recorders.ros2 import subscription
from recorders.ros2.node import Node
from recorders.ros2.subscription import take_decoded, take_raw
from tests.conftest import BIN, Command
from tests.recorders.ros2_publisher import (
    NAMES,
    STATES,
    TORQUES,
    expect,
    publishing,
    values_of,
)
from tunenet_logs import messages
from tunenet_logs.episode import Episode
from tunenet_logs.reader import read_episode

pytestmark = pytest.mark.live

_numbers = itertools.count(os.getpid())
_CLOCK_NS = 10_000_000
"""What a wall clock may be set by while a test runs."""


@pytest.fixture
def domain() -> int:
    """A domain of its own, so that no test hears another."""
    return 1 + next(_numbers) % 100


def recorder(
    domain: int, folder: Path, *options: object, stderr: int = subprocess.PIPE
) -> subprocess.Popen[str]:
    """The command, recording a.mcap on the loopback interface."""
    words = [BIN / "tunenet-record", "--loopback", "--domain", domain, "-o", "a.mcap", *options]
    return subprocess.Popen(
        [str(one) for one in words], cwd=folder, text=True, stdout=subprocess.PIPE, stderr=stderr
    )


def ended(process: subprocess.Popen[str], number: int = 0) -> tuple[str, str]:
    """What a recorder said, on stdout and stderr; sends it a signal before, if that is one."""
    if number:
        process.send_signal(number)
    said = process.communicate(timeout=60)
    assert process.returncode == 0, said
    return said


def check_states(episode: Episode, first_ns: int, count: int, rate_hz: float = 1000.0) -> None:
    """Check that the log holds the messages 0 to count - 1, each with its stamp and values."""
    stamps_ns = first_ns + np.round(np.arange(count) * 1e9 / rate_hz).astype(np.int64)
    for part, label in enumerate(("position", "velocity", "effort")):
        one = episode.signals[f"{STATES}.{label}"]
        assert one.columns == NAMES
        assert np.array_equal(one.stamps_ns, stamps_ns)
        assert np.array_equal(one.values, [values_of(number)[part] for number in range(count)])


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_recorder_that_is_stopped_twice_has_every_message(
    domain: int, tmp_path: Path, number: int
):
    count = 3000
    with publishing(domain, topics={STATES: "states"}, messages=count) as publisher:
        process = recorder(domain, tmp_path, "--joint-states", STATES)
        expect(publisher, "matched")
        for _ in range(2):
            time.sleep(0.4)
            process.send_signal(signal.SIGSTOP)
            time.sleep(0.5)
            process.send_signal(signal.SIGCONT)
        first_ns = int(expect(publisher, "sent")[0])
        said, trouble = ended(process, number)
    episode = read_episode(tmp_path / "a.mcap")
    check_states(episode, first_ns, count)
    assert not episode.warnings
    assert not trouble
    assert f"{count} messages captured, {count} written, 0 dropped" in said
    assert (episode.info.kind, episode.info.source) == ("payload", f"ros2 {STATES}")
    assert episode.info.counts[f"received.{STATES}"] == count
    assert episode.info.counts[f"lost.{STATES}"] == 0
    assert episode.info.notes["ended"] == "stopped by a signal"


def test_messages_go_in_as_they_came_with_the_times_of_sending_and_receipt(
    domain: int, tmp_path: Path
):
    with publishing(domain, topics={STATES: "states"}, messages=200) as publisher:
        process = recorder(domain, tmp_path, "--joint-states", STATES.removeprefix("/"))
        expect(publisher, "matched")
        expect(publisher, "sent")
        ended(process, signal.SIGINT)
    with (tmp_path / "a.mcap").open("rb") as file:
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
    assert len(found) == 200


@pytest.mark.parametrize("multicast", [True, False])
def test_a_best_effort_publisher_that_is_killed_leaves_what_came(
    domain: int, tmp_path: Path, multicast: bool
):
    plan = {"messages": 300, "rate_hz": 200.0, "reliable": False, "multicast": multicast}
    with publishing(domain, topics={STATES: "states"}, **plan) as publisher:
        process = recorder(domain, tmp_path, "--joint-states", STATES, "--timeout", 2)
        expect(publisher, "matched")
        first_ns = int(expect(publisher, "sent")[0])
        publisher.kill()
        said, trouble = ended(process)
    check_states(read_episode(tmp_path / "a.mcap"), first_ns, 300, 200.0)
    assert "300 written" in said
    assert f"no message on {STATES} for 2.0 s" in said
    assert not trouble


def test_positions_and_torques_apart_as_kinovas_driver_publishes_them(domain: int, tmp_path: Path):
    topics = {STATES: "states", TORQUES: "angles"}
    with publishing(domain, topics=topics, messages=50, rate_hz=50.0) as publisher:
        names = ",".join(NAMES)
        options = ["--joint-states", STATES, "--joint-states", TORQUES, "--joint-names", names]
        process = recorder(domain, tmp_path, *options)
        expect(publisher, "matched")
        first_ns = int(expect(publisher, "sent")[0])
        said, trouble = ended(process, signal.SIGTERM)
    assert not trouble
    assert "100 messages captured, 100 written" in said
    episode = read_episode(tmp_path / "a.mcap")
    check_states(episode, first_ns, 50, 50.0)
    torques = episode.signals[f"{TORQUES}.effort"]
    assert torques.columns == NAMES
    assert torques.unit == "N·m"
    assert np.array_equal(torques.values, [values_of(number)[2] for number in range(50)])
    late_ns = torques.stamps_ns - episode.signals[f"{STATES}.effort"].stamps_ns
    assert np.all(late_ns > -_CLOCK_NS)
    counts = episode.info.counts
    assert [counts[f"received.{one}"] for one in topics] == [50, 50]


def test_the_end_by_time_and_the_progress_on_a_terminal(domain: int, tmp_path: Path):
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 200, 0, 0))
    with publishing(domain, topics={STATES: "states"}, messages=1500) as publisher:
        process = recorder(
            domain, tmp_path, "--joint-states", STATES, "--seconds", 1.2, stderr=theirs
        )
        expect(publisher, "matched")
        process.communicate(timeout=60)
    os.close(theirs)
    shown = os.read(ours, 100_000).decode()
    os.close(ours)
    assert process.returncode == 0
    assert re.search(rf"recording: \d+message .*{STATES} [\d.]+ Hz, (no|\d+) gap.*, 0 lost", shown)
    episode = read_episode(tmp_path / "a.mcap")
    assert 0 < episode.info.counts["written"] <= 1500
    assert "ended" not in episode.info.notes


def test_messages_without_names_get_those_that_were_told(domain: int, tmp_path: Path):
    with publishing(domain, topics={STATES: "nameless"}, messages=50, rate_hz=100.0) as publisher:
        options = ["--joint-states", STATES, "--joint-names", ",".join(NAMES)]
        process = recorder(domain, tmp_path, *options)
        expect(publisher, "matched")
        first_ns = int(expect(publisher, "sent")[0])
        ended(process, signal.SIGINT)
    check_states(read_episode(tmp_path / "a.mcap"), first_ns, 50, 100.0)


@pytest.mark.parametrize("names", [[], ["--joint-names", ",".join(NAMES)]])
def test_a_gripper_that_comes_before_the_arm_is_not_judged_for_it(
    domain: int, tmp_path: Path, names: list[str]
):
    topics = {STATES: "gripper states"}
    with publishing(domain, topics=topics, messages=40, rate_hz=100.0) as publisher:
        process = recorder(domain, tmp_path, "--joint-states", STATES, *names)
        expect(publisher, "matched")
        expect(publisher, "sent")
        said, trouble = ended(process, signal.SIGINT)
    assert not trouble
    assert "80 messages captured, 80 written" in said


def test_torques_that_are_missing_are_missed_at_once(domain: int, tmp_path: Path):
    topic = "/arm/out/joint_angles"
    with publishing(domain, topics={topic: "angles"}, messages=50, rate_hz=100.0) as publisher:
        process = recorder(domain, tmp_path, "--joint-states", topic)
        expect(publisher, "matched")
        expect(publisher, "sent")
        _, trouble = ended(process, signal.SIGINT)
    assert trouble.count("\n") == 1
    assert f"no torques (effort) in {topic}" in trouble


@pytest.mark.parametrize(
    ("plan", "options", "words"),
    [
        ({"topics": {"/other": "states"}}, [], (STATES, "/other (sensor_msgs/msg/JointState)")),
        ({"topics": {}}, [], (STATES, "no topic is published", "--domain")),
        ({"topics": {STATES: "text"}}, [], (STATES, "std_msgs/msg/String", "JointAngles")),
        ({"topics": {STATES: "states"}, "xcdr2": True}, [], (STATES, "its publisher's encoding")),
        (
            {"topics": {STATES: "states"}},
            ["--joint-names", f"{NAMES[0]},elbow"],
            ("no joint elbow", NAMES[6]),
        ),
        ({"topics": {STATES: "nameless"}}, ["--joint-names", "a,b"], ("7 joints", "has 2")),
        (
            {"topics": {STATES: "states"}, "messages": 10},
            ["--joint-names", "elbow", "--seconds", "0.3"],
            ("no joint elbow",),
        ),
    ],
    ids=["another-topic", "no-topic", "type", "xcdr2", "names", "nameless", "names-short"],
)
def test_what_cannot_be_recorded_is_one_line_and_no_log(
    domain: int, tmp_path: Path, plan: dict, options: list[str], words: tuple[str, ...]
):
    with publishing(domain, **{"messages": 5000, "rate_hz": 100.0, **plan}):
        process = recorder(domain, tmp_path, "--joint-states", STATES, "--timeout", 2, *options)
        said, trouble = process.communicate(timeout=60)
    assert process.returncode == 1
    assert not said
    assert trouble.count("\n") == 1
    assert all(one in trouble for one in words), trouble
    assert not list(tmp_path.iterdir())


def test_a_signal_before_anything_is_published_ends_it_without_a_log(domain: int, tmp_path: Path):
    process = recorder(domain, tmp_path, "--joint-states", STATES, "--timeout", 60)
    while not list(tmp_path.iterdir()):
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, trouble = process.communicate(timeout=60)
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
    with publishing(domain, topics={STATES: "states"}, messages=20, rate_hz=100.0) as publisher:
        publisher_of = node.wait_for([STATES], 20.0, lambda: False)[STATES]
        raw, decoded = (node.subscribe(publisher_of, messages.JOINT_STATE) for _ in range(2))
        expect(publisher, "matched")
        expect(publisher, "sent")
        as_they_came = [(data, info.source_timestamp) for data, info in take_raw(raw._reader)]
        again = [(data, info.source_timestamp) for data, info in take_decoded(decoded._reader)]
    assert subscription._PRIVATE_TAKE is not None
    assert len(again) > 15  # the second one may have matched later
    assert as_they_came[-len(again) :] == again


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
        "import sys; sys.modules['cyclonedds'] = None; from recorders.cli import main; "
        "sys.exit(main(['--joint-states', '/joint_states']))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert "pip install 'tunenet-logs[ros2]'" in result.stderr
    assert not list(tmp_path.iterdir())
