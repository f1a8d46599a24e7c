"""The damped step: a valley's end is found, and where nothing helps, nothing moves."""

from __future__ import annotations

import numpy as np
import pytest

from tunenet_logs.analysis.estimators.damped import Damping, damped_step
from tunenet_logs.episode import Array

RULE = Damping(tries=6, raised_by=10, lowered_by=10, least=1e-9)


def residuals(at: Array) -> Array:
    """Rosenbrock's valley; 0 at (1, 1)."""
    return np.array([10 * (at[1] - at[0] ** 2), 1 - at[0]])


def cost(at: Array) -> float:
    return float(residuals(at) @ residuals(at))


def stepped(at: Array, damping: float) -> tuple[Array, float]:
    jacobian = np.array([[-20 * at[0], 10.0], [-1.0, 0.0]])
    normal = jacobian.T @ jacobian
    normal += damping * np.diag(np.diag(normal))
    there = at - np.linalg.solve(normal, jacobian.T @ residuals(at))
    return there, cost(there)


def test_the_end_of_a_narrow_valley_is_found():
    at, damping = np.array([-1.2, 1.0]), 1e-3
    least = cost(at)
    for _ in range(60):
        found, after, damping = damped_step(
            lambda one, at=at: stepped(at, one), least, damping, RULE
        )
        assert after <= least
        at, least = at if found is None else found, after
    assert at == pytest.approx([1.0, 1.0], abs=1e-6)
    assert damping >= RULE.least


def test_damping_grows_with_each_step_that_does_not_help():
    asked: list[float] = []
    rule = Damping(tries=3, raised_by=10, lowered_by=10, least=1e-9, raised_from=1e-3)
    found, after, damping = damped_step(
        lambda one: asked.append(one) or ("up", 2.0), 1.0, 1e-6, rule
    )
    assert (found, after) == (None, 1.0)
    assert asked == pytest.approx([1e-6, 1e-2, 1e-1])
    assert damping == pytest.approx(1.0)


def test_a_step_that_is_too_short_ends_it_and_leaves_the_damping():
    assert damped_step(lambda _: None, 1.0, 1e-6, RULE) == (None, 1.0, 1e-6)
