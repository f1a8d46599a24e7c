"""The second experiment: every rollout in its figures is paid for, and curves show them all."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.engines import needs_pybullet
from tunenet_logs.analysis.estimators.base import Estimator, Observation, Problem, Step, Trace
from tunenet_logs.analysis.evaluation.studies import drop_methods as drop
from tunenet_logs.analysis.evaluation.studies.baselines import (
    GridDensity,
    NeuralPosterior,
    middles,
    train_posterior,
)
from tunenet_logs.analysis.evaluation.studies.drop import draw_figure, drop_rows, run_drop
from tunenet_logs.analysis.evaluation.study import Order
from tunenet_logs.recorders.simulators.base import PAPER
from tunenet_logs.terminal import Progress

pytestmark = needs_pybullet
QUIET = Progress(quiet=True)
EASY_CELL = drop.Cell("drop", "paper", "Easy", 0.0)
HARD_CELL = drop.Cell("drop", "paper", "Hard", 0.0)
NOISY_CELL = drop.Cell("drop", "paper", "Easy", 0.01)


class _Spends(Estimator):
    """Takes as many rollouts as it likes, and says what it likes."""

    name = "spends"

    def __init__(self, taken: int, told: int) -> None:
        self._taken, self._told = taken, told

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        for _ in range(self._taken):
            problem.evaluate(problem.initial)
        return Trace((Step(problem.initial, 0), Step(problem.initial, self._told)))


@pytest.mark.parametrize(
    ("taken", "told", "pays"), [(4, 4, False), (4, 2, False), (2, 3, False), (2, 2, True)]
)
def test_a_method_that_does_not_pay_is_found_out(taken: int, told: int, pays: bool):
    (target,) = drop.draw_targets(drop.EASY, 1, seed=1)
    method = drop.Method("spends", "Spends", "user", _Spends(taken, told), 3)
    batch = drop.TargetBatch(method, (target,), PAPER, 3)
    if pays:  # an answer counts from the rollout on that it was paid with
        off = abs(target.initial - target.truth)
        assert drop.errors_of(batch) == pytest.approx(np.full((1, 4), off))
    else:
        with pytest.raises(drop.OverspentError, match="spends"):
            drop.errors_of(batch)


@pytest.fixture(scope="module")
def results() -> drop.DropResults:
    return run_drop(Order((1, 2), 2, jobs=1, methods=("mean", "secant")), QUIET)


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
    truths = [target.truth for target in drop.draw_targets(drop.EASY, 2, seed=2)]
    off = np.abs(np.array(truths) - np.mean(truths))
    assert clean[0].errors[1, :, 0] == pytest.approx(off)
    curves = drop.error_curves(results, "Easy")
    assert [(len(one.mean), len(one.paper)) for one in curves] == [(101, 4)] * 3 + [(101, 0)]


def test_the_secant_finds_what_easy_targets_hide(results: drop.DropResults):
    _, secant = results.of(EASY_CELL)
    assert secant.figures(10).mae < 1e-3
    assert secant.figures(0).mae > 0.02


def test_the_picture_holds_every_curve_and_each_published_point_once(results: drop.DropResults):
    curves = drop.error_curves(results, "Easy")
    shown = [(one.method, len(one.mean), len(one.paper)) for one in curves]
    assert shown == [("mean", 11, 4), ("secant", 11, 0)]
    tall = [replace(one, errors=one.errors * 30) for one in results.of(HARD_CELL)]
    both = replace(results, outcomes=(*results.of(EASY_CELL), *tall))
    for panel, axis in zip(("Easy", "Hard"), draw_figure(both).axes, strict=True):
        bottom, top = axis.get_ylim()
        for curve in drop.error_curves(both, panel):
            assert (curve.low <= curve.mean + 1e-12).all()
            assert (curve.mean <= curve.high + 1e-12).all()
            errors = [*curve.low, *curve.high, *(error for _, error in curve.paper)]
            assert bottom <= min(errors) <= max(errors) <= top


@pytest.mark.slow
def test_a_users_methods_compete_on_the_calibrated_simulator_however_many_processes_there_are():
    alone, together = (
        run_drop(Order((1,), 2, jobs=jobs, methods=("secant", "brent")), QUIET) for jobs in (1, 2)
    )
    for one, other in zip(alone.outcomes, together.outcomes, strict=True):
        assert np.array_equal(one.errors, other.errors)
    for noise_m, most in ((0.0, 40), (0.01, 10)):
        secant, brent = alone.of(drop.Cell("drop", "calibrated", "Easy", noise_m))
        assert (secant.allowed, brent.allowed) == (10, most)
        assert secant.figures(10).mae < 0.01


@pytest.mark.slow
def test_fewer_rollouts_leave_out_columns_and_end_the_curves_and_nothing_else():
    order = Order((1, 2), 2, jobs=2, methods=("secant",))
    few, full = (run_drop(replace(order, rollouts=most), QUIET) for most in (5, None))
    for cut, one in zip(few.outcomes, full.outcomes, strict=True):
        assert np.array_equal(cut.errors, one.errors[:, :, :6])
    assert {row["rollouts"] for row in drop_rows(few)} == {1, 5}
    assert {len(one.mean) for one in drop.error_curves(few, "Easy")} == {6}
    axis, *_ = draw_figure(few).axes
    assert axis.get_xlim()[1] < 6


# ---- The neural posterior: its figures are those of a known density.

HALF_95 = 1.959964  # half of a Gaussian's 95 % interval, in standard deviations


def gaussian(mean: float, sd: float, edges: np.ndarray) -> GridDensity:
    return GridDensity.from_logs(edges, 7.0 - ((middles(edges) - mean) / sd) ** 2 / 2)


@pytest.mark.parametrize(("mean", "sd"), [(0.5, 0.1), (0.31, 0.003), (0.7, 0.0007)])
def test_a_gaussians_mean_and_quantiles_are_found_on_the_grid(mean: float, sd: float):
    density = gaussian(mean, sd, np.linspace(0, 1, 4001))
    assert density.mean == pytest.approx(mean, abs=1e-5)
    expected = (mean - HALF_95 * sd, mean + HALF_95 * sd)
    assert density.interval() == pytest.approx(expected, abs=3e-5)
    assert density.quantile(0.5) == pytest.approx(mean, abs=1e-5)
    half = gaussian(0.0, 0.1, np.linspace(0, 1, 4001))  # what lies outside the prior is left out
    assert half.mean == pytest.approx(0.1 * math.sqrt(2 / math.pi), abs=1e-5)
    assert half.quantile(0.95) == pytest.approx(HALF_95 * 0.1, abs=1e-5)


class KnowsTheNoise:
    """A Gaussian about the restitution that the first number of an observation says."""

    bounds = (0.0, 1.0)

    def log_density(self, observation: np.ndarray, values: np.ndarray) -> np.ndarray:
        return -(((values - observation[0] / 10) / 0.02) ** 2) / 2


def test_it_answers_from_the_target_alone_without_a_rollout():
    problem = drop.DropProblems().pose(drop.DropTarget(4.4, 0.3, 0.6))
    estimator = NeuralPosterior(KnowsTheNoise())
    trace = estimator.estimate(problem, 100)
    assert problem.rollouts == 0
    assert [step.rollouts for step in trace.steps] == [0]
    assert trace.estimate[0] == pytest.approx(problem.target.values[0, 0] / 10, abs=1e-5)
    low, high = estimator.density(problem.target).interval()
    assert (high - low) == pytest.approx(2 * HALF_95 * 0.02, abs=1e-4)


@pytest.mark.slow
def test_a_trained_posterior_is_near_the_one_that_is_known():
    """Of n readings with noise s the posterior is a Gaussian about their mean, s / sqrt(n) wide."""
    rng, sd = np.random.default_rng(1), 0.12
    values = rng.uniform(0, 1, 840)
    readings = values[:, None] + rng.normal(0, sd, (840, 3))
    seen = np.column_stack([readings, np.ones(840)])  # and a number that never changes
    trained = train_posterior(seen[:800], values[:800], (0.0, 1.0), seed=4, epochs=20)
    estimator = NeuralPosterior(trained)
    off, widths = [], []
    for row in seen[800:]:
        if abs(row[:3].mean() - 0.5) < 0.25:
            density = estimator.density(Observation(row[:, None], np.arange(4.0), "-", ("x",)))
            off.append(density.mean - row[:3].mean())
            widths.append(np.ptp(density.interval()))
    assert len(off) > 10
    assert np.mean(np.abs(off)) < 0.25 * sd / math.sqrt(3)
    assert np.median(widths) == pytest.approx(2 * HALF_95 * sd / math.sqrt(3), rel=0.25)


@pytest.mark.slow
def test_the_number_of_processes_changes_no_posterior(capfd: pytest.CaptureFixture[str]):
    order = Order((1,), 6, methods=("npe",), pairs=30, epochs=3)
    found = [run_drop(replace(order, jobs=jobs), QUIET) for jobs in (1, 2)]
    alone, together = found
    assert len(alone.outcomes) == len(alone.credible) == 6
    assert alone.credible == together.credible
    for first, second in zip(alone.outcomes, together.outcomes, strict=True):
        assert np.array_equal(first.errors, second.errors)
    assert capfd.readouterr() == ("", "")  # of the library's words, in the workers too
