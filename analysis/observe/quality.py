"""Checks of a recorded drop: each named, with its figure and what it asks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.observe.base import Observation
from analysis.observe.free_fall import Drop

Array = NDArray[np.float64]

_GRAVITY_M_S2 = 9.81
_REJECT_FIT = 0.1
_SUSPECT_FIT = 0.03


@dataclass(frozen=True)
class Check:
    """One thing that was looked at.

    Attributes:
        detail: the figure that was seen, and what was asked for.
        fatal: a failure means that no value can be reported at all.
    """

    name: str
    passed: bool
    detail: str
    fatal: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "passed", bool(self.passed))  # NumPy's bool is no JSON


def recording_checks(drop: Drop, sideways_m: Array) -> list[Check]:
    """What the recording itself tells.

    Args:
        drop: the drop in it.
        sideways_m: the ball's horizontal positions in the drop's window [m], shape (T, 2).
    """
    height = drop.drop_height_m
    after = drop.seconds > drop.impact_s
    below = drop.contact_m - float(drop.heights_m[after].min())
    seen = (drop.seconds[-1] - drop.impact_s) / drop.fall_time_s
    drift = float(np.linalg.norm(np.ptp(sideways_m, axis=0)))
    periods = np.diff(drop.seconds)
    gap = float(periods.max() / np.median(periods))
    floor = 0.03 * height + 6 * drop.noise_m
    checks = [
        Check("first flight seen", seen > 0.9, f"{seen:.1f} fall times (wanted: 0.9 or more)"),
        Check(
            "stays on the table",
            below < floor,
            f"{1000 * max(below, 0.0):.1f} mm below contact (at most {1000 * floor:.0f})",
        ),
        Check(
            "falls straight",
            drift < 0.5 * height,
            f"{1000 * drift:.0f} mm sideways (at most {500 * height:.0f})",
        ),
        Check("no samples missing", gap < 4, f"longest gap {gap:.1f} periods (at most 4)"),
    ]
    if not np.isnan(drop.rest_m):
        off = abs(drop.rest_m - drop.contact_m)
        level = 0.02 * height + 4 * drop.noise_m
        checks.append(
            Check(
                "rests where it hit",
                off < level,
                f"{1000 * off:.1f} mm between impact and rest (at most {1000 * level:.0f})",
            )
        )
    return checks


def gravity_check(drop: Drop) -> Check:
    """Whether lengths and times are what they seem, and nothing slows the ball."""
    return Check(
        "gravity",
        abs(drop.gravity_m_s2 / _GRAVITY_M_S2 - 1) < 0.05,
        f"falls with {drop.gravity_m_s2:.2f} m/s² (wanted: 9.81 within 5 %)",
    )


def fit_check(simulated: Observation, target: Observation, scale: float) -> Check:
    """Whether the tuned simulator moves as the recording does.

    Args:
        simulated: o_P of the result.
        target: o_T.
        scale: drop height in the observations' unit.
    """
    off = (simulated.values - target.values) / scale
    rms = float(np.sqrt(np.nanmean(off**2)))
    return Check(
        "simulation fits",
        rms < _SUSPECT_FIT,
        f"{100 * rms:.2f} % of the drop height apart, rms (at most {100 * _SUSPECT_FIT:g})",
        fatal=rms > _REJECT_FIT,
    )
