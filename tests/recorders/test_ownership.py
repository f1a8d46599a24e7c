"""A recording's file is its own: two writers to one name, and files that are taken away."""

from __future__ import annotations

import os
import pty
import random
import re
import shutil
import signal
import subprocess
import sys
import termios
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import BIN
from tests.recorders.contender import ATTACKS, OF_OURS, attack, contend, contenders
from tests.recorders.live_recorder import JOINTS, check_whole_file, started
from tests.recorders.mjpeg_camera import playing
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.errors import LogError
from tunenet_logs.reader import read_episode
from tunenet_logs.writing.owned_path import ClaimedName, rename_new, take_and_rename
from tunenet_logs.writing.writer import EpisodeWriter


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


def test_where_nothing_can_be_written_the_loss_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path / "none"))
    folder = tmp_path / "logs"
    folder.mkdir()
    writer = EpisodeWriter(folder / "a.mcap", EpisodeInfo())
    writer.write_message("/a", "std_msgs/msg/String", 1, bytes(12))
    shutil.rmtree(folder)
    with pytest.raises(LogError, match="1 of 1 messages are lost: no copy of them could be"):
        writer.close()


@pytest.mark.parametrize("kind", ["link", "pipe", "folder", "socket"])
def test_what_is_no_file_is_neither_followed_nor_waited_for(tmp_path: Path, kind: str):
    active, aim = tmp_path / "a.mcap.active", tmp_path / "aim"
    if kind == "link":
        active.symlink_to(aim)
    elif kind == "pipe":
        os.mkfifo(active)
    elif kind == "folder":
        active.mkdir()
    else:
        os.mknod(active, 0o140644)
    for overwrite in (False, True):
        with pytest.raises(LogError, match=r"a\.mcap\.active: is no regular file; move it away"):
            EpisodeWriter(tmp_path / "a.mcap", EpisodeInfo(), overwrite=overwrite)
    assert not aim.exists()
    assert list(tmp_path.iterdir()) == [active]


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


@pytest.mark.parametrize("rename", [rename_new, take_and_rename])
def test_renaming_replaces_nothing(tmp_path: Path, rename):
    old, new = tmp_path / "old", tmp_path / "new"
    old.write_bytes(b"1")
    new.write_bytes(b"2")
    with pytest.raises(FileExistsError):
        rename(old, new)
    assert (old.read_bytes(), new.read_bytes()) == (b"1", b"2")
    new.unlink()
    rename(old, new)
    assert (old.exists(), new.read_bytes()) == (False, b"1")
    with pytest.raises(FileNotFoundError):
        rename(old, tmp_path / "other")
    assert not (tmp_path / "other").exists()


# Makes the terminal that of the command, so that its end is the command's.
_LEADER = """
import fcntl, os, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execv(sys.argv[1], sys.argv[1:])
"""


@pytest.mark.live
def test_a_closed_terminal_ends_a_recording_whole(tmp_path: Path):
    terminal, far = pty.openpty()
    termios.tcsetwinsize(far, (24, 80))  # with none, no bar is shown
    with playing(frames=2000, rate_hz=60, distinct=16) as camera:
        words = [str(BIN / "tunenet-record"), "--camera", f"http://{camera}", "-o", "a.mcap"]
        words = [sys.executable, "-c", _LEADER, *words]
        ends: dict[str, Any] = {"stdin": far, "stdout": far, "stderr": far}
        process = subprocess.Popen(words, cwd=tmp_path, **ends, start_new_session=True)
        os.close(far)
        shown = b""
        while not re.search(rb"[1-9]\d*frame", shown):
            shown += os.read(terminal, 4096)
        os.close(terminal)  # as a lost connection does: SIGHUP, and no write succeeds any more
        process.wait(60)
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
    process.send_signal(signal.SIGTERM)
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    check_whole_file(tmp_path / "a.mcap", said)
