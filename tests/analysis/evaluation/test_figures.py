"""The figures of studies are those of a calculation by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tunenet_logs.analysis.evaluation.studies import payload
from tunenet_logs.analysis.evaluation.studies.drop import drop_tables
from tunenet_logs.analysis.evaluation.studies.drop_methods import (
    Cell,
    DropResults,
    Group,
    MethodErrors,
)
from tunenet_logs.analysis.evaluation.studies.engines import EXACT, METHODS, RANGES, line_of
from tunenet_logs.analysis.evaluation.studies.motion import motion_error
from tunenet_logs.analysis.evaluation.studies.positions import coverage_of, coverage_table
from tunenet_logs.analysis.evaluation.studies.real_balls import Found, Score, lines_of
from tunenet_logs.analysis.evaluation.studies.video import figures_of
from tunenet_logs.analysis.evaluation.study import Row
from tunenet_logs.analysis.payload.torque_model import Convention

NAN = np.nan
near = pytest.approx


def among(row: Row, **expected: object) -> None:
    """Whether a row's figures are these."""
    assert {name: row[name] for name in expected} == {
        name: near(one) if isinstance(one, float) else one for name, one in expected.items()
    }


# ---- Methods on drops: errors by rollouts, and who is ahead.

EASY = Cell("drop", "paper", "Easy", 0.0)


def method(name: str, errors: object, group: Group = "user") -> MethodErrors:
    values = np.array(errors) if isinstance(errors, list) else np.full((1, 2, 11), errors)
    return MethodErrors(EASY, name, name.upper(), group, values.shape[2] - 1, values)


def test_errors_over_seeds_and_targets():
    # two seeds, three targets, after 0 and 1 rollouts
    values = [[[9, 0.1], [9, 0.2], [9, 0.6]], [[9, 0.0], [9, 0.1], [9, 0.2]]]
    one = method("cma-es", values, "paper")
    among(vars(one.figures(1)), mae=0.2, median=0.15, lowest=0.1, highest=0.3, paper=0.0540)
    assert (one.figures(100).mae, one.figures(0).mae) == (one.figures(1).mae, 9)


def test_one_method_is_ours_and_those_that_know_targets_are_not_ranked():
    told = (method("mean", 1e-4, "paper"), method("entropy-search", 1e-4, "paper"))
    ours = (method("network", 1e-3, "ours"), method("ours", 0.01, "ours"))
    results = DropResults((1,), 2, (*told, method("secant", 0.02), *ours))
    table, _, ahead = drop_tables(results).partition("Who is ahead")
    assert "OURS at 5 (.0100): 2 times ahead of SECANT at 10 (.0200)" in ahead
    assert not any(name in ahead for name in ("MEAN", "ENTROPY", "NETWORK"))
    assert "MEAN* " in table
    assert "* is given the mean" in table


# ---- Intervals: truth .5 and intervals of .1, the first of which hold it.


def coverage_rows(count: int, held: int, ok: int) -> np.ndarray:
    rows = np.tile([0.5, 0.51, 0.45, 0.55, 0.53, 0.0], (count, 1))
    rows[held:, 2] = 0.505
    rows[:ok, 5] = 1
    return rows


@pytest.mark.filterwarnings("error")
def test_coverage_is_counted_with_its_error_and_of_nothing_is_a_dash():
    one = coverage_of("drops", np.vstack([coverage_rows(600, 570, 300), np.full((2, 6), NAN)]))
    among(one, targets=602, fitted=600, covered=0.95, ok=300 / 602, ok_covered=1.0)
    assert one["covered_se"] == near(0.0090, abs=3e-4)
    assert one["ok_covered_se"] > 0
    nothing = coverage_of("drops", np.full((3, 6), NAN))
    among(nothing, covered=None, covered_se=None, width=None, mae=None)
    among(coverage_of("others", coverage_rows(4, 4, 0)), covered=1.0, ok_covered=None)
    row = coverage_table([nothing]).splitlines()[2]
    assert row.split() == ["drops", "3", "0", "-", "0.0", "%", "-", "-"]


# ---- Tracks and clips.

TRACKS = np.array(
    [
        # truth, value, low, high, shown, verdict
        [0.5, 0.51, 0.48, 0.52, 1, 0],
        [0.5, 0.47, 0.46, 0.48, 0, 1],
        [0.5, 0.60, 0.55, 0.61, 1, 0],
        [0.5, NAN, NAN, NAN, 0, 2],
    ]
)


def test_tracks_of_a_kind():
    found = figures_of(TRACKS)
    among(found, targets=4, answered=0.75, rejected=0.25, ok=0.5, suspect=0.25, wrong=0.25)
    among(found, mae=0.14 / 3, median=0.03, bias=0.08 / 3, p95=0.03 + 0.9 * 0.07, width=0.04)
    among(found, covered=1 / 3, shown=2 / 3, shown_covered=0.5)
    without_truth = TRACKS[[0, 3]].copy()
    without_truth[:, 0] = NAN
    found = figures_of(without_truth)
    among(found, ok=0.5, wrong=0.5, rejected=0.5, mae=None, covered=None, width=None)
    nothing = figures_of(np.tile(TRACKS[3], (3, 1)))
    among(nothing, answered=0.0, rejected=1.0, mae=None, p95=None, covered=None, shown=None)


# ---- Real balls beside the reference.

