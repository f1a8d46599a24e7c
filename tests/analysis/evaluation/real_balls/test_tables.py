"""tunenet-eval real-balls: what is printed and written is what came of the drops."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from tunenet_logs.analysis.evaluation.cli import main
from tunenet_logs.analysis.evaluation.studies.real_balls import (
    COLUMNS,
    LIGHT,
    NONE,
    Compared,
    FilmedBall,
    Found,
    Moved,
    RealOrder,
    compared_lines,
    film_lines,
    filmed_lines,
    moved_lines,
    position_lines,
    protocol,
    real_csv,
    real_json,
    section_blocks,
    spread_of,
)
from tunenet_logs.analysis.evaluation.study import REAL_SECTIONS
from tunenet_logs.terminal import Progress

NAN = np.nan
TRUTH = np.array([0.7, 0.05, 0.1])


def found(error: float, half: float, verdict: str = "ok", path: float = 0.01) -> Found:
    """Restitution and its interval alone."""
    values = np.array([0.7 + error, NAN, NAN])
    ends = np.full((3, 2), NAN)
    ends[0] = values[0] - half, values[0] + half
    return Found(TRUTH, values, ends, verdict, path)


REFERENCE = Found(TRUTH, TRUTH + 0.001, TRUTH[:, None] + np.array([-0.002, 0.003]), "", 1e-4)
DROPS = [
    Compared(found(0.002, 0.005), REFERENCE),
    Compared(found(-0.006, 0.005), REFERENCE),
    Compared(found(0.001, NAN, "suspect", 0.03), REFERENCE),
    Compared(found(NAN, NAN, "rejected", NAN), REFERENCE),
]
MOVED = [
    Moved("golf", 1.0, 0.002, "ok", 0.2, 0.03, 0.02, DROPS[0].ours),
    Moved("golf", 2.0, NAN, "rejected", 0.1, 0.01, 0.01, DROPS[3].ours),
]


def test_figures_have_the_worst_beside_the_mean():
    first, slope, drag, path = compared_lines("x 1", DROPS)
    assert (first.drops, first.answered, first.intervals) == (4, 3, 2)
    assert (first.ok, first.suspect, first.rejected) == (0.5, 0.25, 0.25)
    assert first.ours.mean == pytest.approx(0.003)
    assert (first.ours.median, first.ours.worst) == (pytest.approx(0.002), pytest.approx(0.006))
    assert first.reference.mean == pytest.approx(0.001)
    assert (first.covered, first.reference_covered) == (0.5, 1.0)
    assert (first.width, first.widest) == (pytest.approx(2.0), pytest.approx(2.0))
    assert (slope.ours, slope.covered, slope.width, drag.answered) == (NONE, None, None, 0)
    assert slope.reference.worst == pytest.approx(0.001)
    assert path.ours.worst == pytest.approx(0.03)
    assert path.reference.p99 == pytest.approx(1e-4)
    assert spread_of(np.array([NAN])) == NONE


def test_a_table_holds_its_figures_in_their_columns():
    lines = compared_lines("x 1, 1 mm", DROPS)
    blocks = list(section_blocks("positions", lines))
    assert len(blocks) == 4
    ours = ["x", "1,", "1", "mm", "4", "50.0", "25.0", ".0030", ".0060", "50.0", "(2)"]
    assert blocks[0].splitlines()[2].split() == [*ours, ".0010", ".0010", "100.0", "2.00", "2.00"]
    assert blocks[1].splitlines()[2].split()[7:10] == ["-"] * 3
    path = ["3", "1.667", "1.000", "2.960", "3.000", "0.010", "0.010", "0.010"]
    assert blocks[3].splitlines()[2].split()[4:] == path


def test_motion_stands_beside_the_airless_and_the_papers():
    blocks = list(section_blocks("balls", moved_lines("golf", MOVED)))
    row = blocks[-1].splitlines()[4].split()
    assert row[:4] == ["golf", "1", "of", "2"]
    assert row[4:] == ["0.200,", "0.200", "15.0,", "20.0", "2.000,", "3.000", "1.500,", "2.000"]
    films = [FilmedBall("golf", DROPS[0].ours, 0.01)]
    light = [FilmedBall(LIGHT[1], DROPS[0].ours, NAN)]
    lines = [*filmed_lines("golf", films), *filmed_lines(LIGHT[1], light)]
    blocks = list(section_blocks("films", lines))
    assert LIGHT[1] in blocks[0]
    assert LIGHT[1] not in blocks[-1]
    assert blocks[-1].splitlines()[4].split() == ["golf", "1", "of", "1", "1.000,", "1.000"]


def test_no_line_is_wider_than_a_terminal():
    order = RealOrder((1, 2, 3), 200)
    blocks = [
        protocol(order),
        *section_blocks("positions", compared_lines("x 0.5, 5 mm", DROPS)),
        *section_blocks("balls", moved_lines("table tennis", MOVED)),
    ]
    assert max(len(line) for block in blocks for line in block.splitlines()) <= 100
    assert "seeds 1 to 3, 200 drops" in blocks[0]
    assert order.table_drops == 4
    assert RealOrder((1,), 3).table_drops == 1
    assert sum(len(numbers) for _, numbers in RealOrder((1, 2), 12).portions) == 24


def test_json_and_csv_hold_one_record_for_each_line():
    lines = [*compared_lines("x 1", DROPS), *moved_lines("golf", MOVED)]
    told = json.loads(real_json(lines, RealOrder((1, 2), 4)))
    assert (told["experiment"], told["seeds"], told["targets"]) == ("real-balls", [1, 2], 4)
    table = list(csv.DictReader(real_csv(lines).splitlines()))
    assert tuple(table[0]) == COLUMNS
    for mine, other in zip(table, told["rows"], strict=True):
        assert {key: "" if value is None else str(value) for key, value in other.items()} == mine
    assert table[0]["reference_worst"].startswith("0.001")


@pytest.mark.slow
def test_the_same_figures_however_many_processes_there_are():
    quiet = Progress(quiet=True)
    for run in (position_lines, film_lines):
        assert run(RealOrder((1,), 2, 1), quiet) == run(RealOrder((1,), 2, 2), quiet)


@pytest.mark.slow
def test_the_command_prints_and_writes_the_tables_it_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path = tmp_path / "real.json"
    words = ("--seeds", "1", "--targets", "1", "--jobs", "1", "--quiet", "--json", str(path))
    assert main(("real-balls", *words)) == 0
    told = capsys.readouterr()
    assert not told.err
    assert told.out.count("Restitution at the first impact") == len(REAL_SECTIONS)
    rows = json.loads(path.read_text())["rows"]
    assert {row["section"] for row in rows} == set(REAL_SECTIONS)
    assert [row["drops"] for row in rows if row["section"] == "positions"] == [1] * 24


def test_wrong_usage_is_one_line(capsys: pytest.CaptureFixture[str]):
    assert main(("real-balls", "--sections", "cars")) == 2
    told = capsys.readouterr()
    assert "no section 'cars'; there is: positions, balls, films" in told.err
    assert not told.out
