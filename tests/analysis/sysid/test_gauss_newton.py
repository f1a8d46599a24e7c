"""Least squares of plain functions, from smooth to rough."""

from __future__ import annotations

import numpy as np
import pytest

from tests.analysis.sysid.toy import SECONDS, Shape, line, parameter, run_of, target_of
from tunenet_logs.analysis.sysid.fit import RolloutLeastSquares, Solution, covariance
from tunenet_logs.episode import Array

NOISE = 0.01


def solved(shape: Shape, truth: list[float], *, low: float = -5.0) -> Solution:
    rng = np.random.default_rng(1)
    seen = shape(np.array(truth)) + NOISE * rng.normal(size=len(SECONDS))
    parameters = tuple(parameter(f"p{number}", low) for number in range(len(truth)))
    start = np.array([one.initial for one in parameters])
    return RolloutLeastSquares(run_of(shape), target_of(seen), parameters).solve(start)


def decay(values: Array) -> Array:
    return np.exp(-0.1 * values[0] ** 2 * SECONDS) * np.cos((1 + 0.1 * values[1]) * SECONDS)


@pytest.mark.parametrize(("shape", "truth"), [(line, [1.0, -2.0]), (decay, [1.5, 0.7])])
def test_known_values_come_back(shape: Shape, truth: list[float]):
    low = 0.1 if shape is decay else -5.0
    assert solved(shape, truth, low=low).values == pytest.approx(truth, abs=0.02)


def test_what_lies_beyond_a_bound_ends_on_it():
    solution = solved(line, [-7.0, 2.0])
    assert solution.values[0] == -5.0
    assert solution.values[1] == pytest.approx(2.0, abs=0.8)


@pytest.mark.parametrize("truth", [[1.0], [1.0, 0.0]])
def test_a_parameter_without_effect_stays_and_is_unsure(truth: list[float]):
    def shape(values: Array) -> Array:
        first = values[0] if len(values) > 1 else 0.0
        return first + np.sin(SECONDS)

    solution = solved(shape, truth)
    assert abs(solution.values[-1]) < 0.1
    seen = target_of(np.sin(SECONDS))
    parameters = tuple(parameter(f"p{number}") for number in range(len(truth)))
    found, _ = covariance(solution, seen, parameters)
    assert np.sqrt(found[-1, -1]) > 10.0  # the whole range


@pytest.mark.parametrize("lost", [slice(300, None), slice(0, None)])
def test_rollouts_that_diverge_end_somewhere(lost: slice):
    def shape(values: Array) -> Array:
        seen = line(values)
        if values[0] > 2 or lost.start == 0:
            seen[lost] = np.nan
        return seen

    rng = np.random.default_rng(0)
    seen = line(np.array([1.0, -2.0])) + NOISE * rng.normal(size=len(SECONDS))
    parameters = (parameter("a"), parameter("b"))
    steps = RolloutLeastSquares(run_of(shape), target_of(seen), parameters)
    solution = steps.solve(np.array([4.0, 0.0]) if lost.start else np.zeros(2))
    assert np.isfinite(solution.values).all()
    if lost.start:
        assert solution.values == pytest.approx([1.0, -2.0], abs=0.02)


def test_a_rough_function_comes_near():
    def shape(values: Array) -> Array:
        return line(values) + 0.003 * np.sin(1e5 * values[0] + 50 * SECONDS)

    assert solved(shape, [1.0, -2.0]).values == pytest.approx([1.0, -2.0], abs=0.02)
