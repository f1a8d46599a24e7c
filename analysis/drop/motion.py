"""Tuned simulator compared with the observation: sample by sample, nothing interpolated.

Positions are compared in m, films in px through the fitted camera, and both are reported in % of
the drop height. What counts is from the release to the last bounce in view.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from analysis.drop.bounce_model import BounceSamples
from analysis.drop.bounce_posterior import ball_posterior
from analysis.drop.bounce_samples import MIN_SAMPLES
from analysis.drop.contact_clock import contact_clock
from analysis.drop.detection import AnyDetection
from analysis.drop.equivalent import equivalents
from analysis.drop.projection import Projection
from analysis.drop.untold import SLOPE_AND_DRAG, untold
from analysis.estimators.base import Step, Trace
from analysis.motion import (
    MAX_SAMPLES,
    Curves,
    Equivalents,
    Motion,
    SimulationFit,
    excess,
)
from analysis.statistics import surer_noise_of
from recorders.simulators.contact import CALIBRATED
from recorders.simulators.drop import DRAG
from tunenet_logs.arrays import Array

_AFTER_FALLS = 1.0  # fall times after the last bounce in view that the curves show
_BEFORE_FALLS = 0.25  # fall times before the release: enough to see that the ball was still
_CLEAR_HOP = 0.003  # of the drop height: a lower bounce is not in view
_HOP_SDS = 3.0  # standard deviations of the noise, likewise
_MAX_LEFT_OUT = 0.05  # fraction of the samples that may be something else than the ball
# A sample farther from the simulation than so much noise and this fraction of the drop height is
# something else, as long as few are.
_FAR_SDS, _FAR = 6.0, 0.01

# Standard deviations that noise may add to a mean square: one in twenty has more.
_CHANCE_SDS = 1.64

_MIN_BENDS = 20  # samples whose third differences tell their noise
# Impacts in the first part: before the second one no fit can know how the ball bounces.
_MIN_BEGUN = 2

# Part of the time that the held-out fit sees, and samples that are to be foretold.
_BEGUN, _MIN_HELD_OUT = 0.6, 6

_SAME_S = 2e-9  # stamps that differ by less are of one moment


def simulated(detection: AnyDetection, step: Step) -> tuple[Array, Array]:
    """Return an iterate's times on the log's clock [s] and heights [drop heights], each (T,)."""
    assert step.evaluation is not None
    episode = step.evaluation.episode
    signal = next(iter(episode.signals.values()))
    seconds = (signal.stamps_ns - detection.start_ns).astype(np.float64) * 1e-9
    seconds = contact_clock(detection).to_log(seconds)
    rig = episode.info.rig
    heights_m = signal.values[:, 2] - rig["ball_diameter_m"] / 2
    unit_m = rig["drop_height_m"]
    if detection.physical:
        unit_m = CALIBRATED.gravity_m_s2 * detection.drop.fall_time_s**2 / 2
    return seconds, heights_m / unit_m


def simulated_m(detection: AnyDetection, step: Step) -> tuple[Array, Array]:
    """Return an iterate's times on the log's clock [s] and heights on the table [m], each (T,)."""
    assert step.evaluation is not None
    seconds, heights = simulated(detection, step)
    rig_m = step.evaluation.episode.info.rig["drop_height_m"]
    return seconds, heights * (detection.drop.drop_height_m if detection.physical else rig_m)


@lru_cache(maxsize=1)
def simulation_fit(detection: AnyDetection, last: Step) -> SimulationFit | None:
    """Compare the last rollout with every sample in view; None where there is no camera for it.

    The checks and the record ask for the same one: it is kept until the next.
    """
    view = _view(detection)
    if view is None:
        return None
    samples = detection.observed
    simulated_s, heights = simulated(detection, last)
    at, rows = matched(samples.seconds, simulated_s)
    seconds, positions, heights = samples.seconds[at], samples.positions[at], heights[rows]
    noise = _noise(samples)
    inside = in_view(detection, seconds, noise / view.span)
    if np.count_nonzero(inside) < MIN_SAMPLES:
        return None
    off = view.positions(heights[inside], seconds[inside]) - positions[inside]
    off = np.maximum(np.abs(off) - _blurred(samples, view, seconds[inside]), 0.0) / view.span
    kept = _of_the_ball(off, noise / view.span)
    is_film = detection.film is not None
    return SimulationFit(
        rms_percent=100 * float(np.sqrt(np.mean(off[kept] ** 2))),
        worst_percent=100 * float(off[kept].max()),
        noise_percent=100 * noise / view.span,
        held_out_percent=held_out_percent(detection),
        samples=int(np.count_nonzero(kept)),
        left_out=int(np.count_nonzero(~kept)) + detection.outliers,
        noise=noise if is_film or tells_speed(detection) else noise / view.span,
        unit="px" if is_film else "m" if tells_speed(detection) else "1",
    )


def fit_excess_percent(detection: AnyDetection) -> float | None:
    """Return how far the fit is from the samples in view, beyond their noise [%]."""
    view = _view(detection)
    if view is None or detection.posterior is None:
        return None
    samples = detection.observed
    noise = _noise(samples)
    seen = samples.only(in_view(detection, samples.seconds, noise / view.span))
    if len(seen.seconds) < MIN_SAMPLES:
        return None
    off = np.abs(seen.residuals(detection.posterior.fit.unknowns)) / view.span
    off = off[_of_the_ball(off, noise / view.span)]
    return 100 * excess(float(np.sqrt(np.mean(off**2))), noise / view.span)


def held_out_percent(detection: AnyDetection) -> float | None:
    """Return the hold-out error of a fit to the first 60 % of the time [% of the drop height].

    The noise, and what chance makes of it in few samples, is taken off; None where too little is
    seen in either part.
    """
    view = _view(detection)
    if view is None:
        return None
    seen = detection.observed
    seconds, noise = seen.seconds, _noise(seen)
    inside = in_view(detection, seconds, noise / view.span)
    if not inside.any():
        return None
    begin_s, end_s = detection.drop.release_s, float(seconds[inside][-1])
    until_s = begin_s + _BEGUN * (end_s - begin_s)
    rest = inside & (seconds > until_s)
    impacts = view.impacts(until_s)
    if len(impacts) < _MIN_BEGUN:
        return None
    fit = detection.begun(until_s)
    if fit is None or np.count_nonzero(rest) < _MIN_HELD_OUT:
        return None
    begun = ball_posterior(fit).fit
    later = seen.only(rest)
    off = np.abs(replace(later, bends_s=begun.samples.bends_s).residuals(begun.unknowns))
    off = np.maximum(off - _blurred(seen, view, later.seconds), 0.0) / view.span
    off = off[_of_the_ball(off, noise / view.span)]
    chance = 1 + _CHANCE_SDS * np.sqrt(2 / len(off))  # of a mean square of so few samples
    return 100 * excess(float(np.sqrt(np.mean(off**2))), noise / view.span * np.sqrt(chance))


def tuned_motion(detection: AnyDetection, trace: Trace) -> Motion:
    """Compare both curves at the observation's own stamps, and find drag-free equivalents."""
    last = trace.steps[-1]
    return Motion(
        curves=_curves(detection, last),
        fit=simulation_fit(detection, last) if detection.physical else None,
        equivalents=_equivalents(detection),
        untold=_untold(detection, trace),
        unknown=() if tells_speed(detection) else (DRAG.name,),
        units=detection.units,
        sound=None if detection.ear is None else detection.ear.share,
    )


