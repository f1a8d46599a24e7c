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

# Rms in drop heights: a simulation that is farther off is of something else than the recording.
_REJECT_FIT = 0.1

_CLEAR_FLIGHT = 10  # samples of a first flight in which a parabola can be found, if there is one
# A first rebound lower than this many standard deviations of the noise has no value of its own.
_CLEAR_HOP = 8

_MAX_GAP = 4.0  # sample periods without a sample: a longer gap may hide an impact
_SURE = 0.02  # half width of an interval that still tells one ball from another
# Fall times after the impact: less than that may miss the top of the first bounce, and of a ball
# that a hand catches, what is free.
MIN_SEEN, _MIN_SEEN_THROWN = 0.9, 0.2

# Of the drop height, and of the noise's standard deviations, that a sample may lie under the
# contact: a ball that sinks in less is still on the table.
_MAX_BELOW, _BELOW_SDS = 0.03, 6

# Of the drop height: a ball that is let go stays nearer; one that is thrown does not.
_MAX_DRIFT = 0.5

# Of the drop height [%], beyond the noise: what cannot be seen in a review, and what a fit to the
# first part of a recording may be off in the rest.
MAX_EXCESS_PERCENT, _MAX_HELD_OUT = 0.5, 1.0

# Of the drop height [%]: a simulation that is farther off is of something else.
_REJECT_EXCESS = 15.0

_MAX_LEFT_OUT = 0.05  # fraction of the samples that may be something else than the ball
# Relative: a fall may be this far from g, as the air and a short fall make it.
_WITHIN_GRAVITY = 0.05


def recording_checks(
    drop: Drop,
    sideways_m: Array,
    most_gap_falls: float = 0.0,
    excused_s: Sequence[float] | Array = (),
    most_sideways: float = 0.0,
    sunk_m: float = 0.0,
) -> list[Check]:
    """Check the recording itself: its length, gaps, table and sideways motion.

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
    most_gap = max(_MAX_GAP, most_gap_falls * drop.fall_time_s / float(np.median(periods)))
    floor = _MAX_BELOW * height + _BELOW_SDS * drop.noise_m
    least_seen = _MIN_SEEN_THROWN if drop.launched else MIN_SEEN
    flown, wanted = figures(seen, least_seen, 1)
    size, unit = _length(drop)
    under, most_under = figures(size * max(below, 0.0), size * floor, 1)
    lasts_s = float(drop.seconds[-1] - drop.seconds[0])
    most_m = max(_MAX_DRIFT * height, most_sideways * drop.impact_speed_m_s * lasts_s)
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
    """Return the factor and unit that show a drop's lengths: mm, or % of an unscaled height."""
    if drop.scale_known:
        return 1000.0, "mm"
    return 100 / drop.drop_height_m, "% of the drop height"


def fall_checks(drop: Drop, restitution: float, units: Units) -> list[Check]:
    """Check that the ball falls and flies freely, so that the restitution is its own."""
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
    """Check that the first rebound stands out of the noise, where there is no interval."""
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
    """Check that a 95 % interval is narrow enough; half a width above `reject` is fatal."""
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
    """Check that the tuned simulator moves as the ball does, and predicts the hold-out.

    A simulator that leaves the observation is not tuned, however narrow the fit's interval is.
    """
    if fit is None:
        return []
    seen, most = figures(fit.excess_percent, MAX_EXCESS_PERCENT, 2)
    share = fit.left_out / max(fit.samples + fit.left_out, 1)
    found = [
        Check(
            "simulation fits",
            fit.excess_percent < MAX_EXCESS_PERCENT,
            f"{seen} % of the drop height apart beyond the noise, rms of {fit.samples} samples (at "
            f"most {most}); {fit.worst_percent:.2f} % at worst",
            fatal=fit.excess_percent > _REJECT_EXCESS,
            advice="drop it again without spin, onto a hard and level surface",
        ),
        Check(
            "samples are the ball's",
            share <= _MAX_LEFT_OUT,
            f"{fit.left_out} of {fit.samples + fit.left_out} are elsewhere (at most "
            f"{100 * _MAX_LEFT_OUT:.0f} %)",
            advice="keep other things that move, or are marked, away from the ball",
        ),
    ]
    if fit.held_out_percent is not None:
        off, most = figures(fit.held_out_percent, _MAX_HELD_OUT, 2)
        found.append(
            Check(
                "foretells the rest",
                fit.held_out_percent < _MAX_HELD_OUT,
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
    """Check that the tuned simulator is within `most` drop heights of the recording (rms).

    `scale` is the drop height in the observations' unit; more than `reject` is fatal.
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
