"""Simulate a bounce shot for `tunenet-record --simulate bounce-shot`, the rest by the seed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from recorders.simulators.bounce_shot import BounceShot
from recorders.simulators.drop import RESTITUTION
from recorders.simulators.shot.rig import ShotRig
from tunenet_logs.episode import Episode

_DRAWN_RESTITUTION = (0.5, 0.85)  # of balls that bounce well: table tennis, squash, tennis, golf


@dataclass(frozen=True)
class ShotOrder:
    """A shot to simulate; None is drawn from the seed.

    Attributes:
        restitution: coefficient of restitution at 3 m/s along the plane's normal.
        slope: its exponent over speed; see `SpeedLaw`.
        drag_1_m: air drag on the ball; by the rig's ball if None.
        height_m: how far the ball falls; drawn from what the rig reaches.
    """

    rig: ShotRig = field(default_factory=ShotRig)
    restitution: float | None = None
    slope: float = 0.0
    drag_1_m: float | None = None
    height_m: float | None = None
    rate_hz: float = 240.0
    seed: int = 0


def simulate_shot(order: ShotOrder) -> Episode:
    """Simulate one shot; the same order gives the same bits.

    Raises:
        UsageError: a value is out of range.
    """
    rng = np.random.default_rng(order.seed)
    rig = order.rig if order.drag_1_m is None else order.rig.with_drag(order.drag_1_m)
    reach = rig.release
    restitution = float(rng.uniform(*_DRAWN_RESTITUTION))
    height_m = float(rng.uniform(reach.lowest_m, reach.highest_m))
    simulator = BounceShot(
        rig=rig,
        height_m=height_m if order.height_m is None else order.height_m,
        slope=order.slope,
        rate_hz=order.rate_hz,
    )
    wanted = restitution if order.restitution is None else order.restitution
    episode = simulator.rollout({RESTITUTION.name: wanted})
    notes = {"seed": str(order.seed), "slope": repr(order.slope)}
    return Episode(replace(episode.info, notes=notes), episode.signals)
