"""Bound what a simulator without air can do with one restitution: its own parabolas."""

from __future__ import annotations

import numpy as np

from analysis.evaluation.real_balls.drops import RecordedDrop
from analysis.evaluation.real_balls.physics import GRAVITY_M_S2
from tunenet_logs.arrays import Array

_STILL = 1e-3  # rebound over first impact, in speed, below which it lies
_LIVELIEST = 0.999  # restitution, so that it lies some day


def parabolas(restitution: float, drop_m: float, seconds: Array) -> Array:
    """Return the height over the contact of a ball without air, after the release, shape (T,)."""
    fall_s = float(np.sqrt(2 * drop_m / GRAVITY_M_S2))
    hit = GRAVITY_M_S2 * fall_s
    count = max(1, int(np.ceil(np.log(_STILL) / np.log(np.clip(restitution, 1e-9, _LIVELIEST)))))
    ups = hit * restitution ** np.arange(1, count + 1)
    starts = fall_s + np.concatenate([[0.0], np.cumsum(2 * ups / GRAVITY_M_S2)])
    flight = np.searchsorted(starts, seconds, side="right") - 1
    since = seconds - starts[flight]
    up = np.append(ups, 0.0)[flight]
    rebound = np.maximum(up * since - GRAVITY_M_S2 / 2 * since**2, 0.0)
    fall = drop_m - GRAVITY_M_S2 / 2 * np.maximum(seconds, 0.0) ** 2
    return np.where(flight < 0, fall, rebound)


def first_rebound(drop: RecordedDrop) -> float:
    """Return the restitution that gives the first rebound's height without air."""
    first, second = drop.path.impacts_s[0, :2]
    between = np.linspace(first, second, 2001)
    return float(np.sqrt(drop.truth_m(between).max() / drop.ball.drop_m))


def best_of_all(drop: RecordedDrop) -> float:
    """Fit the restitution whose parabolas are nearest to the heights, release and fall known."""
    inside = drop.seconds >= 0
    seconds = drop.seconds[inside]
    heights = drop.positions_m[inside, 2] - drop.level_m

    def off(restitution: float) -> float:
        return float(np.mean((parabolas(restitution, drop.ball.drop_m, seconds) - heights) ** 2))

    grid = np.linspace(0.05, 0.99, 189)
    for step in (5e-4, 5e-5, 5e-6):
        best = grid[np.argmin([off(float(value)) for value in grid])]
        grid = np.clip(best + step * np.arange(-11, 12), 0.01, 0.999)
    return float(grid[np.argmin([off(float(value)) for value in grid])])


def airless_off(restitution: float, drop: RecordedDrop) -> Array:
    """Return its position error over the drop, shape (T,); see `tuned.off_path`."""
    seconds = np.linspace(0.0, drop.last_bounce_s, 2001)
    drop_m = drop.ball.drop_m
    return (parabolas(restitution, drop_m, seconds) - drop.truth_m(seconds)) / drop_m