def tells_speed(detection: AnyDetection) -> bool:
    """Return whether metres and seconds are known; a film's scale is its clock, if it has one."""
    return detection.tells_speed


def in_view(detection: AnyDetection, seconds: Array, noise: float) -> NDArray[np.bool_]:
    """Return which times are from release to last bounce in view; noise in drop heights."""
    posterior, drop = detection.posterior, detection.drop
    assert posterior is not None
    end_s = last_bounce_s(posterior.fit.projection(), float(seconds[-1]), noise)
    return (seconds >= drop.release_s) & (seconds <= end_s)


def last_bounce_s(view: Projection, until_s: float, noise: float) -> float:
    """Return when the last bounce ends that is high enough to be seen, and in view [s]."""
    last = (until_s - view.impact_s) / view.fall_time_s
    starts, speeds = view.bounce.flights(last)
    high = speeds**2 / 4 > max(_CLEAR_HOP, _HOP_SDS * noise)
    ends = int(np.flatnonzero(high)[-1]) + 1 if high.any() else 0
    return view.impact_s + view.fall_time_s * float(starts[min(ends, len(starts) - 1)])


def _blurred(samples: BounceSamples, view: Projection, seconds: Array) -> Array:
    """Return how far an open shutter may blur the ball from its place, about an impact.

    While the shutter is open the ball comes down and goes up again: what is seen is a mean of both.
    """
    half_s = samples.exposure_s / 2
    times = view.fall_times(seconds)
    starts, _ = view.bounce.flights(float(times.max(initial=0.0)))
    near = np.abs(times[:, None] - starts).min(axis=1) * view.fall_time_s < half_s
    at, early, late = (
        view.positions(view.bounce.heights(times + shift / view.fall_time_s), seconds)
        for shift in (0.0, -half_s, half_s)
    )
    return np.where(near, np.maximum(np.abs(early - at), np.abs(late - at)), 0.0)


