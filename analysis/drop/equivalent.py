"""Equivalent ball for simulators without air: one restitution, the same at every impact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from analysis.drop.projection import Projection
from analysis.motion import Equivalent, Equivalents
from recorders.simulators.base import GRAVITY_M_S2
from recorders.simulators.closed_form.bounce import Bounce
from tunenet_logs.arrays import Array

_GRID = np.linspace(0.02, 1.0, 99)
# Restitutions that are tried, and then differences from the best of them: the cost has many minima.
_FINE = np.linspace(-0.01, 0.01, 81)

_MAX_SPEEDS = 20  # impacts that are listed


def equivalents(view: Projection, seconds: Array, heights: Array) -> Equivalents | None:
    """Fit drag-free balls, dropped alike: to the first rebound, and to all samples.

    Args:
        view: of the tuned ball.
        seconds: of the samples from the release to the last bounce in view, shape (T,).
        heights: observed there [drop heights], shape (T,).
    """
    if not len(seconds):
        return None
    ball = view.bounce
    starts, speeds = ball.flights(_later(view, float(seconds[-1])))
    if not len(starts) or not speeds[0]:
        return None
    rise = _rebound(ball, float(speeds[0]))
    release_s = view.impact_s - view.fall_time_s * ball.fall_time
    times = (seconds - release_s) / view.fall_time_s - 1.0  # it falls for one fall time
    best = _best(times, heights, _GRID)
    best = _best(times, heights, np.clip(best + _FINE, 0.0, 1.0))
    return Equivalents(
        _equivalent(float(np.sqrt(rise)), view, times, heights),
        _equivalent(best, view, times, heights),
    )


def _later(view: Projection, until_s: float) -> float:
    return max((until_s - view.impact_s) / view.fall_time_s, 0.0)


def _rebound(ball: Bounce, speed: float) -> float:
    """Return the height [drop heights] of a ball that leaves with a speed."""
    if ball.drag < 1e-7:
        return speed**2 / 4
    return float(np.log1p(ball.drag * speed**2 / 2) / (2 * ball.drag))


def _best(times: Array, heights: Array, tried: Array) -> float:
    """Return the least-squares restitution, all of them compared at once."""
    kept = tried[:, None]
    after = np.maximum(times, 0.0)
    bouncing = 1 - after * (1 - kept) / (2 * np.maximum(kept, 1e-9))  # e^n when flight n begins
    inside = np.clip(kept, 1e-9, 1 - 1e-9)
    speeds = inside ** np.floor(np.log(np.maximum(bouncing, 1e-12)) / np.log(inside))
    since = after - 2 * inside * (1 - speeds) / (1 - inside)
    flying = np.where(bouncing > 0, np.maximum(since * (2 * inside * speeds - since), 0.0), 0.0)
    falling = 1 - np.maximum(times + 1, 0.0) ** 2
    off = np.where(times < 0, falling, flying) - heights
    return float(tried[int(np.argmin(np.einsum("rt,rt->r", off, off)))])


def _rms(restitution: float, times: Array, heights: Array) -> float:
    off = replace(_AIRLESS, restitution=restitution).heights(times) - heights
    return float(np.sqrt(np.mean(off**2)))


def _equivalent(restitution: float, view: Projection, times: Array, heights: Array) -> Equivalent:
    restitution = float(np.clip(restitution, 0.0, 1.0))
    starts, _ = replace(_AIRLESS, restitution=restitution).flights(float(times[-1]))
    count = min(int(np.count_nonzero(starts <= times[-1])), _MAX_SPEEDS)
    first_m_s = GRAVITY_M_S2 * view.fall_time_s
    return Equivalent(
        restitution,
        100 * _rms(restitution, times, heights),
        tuple(first_m_s * restitution**bounce for bounce in range(max(count, 1))),
    )


_AIRLESS = Bounce(0.5)  # a ball with one restitution and no air
