"""CMA-ES on plain functions: how close it comes, and what it leaves alone."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Mapping

import numpy as np
import pytest

from tunenet_logs.analysis.estimators.base import Observation, Problem, Trace
from tunenet_logs.analysis.estimators.methods import ScaledCmaEs
from tunenet_logs.episode import Array, Episode, EpisodeInfo
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.base import Parameter

pytest.importorskip("cma")

# Ranges of quite different widths.
LOW, HIGH = np.array([0.0, -5000.0, 1e-6]), np.array([1.0, 5000.0, 3e-6])


class Shares:
    """A simulator whose observation is a bent mixture of its parameters' shares of their ranges."""

    engine, step_hz = "none", 1.0

    def __init__(self, count: int) -> None:
        self.parameters = tuple(
            Parameter(f"p{number}", "1", (low, high), (low, high), low)
            for number, (low, high) in enumerate(zip(LOW[:count], HIGH[:count], strict=True))
        )

    def rollout(self, values: Mapping[str, float]) -> Episode:
        for one in self.parameters:
            one.checked(values[one.name])
        return Episode(EpisodeInfo(truth=dict(values)), {})

    def observe(self, episode: Episode) -> Observation:
        count = len(self.parameters)
        values = np.array([episode.info.truth[one.name] for one in self.parameters])
        shares = (values - LOW[:count]) / (HIGH - LOW)[:count]
        mixed = np.tri(count) @ shares + 0.3 * shares**2
        return Observation(mixed[:, None], np.arange(float(count)), "nothing", ("value",))


def problem(shares: Array, first: Array) -> Problem:
    count = len(shares)
    simulator = Shares(count)
    names = [one.name for one in simulator.parameters]
    truth = LOW[:count] + shares * (HIGH - LOW)[:count]
    wanted = simulator.observe(simulator.rollout(dict(zip(names, truth, strict=True))))
    initial = LOW[:count] + first * (HIGH - LOW)[:count]
    return Problem(wanted, simulator, simulator.observe, initial)


def found(trace: Trace) -> Array:
    """The answer in shares of the ranges."""
    count = len(trace.estimate)
    return (trace.estimate - LOW[:count]) / (HIGH - LOW)[:count]


@pytest.mark.parametrize(
    ("count", "rollouts", "off"), [(1, 60, 0.03), (1, 150, 0.003), (2, 250, 0.003), (3, 400, 0.005)]
)
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("first", [0.0, 0.5, 1.0])
def test_it_finds_the_truth_from_anywhere(
    count: int, rollouts: int, off: float, seed: int, first: float
):
    truth = np.array([0.72, 0.31, 0.9])[:count]
    asked = problem(truth, np.full(count, first))
    trace = ScaledCmaEs(seed).estimate(asked, rollouts)
    assert np.abs(found(trace) - truth).max() < off
    assert asked.rollouts <= rollouts


@pytest.mark.parametrize("truth", [0.0, 1.0])
def test_it_finds_the_edge_of_a_range(truth: float):
    trace = ScaledCmaEs(0).estimate(problem(np.array([truth, 0.4]), np.full(2, 0.5)), 300)
    assert found(trace) == pytest.approx([truth, 0.4], abs=0.002)


@pytest.mark.parametrize("rollouts", [0, 1, 2, 7])
def test_few_rollouts_never_make_it_worse(rollouts: int):
    asked = problem(np.array([0.5, 0.5]), np.array([0.5001, 0.5]))
    trace = ScaledCmaEs(0).estimate(asked, rollouts)
    assert asked.rollouts == rollouts
    assert found(trace) == pytest.approx([0.5001, 0.5])


def test_it_is_the_same_twice_and_leaves_numpys_own_numbers_alone():
    def run() -> Array:
        return ScaledCmaEs(3).estimate(problem(np.full(2, 0.3), np.zeros(2)), 50).estimate

    np.random.seed(1)  # noqa: NPY002 (the one that a library might draw from)
    expected = np.random.random(3)  # noqa: NPY002
    np.random.seed(1)  # noqa: NPY002
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        first = run()
    np.testing.assert_array_equal(np.random.random(3), expected)  # noqa: NPY002
    np.random.seed(2)  # noqa: NPY002
    np.testing.assert_array_equal(run(), first)


def test_it_leaves_no_files_and_says_nothing(
    tmp_path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    ScaledCmaEs(0).estimate(problem(np.full(1, 0.3), np.zeros(1)), 100)
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr() == ("", "")


def test_without_its_library_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "cma", None)
    with pytest.raises(UsageError, match=r"cma is not installed; pip install .*\[eval\]"):
        ScaledCmaEs(0).estimate(problem(np.full(1, 0.3), np.zeros(1)), 10)
