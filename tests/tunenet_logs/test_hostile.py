"""Hostile files are refused in one line, and never cost much memory."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import BIN
from tests.hostile import BOMBS, LAUNCHER

MOST_BYTES = 512 * 2**20


@pytest.mark.parametrize("words", [("tunenet-tune",), ("tunenet-logs", "check")], ids=" ".join)
@pytest.mark.parametrize("bomb", BOMBS, ids=lambda bomb: bomb.__name__)
def test_a_bomb_is_one_clean_line(tmp_path: Path, bomb: Callable, words: tuple[str, ...]):
    bomb(tmp_path / "bomb.mcap")
    command, *rest = words
    line = [sys.executable, "-c", LAUNCHER, str(BIN / command), *rest, "bomb.mcap"]
    done = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    said, _, peak = (done.stdout + done.stderr).rpartition("peak ")
    assert "Traceback" not in said
    assert done.returncode == (0 if bomb.__name__ == "nested_metadata" and rest else 1), said
    assert int(peak) * 1024 < MOST_BYTES
