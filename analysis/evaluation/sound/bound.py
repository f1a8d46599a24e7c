"""Bound how well onsets of a known jitter determine the second impact's restitution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from analysis.evaluation.sound.bounces import BounceHistory, BounceOrder, bounced
from tunenet_logs.arrays import Array

# Of the differences: of slope and restitution as they are, of the others in their logarithm.
_STEPS = {"height_m": 1e-3, "restitution": 1e-4, "slope": 1e-3, "drag_1_m": 1e-2, "contact_s": 2e-2}

_PRIORS = {"height_m": 0.7, "restitution": 0.3, "slope": 0.09, "contact_s": 1.0}
# Standard deviations of what is known before, in the same measure; of the drag where the ball is
# not named, and where it is.
_LOG_DRAG_SD, _KNOWN_DRAG_SD = 1.1, 0.1

# Mean absolute error over standard deviation, of a normal distribution.
MEAN_OF_SD = float(np.sqrt(2 / np.pi))


def bound_sd(history: BounceHistory, count: int, jitter_s: float, *, named: bool) -> float:
    """Return the Cramér-Rao bound on the second impact's restitution (standard deviation).

    The Cramér-Rao bound with priors: unknown are when the recording began, the fall, restitution,
    slope, drag, and how long a contact lasts.

    Args:
        history: the bounce.
        count: how many of its impacts are heard.
        jitter_s: standard deviation of an onset.
        named: whether the ball is, so that its drag is known to a tenth.
    """
    count = min(count, len(history.touches_s))
    rows, gains, priors = [np.ones(count)], [0.0], [0.0]
    for name, step in _STEPS.items():
        ahead, behind = (_moved(history.order, name, way * step) for way in (1, -1))
        shared = min(count, len(ahead.touches_s), len(behind.touches_s))
        change = np.zeros(count)
        change[:shared] = (ahead.touches_s[:shared] - behind.touches_s[:shared]) / (2 * step)
        rows.append(change)
        gains.append((ahead.restitutions[1] - behind.restitutions[1]) / (2 * step))
        drag_sd = _KNOWN_DRAG_SD if named else _LOG_DRAG_SD
        priors.append(_PRIORS.get(name, drag_sd) ** -2)
    jacobian, gain = np.column_stack(rows) / jitter_s, np.array(gains)
    information = jacobian.T @ jacobian + np.diag(priors)
    return float(np.sqrt(gain @ np.linalg.solve(information, gain)))


def _moved(order: BounceOrder, name: str, step: float) -> BounceHistory:
    value = getattr(order, name)
    moved = value + step if name in ("restitution", "slope") else value * np.exp(step)
    return bounced(replace(order, **{name: float(moved)}))


def onset_errors_s(times_s: Array, impacts_s: Array, within_s: float = 0.005) -> Array:
    """Return the errors of onsets that belong to an impact, less their median, shape (M,).

    The clocks may differ: the constant between the two is that with which most onsets are an
    impact's.

    Args:
        times_s: of the onsets, shape (N,).
        impacts_s: when the sound of each impact begins, shape (K,).
        within_s: of it counts as the impact's.
    """
    best = np.zeros(0)
    for offset in (times_s[:, None] - impacts_s).ravel().tolist():
        off = times_s[:, None] - impacts_s - offset
        nearest = off[np.arange(len(off)), np.abs(off).argmin(axis=1)]
        own = nearest[np.abs(nearest) < within_s]
        if len(own) > len(best):
            best = own - np.median(own)
    return best
