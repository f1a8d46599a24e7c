"""The second experiment: its figures are what they say, and every rollout in them is paid for."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from tests.engines import needs_pybullet
from tunenet_logs.analysis.drop.presets import TRAININGS
from tunenet_logs.analysis.estimators.base import Estimator, Problem, Step, Trace
from tunenet_logs.analysis.evaluation.studies.drop import (
    DropExperiment,
    draw_figure,
    drop_csv,
    drop_json,
    drop_rows,
    drop_tables,
    error_curves,
    run_drop,
)
from tunenet_logs.analysis.evaluation.studies.drop_methods import (
    EASY,
    HARD,
    NETWORKS,
    Cell,
    DropResults,
    DropTarget,
    Effort,
    Method,
    MethodErrors,
    OverspentError,
    TargetBatch,
    draw_targets,
    errors_of,
    estimate_batches,
    paper_methods,
    published_error,
    user_methods,
)
from tunenet_logs.analysis.evaluation.study import short
from tunenet_logs.analysis.tunenet.weights import shipped_model
from tunenet_logs.recorders.simulators.base import PAPER
from tunenet_logs.terminal import Progress

QUIET = Progress(quiet=True)
EASY_CELL = Cell("drop", "paper", "Easy", 0.0)
HARD_CELL = Cell("drop", "paper", "Hard", 0.0)
NOISY_CELL = Cell("drop", "paper", "Easy", 0.01)
ALLOWED = 10
DEAR = ("cma-es", "entropy-search", "tpe")  # they take long, or their libraries load for long


def ready_methods() -> list[Method]:
    """Every method that draws or searches, and the shipped network of the authors' preset."""
    code = shipped_model(TRAININGS["paper-code"].purpose)
    networks = {name: code for name in NETWORKS}  # noqa: C420 (names of type str)
    return [*paper_methods(networks, 0.5, (0.1, 0.9), 3), *user_methods(3)]


def share(method: Method, targets: list[DropTarget], rollouts: int = ALLOWED) -> TargetBatch:
    return TargetBatch(method, tuple(targets), PAPER, min(rollouts, method.budget))


def outcome(errors: list[list[list[float]]], budget: int, cell: Cell = EASY_CELL) -> MethodErrors:
    return MethodErrors(cell, "cma-es", "CMA-ES", "paper", budget, np.array(errors))


def test_figures_are_those_of_a_calculation_by_hand():
    # two seeds, three targets, after 0 and 1 rollouts
    one = outcome(
        [[[9, 0.1], [9, 0.2], [9, 0.6]], [[9, 0.0], [9, 0.1], [9, 0.2]]],
        budget=1,
    )
    figures = one.figures(1)
    assert figures.mae == pytest.approx((0.3 + 0.1) / 2)
    assert figures.median == pytest.approx(0.15)
    assert (figures.lowest, figures.highest) == pytest.approx((0.1, 0.3))
    assert figures.paper == 0.0540
    assert one.figures(100).mae == figures.mae
    assert one.figures(0).mae == 9


def test_what_a_method_was_not_allowed_is_not_known():
    noisy = outcome([[[0.3, 0.2, 0.1]]], budget=100, cell=NOISY_CELL)
    assert noisy.knows(2)
    assert not noisy.knows(5)
    with pytest.raises(ValueError, match="2 rollouts, not 5"):
        noisy.figures(5)
    assert noisy.figures(1).paper is None


def test_published_figures_stand_beside_what_they_were_measured_as():
    assert published_error("Easy", "tunenet-paper-code", 5) == 0.0050
    assert published_error("Hard", "tunenet-paper", 100) == 0.0175
    assert published_error("Hard (target only)", "entropy-search", 10) == 0.1153
    assert published_error("Easy", "brent", 5) is None
    assert published_error("Easy", "mean", 40) is None


@pytest.mark.parametrize(
    ("error", "text"),
    [(0.25, ".2500"), (0.0012, ".0012"), (0.00018, ".00018"), (2e-6, "2.0e-6"), (0, "<1e-9")],
)
def test_small_errors_keep_two_digits(error: float, text: str):
    assert short(error) == text


@needs_pybullet
@pytest.mark.parametrize(
    "method",
    [
        pytest.param(one, id=one.name, marks=pytest.mark.slow if one.name in DEAR else ())
        for one in ready_methods()
    ],
)
def test_a_target_costs_the_same_whoever_came_before(method: Method):
    targets = draw_targets(HARD, 2, seed=4, noise_m=0.01)
    together = errors_of(share(method, targets))
    alone = np.concatenate([errors_of(share(method, [one])) for one in reversed(targets)])[::-1]
    assert np.array_equal(together, alone)
    assert together.shape == (2, 1 + min(ALLOWED, method.budget))


@needs_pybullet
@pytest.mark.slow
def test_the_number_of_processes_changes_nothing():
    targets = draw_targets(EASY, 2, seed=5)
    methods = [one for one in ready_methods() if one.name != "tpe"]  # its library loads for long
    shares = [share(one, [target], 6) for one in methods for target in targets]
    alone, together = (estimate_batches(shares, jobs, QUIET) for jobs in (1, 2))
    for first, second in zip(alone, together, strict=True):
        assert np.array_equal(first, second)


class _Spends(Estimator):
    """Takes as many rollouts as it likes, and says what it likes."""

    name = "spends"

    def __init__(self, taken: int, told: int) -> None:
        self._taken, self._told = taken, told

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        for _ in range(self._taken):
            problem.evaluate(problem.initial)
        return Trace((Step(problem.initial, 0), Step(problem.initial, self._told)))


