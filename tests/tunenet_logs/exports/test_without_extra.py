"""Without the optional libraries every command says in one line what to install."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.small_exports import small

RUN = """
import sys
sys.modules[sys.argv[1]] = None
from tunenet_logs.cli import main
sys.exit(main(["info", sys.argv[2]]))
"""
EXTRA = "pip install 'tunenet-logs[tables]'"


@pytest.mark.parametrize(
    ("library", "kind"),
    [
        ("pyarrow", "a.parquet"),
        ("python_calamine", "book.xlsx"),
        ("python_calamine", "phyphox.xlsx"),
    ],
)
def test_what_is_missing_is_named(tmp_path: Path, library: str, kind: str):
    (tmp_path / kind).write_bytes(small(kind))
    line = [sys.executable, "-c", RUN, library, str(tmp_path / kind)]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert EXTRA in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("library", ["pyarrow", "python_calamine", "ezc3d"])
@pytest.mark.parametrize("kind", ["c3d.c3d", "phyphox.zip", "a.npz", "level5.mat", "plain.csv.zst"])
def test_nothing_else_needs_them(tmp_path: Path, library: str, kind: str):
    (tmp_path / kind).write_bytes(small(kind))
    line = [sys.executable, "-c", RUN, library, str(tmp_path / kind)]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
