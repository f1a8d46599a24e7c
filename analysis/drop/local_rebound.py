"""Posterior of a ball in a recorded drop, widened by a second estimate if it was thrown.

A thrown ball spins. Then the air bends its flight, and a marker that is not quite at its middle
wobbles, both by more than the noise. The speeds by the parabolas next to the impact alone, each
with a curvature of its own, are a second estimate with other errors. Where the two are farther
apart than chance has it, the interval covers what is between them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from analysis.drop.bounce_posterior import BallPosterior, ball_posterior
from analysis.drop.free_fall import Drop
from analysis.drop.positions_fit import fit_positions, noise_floor
from analysis.statistics import TWO_SIDED
from tunenet_logs.arrays import Array

_NEAR = (0.2, 0.27, 0.35)  # fall times on either side of the impact
_TOUCHING_PERIODS = 1.0  # sample periods on either side in which the ball may touch the ground
_MIN_COUNT = 6  # samples of a parabola with an error of its own
_CHANCE = 2.0  # standard errors that two estimates may be apart by chance


@lru_cache(maxsize=64)
def drop_posterior(drop: Drop, drag_1_m: float | None) -> BallPosterior | None:
    """Compute the ball's posterior; None where the samples are too few for a fit.

    The search, the problem and the checks all ask for it: it is cached.
    """
    fit = fit_positions(drop, drag_1_m)
    if fit is None:
        return None
    posterior = ball_posterior(fit)
    return _widened(drop, posterior) if drop.launched else posterior


def _widened(drop: Drop, posterior: BallPosterior) -> BallPosterior:
    """Widen the interval to hold what parabolas next to the impact say, too."""
    beyond = max(_beyond_chance(drop, posterior, near) for near in _NEAR)
    ends = posterior.interval95.copy()
    reach = np.hypot(ends[0] - posterior.values[0], TWO_SIDED * beyond)
    reach = np.hypot(reach, _touch(drop, posterior))
    ends[0] = np.clip(posterior.values[0] + reach * np.array([-1, 1]), 0.0, 1.0)
    return replace(posterior, interval95=ends)


def _touch(drop: Drop, posterior: BallPosterior) -> float:
    """Return how far the restitution depends on where in a long touch its speeds are taken.

    The flights are prolonged to where they meet. A soft ball has touched down before, and leaves
    the ground after that, with gravity at work in between.
    """
    period_s = float(np.median(np.diff(drop.seconds)))
    impacts = len(posterior.fit.projection().impacts(float(drop.seconds[-1])))
    half_s = drop.touching * period_s / max(impacts, 1) / 2
    gained = drop.gravity_m_s2 * half_s / drop.impact_speed_m_s
    return float(gained * (1 + posterior.values[0]) / 2)


def _beyond_chance(drop: Drop, posterior: BallPosterior, near: float) -> float:
    """Return how far the parabolas' restitution is off, without what chance makes of it."""
    view = posterior.fit.projection()
    since = drop.seconds - view.impact_s
    touching_s = _TOUCHING_PERIODS * float(np.median(np.diff(drop.seconds)))
    starts = view.impacts(float(drop.seconds[-1]))
    next_s = float(starts[1]) * view.fall_time_s if len(starts) > 1 else np.inf
    near_s = near * view.fall_time_s
    before = (since < -touching_s) & (since > -near_s)
    after = (since > touching_s) & (since < min(near_s, next_s - touching_s))
    if min(np.count_nonzero(before), np.count_nonzero(after)) < _MIN_COUNT:
        return 0.0
    ball_m = view.positions(view.bounce.heights(view.fall_times(drop.seconds)), drop.seconds)
    noise_m = max(noise_floor(drop), posterior.fit.scale)
    sides = (
        _speeds(since[side], drop.heights_m[side], ball_m[side], noise_m)
        for side in (before, after)
    )
    (fall, ball_fall, fall_sd), (rise, ball_rise, rise_sd) = sides
    if fall >= 0 or ball_fall >= 0:
        return 0.0
    apart = rise / -fall - ball_rise / -ball_fall
    chance = float(np.hypot(rise_sd, fall_sd * ball_rise / ball_fall)) / -ball_fall
    return max(apart**2 - (_CHANCE * chance) ** 2, 0.0) ** 0.5


def _speeds(
    since: Array, seen_m: Array, ball_m: Array, noise_m: float
) -> tuple[float, float, float]:
    """Fit parabolas: the impact's speeds as seen and of the ball, and the error [m/s]."""
    inverse = np.linalg.pinv(np.vander(since, 3))
    seen, ball = inverse[1] @ seen_m, inverse[1] @ ball_m
    return float(seen), float(ball), float(noise_m * np.linalg.norm(inverse[1]))
