"""The neural posterior: its figures are those of a known density, and it keeps to itself."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.engines import needs_pybullet
from tunenet_logs.analysis.estimators.base import Observation
from tunenet_logs.analysis.evaluation.studies.baselines import (
    GridDensity,
    NeuralPosterior,
    SbiPosterior,
    middles,
    train_posterior,
)
from tunenet_logs.analysis.evaluation.studies.drop import run_drop
from tunenet_logs.analysis.evaluation.studies.drop_methods import (
    DropProblems,
    DropTarget,
    Table,
    choose_methods,
)
from tunenet_logs.analysis.evaluation.study import Order
from tunenet_logs.terminal import Progress

QUIET = Progress(quiet=True)
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


def test_what_lies_outside_the_prior_is_left_out():
    density = gaussian(0.0, 0.1, np.linspace(0, 1, 4001))  # half of it
    assert density.mean == pytest.approx(0.1 * math.sqrt(2 / math.pi), abs=1e-5)
    assert density.quantile(0.95) == pytest.approx(HALF_95 * 0.1, abs=1e-5)


class KnowsTheNoise:
    """A Gaussian about the restitution that the first number of an observation says."""

    bounds = (0.0, 1.0)

    def log_density(self, observation: np.ndarray, values: np.ndarray) -> np.ndarray:
        return -(((values - observation[0] / 10) / 0.02) ** 2) / 2


@needs_pybullet
def test_it_answers_from_the_target_alone_without_a_rollout():
    problem = DropProblems().pose(DropTarget(4.4, 0.3, 0.6))
    estimator = NeuralPosterior(KnowsTheNoise())
    trace = estimator.estimate(problem, 100)
    assert problem.rollouts == 0
    assert [step.rollouts for step in trace.steps] == [0]
    assert trace.estimate[0] == pytest.approx(problem.target.values[0, 0] / 10, abs=1e-5)
    low, high = estimator.density(problem.target).interval()
    assert (high - low) == pytest.approx(2 * HALF_95 * 0.02, abs=1e-4)


BOUNDS = (0.0, 1.0)
SD = 0.12


def line_data(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Three readings of a value, each with Gaussian noise; one that never changes."""
    rng = np.random.default_rng(seed)
    values = rng.uniform(*BOUNDS, count)
    readings = values[:, None] + rng.normal(0, SD, (count, 3))
    return np.column_stack([readings, np.ones(count)]), values


@pytest.fixture(scope="module")
def trained() -> SbiPosterior:
    return train_posterior(*line_data(800, 1), BOUNDS, seed=4, epochs=20)


@pytest.mark.slow
def test_a_trained_posterior_is_near_the_one_that_is_known(trained: SbiPosterior):
    """Of n readings with noise s the posterior is a Gaussian about their mean, s / sqrt(n) wide."""
    estimator = NeuralPosterior(trained)
    readings, _ = line_data(40, 2)
    inner = readings[(abs(readings[:, :3].mean(axis=1) - 0.5) < 0.25)]
    off, widths = [], []
    for row in inner:
        density = estimator.density(Observation(row[:, None], np.arange(4.0), "-", ("x",)))
        low, high = density.interval()
        off.append(density.mean - row[:3].mean())
        widths.append(high - low)
    sd = SD / math.sqrt(3)
    assert len(inner) > 10
    assert np.mean(np.abs(off)) < 0.25 * sd
    assert np.median(widths) == pytest.approx(2 * HALF_95 * sd, rel=0.25)


@pytest.mark.slow
def test_another_process_gets_the_same_network(trained: SbiPosterior):
    readings, _ = line_data(1, 3)
    places = np.linspace(0, 1, 50)
    here = trained.log_density(readings[0], places)
    there = pickle.loads(pickle.dumps(trained))
    assert set(vars(there)) == {"bounds", "inputs", "weights"}
    assert np.array_equal(there.log_density(readings[0], places), here)


@pytest.mark.slow
def test_training_says_nothing_leaves_nothing_and_draws_from_its_own_seed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    import torch

    data = line_data(100, 1)
    state = torch.get_rng_state()
    first = train_posterior(*data, BOUNDS, seed=1, epochs=2)
    assert torch.equal(torch.get_rng_state(), state)
    torch.rand(5)
    second = train_posterior(*data, BOUNDS, seed=1, epochs=2)
    other = train_posterior(*data, BOUNDS, seed=2, epochs=2)
    same = [np.array_equal(first.weights[name], second.weights[name]) for name in first.weights]
    assert all(same)
    assert any(not np.array_equal(one, other.weights[name]) for name, one in first.weights.items())
    assert capfd.readouterr() == ("", "")
    assert not list(tmp_path.iterdir())


def test_it_competes_on_the_papers_simulator_alone():
    everyone = choose_methods(("npe", "secant"))
    assert everyone.has_posteriors
    assert not choose_methods(("secant",)).has_posteriors
    truths = np.array([0.2, 0.7])
    known = KnowsTheNoise()
    cells: list[tuple[Table, KnowsTheNoise | None]] = [
        *(("paper", known), ("calibrated", known), ("paper", None))
    ]
    names = [
        [one.name for one in everyone.methods(table, {}, truths, 1, density)]
        for table, density in cells
    ]
    assert names == [["secant", "npe"], ["secant"], ["secant"]]


@needs_pybullet
@pytest.mark.slow
def test_the_number_of_processes_changes_no_posterior(capfd: pytest.CaptureFixture[str]):
    order = Order((1,), 6, methods=("npe",), pairs=30, epochs=3)
    found = [run_drop(replace(order, jobs=jobs), QUIET) for jobs in (1, 2)]
    alone, together = found
    assert len(alone.outcomes) == len(alone.credible) == 6
    assert alone.credible == together.credible
    for first, second in zip(alone.outcomes, together.outcomes, strict=True):
        assert np.array_equal(first.errors, second.errors)
    clean, noisy = alone.outcomes[0], alone.outcomes[3]
    assert (clean.cell.noise_m, noisy.cell.noise_m) == (0.0, 0.01)
    assert not np.array_equal(clean.errors, noisy.errors)
    assert capfd.readouterr() == ("", "")  # of the library's words, in the workers too
