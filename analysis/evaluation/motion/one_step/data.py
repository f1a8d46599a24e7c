"""Simulate states of dropped balls, and one step of the engine from any state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.drop.observations import PAPER_RADIUS_M, PAPER_RATE_HZ, PAPER_SAMPLES
from analysis.drop.presets import PAPER_HEIGHT_M, PAPER_RESTITUTION
from analysis.evaluation.drop.targets import DropTarget
from recorders.simulators.contact import PAPER
from recorders.simulators.engines import engine
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import Progress

PERIOD_S = 1 / PAPER_RATE_HZ
MIDDLE_RESTITUTION = sum(PAPER_RESTITUTION) / 2


@dataclass(frozen=True, eq=False)
class Transitions:
    """Drops, and the engine's step with a fixed restitution from each of their states.

    Attributes:
        states: height of the centre [m] and speed upward [m/s], shape (N, T + 1, 2), the release
            first.
        simulated: the engine's step from each state but the last, shape (N, T, 2).
    """

    states: Array
    simulated: Array


class EngineStep:
    """Paper's simulator with one restitution for all balls, one step at a time.

    Everything that the engine keeps from the step before is forgotten, and the result is still
    that of an uninterrupted run: its step depends on height and speed alone.

    Args:
        restitution: the one that it believes in; the paper's data has U(.3, .7), of which this
            is the middle unless said. What Ajay et al. gave their simulator is not known.
    """

    def __init__(self, restitution: float = MIDDLE_RESTITUTION) -> None:
        self._restitution = restitution
        self._world = engine().ball_world(PAPER_RADIUS_M, PAPER)

    def __call__(self, states: Array) -> Array:
        """Return the states one step later; both of shape (N, 2)."""
        return np.array([self._one(*state) for state in states.tolist()]).reshape(-1, 2)

    def _one(self, height_m: float, speed_m_s: float) -> tuple[float, float]:
        self._world.place(height_m - PAPER_RADIUS_M, self._restitution)
        self._world.set_speed(speed_m_s)
        return self._world.step(PERIOD_S)


def record_states(release_m: Array, restitution: Array) -> Array:
    """Drop balls in the paper's simulator; heights [m], speeds upward [m/s], (N, 401, 2)."""
    world = engine().ball_world(PAPER_RADIUS_M, PAPER)
    states = np.zeros((len(release_m), PAPER_SAMPLES + 1, 2))
    for run, (height_m, value) in enumerate(zip(release_m, restitution, strict=True)):
        states[run, 0, 0] = height_m
        world.place(float(height_m) - PAPER_RADIUS_M, float(value))
        for step in range(1, PAPER_SAMPLES + 1):
            states[run, step] = world.step(PERIOD_S)
    return states


def target_states(targets: Sequence[DropTarget]) -> Array:
    """Return the true states of test cases, shape (N, 401, 2)."""
    release_m = np.array([one.release_m for one in targets])
    return record_states(release_m, np.array([one.truth for one in targets]))


def training_drops(count: int, seed: int, progress: Progress) -> Transitions:
    """Draw `count` drops from U(4, 5) m with restitutions U(.3, .7), one simulation each."""
    rng = np.random.default_rng(seed)
    release_m = rng.uniform(*PAPER_HEIGHT_M, count)
    states = record_states(release_m, rng.uniform(*PAPER_RESTITUTION, count))
    engine = EngineStep()
    simulated = np.empty((count, PAPER_SAMPLES, 2))
    with progress.bar(count, "simulating single steps", "drop") as bar:
        for run in range(count):
            simulated[run] = engine(states[run, :-1])
            bar.update(1)
    return Transitions(states, simulated)
