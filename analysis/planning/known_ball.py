"""Ball as known from a tuning: restitution over speed and drag, with their uncertainty.

Restitution, slope and drag are the tuned ones. Without a tuned slope, the law is fitted to the
bounces.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from analysis.drop.bounce_model import SLOPE_SD
from analysis.record import Interval, Record
from analysis.record_json import read_record
from analysis.result_files import Logs, logs_of
from analysis.statistics import TWO_SIDED
from recorders.simulators.balls import BALLS, contradict
from recorders.simulators.drop import RESTITUTION
from recorders.simulators.shot.rig import ShotBall
from recorders.simulators.speed_law import SpeedLaw
from tunenet_logs.arrays import Array
from tunenet_logs.errors import LogError, NotFoundError
from tunenet_logs.terminal import one_line

TOLD_SD = 0.01  # assumed of a restitution that a user gives without one, or that has no interval
# Of the logarithm of a restitution whose speed is unknown: the shot's may be half or twice it.
_NO_SPEED_SD = SLOPE_SD * math.log(2)

_MIN_SD = 0.002  # of any restitution: so that no bounce with a tiny interval outweighs all others
# Assumed of a drag without an interval, where half of it is not more: what a usual ball has.
_DRAG_SD_1_M = 0.02

# Fraction of a drag by which that of size and mass may be off: no ball is a smooth sphere.
_SAME_DRAG = 0.2

SLOPE, DRAG = "restitution_slope", "drag"  # the names of a tuning's estimates
_MAX_DRAG_1_M = 10.0  # no ball that falls has more
# Where a slope comes from: the tuning, its bounces, the user, nowhere (it is 0).
SlopeSource = Literal["tuned", "bounces", "told", "assumed"]

_MAX_SPEED_M_S = 1e4  # of an impact; nothing that people drop is faster


@dataclass(frozen=True, eq=False)
class KnownBall:
    """Ball with its uncertainty.

    Attributes:
        law: The most likely one.
        covariance: Of the logarithm of its restitution and of its slope, shape (2, 2).
        bounces: Number seen.
        remarks: For the user.
        slope_source: Where the law's slope comes from.
        drag_1_m: Deceleration by the air over speed squared; None for that of the rig's ball.
        drag_sd_1_m: Its standard deviation; 0 if the user states the drag.
        name: Of the ball, as it was recorded.
        logs: That it was tuned from; see `logs_of`.
    """

    law: SpeedLaw
    covariance: Array
    bounces: int = 0
    remarks: tuple[str, ...] = ()
    slope_source: SlopeSource = "told"
    drag_1_m: float | None = None
    drag_sd_1_m: float = 0.0
    name: str = ""
    logs: Logs = field(default_factory=dict)

    @property
    def slope_sd(self) -> float:
        """Standard deviation of the law's slope."""
        return math.sqrt(self.covariance[1, 1])

    def sd_at(self, speed_m_s: float) -> float:
        """Return the standard deviation of the restitution at this impact speed."""
        row = np.array([1.0, -math.log(speed_m_s / self.law.at_m_s)])
        restitution = max(float(self.law.at(np.array(speed_m_s))), TOLD_SD)
        return restitution * math.sqrt(row @ self.covariance @ row)


def told_ball(
    restitution: float,
    slope: float = 0.0,
    sd: float = TOLD_SD,
    drag_1_m: float | None = None,
) -> KnownBall:
    """Build a ball whose restitution the user states.

    Args:
        restitution: At 3 m/s if there is a slope, else at the shot's own impact.
        slope: Its exponent over speed; see `SpeedLaw`.
        sd: Of the restitution.
        drag_1_m: Of the air; None for that of the rig's ball.

    Raises:
        UsageError: No ball has it.
    """
    covariance = _covariance(restitution, sd)
    return KnownBall(SpeedLaw(restitution, slope), covariance, drag_1_m=drag_1_m)


