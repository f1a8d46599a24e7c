"""Several streams in one log: nothing lost, whatever ends the recording; and their queue."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import files_no_larger_than
from tests.recorders.live_recorder import (
    JOINTS,
    NAMES,
    PICTURES,
    Progress,
    check_whole_file,
    found_in,
    frame_of,
    joints_of,
    missing_s,
    started,
)  # fmt: skip
from tests.recorders.live_wait import LAST_RESORT_S, ending, wait_until
from tunenet_logs import messages
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.errors import LogError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.session import LiveRecording, TopicQueue, record_episode
from tunenet_logs.recorders.simulated import DropOrder, simulate_drop
from tunenet_logs.terminal import Bar
from tunenet_logs.terminal import Progress as Bars
from tunenet_logs.timing.stamps import now_ns

pytestmark = pytest.mark.live
slow = pytest.mark.slow

INFO = EpisodeInfo(kind="test")


def wait_for_joints(folder: Path, count: int) -> None:
    """Wait until a recorder has put so many states of the arm."""
    row = Progress(folder / "progress").row(JOINTS)
    wait_until(lambda: row[0] >= count, f"{count} states of the arm")


@pytest.mark.parametrize(
    "joints", [100, 400, 1000, *(pytest.param(one, marks=slow) for one in (1, 250, 1500))]
)
def test_killed_it_has_all_that_was_acknowledged(tmp_path: Path, joints: int):
    with ending(started(tmp_path)) as process:
        wait_for_joints(tmp_path, joints)
        process.kill()
        process.communicate()
    missing_s(tmp_path, tmp_path / "a.mcap.active")


@pytest.mark.parametrize(
    ("number", "joints"),
    [
        (signal.SIGINT, 0),
        (signal.SIGTERM, 250),
        pytest.param(signal.SIGTERM, 0, marks=slow),
        pytest.param(signal.SIGINT, 250, marks=slow),
    ],
)
def test_a_signal_ends_it_whole_and_every_count_agrees(tmp_path: Path, number: int, joints: int):
    with ending(started(tmp_path)) as process:
        wait_for_joints(tmp_path, joints)
        process.send_signal(number)
        said, _ = process.communicate(timeout=LAST_RESORT_S)
    assert process.returncode == 0
    check_whole_file(tmp_path / "a.mcap", said)
    progress = Progress(tmp_path / "progress")
    found = found_in(tmp_path / "a.mcap")
    assert {topic: one.messages for topic, one in found.items()} == {
        topic: int(progress.row(topic)[0]) for topic in found
    }


def test_after_a_tenth_of_a_second_it_is_on_disk_although_nothing_more_comes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    class Clock:
        """The writer's, which the test turns."""

        now_s = 0.0

        def monotonic(self) -> float:
            return self.now_s

    clock = Clock()
    monkeypatch.setattr("tunenet_logs.writing.writer.time", clock)
    with LiveRecording(tmp_path / "a.mcap", INFO) as recording:
        for number in range(3):
            recording.put_joints(JOINTS, now_ns(), NAMES, *joints_of(number))
            wait_until(lambda: recording._writer.accepted == recording.captured, "it is taken")
            clock.now_s += 0.101
            wait_until(lambda: recording.written == recording.captured, "it is on disk")
            found = found_in(tmp_path / "a.mcap.active")[JOINTS]
            assert (found.messages, found.wrong) == (number + 1, 0)


def test_any_message_that_is_encoded_already_goes_in_as_it_is(tmp_path: Path):
    pose = messages.encode(messages.pose(5, "world", np.arange(3.0)), messages.POSE)
    pixels = bytes(range(24))
    with LiveRecording(tmp_path / "a.mcap", INFO) as recording:
        assert recording.put_message("/pose", messages.POSE, 5, pose)
        assert recording.put_frame("/raw", Frame(5, "rgb8", pixels, (4, 2)))
        with pytest.raises(ValueError, match="holds geometry_msgs/msg/PoseStamped"):
            recording.put_frame("/pose", Frame(6, "jpeg", b""))
        with pytest.raises(ValueError, match="no message type"):
            recording.put_message("/x", "my_msgs/msg/Nix", 5, b"")
        with pytest.raises(ValueError, match="7 joints have values of shape"):
            recording.put_joints(JOINTS, 5, NAMES, [1.0, 2.0])
    assert not recording.put_message("/pose", messages.POSE, 6, pose)
    assert recording.summary.in_words("messages") == "2 messages captured, 2 written, 0 dropped"
    assert np.array_equal(
        read_episode(tmp_path / "a.mcap").signals["/pose"].values, np.arange(3.0)[None]
    )


def test_the_first_write_error_ends_it_and_says_how_much_is_kept(tmp_path: Path):
    recording = LiveRecording(tmp_path / "a.mcap", INFO)
    number = 0
    with files_no_larger_than(500_000):
        while recording.put_frame(PICTURES, Frame(1 + number, "jpeg", frame_of(number))):
            number += 1
            time.sleep(0.001)  # as a camera does
        assert recording.wait(LAST_RESORT_S)
    with pytest.raises(LogError, match=r"writing failed .* kept in a\.mcap") as caught:
        recording.close()
    episode = read_episode(tmp_path / "a.mcap")
    frames = [frame.data for frame in episode.frames()]
    counts = episode.info.counts
    assert frames == [frame_of(index) for index in range(len(frames))]
    assert len(frames) > 1
    assert counts["captured"] == number == counts["written"] + counts["dropped"]
    assert counts["written"] == len(frames) == recording.summary.written
    assert f"{len(frames)} of {number} messages are kept" in str(caught.value)
    assert not episode.warnings


