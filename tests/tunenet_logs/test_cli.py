"""tunenet-logs as a user runs it."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from tests.conftest import BIN, Command


def test_info_tells_what_is_in_a_log(process: Command, drop_log: Path):
    result = process("tunenet-logs", "info", drop_log)
    assert result.returncode == 0
    for fact in ("kind: drop", "/ball/pose", "PoseStamped", "400", "60.0 Hz", "restitution 0.7"):
        assert fact in result.stdout


def test_info_of_what_is_no_log_is_one_line(command: Command, tmp_path: Path):
    (tmp_path / "a.txt").write_text("hello")
    result = command("tunenet-logs", "info", tmp_path / "a.txt")
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert "a.txt" in result.stderr


def test_no_verb_is_wrong_usage(command: Command):
    result = command("tunenet-logs")
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1


def test_paths_that_no_file_system_takes_are_one_line(command: Command):
    result = command("tunenet-logs", "info", "a" * 300 + ".mcap")
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1


def test_a_pipe_is_refused_rather_than_waited_for(command: Command, tmp_path: Path):
    os.mkfifo(tmp_path / "a.mcap")
    result = command("tunenet-logs", "info", tmp_path / "a.mcap")
    assert result.returncode == 1
    assert "regular file" in result.stderr


def test_a_full_disk_behind_standard_output_is_one_line(drop_log: Path):
    with Path("/dev/full").open("w") as full:
        words = [BIN / "tunenet-logs", "info", drop_log]
        result = subprocess.run(words, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
