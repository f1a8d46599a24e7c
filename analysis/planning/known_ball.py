"""What a tuning knows of a ball: its restitution at any speed, with a standard deviation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from analysis.drop.bounce_fit import SLOPE_SD
from analysis.record import Interval, Record
from analysis.record_json import read_record
from analysis.statistics import TWO_SIDED
from recorders.simulators.drop import RESTITUTION
from recorders.simulators.shot.speed_law import SpeedLaw
from tunenet_logs.arrays import Array
from tunenet_logs.errors import LogError, NotFoundError
from tunenet_logs.terminal import one_line

TOLD_SD = 0.01
"""Assumed of a restitution that a user gives without one, or that has no interval."""

_NO_SPEED_SD = SLOPE_SD * math.log(2)
"""Of the logarithm of a restitution whose speed is unknown: the shot's may be half or twice it."""

_LEAST_SD = 0.002
"""Of any restitution: so that no bounce with a tiny interval outweighs all others."""

_FASTEST_M_S = 1e4
"""Of an impact; nothing that people drop is faster."""


@dataclass(frozen=True, eq=False)
class KnownBall:
    """A ball as it is known.

    Attributes:
        law: the most likely one.
        covariance: of the logarithm of its restitution and of its slope, shape (2, 2).
        bounces: how many were fitted.
        remarks: what a user should know, in words.
    """

    law: SpeedLaw
    covariance: Array
    bounces: int = 0
    remarks: tuple[str, ...] = ()

    def sd_at(self, speed_m_s: float) -> float:
        """Standard deviation of the restitution at an impact of this speed."""
        row = np.array([1.0, -math.log(speed_m_s / self.law.at_m_s)])
        restitution = max(float(self.law.at(np.array(speed_m_s))), TOLD_SD)
        return restitution * math.sqrt(row @ self.covariance @ row)


def told_ball(restitution: float, slope: float = 0.0, sd: float = TOLD_SD) -> KnownBall:
    """A ball whose restitution the user gives.

    Args:
        restitution: at 3 m/s where there is a slope, else at the shot's own impact.
        slope: how it falls with speed; see `SpeedLaw`.
        sd: of the restitution.

    Raises:
        UsageError: no ball has it.
    """
    return KnownBall(SpeedLaw(restitution, slope), _covariance(restitution, sd))


def read_tuning(path: Path) -> KnownBall:
    """The ball of a tuning's JSON.

    Raises:
        LogError: cannot be read, or is no tuning of a ball.
        NotFoundError: the tuning was rejected; says why.
    """
    record = read_record(path)
    if record.verdict == "rejected":
        raise NotFoundError(
            f"{path}: this tuning was rejected ({one_line(record.reason)}); drop the ball "
            "again and tune that log"
        )
    if record.task not in (None, "drop"):
        raise LogError(
            f"{path}: is the tuning of a {one_line(record.task)}, not of a drop; give one of a "
            "ball that bounced"
        )
    try:
        value, sd = _value_and_sd(record)
        seen = [
            (speed, *_checked(bounce.restitution, bounce.interval95))
            for bounce in record.rebounds
            if (speed := _checked_speed(bounce.impact_speed_m_s)) is not None
        ]
    except ValueError as error:
        raise LogError(f"{path}: {error}; tune the log again") from error
    remarks = []
    if record.verdict == "suspect":
        remarks.append(f"the tuning is suspect ({one_line(record.reason)})")
    if not seen:
        remarks.append(
            "the tuning knows no impact speeds: the restitution is taken as the same at all speeds"
        )
        covariance = _covariance(value, sd, _NO_SPEED_SD)
        return KnownBall(SpeedLaw(value), covariance, 0, tuple(remarks))
    if len(seen) == 1:
        remarks.append(
            "the tuning does not show how the restitution falls with speed: it is taken as the same"
        )
    return _fitted(np.array(seen, dtype=float), tuple(remarks))


def _covariance(value: float, sd: float, more: float = 0.0) -> Array:
    """Of a law of one restitution, shape (2, 2); `more` is the logarithm's sd for other reasons."""
    return np.diag([(max(sd, _LEAST_SD) / max(value, TOLD_SD)) ** 2 + more**2, 0.0])


def _fitted(seen: Array, remarks: tuple[str, ...]) -> KnownBall:
    """The law ln e = a - p ln(v / v_1) by Bayesian linear regression, with the prior p ~ N(0, 0.1).

    Args:
        seen: speed [m/s], restitution and its standard deviation of each bounce, shape (N, 3).
        remarks: of the ball.
    """
    speeds, values, sds = seen.T
    sds = np.maximum(sds, _LEAST_SD)
    usable = values > 3 * sds
    usable[0] = True
    speeds, values, sds = speeds[usable], np.maximum(values[usable], 1e-3), sds[usable]
    at = float(speeds[0])
    rows = np.column_stack([np.ones(len(speeds)), -np.log(speeds / at)])
    weights = (values / sds) ** 2
    precision = rows.T @ (rows * weights[:, None]) + np.diag([0.0, SLOPE_SD**-2])
    covariance = np.linalg.inv(precision)
    level, slope = covariance @ (rows.T @ (weights * np.log(values)))
    law = SpeedLaw(min(math.exp(level), 1.0), float(np.clip(slope, -1.0, 1.0)), at)
    return KnownBall(law, covariance, len(speeds), remarks)


def _value_and_sd(record: Record) -> tuple[float, float]:
    """Restitution at the first impact, and its standard deviation."""
    known = record.estimate(RESTITUTION.name)
    if known is None or not isinstance(known.value, float):
        raise ValueError("holds no restitution; give the tuning of a dropped ball")
    return _checked(known.value, known.interval95)  # pyright: ignore[reportArgumentType]


def _checked(restitution: float, interval95: Interval | None) -> tuple[float, float]:
    """A restitution and its standard deviation."""
    if not 0 <= restitution <= 1:
        raise ValueError(f"restitution {restitution:g} is not a number from 0 to 1")
    if interval95 is None:
        return restitution, TOLD_SD
    return restitution, abs(interval95[1] - interval95[0]) / 2 / TWO_SIDED


def _checked_speed(speed_m_s: float | None) -> float | None:
    if speed_m_s is not None and not 0 < speed_m_s < _FASTEST_M_S:
        raise ValueError(f"impact_speed {speed_m_s} is none")
    return speed_m_s
