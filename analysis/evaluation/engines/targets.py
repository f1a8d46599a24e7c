"""Draw the balls to drop: the paper's Easy and Hard ranges, and real balls in air."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.drop import observations as views
from analysis.evaluation.drop.targets import EASY, HARD, TEST_SEEDS, draw_targets
from analysis.evaluation.real_balls.drops import (
    DRAGS_1_M,
    DROPS_M,
    MAX_S,
    RATES_HZ,
    RESTITUTIONS,
    SLOPES,
)
from analysis.evaluation.real_balls.physics import RealBall
from tunenet_logs.arrays import Array

REAL = "Real balls"


@dataclass(frozen=True)
class Promise:
    """Range of targets, and how well they are to be tuned.

    Attributes:
        name: as tables and files have it.
        worst: largest error of the effective restitution that the default method may make; None
            where nothing is promised.
    """

    name: str
    worst: float | None


RANGES = (Promise(EASY.name, 0.003), Promise(HARD.name, 0.005), Promise(REAL, None))


@dataclass(frozen=True)
class EngineTarget:
    """Ball to be dropped by one engine and tuned in another.

    Attributes:
        ball: given to the source.
        initial: the first guess of its restitution.
        rate_hz: of the samples.
        samples: how many, the first at the release.
    """

    ball: RealBall
    initial: float
    rate_hz: float
    samples: int

    @property
    def seconds(self) -> Array:
        """Times of the samples after the release, shape (T,)."""
        return np.arange(self.samples) / self.rate_hz


def drawn_targets(which: str, count: int, seed: int) -> list[EngineTarget]:
    """Draw `count` targets of a range; the same for every pair of engines, by the seed.

    Easy and Hard are those of `tunenet-eval drop`: 400 samples at 60 Hz from 3.5 to 4.5 m.
    """
    if which == REAL:
        rng = np.random.default_rng([TEST_SEEDS + seed, *REAL.encode()])
        return [_real_ball(rng) for _ in range(count)]
    found = draw_targets({EASY.name: EASY, HARD.name: HARD}[which], count, seed)
    return [
        EngineTarget(
            RealBall(one.truth, 0.0, 0.0, one.release_m - views.PAPER_RADIUS_M),
            *(one.initial, views.PAPER_RATE_HZ, views.PAPER_SAMPLES),
        )
        for one in found
    ]


def _real_ball(rng: np.random.Generator) -> EngineTarget:
    """Draw a ball of the ranges of `tunenet-eval real-balls`."""
    low, high = np.log(DRAGS_1_M)
    ball = RealBall(
        rng.uniform(*RESTITUTIONS),
        rng.uniform(*SLOPES),
        float(np.exp(rng.uniform(low, high))),
        rng.uniform(*DROPS_M),
    )
    rate_hz = RATES_HZ[int(rng.integers(len(RATES_HZ)))]
    return EngineTarget(ball, rng.uniform(*HARD.initial), rate_hz, round(MAX_S * rate_hz))
