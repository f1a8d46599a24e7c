"""Plan a robot's bounce shot from a tuned ball: the release height that forgives the most.

As in the paper, heights are sampled evenly over the robot's reach. Of those from which the ball
passes the rim without touching it, the best is not the one that passes nearest to the centre, but
the one with the largest margin in restitution, in height and in drag, each in standard deviations.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.drop.bounce_model import SLOPE_SD
from tunenet_logs.analysis.record import Interval, Record, read_record
from tunenet_logs.analysis.result_files import Logs, logs_of, mark
from tunenet_logs.analysis.statistics import TWO_SIDED
from tunenet_logs.episode import Array
from tunenet_logs.errors import LogError, NotFoundError
from tunenet_logs.recorders.simulators.ball import RESTITUTION, SpeedLaw
from tunenet_logs.recorders.simulators.known import BALLS, contradict, engine
from tunenet_logs.recorders.simulators.shot import (
    COARSE_S,
    Flights,
    ShotBall,
    ShotRig,
    fly,
    passes,
    released,
    shoot,
    shoot_in_engine,
)
from tunenet_logs.terminal import one_line

# ---- Ball as known from a tuning: restitution over speed and drag, with their uncertainty.
# Without a tuned slope, the law is fitted to the bounces.

TOLD_SD = 0.01  # assumed of a restitution that a user gives without one, or that has no interval
# Of the logarithm of a restitution whose speed is unknown: the shot's may be half or twice it.
_NO_SPEED_SD = SLOPE_SD * math.log(2)

_MIN_RESTITUTION_SD = 0.002  # so that no bounce with a tiny interval outweighs all others
# Assumed of a drag without an interval, or half of the drag if that is more: a usual ball's drag.
_DRAG_SD_1_M = 0.02

# Fraction by which the drag of size and mass may be off the tuned one: no ball is a smooth sphere.
_SAME_DRAG = 0.2

SLOPE, DRAG = "restitution_slope", "drag"  # the names of a tuning's estimates
# Where a slope comes from: the tuning, its bounces, the user, nowhere (it is then 0).
SlopeSource = Literal["tuned", "bounces", "told", "assumed"]


@dataclass(frozen=True, eq=False)
class KnownBall:
    """Ball with its uncertainty."""

    law: SpeedLaw  # the most likely one
    covariance: Array  # of the logarithm of its restitution and of its slope, shape (2, 2)
    bounces: int = 0  # number seen
    remarks: tuple[str, ...] = ()  # for the user
    slope_source: SlopeSource = "told"  # where the law's slope comes from
    drag_1_m: float | None = None  # deceleration over speed squared; None: the rig's ball's
    drag_sd_1_m: float = 0.0  # its standard deviation; 0 if the user states the drag
    name: str = ""  # of the ball, as it was recorded
    logs: Logs = field(default_factory=dict)  # that it was tuned from; see `logs_of`

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
    restitution: float, slope: float = 0.0, sd: float = TOLD_SD, drag_1_m: float | None = None
) -> KnownBall:
    """Build a ball whose restitution the user states."""
    covariance = _covariance(restitution, sd)
    return KnownBall(SpeedLaw(restitution, slope), covariance, drag_1_m=drag_1_m)


def read_tuning(path: Path) -> KnownBall:
    """Read the ball of a tuning's JSON."""
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
        ball = replace(ball_of(record), name=record.ball or "", logs=logs_of([record]))
    except ValueError as error:
        raise LogError(f"{path}: {error}; tune the log again") from error
    if record.verdict == "suspect":
        doubt = f"the tuning is suspect ({one_line(record.reason)})"
        ball = replace(ball, remarks=(doubt, *ball.remarks))
    return ball


def contradiction(ball: KnownBall, rig_ball: ShotBall, *, is_told: bool) -> str | None:
    """Describe how the rig's ball contradicts that of the tuning; None if it does not."""
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


