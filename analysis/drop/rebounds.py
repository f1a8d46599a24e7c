"""Restitution of each impact without a law, and the ratio of two flights' durations.

`flight_ratio` needs no camera and no scale: in any picture, and in any log, the flights before
and after an impact are smooth curves of time that meet at it, and the second flight's duration
over the first's is the restitution of the second impact.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from analysis.drop.bounce_fit import BounceFit
from analysis.drop.bounce_model import (
    ANY_SCALE_SD,
    CONTACT,
    FALL,
    IMPACT,
    METRE_SD,
    PERSPECTIVE,
    SPAN,
)
from analysis.drop.bounce_posterior import BallPosterior
from analysis.drop.bounce_samples import MAX_IMPACTS
from analysis.drop.projection import PERSPECTIVE_SD, projected
from analysis.estimators.base import Trace
from analysis.record import Rebound
from analysis.statistics import TWO_SIDED, correlation_time
from recorders.simulators.closed_form.bounce import Bounce
from recorders.simulators.contact import CALIBRATED
from tunenet_logs.arrays import Array

if TYPE_CHECKING:
    from analysis.drop.detection import AnyDetection

_CLEAR_HOP = 4.0  # standard deviations of a position that a flight has to be high
# Of each restitution about the fit's: no law, but no impact is far from all others.
_PRIOR_SD = 0.15

_CAMERA = (IMPACT, FALL, CONTACT, SPAN, PERSPECTIVE)
# Unknowns that are fitted with the restitutions, and by how much they are differentiated.
_STEPS = np.array([1e-6, 1e-6, 1e-4, 1e-4, 1e-5])

_FIXED = 1e12  # precision of an unknown that is known
# Of Gauss-Newton's method: it begins nearly at the end, at the fit. A step of so few standard
# errors is the last.
_ITERATIONS, _SETTLED = 6, 1e-5

# Of a flight: for a restitution of its own (a parabola has three coefficients), for a parabola
# through them, and for a cubic, which perspective asks for.
_MIN_SAMPLES, _PARABOLA, _CUBIC = 4, 5, 9

_OUTLIER = 5.0  # standard deviations from the fit, beyond which a sample is not the ball


def fitted_rebounds(posterior: BallPosterior) -> tuple[Rebound, ...]:
    """Fit the restitution of each impact whose flight is seen to its end, by Gauss-Newton.

    The first has the posterior's. The camera is fitted with them; no law binds them but that none
    is far (0.15) from the fit's.
    """
    fit = posterior.fit
    law = fit.samples.bounce(fit.unknowns)
    times = fit.samples.times(fit.unknowns)
    starts, speeds = law.flights(float(times[-1]))
    count = 0  # of flights that are high enough, and seen to their end
    for begin, end, speed in zip(starts[:MAX_IMPACTS], starts[1:], speeds, strict=False):
        hop = fit.unknowns[SPAN] * speed**2 / 4
        seen = np.count_nonzero((times > begin) & (times < end))
        if end > times[-1] or hop < _CLEAR_HOP * fit.scale or seen < _MIN_SAMPLES:
            break
        count += 1
    if not count:
        return ()
    arrivals = _impact_speeds(law, speeds[:count])
    first = np.clip(speeds[:count] / arrivals, 0.01, 1.0)
    values, sds = _fitted(fit, law, first)
    # What slope and drag leave open of the first one's restitution, they leave open of each.
    open_sd = float(np.ptp(posterior.interval95[0])) / 2 / TWO_SIDED
    sds = np.hypot(sds, np.sqrt(max(open_sd**2 - sds[0] ** 2, 0.0)))
    each = replace(law, restitution=float(values[0]), each=tuple(values), constant_below=0.0)
    own_starts, own_speeds = each.flights(float(times[-1]))
    fall_s = float(np.exp(fit.unknowns[FALL]))
    unit_m_s = CALIBRATED.gravity_m_s2 * fall_s / 2
    hits = _impact_speeds(each, own_speeds[:count])
    found = [
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
    ]
    low, high = posterior.interval95[0].tolist()
    found[0] = replace(found[0], restitution=float(posterior.values[0]), interval95=(low, high))
    return tuple(found)


def first_rebound(posterior: BallPosterior) -> Rebound:
    """Return the first impact, whose flight need not be seen to its end."""
    view = posterior.fit.projection()
    low, high = posterior.interval95[0].tolist()
    unit_m_s = CALIBRATED.gravity_m_s2 * view.fall_time_s / 2
    speed_m_s = view.bounce.impact_speed * unit_m_s
    return Rebound(view.impact_s, float(posterior.values[0]), (low, high), speed_m_s)


def reported_rebounds(detection: AnyDetection, trace: Trace) -> tuple[Rebound, ...]:
    """Return the impacts that the fit tells apart, else the first by the tuning's restitution."""
    if trace.fit is not None and trace.fit.detail:
        return trace.fit.detail
    ends = None
    if trace.fit is not None:
        low, high = trace.fit.interval95[0].tolist()
        ends = low, high
    drop = detection.drop
    speed_m_s = drop.impact_speed_m_s if detection.tells_speed else None
    return (Rebound(drop.impact_s, float(trace.estimate[0]), ends, speed_m_s),)


