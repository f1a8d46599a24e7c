"""Tuned simulator compared with what was heard: it is on the table at each impact."""

from __future__ import annotations

import numpy as np

from analysis.drop.times.detection import TimesDetection
from analysis.estimators.base import Step, Trace
from analysis.motion import MAX_SAMPLES, Curves, Motion
from analysis.record import Rebound
from tunenet_logs.arrays import Array

_TOLD = 0.15  # of drag and slope: an interval wider than this, in restitution, is a prior's
_SAME_S = 5e-9  # stamps that differ by less are of one moment


def simulated_m(detection: TimesDetection, step: Step) -> tuple[Array, Array]:
    """Return an iterate's times on the log's clock [s] and heights on the table [m], each (T,).

    The rollout leaves the table at once, the ball after a contact: each flight takes the contact
    before it along.
    """
    assert step.evaluation is not None
    signal = next(iter(step.evaluation.episode.signals.values()))
    seconds = (signal.stamps_ns - detection.start_ns).astype(np.float64) * 1e-9
    heights_m = signal.values[:, 2] - detection.rig_of_rollouts.radius_m
    heard = detection.heard
    seconds = seconds / heard.seconds_s
    without, late = heard.contactless_s, heard.predicted_s - heard.contactless_s
    return seconds + np.interp(seconds, without, late), heights_m


def heard_motion(detection: TimesDetection, trace: Trace) -> Motion:
    """Return the rollout's height; the observed one is 0 at each impact heard, else unknown."""
    if not detection.rig.has_clock:
        return Motion(untold=_untold(detection))
    seconds, heights_m = simulated_m(detection, trace.steps[-1])
    observed_m = np.full(len(seconds), np.nan)
    heard = detection.heard
    late = heard.predicted_s - heard.contactless_s
    heard_s = heard.heard_contactless_s + np.interp(
        heard.heard_contactless_s, heard.contactless_s, late
    )
    at = np.clip(np.searchsorted(seconds, heard_s - _SAME_S), 0, len(seconds) - 1)
    there = np.abs(seconds[at] - heard_s) <= _SAME_S
    observed_m[at[there]] = 0.0
    every = max(1, -(-len(seconds) // (MAX_SAMPLES // 2)))
    kept = np.union1d(np.arange(0, len(seconds), every), at[there])
    curves = Curves(detection.start_ns, seconds[kept], observed_m[kept], heights_m[kept])
    return Motion(curves=curves, untold=_untold(detection))


def heard_rebounds(detection: TimesDetection, trace: Trace) -> tuple[Rebound, ...]:
    """Return each impact between two flights that were heard whole."""
    return detection.heard.rebounds if trace.fit is not None else detection.heard.rebounds[:1]


def _untold(detection: TimesDetection) -> tuple[str, ...]:
    """Return what the times leave to what is known of balls, in words."""
    slope, drag = np.ptp(detection.heard.interval95[1:], axis=1).tolist()
    found: list[str] = []
    if slope > _TOLD:
        found.append("these times do not tell the slope: its interval is what is known of balls")
    if drag > _TOLD and detection.rig.drag_1_m is None:
        found.append(
            "these times do not tell the drag: its interval is what is known of balls (see --ball)"
        )
    return tuple(found)
