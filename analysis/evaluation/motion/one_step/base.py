"""Interface of one-step predictors, and the loop that runs them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from tunenet_logs.arrays import Array

Memory = Any  # what a predictor keeps of a run; None where it keeps nothing


class Stepper(Protocol):
    """Predictor of the next state (height of the centre [m], speed upward [m/s]) of N balls."""

    def start(self, count: int, /) -> Memory:
        """Return the memory of `count` balls of which nothing was seen."""
        ...

    def forecast(self, memory: Memory, states: Array, /) -> tuple[Array, Memory]:
        """Predict the states one step after `states`, shape (N, 2), and what `learn` needs."""
        ...

    def learn(self, memory: Memory, states: Array | None, /) -> Memory:
        """Update the memory with what came of the forecast.

        Args:
            memory: what `forecast` returned.
            states: the true states, shape (N, 2); None where nobody sees them, and the forecast
                is all there is to go by.
        """
        ...


def predict(stepper: Stepper, truth: Array, seen: int) -> Array:
    """Predict the heights of whole runs.

    Args:
        stepper: the predictor.
        truth: states, shape (N, T + 1, 2), the release first.
        seen: so many steps after the release are seen: each of these is predicted one step ahead
            of the true state before it, the others from the predictor's own forecasts. T is
            one-step prediction throughout, 0 a free rollout from the release.

    Returns:
        Heights [m] after each step, shape (N, T).
    """
    runs, steps = len(truth), truth.shape[1] - 1
    heights_m = np.empty((runs, steps))
    memory = stepper.start(runs)
    states = truth[:, 0]
    for step in range(steps):
        states, memory = stepper.forecast(memory, states)
        heights_m[:, step] = states[:, 0]
        true_states = truth[:, step + 1] if step < seen else None
        memory = stepper.learn(memory, true_states)
        if true_states is not None:
            states = true_states
    return heights_m


class Memoryless:
    """Predictor from the present state alone, by `step` on states of shape (N, 2)."""

    def __init__(self, step: Callable[[Array], Array]) -> None:
        self._step = step

    def start(self, _count: int, /) -> Memory:
        """See `Stepper.start`."""
        return None

    def forecast(self, _memory: Memory, states: Array, /) -> tuple[Array, Memory]:
        """See `Stepper.forecast`."""
        return self._step(states), None

    def learn(self, _memory: Memory, _states: Array | None, /) -> Memory:
        """See `Stepper.learn`."""
        return None


def stand_still(states: Array) -> Array:
    """Predict no motion: its error one step ahead is how far the ball goes in one."""
    return states
