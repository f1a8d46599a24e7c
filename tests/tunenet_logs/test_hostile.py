"""Hostile files are refused in one line, and never cost much memory."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import BIN, ROOT
from tests.hostile import BOMBS, LAUNCHER, spent

MAX_BYTES = 512 * 2**20
EACH_BOMB = pytest.mark.parametrize("bomb", BOMBS, ids=lambda bomb: bomb.__name__)
EACH_COMMAND = pytest.mark.parametrize("words", ["tunenet-tune", "tunenet-logs check"])


def code_for(bomb: Callable, words: str) -> int:
    """Nested metadata is odd, and whole."""
    return 0 if (bomb.__name__, words) == ("nested_metadata", "tunenet-logs check") else 1


@pytest.fixture(scope="module")
def met(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, str], dict[str, Any]]:
    """What each command said of each bomb, all in one process, whose peak memory only grows."""
    folder = tmp_path_factory.mktemp("bombs")
    paths = [folder / f"{bomb.__name__}.mcap" for bomb in BOMBS]
    for bomb, path in zip(BOMBS, paths, strict=True):
        bomb(path)
    reader = [sys.executable, "-m", "tests.tunenet_logs.hostile_reader", *paths]
    line = [sys.executable, "-c", LAUNCHER, *reader]
    done = subprocess.run(line, cwd=ROOT, stdout=subprocess.PIPE, text=True, timeout=300)
    told = [json.loads(one) for one in done.stdout.splitlines()]
    return {(one["file"], one["command"]): one for one in told}


@EACH_COMMAND
@EACH_BOMB
def test_a_bomb_is_one_clean_line_and_costs_little(met: dict, bomb: Callable, words: str):
    assert (bomb.__name__, words) in met, f"the process ended at {list(met)[-1:]} or behind it"
    told = met[bomb.__name__, words]
    assert "Traceback" not in told["said"]
    assert told["code"] == code_for(bomb, words), told["said"]
    assert told["peak"] < MAX_BYTES


@pytest.mark.slow
@EACH_COMMAND
@EACH_BOMB
def test_so_it_is_in_a_process_of_its_own(tmp_path: Path, bomb: Callable, words: str):
    bomb(tmp_path / "bomb.mcap")
    command, *rest = words.split()
    told = spent([str(BIN / command), *rest, "bomb.mcap"], tmp_path)
    assert "Traceback" not in told.said
    assert told.code == code_for(bomb, words), told.said
    assert told.peak_kib * 1024 < MAX_BYTES