def ball_of(record: Record) -> KnownBall:
    """Build the ball by what was tuned; of a record without a slope, by its bounces.

    Raises:
        ValueError: The record holds no restitution, or values that no ball has.
    """
    first = _tuned(record, RESTITUTION.name, 0.0, 1.0)
    if first is None:
        raise ValueError("holds no restitution; give the tuning of a dropped ball")
    seen: list[tuple[float, float, float]] = []
    for bounce in record.rebounds:
        speed, value, interval95 = bounce.impact_speed_m_s, bounce.restitution, bounce.interval95
        if speed is None:
            continue
        if not 0 < speed < 1e4:  # of an impact; nothing that people drop is faster
            raise ValueError(f"impact_speed {speed} is none")
        own_sd = _sd(interval95)
        seen.append((speed, value, TOLD_SD if own_sd is None else own_sd))
        _check("restitution", value, 0.0, 1.0)
    slope = _tuned(record, SLOPE, -1.0, 1.0) if record.physical else None
    value, sd = first.value, TOLD_SD if first.sd is None else first.sd
    if not seen:
        remark = (
            "the tuning knows no impact speeds: the restitution is taken as the same at all speeds"
        )
        covariance = _covariance(value, sd, more=_NO_SPEED_SD)
        ball = KnownBall(SpeedLaw(value), covariance, remarks=(remark,), slope_source="assumed")
    elif slope is not None:
        law = SpeedLaw(value, slope.value, seen[0][0])
        covariance = _covariance(value, sd, slope_sd=SLOPE_SD if slope.sd is None else slope.sd)
        ball = KnownBall(law, covariance, len(seen), slope_source="tuned")
    else:
        ball = _fitted(np.array(seen, dtype=float))
    # No ball that falls has a drag of more than 10 /m.
    drag = _tuned(record, DRAG, 0.0, 10.0) if record.physical else None
    if drag is None:
        return ball
    sd_1_m = max(drag.value / 2, _DRAG_SD_1_M) if drag.sd is None else drag.sd
    return replace(ball, drag_1_m=drag.value, drag_sd_1_m=sd_1_m)


class _Tuned(NamedTuple):
    """Quantity and its standard deviation, None without an interval."""

    value: float
    sd: float | None


def _tuned(record: Record, name: str, low: float, high: float) -> _Tuned | None:
    """Return a record's quantity, or None; a ValueError if it is not from `low` to `high`."""
    known = record.estimate(name)
    if known is None or not isinstance(known.value, float):
        return None
    _check(name, known.value, low, high)
    return _Tuned(known.value, _sd(known.interval95))  # pyright: ignore[reportArgumentType] (one number has one interval)


