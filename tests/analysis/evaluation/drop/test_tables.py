"""What the tables say of the figures: who is ahead, and how often intervals hold."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from tunenet_logs.analysis.evaluation.cli import main
from tunenet_logs.analysis.evaluation.studies.drop import (
    coverage_table,
    drop_markdown,
    drop_tables,
    factor,
    intervals_json,
)
from tunenet_logs.analysis.evaluation.studies.drop_methods import (
    Cell,
    DropResults,
    Group,
    MethodErrors,
    coverage_of,
)

EASY_CELL = Cell("drop", "paper", "Easy", 0.0)


def row(method: str, error: float, group: Group = "user") -> MethodErrors:
    return MethodErrors(EASY_CELL, method, method.upper(), group, 10, np.full((1, 2, 11), error))


def ahead(*outcomes: MethodErrors) -> str:
    return drop_tables(DropResults((1,), 2, outcomes)).partition("Who is ahead")[2]


def test_one_method_is_ours_and_those_that_know_targets_are_not_ranked():
    told = (row("mean", 1e-4, "paper"), row("entropy-search", 1e-4, "paper"))
    rows = (*told, row("secant", 0.02), row("network", 1e-3, "ours"), row("ours", 0.01, "ours"))
    text = ahead(*rows)
    assert "at  5: OURS, .0100" in text
    assert "OURS at 5 (.0100): 2 times ahead of SECANT at 10 (.0200)" in text
    assert not any(name in text for name in ("MEAN", "ENTROPY", "NETWORK"))
    table = drop_tables(DropResults((1,), 2, rows)).partition("Who is ahead")[0]
    assert "MEAN* " in table
    assert "* is given the mean" in table
    assert "\\* is given" in drop_markdown(DropResults((1,), 2, rows))
    assert "| MEAN* |" in drop_markdown(DropResults((1,), 2, rows))
    assert not ahead(*told)


@pytest.mark.parametrize(
    ("mine", "theirs", "says"),
    [
        (1e-12, 1e-15, "level with"),
        (0.0, 9e-10, "level with"),
        (0.0, 0.1, "without error, ahead of"),
        (0.2, 0.1, "2 times behind"),
    ],
)
def test_errors_that_print_as_nothing_are_level(mine: float, theirs: float, says: str):
    assert factor(mine, theirs) == says


def coverage_rows(count: int, held: int, ok: int) -> np.ndarray:
    """Truth .5 and intervals of .1, the first `held` of which hold it."""
    rows = np.tile([0.5, 0.51, 0.45, 0.55, 0.53, 0.0], (count, 1))
    rows[held:, 2] = 0.505
    rows[:ok, 5] = 1
    return rows


def test_coverage_is_counted_with_its_error():
    one = coverage_of("drops", np.vstack([coverage_rows(600, 570, 300), np.full((2, 6), np.nan)]))
    assert (one.targets, one.fitted) == (602, 600)
    assert (one.covered, one.ok, one.ok_covered) == pytest.approx((0.95, 300 / 602, 1.0))
    assert one.covered_se == pytest.approx(0.0090, abs=3e-4)
    assert one.ok_covered_se
    assert one.ok_covered_se > 0
    assert "95.0 ± 0.9 %" in coverage_table([one])


@pytest.mark.filterwarnings("error")
def test_coverage_of_nothing_is_a_dash_and_null():
    nothing = coverage_of("drops", np.full((3, 6), np.nan))
    none_ok = coverage_of("others", coverage_rows(4, 4, 0))
    table = coverage_table([nothing, none_ok]).splitlines()
    assert table[2].split() == ["drops", "3", "0", "-", "0.0", "%", "-", "-"]
    assert table[3].strip() == "mean error -; the network's alone -"
    assert "nan" not in "".join(table)
    first, second = json.loads(intervals_json([nothing, none_ok], (1,), 3))["intervals"]
    assert [first[key] for key in ("covered", "covered_se", "width", "mae")] == [None] * 4
    assert (second["covered"], second["ok_covered"]) == (1.0, None)


@pytest.mark.slow
def test_intervals_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    files = {name: tmp_path / f"a.{name}" for name in ("json", "csv")}
    words = [str(word) for name, path in files.items() for word in (f"--{name}", path)]
    assert main(("intervals", "--seeds", "1", "--targets", "2", "--jobs", "1", *words)) == 0
    told = capsys.readouterr()
    assert told.out.startswith("95 % intervals")
    assert max(map(len, told.out.splitlines())) <= 100
    content = json.loads(files["json"].read_text())
    assert [one["targets"] for one in content["intervals"]] == [4, 4]
    table = list(csv.DictReader(files["csv"].read_text().splitlines()))
    assert [one["label"] for one in table] == [one["label"] for one in content["intervals"]]
