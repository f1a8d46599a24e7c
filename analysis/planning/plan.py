"""From a ball to the shot: heights tried in the simulator, and the one that forgives most.

As the paper does, heights are sampled evenly over what the robot reaches. Of those from which the
ball passes the rim without touching it, the best is not simply the one that passes nearest to the
centre: it is the one that may be farthest off, in restitution, in height and in the air's drag,
each in units of how well it is known.
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

SHOTS = 100
"""Heights that are tried: the paper's number."""

_ENOUGH_SDS = 30.0
"""Standard deviations: of shots with a larger margin, the best passes nearest to the centre."""

_MOST_JUDGED = 40
"""Heights whose margins are searched, those nearest to the centre: each costs many rollouts."""

_LEAST_DRAG_SD_1_M = 1e-5
"""Likewise of a drag."""

_LEAST_HEIGHT_SD_M = 1e-4
"""No robot lets go more precisely; keeps the margin finite where the rig gives 0."""


@dataclass(frozen=True)
class BestShot:
    """The shot to take.

    Attributes:
        index: of its height among those that were tried.
        height_m: from which the ball is let go, above its touching the plane.
        miss_m: from the hoop's centre to where the ball passes its plane.
        clearance_m: between ball and rim at the nearest.
        impact_m_s: speed along the plane's normal.
        restitution: at that speed.
        restitution_sd: its standard deviation.
        restitutions: least and greatest with which the ball passes without touching the rim.
        heights_m: least and greatest height from which it does.
        drags_1_m: least and greatest drag with which it does; None where it is taken as told.
        margin: to the nearest of these ends, in standard deviations.
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
    """The heights that were tried, and the best.

    Attributes:
        rig: plane, hoop and reach; its ball has the drag that was tuned, where one was.
        ball: as it is known.
        heights_m: that were tried, ascending, shape (N,).
        offset_m: where each would pass the hoop's plane, forward and left of its centre; NaN for
            one that never comes down there; (N, 2).
        clearance_m: see `signed_gap_m`, shape (N,).
        flights: with the rim in the way, and the paths.
        best: None where no height passes.
        seconds: of wall time that planning took.
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
        """From the hoop's centre, shape (N,) [m]; NaN for a ball that never comes down there."""
        return np.hypot(*self.offset_m.T)

    @property
    def nearest(self) -> int:
        """The index of the height that passes nearest to the centre."""
        return int(np.argmin(np.nan_to_num(self.miss_m, nan=np.inf)))

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know before the robot shoots."""
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
    """Try `shots` heights, 2 or more, evenly over the reach, and choose the best.

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
    """Of the passing heights the one with the largest margin; None where none passes.

    Args:
        rig: plane, hoop and reach.
        ball: as it is known.
        heights: that were tried, shape (N,) [m].
        tried: their flights with nothing in the way.
    """
    gaps = signed_gap_m(tried)
    candidates = np.flatnonzero(gaps > 0)
    if not len(candidates):
        return None
    misses = np.hypot(*tried.offset_m.T)
    if len(candidates) > _MOST_JUDGED:
        candidates = candidates[np.argsort(misses[candidates])[:_MOST_JUDGED]]
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
            room_m / max(rig.release.height_sd_m, _LEAST_HEIGHT_SD_M),
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
    """To the nearer end, in standard deviations; no ball has less drag than none."""
    if drags_1_m is None or ball.drag_1_m is None:
        return math.inf
    low, high = drags_1_m
    room_1_m = min(ball.drag_1_m - low if low > 0 else math.inf, high - ball.drag_1_m)
    return room_1_m / max(ball.drag_sd_1_m, _LEAST_DRAG_SD_1_M)
