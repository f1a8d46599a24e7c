"""Several streams in one log: nothing lost, whatever ends it or is done to its file."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from tests.recorders.live_recorder import (
    ATTACKS,
    JOINTS,
    NAMES,
    OF_OURS,
    PICTURES,
    attack,
    check_whole_file,
    contend,
    contenders,
    found_in,
    frame_of,
    joints_of,
    missing_s,
    progress_of,
    started,
)  # fmt: skip
from tests.recorders.live_wait import LAST_RESORT_S, Terminal, ended, ending, recorder, wait_until
from tests.recorders.mjpeg_camera import playing
from tunenet_logs import messages
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.errors import LogError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.session import LiveRecording, TopicQueue
from tunenet_logs.timing.stamps import now_ns
from tunenet_logs.writing.owned_path import ClaimedName
from tunenet_logs.writing.writer import EpisodeWriter

pytestmark = pytest.mark.live
slow = pytest.mark.slow

INFO = EpisodeInfo(kind="test")


def wait_for_joints(folder: Path, count: int) -> None:
    row = progress_of(folder, JOINTS)
    wait_until(lambda: row[0] >= count, f"{count} states of the arm")


@pytest.mark.parametrize(
    "joints", [100, 400, 1000, *(pytest.param(one, marks=slow) for one in (1, 250, 1500))]
)
def test_killed_it_has_all_that_was_acknowledged(tmp_path: Path, joints: int):
    with ending(started(tmp_path)) as process:
        wait_for_joints(tmp_path, joints)
        ended(process, signal.SIGKILL, -signal.SIGKILL)
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
        check_whole_file(tmp_path / "a.mcap", ended(process, number)[0])
    found = found_in(tmp_path / "a.mcap")
    assert {topic: one.messages for topic, one in found.items()} == {
        topic: int(progress_of(tmp_path, topic)[0]) for topic in found
    }


def test_it_is_on_disk_after_a_tenth_of_a_second(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
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


# ---- A recording's file is its own: two writers to one name, and files that are taken away


@pytest.mark.live
def test_of_two_writers_to_one_name_one_wins_and_the_other_refuses(tmp_path: Path):
    rng = random.Random(1)
    with contenders(2) as both:
        for number in range(40):
            overwrite = number % 2 == 1
            left = rng.choice(["", "log", "active"] if overwrite else [""])
            contend(both, tmp_path, rng, overwrite=overwrite, left=left)


@pytest.mark.live
@pytest.mark.parametrize(
    ("how", "ends"),
    [
        *((how, False) for how in ATTACKS),
        *(
            pytest.param(how, True, marks=[pytest.mark.slow] * (how != "removed"))
            for how in ATTACKS
        ),
    ],
)
def test_a_file_that_is_taken_away_loses_nothing(tmp_path: Path, how: str, ends: bool):
    said = attack(tmp_path, how, 0.0, ends=ends, acknowledged=200)
    where = {
        "folder removed": str(tmp_path / "tmp" / "a.rescued.mcap"),
        "moved": "moved.mcap",
        "folder renamed": str(tmp_path / "renamed" / "a.mcap.active"),
    }.get(how, "a.rescued.mcap")
    assert f"are kept in {where}; leave that file where it is" in said.replace(
        f"{tmp_path}/logs/moved", "moved"
    )


@pytest.mark.parametrize("harm", [b"", b"more"])
def test_a_file_that_another_program_writes_to_is_no_whole_log(tmp_path: Path, harm: bytes):
    writer = EpisodeWriter(tmp_path / "a.mcap", EpisodeInfo())
    writer.write_message("/a", "std_msgs/msg/String", 1, bytes(12))
    with writer.active_path.open("ab" if harm else "wb") as file:
        file.write(harm)
    with pytest.raises(LogError, match=r"another program cut it or wrote to it.*recover$"):
        writer.close()
    assert [one.name for one in tmp_path.iterdir()] == ["a.mcap.active"]
    writer.close()


def test_a_loss_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path / "none"))
    folder = tmp_path / "logs"
    folder.mkdir()
    writer = EpisodeWriter(folder / "a.mcap", EpisodeInfo())
    writer.write_message("/a", "std_msgs/msg/String", 1, bytes(12))
    shutil.rmtree(folder)
    with pytest.raises(LogError, match="1 of 1 messages are lost: no copy of them could be"):
        writer.close()


@pytest.mark.parametrize(
    "make",
    [
        lambda active: active.symlink_to(active.with_name("aim")),
        os.mkfifo,
        Path.mkdir,
        lambda active: os.mknod(active, 0o140644),
    ],
    ids=["link", "pipe", "folder", "socket"],
)
def test_what_is_no_file_is_neither_followed_nor_waited_for(tmp_path: Path, make):
    make(tmp_path / "a.mcap.active")
    for overwrite in (False, True):
        with pytest.raises(LogError, match=r"a\.mcap\.active: is no regular file; move it away"):
            EpisodeWriter(tmp_path / "a.mcap", EpisodeInfo(), overwrite=overwrite)
    assert [one.name for one in tmp_path.iterdir()] == ["a.mcap.active"]


def test_a_hard_link_keeps_its_bytes_and_a_stranger_at_the_name_stays(tmp_path: Path):
    backup, left = tmp_path / "backup", OF_OURS + b"what a killed recorder left"
    backup.write_bytes(left)
    (tmp_path / "a.mcap.active").hardlink_to(backup)
    with EpisodeWriter(tmp_path / "a.mcap", EpisodeInfo(), overwrite=True):
        pass
    assert backup.read_bytes() == left
    writer = EpisodeWriter(tmp_path / "b.mcap", EpisodeInfo())
    writer.active_path.unlink()
    writer.active_path.write_bytes(b"mine")
    writer.discard()
    assert writer.active_path.read_bytes() == b"mine"
    ClaimedName(tmp_path / "c", takes_over=False)  # a claim that is dropped leaves nothing
    assert not list(tmp_path.glob("c*"))


# Makes the terminal that of the command, so that its end is the command's.
_LEADER = """
import fcntl, os, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execv(sys.argv[1], sys.argv[1:])
"""


@pytest.mark.live
def test_a_closed_terminal_ends_a_recording_whole(tmp_path: Path):
    terminal = Terminal()
    ends = dict.fromkeys(("stdin", "stdout", "stderr"), terminal.theirs)
    leader = (sys.executable, "-c", _LEADER)
    with playing(frames=2000, rate_hz=60, distinct=16) as camera:
        words = ("--camera", f"http://{camera}")
        with recorder(tmp_path, *words, before=leader, start_new_session=True, **ends) as process:
            terminal.wait_for(r"[1-9]\d*frame")
            terminal.close()  # as a lost connection does: SIGHUP, and no write succeeds any more
            process.wait(LAST_RESORT_S)
    episode = read_episode(tmp_path / "a.mcap")
    assert not episode.warnings
    assert episode.info.notes["ended"] == "stopped by a signal"
    assert not (tmp_path / "a.mcap.active").exists()


@pytest.mark.live
def test_under_nohup_a_hangup_ends_nothing(tmp_path: Path):
    hangs_up = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        process = started(tmp_path, [JOINTS])
    finally:
        signal.signal(signal.SIGHUP, hangs_up)
    process.send_signal(signal.SIGHUP)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.5)
    check_whole_file(tmp_path / "a.mcap", ended(process, signal.SIGTERM)[0])