TRUTH = np.array([0.7, 0.05, 0.1])
REFERENCE = Found(TRUTH, TRUTH + 0.001, TRUTH[:, None] + np.array([-0.002, 0.003]), "", 1e-4)


def found_ball(error: float, half: float, verdict: str, path: float) -> Score:
    """Restitution and its interval alone."""
    values = np.array([0.7 + error, NAN, NAN])
    ends = np.full((3, 2), NAN)
    ends[0] = values[0] - half, values[0] + half
    return Score(Found(TRUTH, values, ends, verdict, path), REFERENCE)


def test_balls_in_air_beside_the_reference():
    drops = [
        found_ball(0.002, 0.005, "ok", 0.01),
        found_ball(-0.006, 0.005, "ok", 0.01),
        found_ball(0.001, NAN, "suspect", 0.03),
        found_ball(NAN, NAN, "rejected", NAN),
    ]
    first, slope, drag, path = lines_of("x 1, 1 mm", drops)
    among(first, drops=4, answered=3, intervals=2, ok=0.5, suspect=0.25, rejected=0.25)
    among(first, mean=0.003, median=0.002, worst=0.006, reference_mean=0.001, width=2.0)
    among(first, covered=0.5, reference_covered=1.0)
    among(slope, mean=None, worst=None, covered=None, width=None, reference_worst=0.001)
    among(drag, answered=0)
    among(path, worst=0.03, reference_p99=1e-4)


# ---- Payloads.


def test_logs_of_a_driver():
    nothing = {"truth": 0.5, "value": None, "ok": False}
    first = {**nothing, "value": 0.52, "low": 0.4, "high": 0.6, "bound": 0.1, "secant": 0.6}
    first |= {"ok": True, "centre_mm": None}
    second = {**first, "value": 0.44, "high": 0.46, "secant": 0.5, "ok": False}
    second["centre_mm"] = np.array([10.0, 2.0, 0.0])
    row = payload.log_row(payload.LogCase("some", True), [first, second, nothing])
    among(row, logs=3, answered=2 / 3, ok=1 / 3, mae=0.04, held=0.5, width=0.13)
    among(row, secant=0.05, told=0.5, told_mae=0.06)
    assert row["centre_mm"] == near((10.0, 2.0, 0.0))
    among(
        payload.log_row(payload.LogCase("some", True), [nothing]),
        mae=None,
        held=None,
        width=None,
        told=None,
    )


def said(mass_kg: float, *, is_ok: bool = True, sign: int = 1) -> payload.StrangerAnswer:
    convention = Convention(sign, True)
    return payload.StrangerAnswer(mass_kg, mass_kg - 0.01, mass_kg + 0.01, is_ok, convention)


def log_of(answer: payload.StrangerAnswer | None, least_squares_kg: float) -> Row:
    """Of 1 kg, which a subtracted tare finds."""
    both = {"least_squares": least_squares_kg, "tare_subtracted": 1.0}
    return {"truth": 1.0, **both, "bounds": (0.1, 0.1), "answers": (answer, answer)}


def test_strangers_logs_beside_the_baselines():
    case = payload.STRANGER_CASES[0]
    logs = [
        log_of(said(1.005), 1.2),
        log_of(said(1.031), 1.2),  # more than three half widths off
        log_of(said(0.98, is_ok=False), 0.81),
        log_of(said(1.0, sign=-1), 1.2),
        log_of(None, 9.0),
    ]
    row = payload.stranger_row(case, logs, has_tare=True)
    among(row, logs=5, answered=0.8, ok=0.6, far_ok=0.2, wrong_ok=1, held=0.5, width_g=20.0)
    among(row, mae_g=14.0, median_g=12.5, worst_g=31.0, bound_g=100 * np.sqrt(2 / np.pi))
    among(row, least_squares_mae_g=197.5, least_squares_standing="ahead")
    among(row, tare_subtracted_standing="behind")
    among(payload.stranger_row(case, logs[4:], has_tare=True), answered=0.0, mae_g=None)
    level = [log_of(said(1.01), 1.02), log_of(said(1.02), 1.01)]
    row = payload.stranger_row(case, level, has_tare=False)
    among(row, least_squares_standing="level")
    assert "tare_subtracted_mae_g" not in row


# ---- Motions that were predicted, over runs and steps, and engines.


def test_a_motions_error():
    found = motion_error(np.array([[1.1, 0.5], [2.0, 3.0]]), np.array([[1.0, 0.5], [2.5, 4.0]]))
    assert found.cm == near(100 * (0.1 + 0 + 0.5 + 1) / 4)
    assert found.percent == near(100 * (0.1 + 0 + 0.2 + 0.25) / 4)


@pytest.mark.parametrize(
    ("off", "suspect", "at", "is_kept"),
    [
        ((0.001, -0.0029), (), -1, True),
        ((0.001, -0.0031), (), -1, False),
        ((0.001,), (0.1,), -1, True),
        ((), (0.001,), -1, None),
        ((0.1,), (), 0, None),  # another method than the default one promises nothing
    ],
)
def test_a_promise_of_engines_is_kept_by_the_worst_that_is_ok(off, suspect, at: int, is_kept):
    scores = [
        {"method": METHODS[at], "error": abs(one), "apart_percent": 0.1, "is_ok": is_ok}
        for some, is_ok in ((off, True), (suspect, False))
        for one in some
    ]
    row = line_of(RANGES[0], "mujoco", EXACT, METHODS[at], 3, scores)
    assert row["is_kept"] is is_kept
