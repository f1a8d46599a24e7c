"""The paper's table 3: what is printed and written is what was measured."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from tests.engines import needs_pybullet
from tunenet_logs.analysis.evaluation.cli import main
from tunenet_logs.analysis.evaluation.studies import motion as motion_rows
from tunenet_logs.analysis.evaluation.studies.motion import motion_csv, motion_json, motion_lines

SEEDS = (1, 2)


def rows() -> tuple[motion_rows.MotionRow, ...]:
    names = [row.name for row in motion_rows.ROWS if row.name != "tunenet-obs"]
    first = {name: motion_rows.MotionError(2.0 + index, 0.004) for index, name in enumerate(names)}
    second = {name: motion_rows.MotionError(4.0 + index, 0.006) for index, name in enumerate(names)}
    return motion_rows.with_figures([first, second])


def test_the_table_holds_means_spread_and_the_papers_figures():
    text = motion_lines(rows(), SEEDS, 100)
    zero = next(line for line in text.splitlines() if line.startswith("Zero"))
    assert " ".join(zero.split()).startswith(
        "Zero 1 rollout 3.00 (100) [2.00–4.00] 0.0050 (97) [0.0040–0.0060]"
    )
    unmeasured = next(line for line in text.splitlines() if line.startswith("TuneNet (Obs)"))
    assert " ".join(unmeasured.split()).startswith("TuneNet (Obs) 8 rollout - (6.03) - (5.7)")
    assert max(len(line) for line in text.splitlines()) <= 100


def test_json_and_csv_hold_one_record_for_each_row_and_seed():
    told = json.loads(motion_json(rows(), SEEDS, 100))
    table = list(csv.DictReader(motion_csv(rows(), SEEDS).splitlines()))
    assert len(table) == len(told["rows"]) == 2 * (len(motion_rows.ROWS) - 1) + 1
    for mine, other in zip(table, told["rows"], strict=True):
        assert {key: "" if value is None else str(value) for key, value in other.items()} == mine
    (zero, again) = [one for one in told["rows"] if one["method"] == "zero"]
    assert (zero["seed"], zero["percent"], zero["paper_cm"]) == (1, 2.0, 97.0)
    assert (again["seed"], again["cm"]) == (2, 0.006)


@needs_pybullet
@pytest.mark.slow
def test_the_command_runs_from_nothing_to_a_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path = tmp_path / "motion.json"
    words = ("--seeds", "1", "--targets", "2", "--pairs", "60", "--epochs", "1", "--jobs", "1")
    assert main(("motion", *words, "--json", str(path))) == 0
    told = capsys.readouterr()
    assert not told.err
    assert "VRNN hybrid" in told.out
    figures = {one["method"]: one for one in json.loads(path.read_text())["rows"]}
    # of the ball's height itself, so that it depends on nothing that was trained
    assert figures["zero"]["percent"] == pytest.approx(100)
    assert 50 < figures["zero"]["cm"] < 200
    assert figures["untuned"]["percent"] > 1
    for name, paper in (("tunenet-obs", 5.7), ("ours-obs", None)):
        assert figures[name]["cm"] > 0
        assert figures[name]["paper_cm"] == paper
        assert figures[name]["protocol"] == "rollout"
    assert list(tmp_path.iterdir()) == [path]