def _check(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise ValueError(f"{name} {value:g} is not a number from {low:g} to {high:g}")


def _sd(interval95: Interval | None) -> float | None:
    return None if interval95 is None else abs(interval95[1] - interval95[0]) / 2 / TWO_SIDED


def _covariance(value: float, sd: float, slope_sd: float = 0.0, more: float = 0.0) -> Array:
    """Return a law's covariance, shape (2, 2); `more` adds to the sd of ln(restitution)."""
    level = (max(sd, _MIN_RESTITUTION_SD) / max(value, TOLD_SD)) ** 2
    return np.diag([level + more**2, slope_sd**2])


def _fitted(seen: Array) -> KnownBall:
    """Fit ln e = a - p ln(v / v_1) by Bayesian linear regression, with the prior p ~ N(0, 0.1).

    `seen` has the speed [m/s], restitution and its standard deviation of each bounce, (N, 3).
    """
    speeds, values, sds = seen.T
    sds = np.maximum(sds, _MIN_RESTITUTION_SD)
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


# ---- Tolerances: ranges of height, restitution and drag in which the ball passes.
# Heights and restitutions are simulated on a grid that is widened until the ball does not pass,
# drags on a fixed one. Between grid points, an end is where the linearly interpolated gap is zero.

Range = tuple[float, float]  # lower and upper end
# Searched beyond the reach: 30 mm, or more standard deviations of a height than a shot is ever off.
_ROOM_M, _ROOM_SDS = 0.03, 5


# Heights that are tried at a time beyond either end of the reach, as dense as those within it:
# enough to find an end, and not too many for a user who waits.
_MIN_HEIGHTS, _MAX_HEIGHTS = 12, 100

_FIRST_SHIFT = 0.15  # of the restitution, to either side: the default hoop forgives about 0.04
_SHIFTS = 15  # that are tried at a time to either side: a hundredth apart at first
MIN_HEIGHT_M = 0.005  # the lowest height that is tried: from 0 m a ball has no impact
# Drags that are tried to either side, denser near the ball's own: down to none, and up by so much.
_DRAGS, _MAX_ADDED_DRAG_1_M = 12, 0.5

# [m]; added to the negative gap of a ball that passes outside, to tell it from one that touches.
_OUTSIDE = -1.0


def signed_gap_m(flights: Flights) -> Array:
    """Return the gap of ball and rim, shape (N,) [m]; negative unless it passes freely inside."""
    return np.where(flights.is_through, flights.gap_m, -np.abs(flights.gap_m) + _OUTSIDE)


def height_ends(
    rig: ShotRig, ball: KnownBall, heights_m: Array, gaps_m: Array, which: NDArray[np.int64]
) -> list[Range]:
    """Find, around each given height, the least and greatest [m] from which the ball passes.

    The search goes beyond the reach too: by five standard deviations of a height or 30 mm, and
    on until the ball does not pass, or for 1 m. Heights ascend, shape (N,), with their signed
    gaps; `which` are indices of those from which it passes, shape (M,).
    """
    wide, gaps, before = heights_m, gaps_m, 0
    pitch_m = (heights_m[-1] - heights_m[0]) / (len(heights_m) - 1)
    room_m = max(_ROOM_M, _ROOM_SDS * rig.release.height_sd_m)
    most_m = max(1.0, room_m)  # likewise: a shot that passes even from there is reported so far
    while True:
        count = int(np.clip(np.ceil(room_m / pitch_m), _MIN_HEIGHTS, _MAX_HEIGHTS))
        lowest, highest = max(wide[0] - room_m, MIN_HEIGHT_M), wide[-1] + room_m
        below = np.linspace(lowest, wide[0], count, endpoint=False)
        above = np.linspace(wide[-1], highest, count + 1)[1:]
        beyond = np.concatenate([below, above])
        more = signed_gap_m(passes(rig, ball.law, beyond, np.zeros(2 * count)))
        wide = np.concatenate([below, wide, above])
        gaps = np.concatenate([more[:count], gaps, more[count:]])
        before += count
        found = [_ends(wide, gaps, before + index) for index in which.tolist()]
        is_open = any(low == wide[0] > MIN_HEIGHT_M or high == wide[-1] for low, high in found)
        if not is_open or highest >= heights_m[-1] + most_m:
            return found
        room_m *= 2


def restitution_ends(rig: ShotRig, ball: KnownBall, heights_m: Array, values: Array) -> list[Range]:
    """Find how far each shot's restitution may be off, down and up, while the ball still passes."""
    shifts = np.linspace(-_FIRST_SHIFT, _FIRST_SHIFT, 2 * _SHIFTS + 1)
    gaps = _shifted_gaps_m(rig, ball, heights_m, shifts)
    while True:
        most = float(shifts[-1])
        found = [_ends(shifts, one, len(shifts) // 2) for one in gaps]
        low, high = np.array(found).T
        is_open = (low == -most) & (values > most) | (high == most) & (values + most < 1)
        if most >= 1 or not is_open.any():
            return found
        outer = np.linspace(most, min(2 * most, 1.0), _SHIFTS + 1)[1:]
        beyond = np.concatenate([-outer[::-1], outer])
        more = np.full((len(heights_m), len(beyond)), _OUTSIDE)
        more[is_open] = _shifted_gaps_m(rig, ball, heights_m[is_open], beyond)
        shifts = np.concatenate([beyond[:_SHIFTS], shifts, beyond[_SHIFTS:]])
        gaps = np.hstack([more[:, :_SHIFTS], gaps, more[:, _SHIFTS:]])


def drag_ends(rig: ShotRig, ball: KnownBall, heights_m: Array) -> list[Range]:
    """Find, around the ball's drag, the least and greatest [1/m] with which it passes."""
    middle_1_m = rig.ball.air_drag_1_m
    away = np.linspace(0.0, 1.0, _DRAGS + 1)[1:] ** 2
    below = middle_1_m * (1 - away[::-1]) if middle_1_m else np.zeros(0)
    drags = np.concatenate([below, [middle_1_m], middle_1_m + _MAX_ADDED_DRAG_1_M * away])
    heights, tried = np.repeat(heights_m, len(drags)), np.tile(drags, len(heights_m))
    flights = passes(rig, ball.law, heights, np.zeros(len(heights)), tried)
    gaps = signed_gap_m(flights).reshape(len(heights_m), len(drags))
    return [_ends(drags, one, len(below)) for one in gaps]


def _shifted_gaps_m(rig: ShotRig, ball: KnownBall, heights_m: Array, shifts: Array) -> Array:
    """Compute signed gaps at N heights and S restitution shifts, shape (N, S) [m]."""
    grid = np.repeat(heights_m, len(shifts)), np.tile(shifts, len(heights_m))
    return signed_gap_m(passes(rig, ball.law, *grid)).reshape(len(heights_m), len(shifts))


def _ends(values: Array, gaps: Array, index: int) -> Range:
    """Interpolate the range of ascending `values` around `index` where `gaps` [m] are positive."""
    found = []
    for way in (-1, 1):
        at = index
        while 0 <= at + way < len(values) and gaps[at + way] > 0:
            at += way
        end = float(values[at])
        if 0 <= at + way < len(values):
            inside, outside = gaps[at], gaps[at + way]
            # Only a ball inside the hoop has a gap that goes through zero where it touches.
            fraction = inside / (inside - outside) if outside > _OUTSIDE else 0.5
            end += float(fraction * (values[at + way] - values[at]))
        found.append(end)
    return found[0], found[1]


# ---- One shot, as it was to be expected: for what then happened to be seen beside it.

MAX_HEIGHT_M = 50.0  # of a shot that is simulated


@dataclass(frozen=True, eq=False)
class ExpectedShot:
    """Shot with the likeliest restitution, and with both ends of its 95 %."""

    paths_m: Array  # of the centres: likeliest, least, greatest; shape (T, 3, 3), last x, y, z
    # Forward of the hoop's centre where each comes down, as without a rim, shape (3,); NaN if it
    # never does
    offset_m: Array
    is_through: bool  # the likeliest one, with the rim in its way


def expected_shot(rig: ShotRig, ball: KnownBall, height_m: float) -> ExpectedShot:
    """Simulate a shot from a height above the touch point, at most `MAX_HEIGHT_M`."""
    if ball.drag_1_m is not None:
        rig = rig.with_drag(ball.drag_1_m)
    tilt = math.radians(rig.plane.incline_deg)
    speed_m_s = math.sqrt(2 * rig.gravity_m_s2 * height_m) * math.cos(tilt)
    shifts = TWO_SIDED * ball.sd_at(speed_m_s) * np.array([0.0, -1.0, 1.0])
    heights_m = np.full(3, height_m)
    start = released(rig, heights_m)
    flown = fly(rig, ball.law, start, shifts, has_rim=True, step_s=COARSE_S, keep=True)
    free = passes(rig, ball.law, heights_m, shifts)
    return ExpectedShot(flown.positions_m, free.offset_m[:, 0], bool(flown.is_through[0]))


# ---- Plan: simulate a range of release heights, and choose the most tolerant.

SHOTS = 100  # heights that are tried: the paper's number


@dataclass(frozen=True)
class BestShot:
    """Shot with the largest margin."""

    index: int  # of its height among those that were tried
    height_m: float  # release height of the ball above its contact with the plane
    miss_m: float  # from the hoop's centre to where the ball passes its plane
    clearance_m: float  # least distance between ball and rim
    impact_m_s: float  # speed along the plane's normal
    restitution: float  # at that speed
    restitution_sd: float  # its standard deviation
    restitutions: Range  # least and greatest with which the ball passes without touching the rim
    heights_m: Range  # least and greatest height from which it does
    drags_1_m: Range | None  # least and greatest drag; None if the user states it
    margin: float  # to the nearest of these ends, in standard deviations


@dataclass(frozen=True, eq=False)
class Plan:
    """Heights that were tried, and the best."""

    rig: ShotRig  # plane, hoop and reach; its ball has the tuned drag, if any
    ball: KnownBall  # with its uncertainty
    heights_m: Array  # that were tried, ascending, shape (N,)
    # Where each passes the hoop's plane, forward and left of its centre, (N, 2); NaN if nowhere
    offset_m: Array
    clearance_m: Array  # see `signed_gap_m`, shape (N,)
    flights: Flights  # with the rim in the way, and the paths
    best: BestShot | None  # None if no height passes
    seconds: float  # wall time of planning

    @property
    def miss_m(self) -> Array:
        """Distance from the hoop's centre, shape (N,) [m]; NaN if it never comes down there."""
        return np.hypot(*self.offset_m.T)

    @property
    def nearest(self) -> int:
        """Index of the height that passes nearest to the centre."""
        return int(np.argmin(np.nan_to_num(self.miss_m, nan=np.inf)))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the user before the robot shoots."""
        found = list(self.ball.remarks)
        reach, best = self.rig.release, self.best
        if best is None and np.isnan(self.miss_m).all():
            found.append(
                f"no height from {reach.lowest_m:g} to {reach.highest_m:g} m scores: from none "
                "does the ball bounce and come down through the hoop's height (hoop.up_m "
                f"{self.rig.hoop.up_m:g}): lower the hoop, or reach farther"
            )
        elif best is None:
            found.append(
                f"no height from {reach.lowest_m:g} to {reach.highest_m:g} m scores; the nearest "
                f"misses the centre by {1000 * self.miss_m[self.nearest]:.0f} mm, from "
                f"{self.heights_m[self.nearest]:.3f} m: move the hoop, or reach farther"
            )
        elif best.margin < 2:
            drag, sd = self.ball.drag_1_m, self.ball.drag_sd_1_m
            also = f" and a drag of {drag:.3g} ± {sd:.2g} /m" if drag is not None and sd else ""
            found.append(
                f"restitution {best.restitution:.3f} ± {best.restitution_sd:.3f} and a height kept "
                f"to {1000 * reach.height_sd_m:.1f} mm{also} leave {best.margin:.1f} "
                "standard deviations to the rim: drop the ball again for a surer restitution, or "
                "widen the hoop"
            )
        return tuple(found)


def plan_shot(rig: ShotRig, ball: KnownBall, shots: int = SHOTS) -> Plan:
    """Simulate `shots` heights, 2 or more, evenly over the reach, and choose the best.

    A drag that is known of the ball replaces that of the rig's ball.
    """
    start = time.perf_counter()
    if ball.drag_1_m is not None:
        rig = rig.with_drag(ball.drag_1_m)
    heights = np.linspace(rig.release.lowest_m, rig.release.highest_m, shots)
    tried = passes(rig, ball.law, heights, np.zeros(shots))
    best = _best(rig, ball, heights, tried)
    return Plan(
        rig=rig,
        ball=ball,
        heights_m=heights,
        offset_m=tried.offset_m,
        clearance_m=signed_gap_m(tried),
        flights=shoot(rig, ball.law, heights),
        best=best,
        seconds=time.perf_counter() - start,
    )


def _best(rig: ShotRig, ball: KnownBall, heights: Array, tried: Flights) -> BestShot | None:
    """Choose the passing height with the largest margin; None if none passes."""
    gaps = signed_gap_m(tried)
    candidates = np.flatnonzero(gaps > 0)
    if not len(candidates):
        return None
    misses = np.hypot(*tried.offset_m.T)
    if len(candidates) > 40:  # the margin of each costs many rollouts
        candidates = candidates[np.argsort(misses[candidates])[:40]]
    values = ball.law.at(tried.impact_m_s[candidates])
    drags: list[Range | None] = [None] * len(candidates)
    if ball.drag_sd_1_m:
        drags = [*drag_ends(rig, ball, heights[candidates])]
    judged = []
    for index, restitution, shifts, ends, drag in zip(
        candidates.tolist(),
        values.tolist(),
        restitution_ends(rig, ball, heights[candidates], values),
        height_ends(rig, ball, heights, gaps, candidates),
        drags,
        strict=True,
    ):
        height, speed = float(heights[index]), float(tried.impact_m_s[index])
        sd = ball.sd_at(speed)
        room_m = min(height - ends[0], ends[1] - height)
        # No robot lets go more precisely than a tenth of a millimetre, though a rig may say 0.
        margins = [min(-shifts[0], shifts[1]) / sd, room_m / max(rig.release.height_sd_m, 1e-4)]
        if drag is not None and ball.drag_1_m is not None:  # no ball has less drag than none
            below_1_m = ball.drag_1_m - drag[0] if drag[0] > 0 else math.inf
            room_1_m = min(below_1_m, drag[1] - ball.drag_1_m)
            margins.append(room_1_m / max(ball.drag_sd_1_m, 1e-5))
        judged.append(
            BestShot(
                index=index,
                height_m=height,
                miss_m=float(misses[index]),
                clearance_m=float(gaps[index]),
                impact_m_s=speed,
                restitution=restitution,
                restitution_sd=sd,
                restitutions=(max(restitution + shifts[0], 0.0), min(restitution + shifts[1], 1.0)),
                heights_m=ends,
                drags_1_m=drag,
                margin=float(min(margins)),
            )
        )
    # Of shots with a margin over 30 standard deviations, the best passes nearest to the centre.
    return max(judged, key=lambda shot: (min(shot.margin, 30.0), -shot.miss_m))


# ---- Replay: the chosen shot in a physics engine that solves its impacts.


@dataclass(frozen=True)
class Replay:
    """The engine's rollout of the shot."""

    engine: str  # with its version
    is_through: bool  # whether the ball fell through the hoop
    miss_m: float  # from the hoop's centre to where it passed; NaN if it never came down there

    @property
    def words(self) -> str:
        """Description in one line."""
        if np.isnan(self.miss_m):
            return f"in {self.engine} it never comes down through the hoop's height"
        passed = "through the hoop" if self.is_through else "beside the hoop"
        return f"in {self.engine} it falls {passed}, {1000 * self.miss_m:.1f} mm from the centre"


def replayed(plan: Plan) -> Replay | None:
    """Roll out the best shot in the chosen engine; None if no height scores."""
    if plan.best is None:
        return None
    flight = shoot_in_engine(plan.rig, plan.ball.law, plan.best.height_m, COARSE_S)
    miss_m = float(np.hypot(*flight.offset_m[0]))
    return Replay(engine().name, bool(flight.is_through[0]), miss_m)


# ---- Report: a plan as a table, in words and as JSON.

_SLOPE_SOURCES: Mapping[SlopeSource, str] = {
    "tuned": "tuned",
    "bounces": "fitted to the tuning's bounces",
    "told": "as told",
    "assumed": "not known, taken as none",
}


def plan_json(plan: Plan, replay: Replay | None) -> str:
    """Format the plan as one JSON object; its keys are a contract, new ones may be added."""
    best, law, known = plan.best, plan.ball.law, plan.ball
    shots = [
        {
            "height": height,
            "miss": None if math.isnan(miss) else miss,
            "clearance": clearance if clearance > -1 else None,
            "passes": clearance > 0,
            "scores": through,
            "touches_rim": touched,
        }
        for height, miss, clearance, through, touched in zip(
            plan.heights_m.tolist(),
            plan.miss_m.tolist(),
            plan.clearance_m.tolist(),
            plan.flights.is_through.tolist(),
            plan.flights.has_touched.tolist(),
            strict=True,
        )
    ]
    content: dict[str, Any] = {
        "made": mark("plan", known.logs),
        "task": "bounce-shot",
        "unit": "m",
        "ball": {
            "restitution": law.restitution,
            "slope": law.slope,
            "at_speed": law.at_m_s,
            "bounces": known.bounces,
            "slope_sd": known.slope_sd,
            "slope_from": known.slope_source,
            "drag": plan.rig.ball.air_drag_1_m,
            "drag_sd": known.drag_sd_1_m,
            "drag_from": drag_source(known),
        },
        "best": best
        and {
            "height": best.height_m,
            "miss": best.miss_m,
            "clearance": best.clearance_m,
            "impact_speed": best.impact_m_s,
            "restitution": best.restitution,
            "restitution_sd": best.restitution_sd,
            "tolerance": {
                "restitution": best.restitutions,
                "height": best.heights_m,
                "drag": best.drags_1_m,
            },
            "margin_sd": best.margin,
        },
        "replay": replay
        and {
            "engine": replay.engine,
            "through": replay.is_through,
            "miss": None if math.isnan(replay.miss_m) else replay.miss_m,
        },
        "warnings": list(plan.warnings),
        "shots": shots,
        "rig": asdict(plan.rig),
        "seconds": {"plan": round(plan.seconds, 4)},
    }
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def plan_table(plan: Plan, replay: Replay | None) -> str:
    """Format the heights that pass and every tenth of the others, then the best in words."""
    lines = [f"{'height':>10}  {'miss':>8}  {'to the rim':>10}  outcome"]
    for index, height in enumerate(plan.heights_m.tolist()):
        passes, miss_m = plan.clearance_m[index] > 0, float(plan.miss_m[index])
        # One in ten of those that do not score, so that all fill a screen.
        if passes or index % 10 == 0 or index == len(plan.heights_m) - 1:
            room = f"{1000 * plan.clearance_m[index]:.1f} mm" if passes else "-"
            miss = "-" if math.isnan(miss_m) else f"{1000 * miss_m:.0f} mm"
            said = "passes" if passes else "misses"
            if not passes and plan.flights.has_touched[index]:
                said = "off the rim, in" if plan.flights.is_through[index] else "off the rim"
            mark = "  <- best" if plan.best is not None and index == plan.best.index else ""
            lines.append(f"{height:8.4f} m  {miss:>8}  {room:>10}  {said}{mark}")
    again = [replay.words] if replay else []
    return "\n".join([*lines, "", *best_lines(plan), *again, *ball_lines(plan)])


def best_lines(plan: Plan) -> list[str]:
    """Describe the best shot, with its tolerances in restitution, height and drag."""
    best = plan.best
    if best is None:
        return ["no height scores"]
    drags = ""
    if best.drags_1_m is not None:
        drags = f", or a drag from {best.drags_1_m[0]:.3f} to {best.drags_1_m[1]:.3f} /m"
    below, above = (1000 * abs(end - best.height_m) for end in best.heights_m)
    return [
        f"best: let go {best.height_m:.4f} m above the touch; passes {1000 * best.miss_m:.1f} mm "
        f"from the centre, {1000 * best.clearance_m:.1f} mm from the rim",
        f"restitution {best.restitution:.4f} ± {best.restitution_sd:.4f} at its impact of "
        f"{best.impact_m_s:.2f} m/s along the plane's normal",
        f"still passes with a restitution from {best.restitutions[0]:.4f} to "
        f"{best.restitutions[1]:.4f}, or {below:.0f} mm lower to {above:.0f} mm higher{drags}",
    ]


def ball_lines(plan: Plan) -> list[str]:
    """Describe the ball's slope and drag, with their sources."""
    ball, law, own = plan.ball, plan.ball.law, plan.rig.ball
    slope_sd = f" ± {ball.slope_sd:.3f}" if ball.slope_sd else ""
    drag_sd = f" ± {ball.drag_sd_1_m:.4f}" if ball.drag_sd_1_m else ""
    is_flat = ball.slope_source in ("assumed", "told") and not law.slope
    at = "" if is_flat else f" of {law.restitution:.4f} at {law.at_m_s:.2f} m/s"
    source = drag_source(ball)
    if source == "rig":
        source = "no air" if own.mass_kg is None else f"the rig's ball: {own.body.words}"
        source = source if own.drag_1_m is None else "the rig's"
    return [
        f"slope {law.slope:.3f}{slope_sd}{at} ({_SLOPE_SOURCES[ball.slope_source]})",
        f"drag {own.air_drag_1_m:.4f}{drag_sd} /m ({source})",
    ]


def drag_source(ball: KnownBall) -> str:
    """Return where the drag comes from: the tuning, the user, the rig's ball."""
    if ball.drag_1_m is None:
        return "rig"
    return "told" if ball.slope_source == "told" else "tuned"
