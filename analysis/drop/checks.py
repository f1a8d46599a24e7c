"""Checks of a recorded drop, from positions or a film: figure, limit and what to do about it.

What only a film can show is in `film_checks`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.checks import Check, figures
from analysis.drop.free_fall import Drop
from analysis.estimators.base import Observation
from analysis.motion import SimulationFit, Units
from recorders.simulators.contact import CALIBRATED
from tunenet_logs.arrays import Array

_REJECT_FIT = 0.1
"""Rms in drop heights: a simulation that is farther off is of something else than the recording."""

_CLEAR_FLIGHT = 10
"""Samples of a first flight in which a parabola can be found, if there is one."""

_CLEAR_HOP = 8
"""A first rebound lower than this many standard deviations of the noise has no value of its own."""

_MOST_GAP = 4.0
"""Sample periods without a sample: a longer gap may hide an impact."""

_SURE = 0.02
"""Half width of an interval that still tells one ball from another."""

LEAST_SEEN, _LEAST_SEEN_THROWN = 0.9, 0.2
"""Fall times after the impact: less than that may miss the top of the first bounce, and of a ball
that a hand catches, what is free."""

_MOST_BELOW, _BELOW_SDS = 0.03, 6
"""Of the drop height, and of the noise's standard deviations, that a sample may lie under the
contact: a ball that sinks in less is still on the table."""

_MOST_DRIFT = 0.5
"""Of the drop height: a ball that is let go stays nearer; one that is thrown does not."""

MOST_EXCESS_PERCENT, _MOST_HELD_OUT = 0.5, 1.0
"""Of the drop height [%], beyond the noise: what cannot be seen in a review, and what a fit to the
first part of a recording may be off in the rest."""

_REJECT_EXCESS = 15.0
"""Of the drop height [%]: a simulation that is farther off is of something else."""

_MOST_LEFT_OUT = 0.05
"""Fraction of the samples that may be something else than the ball."""

_WITHIN_GRAVITY = 0.05
"""Relative: a fall may be this far from g, as the air and a short fall make it."""


def recording_checks(
    drop: Drop,
    sideways_m: Array,
    most_gap_falls: float = 0.0,
    excused_s: Sequence[float] | Array = (),
    most_sideways: float = 0.0,
    sunk_m: float = 0.0,
) -> list[Check]:
    """What the recording itself tells.

    Args:
        drop: the drop in it.
        sideways_m: the ball's horizontal positions in the drop's window [m], shape (T, 2).
        most_gap_falls: a gap of so many fall times may be, even where it is many periods.
        excused_s: when a sample is missing that tells nothing of an impact [s].
        sunk_m: how far below the contact the ball is elsewhere in the recording [m].
        most_sideways: fraction of the impact's speed at which the ball may go sideways.
    """
    height = drop.drop_height_m
    after = drop.seconds > drop.impact_s
    below = max(drop.contact_m - float(drop.heights_m[after].min(initial=drop.contact_m)), sunk_m)
    seen = (drop.seconds[-1] - drop.impact_s) / drop.fall_time_s
    drift = float(np.linalg.norm(np.ptp(sideways_m, axis=0)))
    periods = np.diff(drop.seconds)
    known_s = np.union1d(drop.seconds, np.asarray(excused_s))
    longest_s = float(np.diff(known_s).max())
    gap = longest_s / float(np.median(periods))
    most_gap = max(_MOST_GAP, most_gap_falls * drop.fall_time_s / float(np.median(periods)))
    floor = _MOST_BELOW * height + _BELOW_SDS * drop.noise_m
    least_seen = _LEAST_SEEN_THROWN if drop.launched else LEAST_SEEN
    flown, wanted = figures(seen, least_seen, 1)
    size, unit = _length(drop)
    under, most_under = figures(size * max(below, 0.0), size * floor, 1)
    lasts_s = float(drop.seconds[-1] - drop.seconds[0])
    most_m = max(_MOST_DRIFT * height, most_sideways * drop.impact_speed_m_s * lasts_s)
    aside, most_aside = figures(size * drift, size * most_m, 0)
    longest, too_long = figures(gap, most_gap, 1)
    return [
        Check(
            "first flight seen",
            seen > least_seen,
            f"{flown} fall times (wanted: {wanted} or more)",
            advice="record until the ball lies still",
            doubts_model=False,
        ),
        Check(
            "stays on the table",
            below < floor,
            f"{under} {unit} below contact (at most {most_under})",
            advice="drop onto the middle of a large, level surface",
        ),
        Check(
            "falls straight",
            drift < most_m,
            f"{aside} {unit} sideways (at most {most_aside})",
            advice="let go without a push, over a level surface",
        ),
        Check(
            "no samples missing",
            gap < most_gap,
            f"longest gap {longest} periods (less than {too_long})",
            advice="keep the ball in sight all the way, and the rate steady",
            doubts_model=False,
        ),
    ]


def _length(drop: Drop) -> tuple[float, str]:
    """How many of a unit are in one of a drop's metres, which are none where nothing tells them."""
    if drop.scale_known:
        return 1000.0, "mm"
    return 100 / drop.drop_height_m, "% of the drop height"


