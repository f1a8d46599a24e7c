"""Late faults of a track, in its clock or in a flight: what comes later is left out.

A picture that was lost, or a flight that hits an edge, touches what comes after it. As long as the
first flight is whole, so is its result.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.drop.bounce_fit import BounceFit
from analysis.drop.bounce_model import FALL, IMPACT, SPAN
from tunenet_logs.arrays import Array

MAX_CLOCK_GAIN = 12.0  # log likelihood ratio: of 120 tries chance alone reaches about 5
_FREEDOM = 8.0  # degrees of freedom of Student's t, as in the fit
# Moments at which a jump is looked for, and samples to either end where none can be told.
_MOMENTS, _EDGE = 60, 3

_MIN_COUNT = 12  # samples for a test of the clock
# Log likelihood below that of the likeliest moment, down to which it may have been an earlier one.
_LIKELY = 4.0

# Px and fractions of the fall, of which the larger is a step between pictures that tells.
_STEP_PX, _STEP = 6.0, 0.03

_GAP = 1.5  # usual periods: what is longer is a stamped gap
# By which a step is longer than the others, as a fraction, and in their standard deviations, which
# are not below the last.
_LONGER, _LONGER_SDS, _MIN_SPREAD = 0.3, 5.0, 0.02

# Standard deviations by which most samples of a flight are off that is not the fitted ball's, and
# how many of them there are.
_ASTRAY, _MIN_ASTRAY = 5.0, 4


def clock_test(fit: BounceFit) -> tuple[float, float]:
    """Test by Rao's score test whether the clock jumps, or changes its rate, at some moment.

    It is one more unknown, linear about the fit, the best of all moments. Samples count as little
    as in the fit where they are far off: a picture of an impact is no jump.

    Returns:
        The gain in log likelihood, and the moment [s].
    """
    gains, moments = _clock_gains(fit)
    best = int(gains.argmax())
    return float(gains[best]), float(moments[best])


@dataclass(frozen=True)
class LateFault:
    """Moment from which a track cannot be trusted, after its second impact at the earliest.

    Attributes:
        seconds: the time of the samples [s].
        flights: how many are whole before a flight that is not the ball's; None where the clock
            is at fault.
    """

    seconds: float
    flights: int | None


def late_fault(fit: BounceFit) -> LateFault | None:
    """Find the first late fault of a fitted track; None without one."""
    impacts_s = _impacts_s(fit)
    if len(impacts_s) < 2:
        return None
    gains, moments = _clock_gains(fit)
    if gains.max() > MAX_CLOCK_GAIN:
        first_s = float(moments[gains > gains.max() - _LIKELY].min())
        if first_s >= impacts_s[1]:  # what it sets astray is no other bounce
            return LateFault(first_s, None)
    return _astray(fit, impacts_s)


def long_steps(fit: BounceFit) -> int:
    """Count steps of the ball between pictures that are far longer than all others.

    There pictures are missing of which no stamp tells. Steps over an impact, of slow parts, and
    over stamped gaps are not counted.
    """
    samples = fit.samples
    times, period_s = samples.times(fit.unknowns), np.diff(samples.seconds)
    usual_s = float(np.median(period_s))
    starts, _ = samples.bounce(fit.unknowns).flights(float(times[-1]))
    apart = np.abs(times[:, None] - starts).min(axis=1) * float(np.exp(fit.unknowns[FALL]))
    flight = np.searchsorted(starts, times)
    expected = np.diff(samples.positions + fit.residuals)
    chosen = (flight[1:] == flight[:-1]) & (times[:-1] > -1) & (period_s < _GAP * usual_s)
    chosen &= np.minimum(apart[1:], apart[:-1]) > usual_s / 2
    chosen &= np.abs(expected) > max(_STEP_PX, _STEP * float(fit.unknowns[SPAN]))
    if np.count_nonzero(chosen) < _MIN_COUNT:
        return 0
    ratios = np.diff(samples.positions)[chosen] / expected[chosen]
    off = ratios - np.median(ratios)
    spread = 1.4826 * float(np.median(np.abs(off))) + _MIN_SPREAD
    return int(np.count_nonzero(off > max(_LONGER, _LONGER_SDS * spread)))


def _impacts_s(fit: BounceFit) -> Array:
    """Return the impacts, the first included, as far as samples go [s]."""
    samples, fall_s = fit.samples, float(np.exp(fit.unknowns[FALL]))
    starts, _ = samples.bounce(fit.unknowns).flights(float(samples.times(fit.unknowns)[-1]))
    seconds = float(fit.unknowns[IMPACT]) + fall_s * starts
    return seconds[seconds < samples.seconds[-1]]


def _astray(fit: BounceFit, impacts_s: Array) -> LateFault | None:
    """Find the first flight most of whose samples are far off."""
    seconds = fit.samples.seconds
    off = np.abs(fit.residuals) / fit.scale
    for flights, begin in enumerate(impacts_s[1:], start=1):
        end = impacts_s[flights + 1] if flights + 1 < len(impacts_s) else np.inf
        flight = off[(seconds > begin) & (seconds < end)]
        if len(flight) >= _MIN_ASTRAY and np.median(flight) > _ASTRAY:
            return LateFault(float(begin), flights)
    return None


def _clock_gains(fit: BounceFit) -> tuple[Array, Array]:
    """Score a jump, and another rate, from each moment on; return gains and moments [s]."""
    samples = fit.samples
    seconds = samples.seconds
    if len(seconds) < _MIN_COUNT:
        return np.zeros(1), seconds[:1]
    weights = np.sqrt((_FREEDOM + 1) / (_FREEDOM + (fit.residuals / fit.scale) ** 2))
    known, _ = np.linalg.qr(weights[:, None] * samples.jacobian(fit.unknowns, fit.free))
    speed = -samples.jacobian(fit.unknowns, (IMPACT,))[:, 0]
    every = max(1, len(seconds) // _MOMENTS)
    moments = seconds[_EDGE:-_EDGE:every]
    since = seconds[:, None] - moments
    shifts = np.hstack([since > 0, np.maximum(since, 0.0)]) * (weights * speed)[:, None]
    new = shifts - known @ (known.T @ shifts)
    power = np.maximum((new**2).sum(axis=0), 1e-9 * (shifts**2).sum(axis=0) + 1e-12)
    gains = (new.T @ (weights * fit.residuals)) ** 2 / power / fit.scale**2
    return gains / fit.effective_sample_factor / 2, np.tile(moments, 2)
