"""Laplace approximation of a ball's evidence by its times, against noises.

`fit` averages over a grid of slopes and drags, and takes its time; to choose among readings of
many onsets, one ball is fitted with the same unknowns and priors, the posterior about it normal.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from analysis.drop.times import impact_prior as priors
from analysis.drop.times.fit import FLIGHT_RANGE, Rig
from analysis.drop.times.flight_times import flights
from analysis.drop.times.least_squares import Whitening, ideal_ball, whitenings
from tunenet_logs.arrays import Array

_SLOPE, _SLOPE_SD = 0.04, 0.07
_ITERATIONS = 8
# Of the derivatives: log speed, restitution, slope, log drag.
_STEPS = np.array([1e-6, 1e-6, 1e-5, 1e-4])

_FLAT = 3  # unknowns without a prior: time of the first impact, log speed after it, restitution
# Slope and log drag, within which balls are.
_MIN, _MAX = np.array([-0.25, np.log(5e-4)]), np.array([0.45, np.log(0.6)])


def log_likelihood(
    times_s: Array, numbers: NDArray[np.int64], log_rate: float, rig: Rig
) -> tuple[float, float]:
    """Return the log odds against noises at random times, and the ball's restitution.

    Args:
        times_s: of the impacts, shape (N,), N at least 3 [s].
        numbers: of the impacts, the first 0, shape (N,).
        log_rate: logarithm of the density of noises' times [1/s].
        rig: what is known of the ball; its height is not used.
    """
    tried = [
        _likelihood(times_s, numbers, white, rig)
        for white in whitenings(times_s, numbers, rig.jitter_s)
    ]
    logs = np.array([log for log, _ in tried])
    most = float(logs.max())
    found = most + float(np.log(np.exp(logs - most).sum()))
    odds = found - float(np.log(FLIGHT_RANGE)) - (len(times_s) - 1) * log_rate
    return odds, tried[int(logs.argmax())][1]


def _likelihood(
    times_s: Array, numbers: NDArray[np.int64], white: Whitening, rig: Rig
) -> tuple[float, float]:
    """Return the log likelihood with this share of scatter, and the ball's restitution."""
    log_drag = np.log(rig.drag_1_m or priors.TYPICAL_DRAG_1_M)
    middles = np.array([0.0, 0.0, 0.0, _SLOPE, log_drag, priors.CONTACT_S])
    drag_sd = priors.KNOWN_DRAG if rig.drag_1_m else priors.LOG_DRAG_SD
    prior = np.array([0.0, 0.0, 0.0, _SLOPE_SD**-2, drag_sd**-2, priors.CONTACT_SD_S**-2])
    at: Array = middles.copy()
    at[:_FLAT] = ideal_ball(times_s - priors.CONTACT_S * numbers, numbers)
    left, columns = _seen(times_s, numbers, at)
    for _ in range(_ITERATIONS):
        left, columns = white.rows @ left, white.rows @ columns
        normal = columns.T @ columns / rig.jitter_s**2 + np.diag(prior + 1e-9)
        pull = columns.T @ left / rig.jitter_s**2 + prior * (middles - at)
        step = np.linalg.solve(normal, pull)
        step[1:3] = np.clip(step[1:3], -0.15, 0.15)
        at = np.asarray(at + step, dtype=np.float64)
        at[2] = np.clip(at[2], 0.01, 1.3)
        at[3:5] = np.clip(at[3:5], _MIN, _MAX)
        left, columns = _seen(times_s, numbers, at)
    left, columns = white.rows @ left, white.rows @ columns
    jitters = priors.JITTERS_S[:, None, None]
    normal = columns.T @ columns / jitters**2 + np.diag(prior + 1e-9)
    pull = (columns.T @ left) / jitters[..., 0] ** 2 + prior * (middles - at)
    gain = np.einsum("ji,ji->j", pull, np.linalg.solve(normal, pull[..., None])[..., 0])
    squares = (left @ left) / priors.JITTERS_S**2 + prior @ (middles - at) ** 2 - gain
    log = priors.log_jitter_prior(rig.jitter_s) - 0.5 * squares
    log = log + white.log_prior + priors.log_scatter_prior(white.ratio_1_s * priors.JITTERS_S)
    log = log - len(times_s) * np.log(priors.JITTERS_S) - 0.5 * np.linalg.slogdet(normal)[1]
    log = log + 0.5 * np.log(prior[_FLAT:]).sum() + white.log_size
    log = log - 0.5 * (len(times_s) - _FLAT) * np.log(2 * np.pi)
    most = float(log.max())
    return most + float(np.log(np.exp(log - most).sum())), float(at[2])


def _seen(times_s: Array, numbers: NDArray[np.int64], at: Array) -> tuple[Array, Array]:
    """Return the times' residuals, shape (N,), and their predictions' derivatives, (N, 6)."""
    balls = np.tile(at[1:5], (5, 1))
    balls[1:] += np.diag(_STEPS)
    count = int(numbers.max())
    speed, kept, slope, log_drag = balls.T
    hits = flights(count, np.exp(speed), kept, slope, np.exp(log_drag)).impacts_s[numbers]
    bends = (hits[:, 1:] - hits[:, :1]) / _STEPS
    late = numbers.astype(np.float64)
    columns = np.column_stack([np.ones(len(numbers)), bends, late])
    return times_s - at[0] - hits[:, 0] - at[5] * numbers, columns
