"""Joint states in a domain where much is published all the time."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs the extra ros2")

from tests.conftest import Command
from tests.recorders.live_wait import LAST_RESORT_S, Terminal
from tests.recorders.ros2_publisher import NAMES, STATES, publishing, values_of
from tests.recorders.ros2_recorder import free_domain, recorder
from tunenet_logs.episode import Episode
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.ros2.graph import Node

pytestmark = pytest.mark.live

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


def recorded(command: Command, crowd: int, log: Path, *options: object) -> str:
    """Record for a moment, as part of the domain; what was said on stderr."""
    words = ("--domain", crowd, "-o", log, "--seconds", 0.3, "--timeout", LAST_RESORT_S)
    result = command("tunenet-record", *words, *options)
    assert result.returncode == 0, result.stderr
    return result.stderr


def check_states(episode: Episode, topic: str) -> None:
    """Check that the log holds every message of a topic from one on, and nothing else."""
    position = episode.signals[f"{topic}.position"]
    numbers = np.round(position.values[:, 0] * 1024).astype(int)
    assert np.array_equal(numbers, numbers[0] + np.arange(len(numbers)))
    assert np.all(np.diff(position.stamps_ns) == 1_000_000_000 // _RATE_HZ)
    for part, label in enumerate(("position", "velocity", "effort")):
        one = episode.signals[f"{topic}.{label}"]
        assert one.columns == NAMES
        assert np.array_equal(one.values, [values_of(number)[part] for number in numbers])
    counts = episode.info.counts
    assert counts["captured"] == counts["written"] == counts[f"received.{topic}"] == len(numbers)


def test_it_ends_after_so_many_seconds(command: Command, crowd: int, tmp_path: Path):
    assert not recorded(command, crowd, tmp_path / "a.mcap", "--joint-states", "/other")
    episode = read_episode(tmp_path / "a.mcap")
    check_states(episode, "/other")
    assert "ended" not in episode.info.notes


def test_a_terminal_shows_rate_gaps_and_losses(crowd: int, tmp_path: Path):
    with (
        closing(Terminal()) as terminal,
        recorder(crowd, tmp_path, "--joint-states", "/other", stderr=terminal.theirs) as process,
    ):
        terminal.wait_for(r"recording: \d+message .*/other [\d.]+ Hz, (no|\d+) gap.*, 0 lost")
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=LAST_RESORT_S)
    assert process.returncode == 0


def test_messages_without_names_get_those_that_were_told(
    command: Command, crowd: int, tmp_path: Path
):
    options = ("--joint-states", "nameless", "--joint-names", ",".join(NAMES))
    assert not recorded(command, crowd, tmp_path / "a.mcap", *options)
    check_states(read_episode(tmp_path / "a.mcap"), "/nameless")


def test_torques_that_are_missing_are_missed_at_once(command: Command, crowd: int, tmp_path: Path):
    said = recorded(command, crowd, tmp_path / "a.mcap", "--joint-states", ANGLES)
    assert said.count("\n") == 1
    assert f"no torques (effort) in {ANGLES}" in said


def check_refused(command: Command, folder: Path, *options: object) -> str:
    """Check that a recording is refused in one line and leaves no log; what it says."""
    result = command("tunenet-record", *options, cwd=folder)
    assert result.returncode == 1
    assert not result.stdout
    assert result.stderr.count("\n") == 1
    assert not list(folder.iterdir())
    return result.stderr


@pytest.mark.parametrize(
    ("topic", "options", "words"),
    [
        ("/nix", ["--timeout", "0.3"], ("/nix", "/other (sensor_msgs/msg/JointState)")),
        ("/text", [], ("/text", "std_msgs/msg/String", "JointAngles")),
        ("/new", ["--timeout", "0.3"], ("/new", "its publisher's encoding")),
        ("/other", ["--joint-names", f"{NAMES[0]},elbow"], ("no joint elbow", NAMES[6])),
        ("/nameless", ["--joint-names", "a,b", "--seconds", "0.3"], ("7 joints", "has 2")),
        ("/other", ["--joint-names", "elbow", "--seconds", "0.3"], ("no joint elbow",)),
    ],
    ids=["another-topic", "type", "xcdr2", "names", "nameless", "names-short"],
)
def test_what_cannot_be_recorded_is_one_line_and_no_log(
    command: Command,
    crowd: int,
    tmp_path: Path,
    topic: str,
    options: list[str],
    words: tuple[str, ...],
):
    patience = ("--timeout", LAST_RESORT_S)
    asked = ("--domain", crowd, "--joint-states", topic, *patience, *options)
    said = check_refused(command, tmp_path, *asked)
    assert all(one in said for one in words), said


def test_where_nothing_is_published_that_is_told(command: Command, tmp_path: Path):
    asked = ("--loopback", "--joint-states", STATES, "--timeout", 0.3)
    with free_domain() as domain:
        said = check_refused(command, tmp_path, *asked, "--domain", domain)
    assert all(one in said for one in (STATES, "no topic is published", "--domain"))
