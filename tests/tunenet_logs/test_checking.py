"""`tunenet-logs check` says whether a log is whole, and where it is not."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.conftest import Command
from tests.strangers import Stranger, write_poses
from tunenet_logs.copying import check
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.terminal import Progress
from tunenet_logs.writing.writer import EpisodeWriter

QUIET = Progress(quiet=True)


def test_whole_logs_pass(command: Command, drop_log: Path, filmed_log: Path):
    result = command("tunenet-logs", "check", drop_log, filmed_log)
    assert result.returncode == 0, result.stdout
    assert result.stdout.count(": whole, ") == 2
    assert result.stderr == ""


def test_damage_is_named_with_its_place(command: Command, drop_log: Path):
    data = bytearray(drop_log.read_bytes())
    at = data.index(b"zstd") + 2000
    data[at] ^= 1
    drop_log.write_bytes(bytes(data))
    result = command("tunenet-logs", "check", drop_log)
    assert result.returncode == 1
    [line] = [one for one in result.stdout.splitlines() if "chunk" in one]
    start, end = (int(word.strip("()")) for word in line.split() if word.strip("()").isdecimal())
    assert start < at < end


def test_a_log_without_a_data_checksum_passes_with_a_note(tmp_path: Path, command: Command):
    stamps, positions = Stranger(0.6).samples()
    write_poses(tmp_path / "a.mcap", stamps, positions)
    result = command("tunenet-logs", "check", tmp_path / "a.mcap")
    assert result.returncode == 0
    assert "cannot be vouched for" in result.stdout


def test_damaged_pictures_are_counted(tmp_path: Path, filmed_log: Path):
    from tunenet_logs.reader import read_episode

    with EpisodeWriter(tmp_path / "a.mcap", EpisodeInfo()) as writer:
        for number, frame in enumerate(read_episode(filmed_log).frames()):
            data = frame.data[:1000] if number in (3, 7) else frame.data
            writer.write_frame("/camera", Frame(frame.stamp_ns, "jpeg", data))
    [line] = check(tmp_path / "a.mcap", QUIET).damage
    assert "2 of" in line


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.999])
def test_a_cut_log_never_passes(drop_log: Path, command: Command, share: float):
    data = drop_log.read_bytes()
    drop_log.write_bytes(data[: max(9, int(share * len(data)))])
    assert command("tunenet-logs", "check", drop_log).returncode == 1


def test_one_bad_file_does_not_hide_the_others(command: Command, drop_log: Path, tmp_path: Path):
    (tmp_path / "bad.mcap").write_bytes(b"nothing")
    result = command("tunenet-logs", "check", tmp_path / "bad.mcap", drop_log)
    assert result.returncode == 1
    assert f"{drop_log}: whole" in result.stdout
    assert result.stderr.count("\n") == 1


@pytest.mark.parametrize("more", [b"garbage", b""], ids=["bytes", "another log"])
def test_what_follows_the_end_is_said(drop_log: Path, command: Command, more: bytes):
    data = drop_log.read_bytes()
    drop_log.write_bytes(data + (more or data))
    result = command("tunenet-logs", "check", drop_log)
    assert result.returncode == 1
    assert ("bytes follow" if more else "another log follows") in result.stdout
