"""No cell of a table of ours is a formula, and each is read back as it was."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import Command, record
from tunenet_logs.files import csv_line, text_of

TEXTS = [
    '=HYPERLINK("http://example.org/?"&A1,"click")', "=1+1", "+1+1", "-1+1", "-", "@SUM(A1)",
    "\t=1", "\r=1", "\n=1", " =1", "'=1", "''=1", "\ufeff=1", "\uff1d1", "\0=1",
    "it's", "'quoted'", "a,b", "a;=1", 'say "x"', "two\nlines", "", "drop.mcap", "/ball", "1/2",
]  # fmt: skip


@pytest.mark.parametrize("text", TEXTS)
def test_a_text_is_inert_and_comes_back(text: str):
    (cell,) = csv.reader(csv_line([text]).splitlines(keepends=True)) if text else ([""],)
    assert cell[0].lstrip(" \t\r\n\0\ufeff")[:1] not in (*"=+-@", "\uff1d")
    assert cell[0][:1] not in ("\t", "\r", "\n")
    assert text_of(cell[0]) == text


def test_numbers_stay_numbers():
    line = csv_line([-1, -0.5, np.float64(-2e-7), "-1.5", "+3", "1e-5", None, float("nan"), True])
    assert line == "-1,-0.5,-2e-07,-1.5,+3,1e-5,,,True\n"


def test_the_name_of_a_log_is_no_formula_in_any_table(tmp_path: Path, command: Command):
    record(tmp_path / "=1+1.mcap", restitution=0.7, height_m=1.0)
    done = command(
        "tunenet-tune", ".", "-o", "out", "--csv", "all.csv", "--no-review", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    done = command("tunenet-compare", "out", "--csv", "compared.csv", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for name in ("all.csv", "compared.csv"):
        with (tmp_path / name).open(newline="") as file:
            cells = [cell for row in csv.reader(file) for cell in row]
        assert not any(cell.startswith("=") for cell in cells)
    assert "=1+1.mcap" in map(text_of, cells)