def test_what_comes_too_fast_is_dropped_and_counted_by_topic(tmp_path: Path):
    recording = LiveRecording(tmp_path / "a.mcap", INFO, queue_bytes=100_000)
    number = 0
    while recording.dropped < 100:
        recording.put_frame(PICTURES, Frame(1 + number, "jpeg", frame_of(number)))
        recording.put_joints(JOINTS, 1 + number, NAMES, *joints_of(number))
        number += 1
        assert number < 100_000
    summary = recording.close()
    counts = read_episode(tmp_path / "a.mcap").info.counts
    assert summary.captured == 2 * number == summary.written + summary.dropped
    assert summary.dropped == sum(counts.get(f"dropped.{one}", 0) for one in (PICTURES, JOINTS))
    assert counts[f"dropped.{PICTURES}"] > 0
    found = found_in(tmp_path / "a.mcap")
    assert sum(one.messages for one in found.values()) == summary.written == counts["written"]


def test_a_recording_that_is_discarded_leaves_nothing(tmp_path: Path):
    recording = LiveRecording(tmp_path / "a.mcap", INFO)
    recording.put_joints(JOINTS, 7, NAMES, *joints_of(0))
    recording.discard()
    assert not list(tmp_path.iterdir())


def test_what_a_recorder_counts_is_in_the_log(tmp_path: Path):
    with LiveRecording(tmp_path / "a.mcap", INFO) as recording:
        recording.put_joints(JOINTS, 7, NAMES, *joints_of(0))
        recording.count(f"gaps.{JOINTS}", 3)
    assert read_episode(tmp_path / "a.mcap").info.counts[f"gaps.{JOINTS}"] == 3


# ---- What is simulated


class StopsAfter(Bars):
    """Sends a real signal to this process after so many samples."""

    def __init__(self, samples: int) -> None:
        super().__init__(quiet=True)
        self.left = samples

    @contextmanager
    def bar(self, total: int | None, what: str, unit: str) -> Iterator[Bar]:
        yield self

    def set_postfix_str(self, text: str, /, *, refresh: bool) -> None:
        pass

    def update(self, done: int, /) -> None:
        self.left -= done
        if self.left == 0:
            os.kill(os.getpid(), signal.SIGTERM)


def test_a_signal_ends_the_recording_of_a_simulation_whole(tmp_path: Path):
    path, before = tmp_path / "a.mcap", signal.getsignal(signal.SIGTERM)
    episode = simulate_drop(DropOrder(seed=1))
    summary = record_episode(episode, path, overwrite=False, progress=StopsAfter(100))
    back = read_episode(path)
    assert summary.captured == summary.written == back.info.counts["written"] == 100
    assert len(back.signals["/ball/pose"].values) == 100
    assert summary.ended
    assert "signal" in back.info.notes["ended"]
    assert not back.warnings
    assert signal.getsignal(signal.SIGTERM) is before


# ---- The queue between a source and the writer


def taken(queue: TopicQueue) -> list:
    return list(iter(queue.take, None))


def test_a_queue_is_bounded_in_bytes_over_all_topics():
    queue: TopicQueue[str] = TopicQueue(100, drops=True)
    for topic, stamp_ns, size in (("/a", 0, 40), ("/a", 1, 40), ("/a", 2, 40), ("/b", 5, 20)):
        assert queue.put(topic, stamp_ns, "x", size)
    assert queue.put("/b", 6, "y", 1)
    assert (queue.tally("/a").captured, queue.tally("/a").dropped) == (3, 1)
    assert (queue.tally("/b").captured, queue.tally("/b").dropped) == (2, 1)
    queue.close()
    assert not queue.put("/a", 9, "x", 1)
    assert [(item.topic, item.stamp_ns) for item in taken(queue)] == [
        ("/a", 0),
        ("/a", 1),
        ("/b", 5),
    ]
    assert queue.is_done
    assert (queue.captured, queue.dropped) == (5, 2)
    queue = TopicQueue(100, drops=True)  # a message larger than the bound passes alone
    queue.put("/a", 0, "large", 1000)
    queue.put("/a", 1, "small", 1)
    assert (queue.dropped, [item.payload for item in taken(queue)]) == (1, ["large"])
    queue = TopicQueue(1000, drops=True)  # receipts never run backwards
    for number, received_ns in enumerate((5, 3, 9)):
        queue.put("/a", number, "x", 1, received_ns)
    assert [item.received_ns for item in taken(queue)] == [5, 5, 9]


def test_a_queue_that_must_not_drop_makes_the_source_wait():
    queue: TopicQueue[int] = TopicQueue(100, drops=False)

    def fill() -> None:
        for index in range(10):
            queue.put("/a", index, index, 60)
        queue.close()

    thread = threading.Thread(target=fill)
    thread.start()
    seen: list[int] = []
    while not queue.is_done:
        item = queue.take()
        if item is None:
            queue.pause()
        else:
            seen.append(item.payload)
            assert queue.captured <= len(seen) + 1  # the next one, at most, waits inside
    thread.join()
    assert (seen, queue.dropped) == (list(range(10)), 0)
