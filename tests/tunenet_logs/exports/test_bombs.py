"""Exports, archives and films that were made to hurt end soon, and in little memory."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import BIN
from tests.export_bombs import BOMBS
from tests.hostile import spent

MAX_KIB = 500_000
MAX_LONG_KIB = 640_000  # of what is whole, as long as anything that is read, and tuned
MAX_CPU_S = 10.0
# Those that are made and met in a moment.
QUICK = (
    "many_columns", "nested_json", "nested_xml", "entities_xml", "forged_c3d", "forged_npz",
    "forged_mat", "forged_parquet", "workbook_with_macros", "spreadsheet_repeated", "forged_tiffs",
    "forged_y4m", "forged_webp", "long_definition", "deep_lists",
)  # fmt: skip


def met(bomb: Callable[[Path], Path], folder: Path) -> str:
    """What the tuner says of a file, once it was found that it took little for that."""
    path = bomb(folder)
    command = [str(BIN / "tunenet-tune"), str(path), "-o", str(folder / "out")]
    said, code, cpu_s, peak_kib = spent(command, folder)
    assert code == 1, said
    assert "Traceback" not in said
    assert peak_kib < (MAX_LONG_KIB if bomb.__name__.startswith("long_") else MAX_KIB)
    assert cpu_s < MAX_CPU_S, said
    results = list((folder / "out").glob("*.json")) if (folder / "out").is_dir() else []
    if not results:
        assert said.startswith("tunenet-tune: ")
        assert said.count("\n") == 1
        return said
    (result,) = results
    why = json.loads(result.read_text())
    assert why["verdict"] == "rejected"
    return said


@pytest.mark.slow
@pytest.mark.parametrize("bomb", BOMBS, ids=lambda one: one.__name__)
def test_a_bomb_takes_little(tmp_path: Path, bomb: Callable[[Path], Path]):
    assert met(bomb, tmp_path)


@pytest.mark.parametrize("bomb", [one for one in BOMBS if one.__name__ in QUICK],
                         ids=lambda one: one.__name__)  # fmt: skip
def test_a_small_bomb_takes_little(tmp_path: Path, bomb: Callable[[Path], Path]):
    assert met(bomb, tmp_path)
