"""Simulate a drop on a table in the hidden world, and the mishaps of those that leave it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from analysis.evaluation.shots.ground_truth_shot import ACROSS_SD_M, HEIGHT_SD_M
from analysis.evaluation.shots.ground_truth_sim import (
    GRAVITY_M_S2,
    RADIUS_M,
    RATE_HZ,
    BallPath,
    HiddenBall,
    Vector,
    ground,
    run_ball,
    table,
)
from tunenet_logs.arrays import Array

DROP_M = 0.5  # how far the robot lets balls fall: about as fast as they will hit the plane
HELD_S, FILMED_S = 0.25, 2.6  # filmed before and after the release: the fall takes 0.32 s
# The ball hits the table's edge first; rolls off the table; or leaves the picture.
MISHAPS = ("edge", "rolls off", "out of view")

_FAR_M = 100.0  # to the edge of a table that no ball leaves
_FLOOR_M = -0.75  # below a table of common height
_EDGE_DEG = (10.0, 45.0)  # range of an edge's normal where the ball hits it, from the vertical
# Fraction of the first impact's speed at which a ball that will leave moves sideways.
_SIDEWAYS = (0.05, 0.25)

_AWAY_M_S = (0.25, 1.0)  # sideways speed of a ball that goes out of view
_ONE_CONTACT_S = 0.01  # hits that follow each other faster are one contact


@dataclass(frozen=True, eq=False)
class HiddenDrop:
    """Drop in the hidden world.

    Attributes:
        mishap: one of `MISHAPS`; None where it stays on the table and in view.
        path: the ball's, from its release on.
        leaves_s: when it goes out of view; None unless that is its mishap.
        heading_rad: which way it moves then, from the camera's line of sight.
    """

    ball: HiddenBall
    mishap: str | None
    path: BallPath
    leaves_s: float | None = None
    heading_rad: float = 0.0

    def centers_m(self, seconds: Array) -> Array:
        """Return the ball's centre at times after the release, (N, 3) [m], z over the table."""
        return self.path.at(seconds)

    @property
    def impact_m_s(self) -> float:
        """Speed of a fall from that height without air."""
        return math.sqrt(2 * GRAVITY_M_S2 * DROP_M)


def drop_of(ball: HiddenBall, mishap: str | None, rng: np.random.Generator) -> HiddenDrop:
    """Drop a ball on the table, with or without a mishap."""
    if mishap is None:
        return HiddenDrop(ball, None, _run(ball, _FAR_M, 0.0, rng))
    heading = float(rng.uniform(0.0, 2 * math.pi))
    if mishap == "edge":
        beyond_m = RADIUS_M * math.sin(math.radians(rng.uniform(*_EDGE_DEG)))
        return HiddenDrop(ball, mishap, _run(ball, -beyond_m, heading, rng))
    first_m_s = math.sqrt(2 * GRAVITY_M_S2 * DROP_M)
    if mishap == "rolls off":
        speed = float(rng.uniform(*_SIDEWAYS)) * first_m_s
        state = rng.bit_generator.state
        whole = _run(ball, _FAR_M, heading, rng, speed)
        impacts = impact_seconds(whole)
        leaves_s = rng.uniform(impacts[0], impacts[min(2, len(impacts) - 1)])
        x, y, _ = whole.at(np.array([leaves_s]))[0]
        edge_m = float(x * math.cos(heading) + y * math.sin(heading))
        again = np.random.default_rng()
        again.bit_generator.state = state
        return HiddenDrop(ball, mishap, _run(ball, edge_m, heading, again, speed))
    heading = math.pi / 2 * float(rng.choice([-1.0, 1.0])) + float(rng.uniform(-0.5, 0.5))
    path = _run(ball, _FAR_M, heading, rng, float(rng.uniform(*_AWAY_M_S)))
    impacts = impact_seconds(path)
    leaves_s = float(rng.uniform(impacts[0] / 2, impacts[1]))
    return HiddenDrop(ball, mishap, path, leaves_s, heading)


def impact_seconds(run: BallPath) -> Array:
    """Return when the ball hit something [s], shape (N,); hits of one contact count once."""
    samples = np.array([sample for _, sample in run.hits])
    first = np.diff(samples, prepend=-100) > _ONE_CONTACT_S * RATE_HZ
    return samples[first] / RATE_HZ


def _run(
    ball: HiddenBall,
    edge_m: float,
    heading_rad: float,
    rng: np.random.Generator,
    sideways_m_s: float = 0.0,
) -> BallPath:
    off = rng.normal(0.0, 1.0, 3) * (ACROSS_SD_M, ACROSS_SD_M, HEIGHT_SD_M)
    start: Vector = (float(off[0]), float(off[1]), RADIUS_M + DROP_M + float(off[2]))
    speed = (
        sideways_m_s * math.cos(heading_rad),
        sideways_m_s * math.sin(heading_rad),
        0.0,
    )
    things = (table(edge_m, heading_rad), ground(_FLOOR_M))
    return run_ball(ball, start, things, FILMED_S, rng, speed)
