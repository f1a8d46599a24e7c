"""The restitution at each impact of a filmed drop, which a real ball's speed changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.drop.film_fit import (
    CONTACT,
    FALL,
    IMPACT,
    PERSPECTIVE,
    SPAN,
    FilmFit,
)
from analysis.drop.projection import projected
from analysis.model_averaging import TWO_SIDED, correlation_time
from recorders.simulators.bounce import Bounce
from recorders.simulators.contact import CALIBRATED
from tunenet_logs.arrays import Array

_MOST = 6
_CLEAR_HOP = 4.0
_FEWEST_SAMPLES = 4
_PRIOR_SD = 0.15
_CAMERA = (IMPACT, FALL, CONTACT, SPAN, PERSPECTIVE)
_STEPS = np.array([1e-6, 1e-6, 1e-4, 1e-4, 1e-5])
_ROUNDS = 6


@dataclass(frozen=True)
class Rebound:
    """One impact of a ball.

    Attributes:
        impact_s: when, on the drop's clock [s].
        restitution: there.
        interval95: of the restitution.
        impact_speed_m_s: None where nothing fixes the scale.
    """

    impact_s: float
    restitution: float
    interval95: tuple[float, float]
    impact_speed_m_s: float | None


def rebounds(fit: FilmFit) -> tuple[Rebound, ...]:
    """Each impact whose flight is seen to its end, with a restitution of its own.

    The camera is fitted with them; no law binds them but that none is far (0.15) from the fit's.

    Args:
        fit: of a whole bounce.
    """
    law = fit.samples.bounce(fit.unknowns)
    seconds = fit.samples.seconds
    times = (seconds - fit.unknowns[IMPACT]) / np.exp(fit.unknowns[FALL])
    starts, speeds = law.flights(float(times[-1]))
    count = _clear_flights(starts, speeds, times, fit)
    if not count:
        return ()
    arrivals = _impact_speeds(law, speeds[:count])
    first = np.clip(speeds[:count] / arrivals, 0.01, 1.0)
    values, sds = _fitted(fit, law, first)
    each = Bounce(float(values[0]), law.slope, law.drag, tuple(values))
    _, own_speeds = each.flights(float(times[-1]))
    fall_s = float(np.exp(fit.unknowns[FALL]))
    unit_m_s = CALIBRATED.gravity_m_s2 * fall_s / 2
    hits = _impact_speeds(each, own_speeds[:count])
    own_starts, _ = each.flights(float(times[-1]))
    return tuple(
        Rebound(
            impact_s=float(fit.unknowns[IMPACT] + fall_s * own_starts[one]),
            restitution=float(values[one]),
            interval95=(
                float(max(values[one] - TWO_SIDED * sds[one], 0.0)),
                float(min(values[one] + TWO_SIDED * sds[one], 1.0)),
            ),
            impact_speed_m_s=float(hits[one]) * unit_m_s,
        )
        for one in range(min(count, len(own_starts)))
    )


def _clear_flights(starts: Array, speeds: Array, times: Array, fit: FilmFit) -> int:
    """How many of the first flights are high enough, and seen to their end."""
    count = 0
    for begin, end, speed in zip(starts[:_MOST], starts[1:], speeds, strict=False):
        hop_px = fit.unknowns[SPAN] * speed**2 / 4
        seen = np.count_nonzero((times > begin) & (times < end))
        if end > times[-1] or hop_px < _CLEAR_HOP * fit.scale_px or seen < _FEWEST_SAMPLES:
            break
        count += 1
    return count


def _impact_speeds(ball: Bounce, leaving: Array) -> Array:
    """Of the impacts that the ball leaves with these speeds [drop heights, sqrt(2 H / g)]."""
    later = [ball.flight(float(speed))[1] for speed in leaving[:-1]]
    return np.array([ball.impact_speed, *later])


def _fitted(fit: FilmFit, law: Bounce, first: Array) -> tuple[Array, Array]:
    """Restitutions and their standard errors, by Gauss and Newton with the fit's weights."""
    weights = np.where(np.abs(fit.left_px) < 4 * fit.scale_px, 1.0, 0.0)
    worth = correlation_time(fit.left_px, len(fit.free))
    scale = fit.scale_px * np.sqrt(worth)
    camera = fit.unknowns[list(_CAMERA)]
    values = np.concatenate([camera, first])
    steps = np.concatenate([_STEPS, np.full(len(first), 1e-6)])
    prior = np.concatenate([[0, 0, 0, 0, 0.7**-2], np.full(len(first), _PRIOR_SD**-2)])
    target = np.concatenate([np.zeros(5), first])
    covariance = np.eye(len(values))
    for _ in range(_ROUNDS):
        left = _left(fit, law, values)
        moves = np.diag(steps)
        slopes = np.column_stack(
            [
                (_left(fit, law, values + move) - _left(fit, law, values - move)) / (2 * step)
                for move, step in zip(moves, steps, strict=True)
            ]
        )
        normal = slopes.T @ (weights[:, None] * slopes) / scale**2 + np.diag(prior)
        pull = -slopes.T @ (weights * left) / scale**2 - prior * (values - target)
        covariance = np.linalg.pinv(normal)
        values = values + covariance @ pull
        values[5:] = np.clip(values[5:], 0.01, 1.0)
    return values[5:], np.sqrt(np.diag(covariance))[5:]


def _left(fit: FilmFit, law: Bounce, values: Array) -> Array:
    impact_s, log_fall, contact, span, perspective = values[:5]
    ball = Bounce(law.restitution, law.slope, law.drag, tuple(values[5:]))
    times = (fit.samples.seconds - impact_s) / np.exp(log_fall)
    places = contact + span * projected(ball.heights(times), float(perspective))
    return places - fit.samples.places_px
