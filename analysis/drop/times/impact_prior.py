"""Priors of a ball that is heard, before its times are looked at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tunenet_logs.arrays import Array

# Probabilities of a ball that keeps its restitution, and of one that the air does not slow: what is
# heard is real, and in air.
NO_SLOPE, NO_DRAG = 0.1, 0.05

# Another ball's slope: half normal, with a little room below 0.
_SLOPE_SD, _NEGATIVE_SD = 0.09, 0.02

# Another ball's drag: log normal. A steel ball has .002, a table-tennis ball .13.
TYPICAL_DRAG_1_M, LOG_DRAG_SD = 0.03, 1.1

_LOG_SCALE_SD = 0.7  # more of it where no clock tells how high the ball flies
KNOWN_DRAG = 0.1  # fraction by which a drag may be off that follows from a ball's mass and size
# Usual standard deviation of a time: of a trigger at a sound's threshold, which has .1 to 5 ms, and
# of an onset that is looked for in the sound.
TRIGGER_JITTER_S, ONSET_JITTER_S = 0.001, 0.00025

_LOG_JITTER_SD = 0.9  # of either: log normal
_LOW_SLOPE, _HIGH_SLOPE = -0.25, 0.45
_LOW_DRAG_1_M, _HIGH_DRAG_1_M = 5e-4, 0.6  # ends of the grid
JITTERS_S = np.geomspace(3e-5, 0.03, 31)  # standard deviations of a time that are tried
# How likely is each standard deviation of an impact's own restitution about the law, as a fraction
# of it: a machined ball's on stone, a table-tennis ball's, a marble's on a floor. The times' own
# jitter scales it.
SCATTERS = {0.002: 0.5, 0.01: 0.3, 0.03: 0.2}

_MAX_SCATTER, _LOG_MOST_SD = 0.04, 0.1  # more than that no ball has that keeps to a law
# How long a ball touches the table: a steel ball .2 ms, a soft one 8 ms.
CONTACT_S, CONTACT_SD_S, CONTACTS_S = 0.002, 0.003, (0.0, 0.009)


@dataclass(frozen=True, eq=False)
class Nodes:
    """Grid of balls, shape (M,) each.

    Attributes:
        slopes: p.
        drags_1_m: deceleration by the air over speed squared.
        log_prior: of each cell.
    """

    slopes: Array
    drags_1_m: Array
    log_prior: Array


def log_jitter_prior(usual_s: float) -> Array:
    """Return the log prior of each of `JITTERS_S`, normalised."""
    off = np.log(JITTERS_S / usual_s) / _LOG_JITTER_SD
    weights = np.exp(-0.5 * off**2)
    return np.log(weights / weights.sum())


def log_scatter_prior(scatters: Array) -> Array:
    """Return the log prior against too much scatter: 0 where there is not."""
    over = np.maximum(np.log(scatters / _MAX_SCATTER), 0.0)
    return -0.5 * (over / _LOG_MOST_SD) ** 2


def nodes(
    slopes: tuple[float, float],
    log_drags: tuple[float, float],
    counts: tuple[int, int],
    known_drag_1_m: float | None,
    *,
    has_clock: bool = True,
) -> Nodes:
    """Build a grid over slope and log drag within these ends, with balls of no slope or no drag."""
    low, high = max(slopes[0], _LOW_SLOPE), min(slopes[1], _HIGH_SLOPE)
    edges = np.linspace(min(low, high - 1e-3), high, counts[0] + 1)
    slope = (edges[1:] + edges[:-1]) / 2
    sds = np.where(slope < 0, _NEGATIVE_SD, _SLOPE_SD)
    density = np.exp(-0.5 * (slope / sds) ** 2) / np.sqrt(np.pi / 2) / (_NEGATIVE_SD + _SLOPE_SD)
    slope, slope_prior = (
        np.append(slope, 0.0),
        np.append(density * np.diff(edges) * (1 - NO_SLOPE), NO_SLOPE),
    )
    if known_drag_1_m is not None:
        off = np.linspace(-2.4, 2.4, 7)
        drag = known_drag_1_m * (1 + KNOWN_DRAG * off)
        drag_prior = np.exp(-0.5 * off**2)
        drag_prior /= drag_prior.sum()
    else:
        ends = np.log([_LOW_DRAG_1_M, _HIGH_DRAG_1_M])
        low, high = max(log_drags[0], ends[0]), min(log_drags[1], ends[1])
        edges = np.linspace(min(low, high - 0.1), high, counts[1] + 1)
        sd = LOG_DRAG_SD if has_clock else float(np.hypot(LOG_DRAG_SD, _LOG_SCALE_SD))
        middle = (edges[1:] + edges[:-1]) / 2
        off = (middle - np.log(TYPICAL_DRAG_1_M)) / sd
        density = np.exp(-0.5 * off**2) / np.sqrt(2 * np.pi) / sd
        drag = np.append(np.exp(middle), 0.0)
        drag_prior = np.append(density * np.diff(edges) * (1 - NO_DRAG), NO_DRAG)
    both = np.meshgrid(slope, drag, indexing="ij")
    prior = np.outer(slope_prior, drag_prior).ravel()
    return Nodes(both[0].ravel(), both[1].ravel(), np.log(np.maximum(prior, 1e-300)))


WHOLE_SLOPE = (_LOW_SLOPE, _HIGH_SLOPE)
# Ends of the grid that leaves nothing out.
WHOLE_LOG_DRAG = (float(np.log(_LOW_DRAG_1_M)), float(np.log(_HIGH_DRAG_1_M)))
