"""Checks of a recorded drop: each named, with its figure and what it asks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.drop.free_fall import Drop
from analysis.estimators.observation import Observation
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode

_GRAVITY_M_S2 = 9.81
_REJECT_FIT = 0.1
_CLEAR_FLIGHT = 10
_CLEAR_HOP = 8
_MOST_GAP = 4.0
_SURE = 0.02
_MORE_DIGITS = 3


@dataclass(frozen=True)
class Check:
    """One thing that was looked at.

    Attributes:
        detail: the figure that was seen, and what was asked for.
        fatal: a failure means that no value can be reported at all.
        advice: what to do at the next drop so that it passes, as one short order.
    """

    name: str
    passed: bool
    detail: str
    fatal: bool = False
    advice: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "passed", bool(self.passed))  # NumPy's bool is no JSON


def log_checks(episode: Episode) -> tuple[Check, ...]:
    """What the file tells: a log whose samples may have been changed cannot be trusted."""
    detail = episode.tainted or "no sample that was read is known to be damaged"
    advice = "tune the log as it was before it was damaged"
    return (Check("samples as they were recorded", not episode.tainted, detail, advice=advice),)


def recording_checks(drop: Drop, sideways_m: Array, most_gap_falls: float = 0.0) -> list[Check]:
    """What the recording itself tells.

    Args:
        drop: the drop in it.
        sideways_m: the ball's horizontal positions in the drop's window [m], shape (T, 2).
        most_gap_falls: a gap of so many fall times may be, even where it is many periods.
    """
    height = drop.drop_height_m
    after = drop.seconds > drop.impact_s
    below = drop.contact_m - float(drop.heights_m[after].min())
    seen = (drop.seconds[-1] - drop.impact_s) / drop.fall_time_s
    drift = float(np.linalg.norm(np.ptp(sideways_m, axis=0)))
    periods = np.diff(drop.seconds)
    gap = float(periods.max() / np.median(periods))
    most_gap = max(_MOST_GAP, most_gap_falls * drop.fall_time_s / float(np.median(periods)))
    floor = 0.03 * height + 6 * drop.noise_m
    flown, wanted = _pair(seen, 0.9, 1)
    under, most_under = _pair(1000 * max(below, 0.0), 1000 * floor, 1)
    aside, most_aside = _pair(1000 * drift, 500 * height, 0)
    longest, too_long = _pair(gap, most_gap, 1)
    return [
        Check(
            "first flight seen",
            seen > 0.9,
            f"{flown} fall times (wanted: {wanted} or more)",
            advice="record until the ball lies still",
        ),
        Check(
            "stays on the table",
            below < floor,
            f"{under} mm below contact (at most {most_under})",
            advice="drop onto the middle of a large, level surface",
        ),
        Check(
            "falls straight",
            drift < 0.5 * height,
            f"{aside} mm sideways (at most {most_aside})",
            advice="let go without a push, over a level surface",
        ),
        Check(
            "no samples missing",
            gap < most_gap,
            f"longest gap {longest} periods (less than {too_long})",
            advice="keep the ball in sight all the way, and the rate steady",
        ),
    ]


def fall_checks(drop: Drop, restitution: float) -> list[Check]:
    """Whether it falls and flies as free bodies do, so that the restitution is the ball's own."""
    checks = [
        Check(
            "gravity",
            abs(drop.gravity_m_s2 / _GRAVITY_M_S2 - 1) < 0.05,
            f"falls with {drop.gravity_m_s2:.2f} m/s² (wanted: 9.81 within 5 %)",
            advice="record lengths in m and the true times",
        )
    ]
    if not np.isnan(drop.rest_m):
        off = abs(drop.rest_m - drop.contact_m)
        apart, most_apart = _pair(1000 * off, 1000 * drop.rest_tolerance_m, 1)
        checks.append(
            Check(
                "rests where it hit",
                off < drop.rest_tolerance_m,
                f"{apart} mm between impact and rest (at most {most_apart})",
                advice="let it come to rest by itself, on a hard and level surface",
            )
        )
    flight_samples = 2 * restitution * drop.fall_time_s / float(np.median(np.diff(drop.seconds)))
    if not np.isnan(drop.drag):
        most = 0.02 + 2 * drop.drag_sd
        slower, most_slower = _pair(100 * drop.drag, 100 * most, 1)
        checks.append(
            Check(
                "no air drag",
                drop.drag < most,
                f"falls {slower} % slower than it flies (at most {most_slower})",
                advice="drop from lower, where the air does less",
            )
        )
    elif flight_samples >= _CLEAR_FLIGHT:
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
    high, least = _pair(1000 * hop_m, 1000 * _CLEAR_HOP * drop.noise_m, 1)
    return Check(
        "rebound stands out",
        hop_m > _CLEAR_HOP * drop.noise_m,
        f"{high} mm high (wanted: over {least}, {_CLEAR_HOP} times the noise)",
        advice="drop from higher, or record with less noise",
    )


def sure_check(low: float, high: float, reject: float = np.inf) -> Check:
    """Whether a 95 % interval is narrow enough to be of use.

    Args:
        low: lower end.
        high: upper end.
        reject: half a width from which on nothing is known.
    """
    half = (high - low) / 2
    shown, most = _pair(half, _SURE, 2, "g")
    return Check(
        "sure enough",
        half < _SURE,
        f"95 % interval of ±{shown} (at most {most})",
        fatal=half > reject,
        advice="drop from higher, or record larger or at a higher rate",
    )


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
    apart, most_apart = _pair(100 * rms, 100 * most, 2)
    return Check(
        "simulation fits",
        rms < most,
        f"{apart} % of the drop height apart, rms (at most {most_apart})",
        fatal=rms > reject,
        advice="drop it again without spin, onto a hard and level surface",
    )


def _pair(seen: float, limit: float, digits: int, kind: str = "f") -> tuple[str, str]:
    """Two numbers with so many digits, or more where they would read alike."""
    for more in range(digits, digits + _MORE_DIGITS + 1):
        pair = f"{seen:.{more}{kind}}", f"{limit:.{more}{kind}}"
        if pair[0] != pair[1]:
            return pair
    return f"{seen:.{digits}{kind}}", f"{limit:.{digits}{kind}}"
