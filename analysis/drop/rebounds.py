"""Single impacts of a filmed drop, without a law that binds them: restitutions, and flight times.

A real ball's restitution changes with its speed: `rebounds` fits one to each impact. `flight_ratio`
needs no camera either: near an impact the fall and the flight after it are smooth curves of time in
any camera's picture, and where the two meet is the impact. How much shorter the second flight is
than the first is the restitution of the second impact, whatever was filmed and from where.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from analysis.drop.film_fit import CONTACT, FALL, IMPACT, PERSPECTIVE, SPAN, FilmFit
from analysis.drop.projection import PERSPECTIVE_SD, projected
from analysis.model_averaging import TWO_SIDED, correlation_time
from analysis.record import Rebound
from recorders.simulators.closed_form.bounce import Bounce
from recorders.simulators.contact import CALIBRATED
from tunenet_logs.arrays import Array

_MOST = 6
"""Impacts: as many as a fit explains."""

_CLEAR_HOP = 4.0
"""Standard deviations of a position that a flight has to be high."""

_FEWEST_SAMPLES = 4
"""Of a flight: one more than a parabola has coefficients."""

_PRIOR_SD = 0.15
"""Of each restitution about the fit's: no law, but no impact is far from all others."""

_CAMERA = (IMPACT, FALL, CONTACT, SPAN, PERSPECTIVE)
_STEPS = np.array([1e-6, 1e-6, 1e-4, 1e-4, 1e-5])
"""Unknowns that are fitted with the restitutions, and by how much they are differentiated."""

_ITERATIONS = 6
"""It begins at the fit, nearly at the end: a few suffice."""

_FEWEST, _CUBIC = 5, 9
"""Samples of a flight that a parabola is drawn through, and a cubic, which perspective asks for."""

_OUTLIER = 5.0
"""Standard deviations from the fit, beyond which a sample is not the ball."""


def rebounds(fit: FilmFit) -> tuple[Rebound, ...]:
    """Each impact whose flight is seen to its end, with a restitution of its own.

    The camera is fitted with them; no law binds them but that none is far (0.15) from the fit's.

    Args:
        fit: of a whole bounce.
    """
    law = fit.samples.bounce(fit.unknowns)
    times = fit.samples.times(fit.unknowns)
    starts, speeds = law.flights(float(times[-1]))
    count = 0  # of flights that are high enough, and seen to their end
    for begin, end, speed in zip(starts[:_MOST], starts[1:], speeds, strict=False):
        hop_px = fit.unknowns[SPAN] * speed**2 / 4
        seen = np.count_nonzero((times > begin) & (times < end))
        if end > times[-1] or hop_px < _CLEAR_HOP * fit.scale_px or seen < _FEWEST_SAMPLES:
            break
        count += 1
    if not count:
        return ()
    arrivals = _impact_speeds(law, speeds[:count])
    first = np.clip(speeds[:count] / arrivals, 0.01, 1.0)
    values, sds = _fitted(fit, law, first)
    each = Bounce(float(values[0]), law.slope, law.drag, tuple(values))
    own_starts, own_speeds = each.flights(float(times[-1]))
    fall_s = float(np.exp(fit.unknowns[FALL]))
    unit_m_s = CALIBRATED.gravity_m_s2 * fall_s / 2
    hits = _impact_speeds(each, own_speeds[:count])
    return tuple(
        Rebound(
            impact_s=float(fit.unknowns[IMPACT] + fall_s * own_starts[index]),
            restitution=float(values[index]),
            interval95=(
                float(max(values[index] - TWO_SIDED * sds[index], 0.0)),
                float(min(values[index] + TWO_SIDED * sds[index], 1.0)),
            ),
            impact_speed_m_s=float(hits[index]) * unit_m_s,
        )
        for index in range(min(count, len(own_starts)))
    )


def _impact_speeds(ball: Bounce, leaving: Array) -> Array:
    """Of the impacts that the ball leaves with these speeds [drop heights, sqrt(2 H / g)]."""
    later = [ball.flight(float(speed))[1] for speed in leaving[:-1]]
    return np.array([ball.impact_speed, *later])


def _fitted(fit: FilmFit, law: Bounce, first: Array) -> tuple[Array, Array]:
    """Restitutions and their standard errors by Gauss-Newton's method, without outliers.

    Args:
        fit: of the law.
        law: the ball.
        first: restitutions to begin with, shape (N,).
    """
    weights = np.where(np.abs(fit.residuals_px) < 4 * fit.scale_px, 1.0, 0.0)
    scale = fit.scale_px * np.sqrt(correlation_time(fit.residuals_px, len(fit.free)))
    camera = fit.unknowns[list(_CAMERA)]
    values = np.concatenate([camera, first])
    steps = np.concatenate([_STEPS, np.full(len(first), 1e-6)])
    prior = np.concatenate([[0, 0, 0, 0, PERSPECTIVE_SD**-2], np.full(len(first), _PRIOR_SD**-2)])
    target = np.concatenate([np.zeros(5), first])
    covariance = np.eye(len(values))
    for _ in range(_ITERATIONS):
        residuals = _residuals_px(fit, law, values)
        moves = np.diag(steps)
        rises = [
            _residuals_px(fit, law, values + move) - _residuals_px(fit, law, values - move)
            for move in moves
        ]
        jacobian = np.column_stack(rises) / (2 * steps)
        normal = jacobian.T @ (weights[:, None] * jacobian) / scale**2 + np.diag(prior)
        gradient = -jacobian.T @ (weights * residuals) / scale**2 - prior * (values - target)
        covariance = np.linalg.pinv(normal)
        values = values + covariance @ gradient
        values[5:] = np.clip(values[5:], 0.01, 1.0)
    return values[5:], np.sqrt(np.diag(covariance))[5:]


