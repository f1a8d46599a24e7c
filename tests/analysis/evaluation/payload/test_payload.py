"""The payload's experiment: table 1, and logs like a real driver's."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tunenet_logs.analysis.evaluation.cli import main
from tunenet_logs.analysis.evaluation.studies.payload import (
    CASES,
    METHODS,
    SETS,
    LogCase,
    MassOrder,
    MassRow,
    log_rows,
    log_table,
    mass_rows,
    mass_table,
    row_of,
)
from tunenet_logs.analysis.tunenet.network import HomogeneousNetwork, initial_weights
from tunenet_logs.terminal import Progress

QUIET = Progress(quiet=True)
ORDER = MassOrder((1, 2), 60, 2, pairs=600, epochs=10)


@pytest.fixture(scope="module")
def rows() -> list[MassRow]:
    return mass_rows(ORDER, QUIET)


def error(rows: list[MassRow], name: str, which: str) -> float:
    (row,) = [one for one in rows if one.method.name == name and one.which == which]
    assert row.errors.shape == (2, 60)
    return float(row.errors.mean())


@pytest.mark.slow
def test_baselines_are_the_papers(rows: list[MassRow]):
    assert error(rows, "one", "test") == pytest.approx(0.504, abs=0.06)
    assert error(rows, "mean", "test") == pytest.approx(0.255, abs=0.04)
    assert error(rows, "mean", "validation") == pytest.approx(0.25, abs=0.04)


@pytest.mark.slow
def test_what_is_linear_is_found_exactly(rows: list[MassRow]):
    """Also from a training of seconds, and a kilogram beyond it."""
    for which in ("validation", "test"):
        assert error(rows, "secant", which) < 1e-9
        assert error(rows, "default", which) < 1e-4
        assert error(rows, "default-1", which) > error(rows, "default", which)


def test_the_table_has_the_papers_figures():
    nothing = np.zeros((2, 60))
    rows = [MassRow(method, which, nothing, nothing) for method in METHODS for which in SETS]
    text = mass_table(rows, ORDER)
    assert len(text.splitlines()) == 4 + len(METHODS)
    for figure in ("(0.011)", "(0.198)", "(13.2)", "(0.504)", "(0.255)", "(28)", "(17.1)"):
        assert figure in text


@pytest.mark.slow
def test_the_command_prints_and_writes(capsys: pytest.CaptureFixture, tmp_path: Path):
    words = ["payload", "--sections", "masses", "--seeds", "1", "--targets", "5", "--pairs", "60"]
    words += ["--epochs", "2", "--json", str(tmp_path / "a.json"), "--csv", str(tmp_path / "a.csv")]
    assert main([*words, "--quiet", "--jobs", "1"]) == 0
    assert "TuneNet, paper's text" in capsys.readouterr().out
    told = json.loads((tmp_path / "a.json").read_text())
    assert told["logs"] == []
    assert len(told["masses"]) == 2 * len(METHODS)
    head, *lines = (tmp_path / "a.csv").read_text().splitlines()
    assert head.startswith("method,iterations,set,seed,mae_kg")
    assert len(lines) == 2 * len(METHODS)


def test_an_unknown_section_is_wrong_usage(capsys: pytest.CaptureFixture):
    assert main(["payload", "--sections", "bad"]) == 2
    assert "there is: masses, logs" in capsys.readouterr().err


@pytest.mark.slow
def test_logs_go_the_whole_way():
    few = {row.case.label: row for row in log_rows((1, 2), 2, 2, QUIET)}
    assert len(few) == len(CASES)
    assert all(row.logs == 2 for row in few.values())
    clean = few["noise of 0.05 N·m alone, circle"]
    assert clean.answered == 1
    assert clean.mae is not None
    assert clean.mae < 0.005
    tared, alone = few["driver, circle, tare"], few["driver, circle"]
    assert tared.width is not None
    assert alone.width is not None
    assert tared.width < 0.5 * alone.width


def test_figures_of_a_line():
    nothing = float("nan")
    case = LogCase("some", True)
    answers = [
        [0.5, 0.52, 0.4, 0.6, 0.1, 0.6, 1.0, *[nothing] * 3, 0, 0, 0],
        [0.5, 0.44, 0.4, 0.46, 0.1, 0.5, 0.0, 0.01, 0.0, 0.0, 0.0, 0.002, 0.0],
        [0.5, *[nothing] * 5, 0.0, *[nothing] * 3, 0, 0, 0],
    ]
    row = row_of(case, np.array(answers))
    assert (row.logs, row.answered, row.ok) == (3, pytest.approx(2 / 3), pytest.approx(1 / 3))
    assert row.mae == pytest.approx(0.04)
    assert row.held == 0.5
    assert row.width == pytest.approx(0.13)
    assert row.secant == pytest.approx(0.05)
    assert row.told == 0.5
    assert row.centre_mm == pytest.approx((10.0, 2.0, 0.0))
    assert row.told_mae == pytest.approx(0.06)
    assert "10.0 / 2.0 / 0.0 mm" in log_table([row])
    empty = row_of(case, np.array(answers[2:]))
    assert (empty.mae, empty.held, empty.width, empty.told) == (None, None, None, None)
    assert "-" in log_table([empty])


def test_twice_the_torques_are_twice_the_residual():
    network, rng = HomogeneousNetwork(), np.random.default_rng(3)
    weights = initial_weights(network, 7, 1, rng)
    proposed, target = rng.normal(size=(2, 20, 7))
    once = network.residual(weights, proposed, target)
    assert network.residual(weights, 2 * proposed, 2 * target) == pytest.approx(2 * once)
    assert network.residual(weights, target, target) == pytest.approx(0.0)
    assert network.residual(weights, target, proposed) == pytest.approx(-once)
