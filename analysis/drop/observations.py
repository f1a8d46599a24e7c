"""Drop as an observation: in fall times and drop heights, or as the paper has it.

With s = (t - t_impact) / T0 (T0 the time of the fall without air) and u the height above contact in
drop heights, a bounce is one curve that depends on the ball alone: on its restitution, on how that
falls with speed, and on the air's drag times the drop height. Drop height, gravity, table and
sampling rate drop out. So one network serves every rig.
"""

from __future__ import annotations

import numpy as np

from analysis.drop.free_fall import Drop
from analysis.estimators.base import Observation, resample
from recorders.simulators.closed_form.flight import lands_after_s
from recorders.simulators.contact import ContactSettings
from recorders.simulators.drop import DRAG, TOPIC, DropRig
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode

CANONICAL_PER_FALL = 32
CANONICAL_BEFORE = 28
# The canonical grid: points in each fall time, how many of them are before the first impact, and
# fall times after it. The first moments of a fall are left out: a hand may still be there.
CANONICAL_SPAN = 4

PAPER_RATE_HZ = 60.0
PAPER_SAMPLES = 400
PAPER_RADIUS_M = 0.5  # the simulation of the TuneNet paper: samples and ball
_PAPER_UNIT_M = 5.0  # its highest drop: with it z is from 0 to about 1


def canonical_axis() -> Array:
    """Return the canonical grid [fall times after the first impact], shape (156,)."""
    last = CANONICAL_SPAN * CANONICAL_PER_FALL
    return np.setdiff1d(np.arange(-CANONICAL_BEFORE, last + 1), [0]) / CANONICAL_PER_FALL


def canonical_observation(values: Array) -> Observation:
    """Wrap heights [drop heights] on the canonical grid, shape (156,)."""
    axis = canonical_axis()
    return Observation(values[:, None], axis, "time after impact [fall times]", ("[drop heights]",))


def canonical(drop: Drop) -> Observation:
    """Resample a drop to the canonical grid: height [drop heights] against time [fall times].

    A ball that is seen to rest goes on resting; else what comes after the recording is NaN.
    """
    axis = canonical_axis()
    times = (drop.seconds - drop.impact_s) / drop.fall_time_s
    heights = (drop.heights_m - drop.contact_m) / drop.drop_height_m
    values = _between_impacts(times, heights, axis)
    if not np.isnan(drop.rest_m):
        values[axis > times[-1]] = (drop.rest_m - drop.contact_m) / drop.drop_height_m
    return canonical_observation(values)


def rollout_drop(
    episode: Episode, rig: DropRig, contact: ContactSettings, drop_height_m: float | None = None
) -> Drop:
    """Build the drop of a simulated episode, whose rig and release are known exactly.

    Heights are measured by `drop_height_m`; None for the rig's own, of a ball let go.
    """
    height_m = rig.gap_m if drop_height_m is None else drop_height_m
    signal, gravity = episode.signals[TOPIC], contact.gravity_m_s2
    drag_1_m = episode.info.truth.get(DRAG.name, 0.0)  # of a rollout: what it was told
    impact_s = rig.hold_s + lands_after_s(rig.gap_m, rig.speed_m_s, gravity, drag_1_m)
    return Drop(
        first=0,
        seconds=(signal.stamps_ns - rig.start_ns).astype(np.float64) * 1e-9,
        heights_m=signal.values[:, 2],
        release_s=rig.hold_s,
        release_m=rig.radius_m + rig.gap_m,
        impact_s=impact_s,
        contact_m=rig.radius_m,
        impact_speed_m_s=float(np.sqrt(2 * gravity * height_m)),
        flight_restitution=float("nan"),
        flight_restitution_sd=float("nan"),
        gravity_m_s2=gravity,
        flight_gravity_m_s2=gravity,
        fall_s=(rig.hold_s, impact_s),
        flight_s=(impact_s, impact_s),
        noise_m=0.0,
        rest_s=float("nan"),
        rest_m=rig.radius_m,
        rest_tolerance_m=0.0,
    )


def paper_heights(drop: Drop) -> Observation:
    """Resample z [m] to 400 samples at 60 Hz from the release, as the paper's network has it.

    z is that of a ball of 0.5 m radius on a plane at z = 0. A recording that ends with the ball at
    rest goes on with it at rest; else what is missing is NaN.
    """
    wanted = paper_start_s(drop) + paper_axis()
    values = resample(drop.seconds, drop.heights_m - drop.table_m, wanted)
    if not np.isnan(drop.rest_m):
        values[wanted > drop.seconds[-1]] = 0.0
    return _paper_observation(values + PAPER_RADIUS_M)


def paper_start_s(drop: Drop) -> float:
    """Return when the paper's simulation starts [s]: its k-th sample is k periods later.

    The engine's step (v += -g dt, then z += v dt) puts its k-th sample where free fall is after
    k + 1/2 periods. A recording that starts with the release, to within a sample or so, is taken
    from its first sample on.
    """
    period_s = 1 / PAPER_RATE_HZ
    start_s = drop.release_s + period_s / 2
    if abs(drop.seconds[0] - start_s) < 1.5 * period_s:
        return float(drop.seconds[0] - period_s)
    return start_s


def paper_rollout(episode: Episode) -> Observation:
    """Return the paper's rollout as it is: z after each of 400 steps."""
    return _paper_observation(episode.signals[TOPIC].values[:, 2])


def paper_unit_heights(episode: Episode) -> Observation:
    """Return z from 0 to about 1 [5 m], for a paper's network that sees a video beside it."""
    heights = episode.signals[TOPIC].values[:, 2] / _PAPER_UNIT_M
    return Observation(heights[:, None].copy(), paper_axis(), "time [s]", ("z [5 m]",))


def paper_axis() -> Array:
    """Return the times of the paper's samples after the start [s], shape (400,)."""
    return np.arange(1, PAPER_SAMPLES + 1) / PAPER_RATE_HZ


def _paper_observation(heights_m: Array) -> Observation:
    return Observation(heights_m[:, None].copy(), paper_axis(), "time [s]", ("z [m]",))


def _between_impacts(times: Array, heights: Array, wanted: Array) -> Array:
    """Interpolate a curve of parabolas u'' = -2 that meet at impacts; NaN outside.

    Three parabolas claim each gap between samples: the one through its two ends, and those of the
    gaps on either side, prolonged. Without an impact near by they agree; with one in the gap beside
    it, two agree; with one in the gap itself, the two neighbours meet there from above and the
    gap's own lies over both. The median is right every time. A ball at rest is no parabola: there
    the straight line is the lower bound.
    """
    gap = np.clip(np.searchsorted(times, wanted, side="right") - 1, 1, len(times) - 3)

    claims: list[Array] = []
    for first in (gap - 1, gap, gap + 1):
        before, after = times[first], times[first + 1]
        slope = (heights[first + 1] - heights[first]) / (after - before)
        since = wanted - before
        claims.append(heights[first] + slope * since + since * (after - wanted))
    straight = np.interp(wanted, times, heights)
    values = np.maximum(np.sort(claims, axis=0)[1], np.minimum(straight, 0.0))
    values[(wanted < times[0]) | (wanted > times[-1])] = np.nan
    return values
