"""Draw the drops of the paper's second experiment: balls, heights and observation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from analysis.drop import observations as views
from analysis.drop.presets import PAPER_HEIGHT_M, PAPER_RESTITUTION
from analysis.estimators.base import Observation, Problem
from recorders.simulators.base import Parameter
from recorders.simulators.contact import CALIBRATED, PAPER, ContactSettings
from recorders.simulators.drop import RESTITUTION, TOPIC, DropRig, DropSimulator
from tunenet_logs.episode import Episode

# Test targets are drawn from seeds above this one, training and validation from below.
TEST_SEEDS = 7_000_000

# Height of the ball's centre, where a method has to find it too; 4.5 m is the paper's middle.
RELEASE = Parameter("release_m", "m", (0.6, 10.0), PAPER_HEIGHT_M, 4.5)


@dataclass(frozen=True)
class TargetSet:
    """Test set: ranges from which its restitutions are drawn.

    Attributes:
        name: as `tunenet-eval` prints it.
        initial: range of the first guess.
        target: range of what is to be found.
    """

    name: str
    initial: tuple[float, float]
    target: tuple[float, float]


EASY = TargetSet("Easy", PAPER_RESTITUTION, PAPER_RESTITUTION)
HARD = TargetSet("Hard", (0.0, 1.0), (0.0, 1.0))
# As the paper's text has it; what its authors' code draws is `HARD`.
HARD_TARGET = TargetSet("Hard (target only)", PAPER_RESTITUTION, (0.0, 1.0))

TARGET_SETS = (EASY, HARD, HARD_TARGET)


@dataclass(frozen=True)
class DropTarget:
    """Test case.

    Attributes:
        release_m: height of the ball's centre when it is let go.
        initial: the first guess of the restitution, alike for every method.
        truth: the restitution of the target; no method sees it.
        noise_m: standard deviation of what is added to each height of the target.
        seed: of that noise.
    """

    release_m: float
    initial: float
    truth: float
    noise_m: float = 0.0
    seed: int = 0


def draw_targets(which: TargetSet, count: int, seed: int, noise_m: float = 0.0) -> list[DropTarget]:
    """Draw `count` test cases; the same seed gives the same ones, for any noise."""
    rng = np.random.default_rng([TEST_SEEDS + seed, *which.name.encode()])
    heights = rng.uniform(*PAPER_HEIGHT_M, count)
    initial = rng.uniform(*which.initial, count)
    truth = rng.uniform(*which.target, count)
    seeds = rng.integers(2**31, size=count)
    rows = zip(heights, initial, truth, seeds, strict=True)
    return [
        DropTarget(float(height), float(first), float(last), noise_m, int(noise_seed))
        for height, first, last, noise_seed in rows
    ]


class _AnyRelease:
    """Drop simulator with the height of release as a second parameter."""

    parameters = (RESTITUTION, RELEASE)

    def __init__(self, simulator: DropSimulator) -> None:
        self._simulator = simulator
        self.engine, self.step_hz = simulator.engine, simulator.step_hz

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """See `Simulator.rollout`."""
        rig = self._simulator.rig
        drop_height_m = RELEASE.checked(values[RELEASE.name]) - rig.radius_m
        moved = DropRig(drop_height_m, rig.radius_m, rig.rate_hz, rig.samples)
        rest = {RESTITUTION.name: values[RESTITUTION.name]}
        return self._simulator.with_rig(moved).rollout(rest)


class DropProblems:
    """Problems of the test cases, all in one world of the engine.

    Args:
        contact: the paper's simulator (400 samples of z at 60 Hz), or the calibrated one (the
            canonical observation of the same drop).
    """

    def __init__(self, contact: ContactSettings = PAPER) -> None:
        self._contact = contact
        self._world = DropSimulator(_rig(PAPER_HEIGHT_M[0]), contact)

    def pose(self, target: DropTarget, *, free_release: bool = False) -> Problem:
        """Pose one test case; `free_release` makes the height of release a second parameter."""
        rig = _rig(target.release_m)
        simulator = self._world.with_rig(rig)
        episode = simulator.rollout({RESTITUTION.name: target.truth})
        observe = views.paper_rollout
        if self._contact == CALIBRATED:
            observe = partial(_canonical, rig=rig)
        seen = _with_noise(episode, target)
        if free_release:
            guess = np.array([target.initial, target.release_m])
            return Problem(observe(seen), _AnyRelease(simulator), observe, guess)
        return Problem(observe(seen), simulator, observe, np.array([target.initial]))


def _rig(release_m: float) -> DropRig:
    radius = views.PAPER_RADIUS_M
    return DropRig(release_m - radius, radius, views.PAPER_RATE_HZ, views.PAPER_SAMPLES)


def _canonical(episode: Episode, rig: DropRig) -> Observation:
    return views.canonical(views.rollout_drop(episode, rig, CALIBRATED))


def _with_noise(episode: Episode, target: DropTarget) -> Episode:
    if not target.noise_m:
        return episode
    signal = episode.signals[TOPIC]
    rng = np.random.default_rng(target.seed)
    noise_m = rng.normal(0.0, target.noise_m, len(signal.values))
    noisy = replace(signal, values=signal.values + np.array([0.0, 0.0, 1.0]) * noise_m[:, None])
    return replace(episode, signals={**episode.signals, TOPIC: noisy})