def _noise(samples: BounceSamples) -> float:
    """Estimate the samples' noise by themselves, in their unit."""
    least = samples.own_noise / 2 if len(samples.positions) > _MIN_BENDS else samples.own_noise
    return max(surer_noise_of(samples.positions), least) if len(samples.positions) > 3 else least


def _view(detection: AnyDetection) -> Projection | None:
    posterior = detection.posterior if detection.physical else None
    return None if posterior is None else posterior.fit.projection()


def matched(seconds: Array, of_rollout: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the indices of samples and of the rollout's at the same moments."""
    rows = np.clip(np.searchsorted(of_rollout, seconds - _SAME_S), 0, len(of_rollout) - 1)
    at = np.flatnonzero(np.abs(of_rollout[rows] - seconds) <= _SAME_S)
    return at, rows[at]


def _of_the_ball(off: Array, noise: float) -> NDArray[np.bool_]:
    """Flag all samples but those far off, as long as these are few; in drop heights."""
    far = off > _FAR_SDS * noise + _FAR
    return ~far if np.count_nonzero(far) <= _MAX_LEFT_OUT * len(off) else np.ones_like(far)


def _curves(detection: AnyDetection, last: Step) -> Curves | None:
    """Return both curves; None where they share fewer than two stamps."""
    drop = detection.drop
    samples, view = detection.observed, _view(detection)
    seconds, noise = samples.seconds, _noise(samples)
    if view is None:
        heights_m, end_s = drop.heights_m - drop.table_m, float(drop.seconds[-1])
        seconds = drop.seconds
    else:
        heights_m = view.heights(samples.positions, seconds) * drop.drop_height_m
        end_s = last_bounce_s(view, float(seconds[-1]), noise / view.span)
        end_s += _AFTER_FALLS * drop.fall_time_s
    inside = (seconds >= drop.release_s - _BEFORE_FALLS * drop.fall_time_s) & (seconds <= end_s)
    inside &= np.isfinite(heights_m)
    every = max(1, -(-int(np.count_nonzero(inside)) // MAX_SAMPLES))
    seconds, heights_m = seconds[inside][::every], heights_m[inside][::every]
    if len(seconds) < 2:
        return None
    simulated_s, rollout_m = simulated_m(detection, last)
    curve_m = np.full(len(seconds), np.nan)
    if view is None:  # the paper's simulator has stamps of its own
        curve_m = np.interp(seconds, simulated_s, rollout_m)
    else:
        at, rows = matched(seconds, simulated_s)
        curve_m[at] = rollout_m[rows]
    if np.count_nonzero(np.isfinite(curve_m)) < 2:
        return None
    if not tells_speed(detection):  # drop heights are all that is known
        heights_m, curve_m = heights_m / drop.drop_height_m, curve_m / drop.drop_height_m
    return Curves(int(detection.start_ns), seconds, heights_m, curve_m)


def _untold(detection: AnyDetection, trace: Trace) -> tuple[str, ...]:
    """Return what the samples leave to the priors, where slope and drag were asked for."""
    posterior = detection.posterior if detection.physical else None
    if posterior is None or len(trace.estimate) <= SLOPE_AND_DRAG:
        return ()
    return untold(posterior)


def _equivalents(detection: AnyDetection) -> Equivalents | None:
    view = _view(detection)
    if view is None:
        return None
    samples = detection.observed
    seen = samples.only(in_view(detection, samples.seconds, _noise(samples) / view.span))
    found = equivalents(view, seen.seconds, view.heights(seen.positions, seen.seconds))
    if found is None or tells_speed(detection):
        return found
    first, over_all = (replace(one, speeds_m_s=()) for one in (found.first, found.all))
    return Equivalents(first, over_all)
