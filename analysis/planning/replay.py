"""Replay the chosen shot in a physics engine that solves its impacts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.planning.plan import Plan
from recorders.simulators.bounce_shot import shoot_in_engine
from recorders.simulators.engines import engine
from recorders.simulators.shot.flight import COARSE_S


@dataclass(frozen=True)
class Replay:
    """The engine's rollout of the shot.

    Attributes:
        engine: With its version.
        is_through: Whether the ball fell through the hoop.
        miss_m: From the hoop's centre to where it passed; NaN if it never came down there.
    """

    engine: str
    is_through: bool
    miss_m: float

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
