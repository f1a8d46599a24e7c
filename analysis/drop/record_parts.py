"""What a record says of a drop beside its value: the curves and the rebounds."""

from __future__ import annotations

import numpy as np

from analysis.drop.detection import AnyDetection
from analysis.estimators.base import Step, Trace
from analysis.record import MOST_SAMPLES, Curves, Rebound
from tunenet_logs.arrays import Array

_SHOWN_FALLS = 5.0
"""Fall times after the impact: little is to be seen later."""

_BEFORE_FALLS = 0.25
"""Fall times before the release: enough to see that the ball was still."""

_SAME_S = 1e-6
"""Stamps that differ by less are of one moment."""


def tuned_curves(detection: AnyDetection, last: Step) -> Curves | None:
    """Both curves at the same times; None where they share fewer than two."""
    drop = detection.drop
    simulated_s, simulated_m = simulated_heights(detection, last)
    if not len(simulated_s):
        return None
    begin_s = drop.release_s - _BEFORE_FALLS * drop.fall_time_s
    end_s = drop.impact_s + _SHOWN_FALLS * drop.fall_time_s
    heights_m = observed_heights_m(detection)
    inside = (drop.seconds >= begin_s) & (drop.seconds <= end_s) & np.isfinite(heights_m)
    seconds, observed_m = drop.seconds[inside], heights_m[inside]
    if len(seconds) < 2:
        return None
    if len(seconds) > MOST_SAMPLES:
        even_s = np.linspace(seconds[0], seconds[-1], MOST_SAMPLES)
        seconds, observed_m = even_s, np.interp(even_s, seconds, observed_m)
    simulated_m = np.interp(seconds, simulated_s, simulated_m)
    return Curves(int(detection.start_ns), seconds, observed_m, simulated_m)


def observed_heights_m(detection: AnyDetection) -> Array:
    """Heights of a drop above the table [m], at the drop's own times, shape (T,)."""
    drop = detection.drop
    return drop.heights_m - (drop.contact_m if detection.physical else drop.table_m)


def simulated_heights(detection: AnyDetection, step: Step) -> tuple[Array, Array]:
    """Times on the log's clock [s] and heights above the table [m] of an iterate, each (T,)."""
    assert step.evaluation is not None
    episode, drop = step.evaluation.episode, detection.drop
    signal = next(iter(episode.signals.values()))
    seconds = (signal.stamps_ns - detection.start_ns).astype(np.float64) * 1e-9
    heights_m = signal.values[:, 2] - episode.info.rig["ball_diameter_m"] / 2
    inside = (seconds > drop.seconds[0] - _SAME_S) & (seconds < drop.seconds[-1] + _SAME_S)
    return seconds[inside], heights_m[inside]


def reported_rebounds(detection: AnyDetection, trace: Trace) -> tuple[Rebound, ...]:
    """The impacts that the fit tells apart, else the first, whose restitution is the tuning's."""
    if trace.fit is not None and trace.fit.detail:
        return trace.fit.detail
    ends = None
    if trace.fit is not None:
        low, high = trace.fit.interval95[0].tolist()
        ends = low, high
    drop = detection.drop
    return (Rebound(drop.impact_s, float(trace.estimate[0]), ends, drop.impact_speed_m_s),)
