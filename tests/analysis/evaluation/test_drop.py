"""The second experiment: its figures are what they say, and every rollout in them is paid for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.engines import needs_pybullet
from tunenet_logs.analysis.drop.presets import TRAININGS
from tunenet_logs.analysis.estimators.base import Estimator, Problem, Step, Trace
from tunenet_logs.analysis.evaluation.studies.curves import draw_figure, error_curves
from tunenet_logs.analysis.evaluation.studies.drop import drop_rows, run_drop
from tunenet_logs.analysis.evaluation.studies.drop_methods import (
    EASY,
    HARD,
    NETWORKS,
    Cell,
    DropResults,
    DropTarget,
    Method,
    MethodRegistry,
    OverspentError,
    TargetBatch,
    draw_targets,
    errors_of,
)
from tunenet_logs.analysis.evaluation.study import METHODS, Order, scored
from tunenet_logs.analysis.parallel import Piece
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
    names = (*METHODS["methods of the paper"], "secant", "brent", "least-squares", "tpe")
    registry = MethodRegistry(names, frozenset())
    return registry.methods("paper", networks, np.array([0.1, 0.9]), 3)


def share(method: Method, targets: list[DropTarget], rollouts: int = ALLOWED) -> TargetBatch:
    return TargetBatch(method, tuple(targets), PAPER, min(rollouts, method.budget))


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
    cases = {"": [Piece(one) for one in shares]}
    alone, together = (
        scored(errors_of, cases, Order((1,), 2, jobs=jobs), QUIET, ("estimating", "target"))[""]
        for jobs in (1, 2)
    )
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
    return run_drop(Order((1, 2), 2, jobs=1, methods=("mean", "secant")), QUIET)


@needs_pybullet
@pytest.mark.slow
def test_every_cell_is_filled_within_its_budget():
    names = ("mean", "direct", "secant", "tunenet-paper-code", "difference")
    results = run_drop(Order((1, 2), 2, jobs=2, methods=names, pairs=50, epochs=2), QUIET)
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
def test_a_users_methods_compete_on_the_calibrated_simulator():
    found = run_drop(Order((1,), 2, jobs=1, methods=("secant", "brent")), QUIET)
    for noise_m, most in ((0.0, 40), (0.01, 10)):
        secant, brent = found.of(Cell("drop", "calibrated", "Easy", noise_m))
        assert (secant.allowed, brent.allowed) == (10, most)
        assert secant.figures(10).mae < 0.01


@needs_pybullet
@pytest.mark.slow
@pytest.mark.parametrize("method", ready_methods(), ids=lambda one: one.name)
def test_an_answer_does_not_depend_on_how_many_rollouts_are_left(method: Method):
    targets = draw_targets(HARD, 2, seed=-4, noise_m=0.01)
    few, many = errors_of(share(method, targets, 5)), errors_of(share(method, targets))
    assert np.array_equal(few, many[:, : few.shape[1]])


@needs_pybullet
@pytest.mark.slow
def test_fewer_rollouts_leave_out_columns_and_end_the_curves_and_nothing_else():
    order = Order((1, 2), 2, jobs=2, methods=("secant",))
    few, full = (run_drop(replace(order, rollouts=most), QUIET) for most in (5, None))
    for cut, one in zip(few.outcomes, full.outcomes, strict=True):
        assert np.array_equal(cut.errors, one.errors[:, :, :6])
    assert {row["rollouts"] for row in drop_rows(few)} == {1, 5}
    assert {len(one.mean) for one in error_curves(few, "Easy")} == {6}
    axis, *_ = draw_figure(few).axes
    assert axis.get_xlim()[1] < 6