@needs_pybullet
@pytest.mark.parametrize(("taken", "told"), [(4, 4), (4, 2), (2, 3)])
def test_a_method_that_does_not_pay_is_found_out(taken: int, told: int):
    method = Method("spends", "Spends", "user", _Spends(taken, told), 3)
    with pytest.raises(OverspentError, match="spends"):
        errors_of(share(method, draw_targets(EASY, 1, seed=1)))


@needs_pybullet
def test_an_answer_counts_from_the_rollout_on_that_it_was_paid_with():
    method = Method("spends", "Spends", "user", _Spends(2, 2), 3)
    (target,) = draw_targets(EASY, 1, seed=1)
    off = abs(target.initial - target.truth)
    assert errors_of(share(method, [target])) == pytest.approx(np.full((1, 4), off))


@pytest.fixture(scope="module")
def results() -> DropResults:
    return run_drop(DropExperiment((1, 2), 2, ("mean", "secant"), 1), QUIET)


@needs_pybullet
@pytest.mark.slow
def test_every_cell_is_filled_within_its_budget():
    names = ("mean", "direct", "secant", "tunenet-paper-code", "difference")
    results = run_drop(DropExperiment((1, 2), 2, names, 2, Effort(50, 2)), QUIET)
    clean = results.of(EASY_CELL)
    assert [one.method for one in clean] == ["mean", "direct", "tunenet-paper-code", "secant"]
    assert {one.errors.shape[:2] for one in results.outcomes} == {(2, 2)}
    assert max(one.allowed for one in clean) == 100
    assert max(one.allowed for one in results.of(NOISY_CELL)) == 10
    ablation = [one.method for cell in results.cells[-2:] for one in results.of(cell)]
    assert ablation == ["difference", "difference"]
    truths = [target.truth for target in draw_targets(EASY, 2, seed=2)]
    off = np.abs(np.array(truths) - np.mean(truths))
    assert clean[0].errors[1, :, 0] == pytest.approx(off)
    curves = error_curves(results, "Easy")
    assert [(len(one.mean), len(one.paper)) for one in curves] == [(101, 4)] * 3 + [(101, 0)]


@needs_pybullet
def test_the_secant_finds_what_easy_targets_hide(results: DropResults):
    _, secant = results.of(EASY_CELL)
    assert secant.figures(10).mae < 1e-3
    assert secant.figures(0).mae > 0.02


@needs_pybullet
def test_json_csv_and_table_hold_the_same_figures(results: DropResults):
    told = json.loads(drop_json(results))
    rows = list(csv.DictReader(drop_csv(results).splitlines()))
    assert len(rows) == len(told["rows"]) == len(drop_rows(results))
    table = drop_tables(results)
    assert "intervals" not in told  # not measured where methods are chosen
    keys = ("experiment", "simulator", "set", "noise_m", "method", "rollouts")
    for one in told["summary"]:
        mine = [float(row["mae"]) for row in rows if all(row[key] == str(one[key]) for key in keys)]
        assert len(mine) == len(told["seeds"])
        assert one["mae"] == pytest.approx(np.mean(mine))
        assert (one["lowest"], one["highest"]) == pytest.approx((min(mine), max(mine)))
    mean = next(one for one in told["summary"] if one["method"] == "mean")
    lines = [" ".join(line.split()) for line in table.splitlines()]
    assert any(line.startswith(f"Mean* {short(mean['mae'])} (.0968)") for line in lines)
    assert max(len(line) for line in table.splitlines()) <= 100


@needs_pybullet
def test_curves_go_on_to_the_end_and_show_each_published_point_once(results: DropResults):
    curves = error_curves(results, "Easy")
    assert {len(curve.mean) for curve in curves} == {11}
    assert [(one.method, len(one.paper)) for one in curves] == [("mean", 4), ("secant", 0)]
    for curve in curves:
        assert (curve.low <= curve.mean + 1e-12).all()
        assert (curve.mean <= curve.high + 1e-12).all()


@needs_pybullet
def test_the_picture_holds_every_curve_and_point(results: DropResults):
    tall = [replace(one, errors=one.errors * 30) for one in results.of(HARD_CELL)]
    both = replace(results, outcomes=(*results.of(EASY_CELL), *tall))
    figure = draw_figure(both)
    for panel, axis in zip(("Easy", "Hard"), figure.axes, strict=True):
        bottom, top = axis.get_ylim()
        for curve in error_curves(both, panel):
            shown = [*curve.low, *curve.high, *(error for _, error in curve.paper)]
            assert bottom <= min(shown)
            assert max(shown) <= top


@needs_pybullet
@pytest.mark.slow
def test_one_target_is_enough_for_all_that_is_told():
    order = DropExperiment((1,), 1, ("mean", "entropy-search"), 1)
    for one in run_drop(order, QUIET).outcomes:
        assert one.figures(1).mae == pytest.approx(0, abs=1e-12)


@needs_pybullet
@pytest.mark.slow
def test_a_users_methods_compete_on_the_calibrated_simulator():
    found = run_drop(DropExperiment((1,), 2, ("secant", "brent"), 1), QUIET)
    for noise_m, most in ((0.0, 40), (0.01, 10)):
        secant, brent = found.of(Cell("drop", "calibrated", "Easy", noise_m))
        assert (secant.allowed, brent.allowed) == (10, most)
        assert secant.figures(10).mae < 0.01
