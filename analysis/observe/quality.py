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


def recording_checks(drop: Drop, sideways_m: Array) -> list[Check]:
    """What the recording itself tells.

    Args:
        sideways_m: the ball's horizontal positions in the drop's window [m], shape (T, 2).
    """
    height = drop.drop_height_m
    after = drop.seconds > drop.impact_s
    below = drop.contact_m - float(drop.heights_m[after].min())
    seen = (drop.seconds[-1] - drop.impact_s) / drop.fall_time_s
    drift = float(np.linalg.norm(np.ptp(sideways_m, axis=0)))
    periods = np.diff(drop.seconds)
    gap = float(periods.max() / np.median(periods))
    gravity_off = abs(drop.gravity_m_s2 / _GRAVITY_M_S2 - 1)
    checks = [
        Check(
            "gravity",
            gravity_off < 0.05,
            f"the ball falls with {drop.gravity_m_s2:.2f} m/s², expected 9.81 within 5 % "
            "(else lengths or times are off, or something slows it)",
        ),
        Check(
            "first flight seen",
            seen > 0.9,
            f"{seen:.1f} fall times recorded after the impact, at least 0.9 wanted",
        ),
        Check(
            "stays on the table",
            below < 0.03 * height + 6 * drop.noise_m,
            f"{1000 * max(below, 0.0):.0f} mm below the contact at the lowest, "
            f"at most {1000 * (0.03 * height + 6 * drop.noise_m):.0f} mm expected",
        ),
        Check(
            "falls straight",
            drift < 0.5 * height,
            f"{1000 * drift:.0f} mm of sideways travel, at most {500 * height:.0f} mm wanted",
        ),
        Check(
            "no samples missing",
            gap < 4,
            f"the longest gap is {gap:.1f} sample periods, at most 4 wanted",
        ),
    ]
    if not np.isnan(drop.rest_m):
        off = abs(drop.rest_m - drop.contact_m)
        checks.append(
            Check(
                "rests where it hit",
                off < 0.02 * height + 4 * drop.noise_m,
                f"{1000 * off:.1f} mm between the levels of impact and of rest",
            )
        )
    return checks


def fit_check(simulated: Observation, target: Observation, scale: float) -> Check:
    """Whether the tuned simulator moves as the recording does.

    Args:
        scale: drop height in the observations' unit.
    """
    off = (simulated.values - target.values) / scale
    rms = float(np.sqrt(np.nanmean(off**2)))
    return Check(
        "simulation fits",
        rms < _SUSPECT_FIT,
        f"{100 * rms:.2f} % of the drop height between the two curves (rms), "
        f"at most {100 * _SUSPECT_FIT:g} % wanted",
        fatal=rms > _REJECT_FIT,
    )