def fall_checks(drop: Drop, restitution: float, units: Units) -> list[Check]:
    """Whether it falls and flies as free bodies do, so that the restitution is the ball's own."""
    checks: list[Check] = []
    if units.doubt:
        checks.append(Check("gravity", False, units.doubt, advice=units.remedy, doubts_model=False))
    elif units.tell_speed:
        checks.append(
            Check(
                "gravity",
                abs(drop.gravity_m_s2 / CALIBRATED.gravity_m_s2 - 1) < _WITHIN_GRAVITY,
                f"falls with {drop.gravity_m_s2:.2f} m/s² (wanted: {CALIBRATED.gravity_m_s2:.2f} "
                f"within {100 * _WITHIN_GRAVITY:.0f} %)",
                advice="record lengths in m and the true times",
            )
        )
    if not np.isnan(drop.rest_m):
        off = abs(drop.rest_m - drop.contact_m)
        size, unit = _length(drop)
        apart, most_apart = figures(size * off, size * drop.rest_tolerance_m, 1)
        checks.append(
            Check(
                "rests where it hit",
                off < drop.rest_tolerance_m,
                f"{apart} {unit} between impact and rest (at most {most_apart})",
                advice="let it come to rest by itself, on a hard and level surface",
            )
        )
    flight_samples = 2 * restitution * drop.fall_time_s / float(np.median(np.diff(drop.seconds)))
    if np.isnan(drop.flight_restitution) and flight_samples >= _CLEAR_FLIGHT:
        detail = (
            f"none found in the {flight_samples:.0f} samples of the first flight "
            "(a filtered track?)"
        )
        advice = "record unfiltered positions, and let go without spin"
        checks.append(Check("flies a parabola", False, detail, advice=advice))
    return checks


def rebound_check(drop: Drop, restitution: float) -> Check:
    """Whether the noise leaves enough of the first rebound, where no interval says so."""
    hop_m = restitution**2 * drop.drop_height_m
    high, least = figures(1000 * hop_m, 1000 * _CLEAR_HOP * drop.noise_m, 1)
    return Check(
        "rebound stands out",
        hop_m > _CLEAR_HOP * drop.noise_m,
        f"{high} mm high (wanted: over {least}, {_CLEAR_HOP} times the noise)",
        advice="drop from higher, or record with less noise",
        symptom=True,
    )


def sure_check(low: float, high: float, reject: float = np.inf) -> Check:
    """Whether a 95 % interval is narrow enough to be of use.

    Args:
        low: lower end.
        high: upper end.
        reject: half a width from which on nothing is known.
    """
    half = (high - low) / 2
    shown, most = figures(half, _SURE, 2, "g")
    return Check(
        "sure enough",
        half < _SURE,
        f"95 % interval of ±{shown} (at most {most})",
        fatal=half > reject,
        advice="drop from higher, or record larger or at a higher rate",
        symptom=True,
        doubts_model=False,
    )


def motion_checks(fit: SimulationFit | None) -> list[Check]:
    """Whether the tuned simulator moves as the ball was seen to, and whether it foretells it.

    A simulator that leaves the observation is not tuned, whatever interval the fit has.
    """
    if fit is None:
        return []
    seen, most = figures(fit.excess_percent, MOST_EXCESS_PERCENT, 2)
    share = fit.left_out / max(fit.samples + fit.left_out, 1)
    found = [
        Check(
            "simulation fits",
            fit.excess_percent < MOST_EXCESS_PERCENT,
            f"{seen} % of the drop height apart beyond the noise, rms of {fit.samples} samples (at "
            f"most {most}); {fit.worst_percent:.2f} % at worst",
            fatal=fit.excess_percent > _REJECT_EXCESS,
            advice="drop it again without spin, onto a hard and level surface",
        ),
        Check(
            "samples are the ball's",
            share <= _MOST_LEFT_OUT,
            f"{fit.left_out} of {fit.samples + fit.left_out} are elsewhere (at most "
            f"{100 * _MOST_LEFT_OUT:.0f} %)",
            advice="keep other things that move, or are marked, away from the ball",
        ),
    ]
    if fit.held_out_percent is not None:
        off, most = figures(fit.held_out_percent, _MOST_HELD_OUT, 2)
        found.append(
            Check(
                "foretells the rest",
                fit.held_out_percent < _MOST_HELD_OUT,
                f"by the first 60 % of the time the rest is {off} % of the drop height off (at "
                f"most {most})",
                advice="drop from higher, or record more bounces at a higher rate",
                doubts_model=False,
            )
        )
    return found


def fit_check(
    simulated: Observation,
    target: Observation,
    scale: float,
    most: float,
    reject: float = _REJECT_FIT,
) -> Check:
    """Whether the tuned simulator moves as the recording does.

    Args:
        simulated: o_P of the result.
        target: o_T.
        scale: drop height in the observations' unit.
        most: share of the drop height that the two may lie apart (rms).
        reject: share from which on nothing can be reported.
    """
    off = (simulated.values - target.values) / scale
    rms = float(np.sqrt(np.nanmean(off**2)))
    apart, most_apart = figures(100 * rms, 100 * most, 2)
    return Check(
        "simulation fits",
        rms < most,
        f"{apart} % of the drop height apart, rms (at most {most_apart})",
        fatal=rms > reject,
        advice="drop it again without spin, onto a hard and level surface",
        symptom=True,
    )