def _impact_speeds(ball: Bounce, leaving: Array) -> Array:
    """Return the speeds before impacts left with these speeds [drop heights, sqrt(2 H / g)]."""
    later = [ball.flight(float(speed))[1] for speed in leaving[:-1]]
    return np.array([ball.impact_speed, *later])


def _fitted(fit: BounceFit, law: Bounce, first: Array) -> tuple[Array, Array]:
    """Fit N restitutions and their standard errors by Gauss-Newton's method, without outliers."""
    weights = np.where(np.abs(fit.residuals) < 4 * fit.scale, 1.0, 0.0)
    scale = fit.scale * np.sqrt(correlation_time(fit.residuals, len(fit.free)))
    camera = fit.unknowns[list(_CAMERA)]
    seconds, view = fit.samples.seconds, fit.projection()
    seen = fit.samples.positions - (view.contacts(seconds) - view.contact)
    values = np.concatenate([camera, first])
    steps = np.concatenate([_STEPS, np.full(len(first), 1e-6)])
    free = [0.0, 0.0, 0.0, 0.0, PERSPECTIVE_SD**-2]
    if fit.samples.in_metres:  # this camera is known, and as far as metres are metres its scale
        metre_sd = METRE_SD if fit.samples.scale_known else ANY_SCALE_SD
        free[3:] = [(metre_sd * camera[3]) ** -2, _FIXED]
    prior = np.concatenate([free, np.full(len(first), _PRIOR_SD**-2)])
    target = np.concatenate([[0.0, 0.0, 0.0, camera[3], 0.0], first])
    covariance = np.eye(len(values))
    for _ in range(_ITERATIONS):
        moves = np.diag(steps)
        trials: list[Array] = []
        known: dict[tuple[float, ...], Array] = {}  # the camera's own unknowns move no ball
        for trial in (values, *(values + moves), *(values - moves)):
            impact_s, log_fall, contact, span, perspective = trial[:5]
            moves_as = (impact_s, log_fall, *trial[5:].tolist())
            if moves_as not in known:
                ball = replace(law, each=moves_as[2:], constant_below=0.0)
                known[moves_as] = ball.heights((seconds - impact_s) / np.exp(log_fall))
            positions = contact + span * projected(known[moves_as], float(perspective))
            trials.append(positions - seen)
        residuals, above, below = np.split(np.column_stack(trials), [1, 1 + len(steps)], axis=1)
        jacobian = (above - below) / (2 * steps)
        normal = jacobian.T @ (weights[:, None] * jacobian) / scale**2 + np.diag(prior)
        gradient = -jacobian.T @ (weights * residuals[:, 0]) / scale**2 - prior * (values - target)
        covariance = np.linalg.pinv(normal)
        step = covariance @ gradient
        values = values + step
        values[5:] = np.clip(values[5:], 0.01, 1.0)
        if np.all(np.abs(step) <= _SETTLED * np.sqrt(np.diag(covariance))):
            break
    return values[5:], np.sqrt(np.diag(covariance))[5:]


@dataclass(frozen=True)
class FlightRatio:
    """Ratio of the second flight's duration to the first's.

    Attributes:
        value: as seen.
        fitted: as the fitted ball has it.
        sd: standard error of the value.
    """

    value: float
    fitted: float
    sd: float


def flight_ratio(fit: BounceFit) -> FlightRatio | None:
    """Measure the ratio by the first three impacts; None where they are not seen well enough."""
    times = fit.samples.times(fit.unknowns)
    starts, _ = fit.samples.bounce(fit.unknowns).flights(float(times[-1]))
    if len(starts) < 4 or starts[2] > times[-1]:
        return None
    edges = np.array([-1.0, *starts[:4]])
    edges[-1] = min(edges[-1], times[-1])
    half = 0.5 * float(np.median(np.diff(times)))
    flights: list[_Flight] = []
    for begin, end in itertools.pairwise(edges):
        inside = (times > begin + half) & (times < end - half)
        inside &= np.abs(fit.residuals) < _OUTLIER * fit.scale
        count = int(np.count_nonzero(inside))
        if count < _PARABOLA:
            return None
        middle = float(times[inside].mean())
        columns = np.vander(times[inside] - middle, 4 if count >= _CUBIC else 3)
        powers, *_ = np.linalg.lstsq(columns, fit.samples.positions[inside], rcond=None)
        covariance = np.linalg.pinv(columns.T @ columns) * fit.scale**2
        flights.append(_Flight(middle, powers.astype(np.float64), covariance.astype(np.float64)))
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
    fitted = float((starts[2] - starts[1]) / starts[1])
    return FlightRatio(float(ratio), fitted, float(np.linalg.norm(slopes * sds)))


@dataclass(frozen=True, eq=False)
class _Flight:
    """Flight as a polynomial of time.

    Attributes:
        middle: time that it is about [fall times].
        powers: coefficients [px], highest power first, shape (3,) or (4,).
        covariance: of them.
    """

    middle: float
    powers: Array
    covariance: Array

    def meets(self, then: _Flight, near: float, reach: float) -> tuple[float, float] | None:
        """Return when this flight ends in the next, and the standard error; None if it does not."""
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