def read_tuning(path: Path) -> KnownBall:
    """Read the ball of a tuning's JSON.

    Raises:
        LogError: It cannot be read, or is no tuning of a ball.
        NotFoundError: The tuning was rejected; the message says why.
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
        ball = replace(_ball_of(record), logs=logs_of([record]))
    except ValueError as error:
        raise LogError(f"{path}: {error}; tune the log again") from error
    if record.verdict == "suspect":
        doubt = f"the tuning is suspect ({one_line(record.reason)})"
        ball = replace(ball, remarks=(doubt, *ball.remarks))
    return ball


def contradiction(ball: KnownBall, rig_ball: ShotBall, *, is_told: bool) -> str | None:
    """Describe how the rig's ball contradicts that of the tuning; None if it does not.

    Args:
        ball: Of the tuning.
        rig_ball: Of the rig.
        is_told: Whether the user gave the rig; the default one can contradict in size only.
    """
    named = BALLS.get(ball.name)
    if named is not None and contradict(rig_ball.body, named):
        return (
            f"the rig's ball is of {rig_ball.body.words}, that of the tuning a {ball.name} ball of "
            f"{named.words}: correct the rig"
        )
    if ball.drag_1_m is None or not is_told:
        return None
    off_1_m = abs(rig_ball.air_drag_1_m - ball.drag_1_m)
    if off_1_m <= max(_SAME_DRAG * ball.drag_1_m, TWO_SIDED * ball.drag_sd_1_m):
        return None
    return (
        f"by the rig's ball the drag is {rig_ball.air_drag_1_m:.3g} /m, tuned is "
        f"{ball.drag_1_m:.3g} ± {ball.drag_sd_1_m:.2g} /m: the tuned one counts"
    )


def _ball_of(record: Record) -> KnownBall:
    """Build the ball by what was tuned; of a record without a slope, by its bounces.

    Raises:
        ValueError: It holds a value that no ball has.
    """
    value, sd = _value_and_sd(record)
    seen = [
        (speed, *_checked(bounce.restitution, bounce.interval95))
        for bounce in record.rebounds
        if (speed := _checked_speed(bounce.impact_speed_m_s)) is not None
    ]
    slope = _tuned(record, SLOPE, -1.0, 1.0) if record.physical else None
    if not seen:
        ball = _of_no_speed(value, sd)
    elif slope is not None:
        law = SpeedLaw(value, slope.value, seen[0][0])
        covariance = _covariance(value, sd, slope_sd=SLOPE_SD if slope.sd is None else slope.sd)
        ball = KnownBall(law, covariance, len(seen), slope_source="tuned")
    else:
        ball = _fitted(np.array(seen, dtype=float))
    drag = _tuned(record, DRAG, 0.0, _MAX_DRAG_1_M) if record.physical else None
    if drag is not None:
        sd_1_m = max(drag.value / 2, _DRAG_SD_1_M) if drag.sd is None else drag.sd
        ball = replace(ball, drag_1_m=drag.value, drag_sd_1_m=sd_1_m)
    return replace(ball, name=record.ball or "")


class _Tuned(NamedTuple):
    """Quantity and its standard deviation, None without an interval."""

    value: float
    sd: float | None


def _tuned(record: Record, name: str, low: float, high: float) -> _Tuned | None:
    """Return a record's quantity, or None.

    Raises:
        ValueError: It is not from `low` to `high`.
    """
    known = record.estimate(name)
    if known is None or not isinstance(known.value, float):
        return None
    if not low <= known.value <= high:
        raise ValueError(f"{name} {known.value:g} is not a number from {low:g} to {high:g}")
    if known.interval95 is None:
        return _Tuned(known.value, None)
    below, above = known.interval95
    return _Tuned(known.value, abs(above - below) / 2 / TWO_SIDED)  # pyright: ignore[reportOperatorIssue] (one number has one interval)


def _of_no_speed(value: float, sd: float) -> KnownBall:
    """Build a ball whose impact speeds are unknown."""
    return KnownBall(
        SpeedLaw(value),
        _covariance(value, sd, more=_NO_SPEED_SD),
        remarks=(
            "the tuning knows no impact speeds: the restitution is taken as the same at all speeds",
        ),
        slope_source="assumed",
    )


def _covariance(value: float, sd: float, slope_sd: float = 0.0, more: float = 0.0) -> Array:
    """Return a law's covariance, shape (2, 2); `more` adds to the sd of ln(restitution)."""
    level = (max(sd, _MIN_SD) / max(value, TOLD_SD)) ** 2
    return np.diag([level + more**2, slope_sd**2])


def _fitted(seen: Array) -> KnownBall:
    """Fit ln e = a - p ln(v / v_1) by Bayesian linear regression, with the prior p ~ N(0, 0.1).

    Args:
        seen: Speed [m/s], restitution and its standard deviation of each bounce, shape (N, 3).
    """
    speeds, values, sds = seen.T
    sds = np.maximum(sds, _MIN_SD)
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
    if len(seen) > 1:
        return KnownBall(law, covariance, len(speeds), slope_source="bounces")
    remark = (
        "the tuning does not show how the restitution falls with speed: it is taken as the same"
    )
    return KnownBall(law, covariance, 1, (remark,), "assumed")


def _value_and_sd(record: Record) -> tuple[float, float]:
    """Return the restitution at the first impact, and its standard deviation."""
    known = record.estimate(RESTITUTION.name)
    if known is None or not isinstance(known.value, float):
        raise ValueError("holds no restitution; give the tuning of a dropped ball")
    return _checked(known.value, known.interval95)  # pyright: ignore[reportArgumentType]


def _checked(restitution: float, interval95: Interval | None) -> tuple[float, float]:
    """Return a restitution and its standard deviation."""
    if not 0 <= restitution <= 1:
        raise ValueError(f"restitution {restitution:g} is not a number from 0 to 1")
    if interval95 is None:
        return restitution, TOLD_SD
    return restitution, abs(interval95[1] - interval95[0]) / 2 / TWO_SIDED


def _checked_speed(speed_m_s: float | None) -> float | None:
    if speed_m_s is not None and not 0 < speed_m_s < _MAX_SPEED_M_S:
        raise ValueError(f"impact_speed {speed_m_s} is none")
    return speed_m_s
