"""Plan a bounce shot: simulate a range of release heights, and choose the most tolerant.

As in the paper, heights are sampled evenly over the robot's reach. Of those from which the ball
passes the rim without touching it, the best is not the one that passes nearest to the centre, but
the one with the largest margin in restitution, in height and in drag, each in standard deviations.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np

from analysis.planning.known_ball import KnownBall
from analysis.planning.tolerance import (
    Range,
    drag_ends,
    height_ends,
    restitution_ends,
    signed_gap_m,
)
from recorders.simulators.bounce_shot import passes, shoot
from recorders.simulators.shot.flight import Flights
from recorders.simulators.shot.rig import ShotRig
from tunenet_logs.arrays import Array

SHOTS = 100  # heights that are tried: the paper's number
# Standard deviations: of shots with a larger margin, the best passes nearest to the centre.
_ENOUGH_SDS = 30.0

# Heights whose margins are searched, those nearest to the centre: each costs many rollouts.
_MAX_JUDGED = 40

_MIN_DRAG_SD_1_M = 1e-5  # likewise of a drag
# No robot lets go more precisely; keeps the margin finite where the rig gives 0.
_MIN_HEIGHT_SD_M = 1e-4


@dataclass(frozen=True)
class BestShot:
    """Shot with the largest margin.

    Attributes:
        index: Of its height among those that were tried.
        height_m: Release height of the ball above its contact with the plane.
        miss_m: From the hoop's centre to where the ball passes its plane.
        clearance_m: Least distance between ball and rim.
        impact_m_s: Speed along the plane's normal.
        restitution: At that speed.
        restitution_sd: Its standard deviation.
        restitutions: Least and greatest with which the ball passes without touching the rim.
        heights_m: Least and greatest height from which it does.
        drags_1_m: Least and greatest drag with which it does; None if the user states it.
        margin: To the nearest of these ends, in standard deviations.
    """

    index: int
    height_m: float
    miss_m: float
    clearance_m: float
    impact_m_s: float
    restitution: float
    restitution_sd: float
    restitutions: Range
    heights_m: Range
    drags_1_m: Range | None
    margin: float


@dataclass(frozen=True, eq=False)
class Plan:
    """Heights that were tried, and the best.

    Attributes:
        rig: Plane, hoop and reach; its ball has the tuned drag, if any.
        ball: With its uncertainty.
        heights_m: That were tried, ascending, shape (N,).
        offset_m: Where each would pass the hoop's plane, forward and left of its centre, (N, 2);
            NaN for one that never comes down there.
        clearance_m: See `signed_gap_m`, shape (N,).
        flights: With the rim in the way, and the paths.
        best: None if no height passes.
        seconds: Wall time of planning.
    """

    rig: ShotRig
    ball: KnownBall
    heights_m: Array
    offset_m: Array
    clearance_m: Array
    flights: Flights
    best: BestShot | None
    seconds: float

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
            found.append(
                f"restitution {best.restitution:.3f} ± {best.restitution_sd:.3f} and a height kept "
                f"to {1000 * reach.height_sd_m:.1f} mm{self._drag_words} leave {best.margin:.1f} "
                "standard deviations to the rim: drop the ball again for a surer restitution, or "
                "widen the hoop"
            )
        return tuple(found)

    @property
    def _drag_words(self) -> str:
        drag, sd = self.ball.drag_1_m, self.ball.drag_sd_1_m
        return f" and a drag of {drag:.3g} ± {sd:.2g} /m" if drag is not None and sd else ""


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
    if len(candidates) > _MAX_JUDGED:
        candidates = candidates[np.argsort(misses[candidates])[:_MAX_JUDGED]]
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
        margins = (
            min(-shifts[0], shifts[1]) / sd,
            room_m / max(rig.release.height_sd_m, _MIN_HEIGHT_SD_M),
            _drag_margin(ball, drag),
        )
        judged.append(
            BestShot(
                index=index,
                height_m=height,
                miss_m=float(misses[index]),
                clearance_m=float(gaps[index]),
                impact_m_s=speed,
                restitution=restitution,
                restitution_sd=sd,
                restitutions=(
                    max(restitution + shifts[0], 0.0),
                    min(restitution + shifts[1], 1.0),
                ),
                heights_m=ends,
                drags_1_m=drag,
                margin=float(min(margins)),
            )
        )
    return max(judged, key=lambda shot: (min(shot.margin, _ENOUGH_SDS), -shot.miss_m))


def _drag_margin(ball: KnownBall, drags_1_m: Range | None) -> float:
    """Return the margin to the nearer drag [sd]; no ball has less drag than none."""
    if drags_1_m is None or ball.drag_1_m is None:
        return math.inf
    low, high = drags_1_m
    room_1_m = min(ball.drag_1_m - low if low > 0 else math.inf, high - ball.drag_1_m)
    return room_1_m / max(ball.drag_sd_1_m, _MIN_DRAG_SD_1_M)
