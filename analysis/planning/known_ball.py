"""What a tuning knows of a ball: its restitution at any speed, and how surely."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from recorders.simulators.drop import RESTITUTION
from recorders.simulators.shot.speed_law import SpeedLaw
from tunenet_logs.arrays import Array
from tunenet_logs.errors import LogError, NotFoundError
from tunenet_logs.wording import one_line

TOLD_SD = 0.01
"""Of a restitution that a user tells, or that has no interval."""

_SLOPE_SD = 0.1
"""Of p before any bounce is seen, around 0; real balls have .03 to .22."""

_NO_SPEED_SD = _SLOPE_SD * math.log(2)
"""Of the logarithm of a restitution whose speed is unknown: the shot's may be half or twice it."""

_LEAST_SD = 0.002
_NORMAL_95 = 1.96
_LARGEST_BYTES = 20_000_000


@dataclass(frozen=True, eq=False)
class KnownBall:
    """A ball as it is known.

    Attributes:
        law: the most likely one.
        covariance: of the logarithm of its restitution and of its slope, shape (2, 2).
        bounces: how many told.
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
    """A ball whose restitution somebody tells.

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
    told = _object(path)
    if told.get("verdict") == "rejected":
        raise NotFoundError(
            f"{path}: this tuning was rejected ({one_line(told.get('reason'))}); drop the ball "
            "again and tune that log"
        )
    if told.get("task") not in (None, "drop"):
        raise LogError(
            f"{path}: is the tuning of a {one_line(told['task'])}, not of a drop; give one of a "
            "ball that bounced"
        )
    value, sd = _value(path, told)
    seen = [one for one in _bounces(path, told) if one[0] is not None]
    remarks = []
    if told.get("verdict") == "suspect":
        remarks.append(f"the tuning is suspect ({one_line(told.get('reason'))})")
    if not seen:
        remarks.append(
            "the tuning knows no impact speeds: the restitution is taken as the same at all speeds"
        )
        covariance = _covariance(value, sd, _NO_SPEED_SD)
        return KnownBall(SpeedLaw(value), covariance, 0, tuple(remarks))
    if len(seen) == 1:
        remarks.append(
            "the tuning does not tell how the restitution falls with speed: it is taken as the same"
        )
    return _fitted(np.array(seen, dtype=float), tuple(remarks))


def _covariance(value: float, sd: float, more: float = 0.0) -> Array:
    """Of a law of one restitution; `more` is the logarithm's spread for other reasons."""
    return np.diag([(max(sd, _LEAST_SD) / max(value, TOLD_SD)) ** 2 + more**2, 0.0])


def _fitted(seen: Array, remarks: tuple[str, ...]) -> KnownBall:
    """The law ln e = a - p ln(v / v_1) that suits the bounces best, p ~ N(0, .1) before.

    Args:
        seen: speed, restitution and its standard deviation of each, shape (N, 3).
        remarks: to hand on.
    """
    speeds, values, sds = seen.T
    sds = np.maximum(sds, _LEAST_SD)
    usable = values > 3 * sds
    usable[0] = True
    speeds, values, sds = speeds[usable], np.maximum(values[usable], 1e-3), sds[usable]
    at = float(speeds[0])
    rows = np.column_stack([np.ones(len(speeds)), -np.log(speeds / at)])
    weights = (values / sds) ** 2
    precision = rows.T @ (rows * weights[:, None]) + np.diag([0.0, _SLOPE_SD**-2])
    covariance = np.linalg.inv(precision)
    level, slope = covariance @ (rows.T @ (weights * np.log(values)))
    law = SpeedLaw(min(math.exp(level), 1.0), float(np.clip(slope, -1.0, 1.0)), at)
    return KnownBall(law, covariance, len(speeds), remarks)


def _object(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            data = file.read(_LARGEST_BYTES + 1)
        told = json.loads(data) if len(data) <= _LARGEST_BYTES else None
    except OSError as error:
        raise LogError(
            f"{path}: cannot be read ({error.strerror}); give a tuning's .json"
        ) from error
    except (ValueError, RecursionError) as error:
        raise LogError(
            f"{path}: is no JSON ({one_line(error)}); give the .json that tunenet-tune wrote"
        ) from error
    if not isinstance(told, dict) or "verdict" not in told or "parameters" not in told:
        raise LogError(f"{path}: is no tuning; give the .json that tunenet-tune wrote")
    return told


def _value(path: Path, told: dict[str, Any]) -> tuple[float, float]:
    """Restitution at the first impact, and its standard deviation."""
    parameters = told["parameters"]
    one = parameters.get(RESTITUTION.name) if isinstance(parameters, dict) else None
    if not isinstance(one, dict):
        raise LogError(f"{path}: holds no restitution; give the tuning of a dropped ball")
    return _restitution(path, one.get("value")), _sd(path, one.get("interval95"))


def _bounces(path: Path, told: dict[str, Any]) -> Sequence[tuple[float | None, float, float]]:
    found = []
    for one in told.get("bounces") or ():
        if not isinstance(one, dict):
            raise LogError(f"{path}: its bounces are not a tuning's; tune the log again")
        speed = one.get("impact_speed")
        if speed is not None and not (_is_number(speed) and 0 < speed < 1e4):
            raise LogError(f"{path}: impact_speed {one_line(speed)} is none; tune the log again")
        value, sd = _restitution(path, one.get("restitution")), _sd(path, one.get("interval95"))
        found.append((speed, value, sd))
    return found


def _restitution(path: Path, value: Any) -> float:
    if not _is_number(value) or not 0 <= value <= 1:
        raise LogError(
            f"{path}: restitution {one_line(value)} is not a number from 0 to 1; tune the log again"
        )
    return float(value)


def _sd(path: Path, ends: Any) -> float:
    if ends is None:
        return TOLD_SD
    if not (isinstance(ends, list) and len(ends) == 2 and all(map(_is_number, ends))):
        raise LogError(f"{path}: interval95 {one_line(ends)} is none; tune the log again")
    return abs(float(ends[1]) - float(ends[0])) / 2 / _NORMAL_95


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