def _residuals_px(fit: FilmFit, law: Bounce, values: Array) -> Array:
    """Of the samples for a camera and restitutions of their own, shape (T,)."""
    impact_s, log_fall, contact, span, perspective = values[:5]
    ball = Bounce(law.restitution, law.slope, law.drag, tuple(values[5:]))
    times = (fit.samples.seconds - impact_s) / np.exp(log_fall)
    positions = contact + span * projected(ball.heights(times), float(perspective))
    return positions - fit.samples.positions_px


@dataclass(frozen=True)
class FlightRatio:
    """Duration of the second flight over that of the first.

    Attributes:
        value: as seen.
        fitted: as the fitted ball has it.
        sd: standard error of the value.
    """

    value: float
    fitted: float
    sd: float


def flight_ratio(fit: FilmFit) -> FlightRatio | None:
    """From the first three impacts; None where they are not seen well enough."""
    times = fit.samples.times(fit.unknowns)
    starts, _ = fit.samples.bounce(fit.unknowns).flights(float(times[-1]))
    if len(starts) < 4 or starts[2] > times[-1]:
        return None
    edges = np.array([-1.0, *starts[:4]])
    edges[-1] = min(edges[-1], times[-1])
    half = 0.5 * float(np.median(np.diff(times)))
    flights: list[_Flight] = []
    for begin, end in itertools.pairwise(edges):
        flight = _Flight.through(times, fit, begin + half, end - half)
        if flight is None:
            return None
        flights.append(flight)
    reach = 4 * half + 0.03
    impacts: list[tuple[float, float]] = []
    for (before, after), near in zip(itertools.pairwise(flights), starts[:3], strict=True):
        impact = before.meets(after, near, reach)
        if impact is None:
            return None
        impacts.append(impact)
    (first, second, third), sds = np.array(impacts).T
    ratio = (third - second) / (second - first)
    slopes = np.array([ratio, -1 - ratio, 1.0]) / (second - first)
    return FlightRatio(
        value=float(ratio),
        fitted=float((starts[2] - starts[1]) / starts[1]),
        sd=float(np.linalg.norm(slopes * sds)),
    )


@dataclass(frozen=True, eq=False)
class _Flight:
    """One flight as a polynomial of time.

    Attributes:
        middle: time that it is about [fall times].
        powers: coefficients [px], highest power first, shape (3,) or (4,).
        covariance: of them.
    """

    middle: float
    powers: Array
    covariance: Array

    @classmethod
    def through(cls, times: Array, fit: FilmFit, begin: float, end: float) -> _Flight | None:
        """Least squares between two times, without outliers; None for too few samples."""
        inside = (times > begin) & (times < end)
        inside &= np.abs(fit.residuals_px) < _OUTLIER * fit.scale_px
        count = int(np.count_nonzero(inside))
        if count < _FEWEST:
            return None
        middle = float(times[inside].mean())
        columns = np.vander(times[inside] - middle, 4 if count >= _CUBIC else 3)
        powers, *_ = np.linalg.lstsq(columns, fit.samples.positions_px[inside], rcond=None)
        covariance = np.linalg.pinv(columns.T @ columns) * fit.scale_px**2
        return cls(middle, powers.astype(np.float64), covariance.astype(np.float64))

    def meets(self, then: _Flight, near: float, reach: float) -> tuple[float, float] | None:
        """When this flight ends in the next, and the standard error; None if it does not."""
        grid = np.linspace(near - reach, near + reach, 201)
        apart = np.polyval(self.powers, grid - self.middle)
        apart = apart - np.polyval(then.powers, grid - then.middle)
        crossed = np.flatnonzero((apart[:-1] > 0) & (apart[1:] <= 0))
        if not len(crossed):
            return None
        at = int(min(crossed, key=lambda index: abs(grid[index] - near)))
        slope = (apart[at + 1] - apart[at]) / (grid[1] - grid[0])
        when = float(grid[at] - apart[at] / slope)
        variance = sum(
            float(row @ flight.covariance @ row)
            for flight in (self, then)
            for row in [np.vander([when - flight.middle], len(flight.powers))[0]]
        )
        return when, float(np.sqrt(variance) / abs(slope))
