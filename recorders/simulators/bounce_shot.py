"""Simulate the bounce shot of the paper's third experiment: off an incline, through a hoop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from recorders.simulators.base import Parameter
from recorders.simulators.contact import CALIBRATED
from recorders.simulators.drop import RESTITUTION, TOPIC
from recorders.simulators.engines import engine
from recorders.simulators.shot.contact import BallStates
from recorders.simulators.shot.engine_impact import solved_by
from recorders.simulators.shot.flight import COARSE_S, STEP_S, Flights, fly
from recorders.simulators.shot.rig import ShotRig
from recorders.simulators.speed_law import SpeedLaw
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.errors import UsageError

KIND = "bounce-shot"


def shoot(rig: ShotRig, law: SpeedLaw, heights_m: Array) -> Flights:
    """Simulate shots from these heights, shape (N,), with their paths and the rim in their way."""
    return fly(
        rig, law, released(rig, heights_m), np.zeros(len(heights_m)), has_rim=True, keep=True
    )


def passes(
    rig: ShotRig,
    law: SpeedLaw,
    heights_m: Array,
    shifts: Array,
    drags_1_m: Array | None = None,
) -> Flights:
    """Simulate shots as if the rim were not there: where they pass it, and how near.

    Args:
        rig: plane, hoop and ball.
        law: of the ball.
        heights_m: shape (N,).
        shifts: added to the restitution of each shot, shape (N,).
        drags_1_m: of each shot's ball, shape (N,); the rig's ball's if None.
    """
    start = released(rig, heights_m)
    return fly(rig, law, start, shifts, has_rim=False, drags_1_m=drags_1_m, step_s=COARSE_S)


def shoot_in_engine(rig: ShotRig, law: SpeedLaw, height_m: float, step_s: float) -> Flights:
    """Simulate one shot with the rim, each impact solved by the chosen engine.

    Args:
        rig: plane, hoop and ball.
        law: of the ball.
        height_m: how far the ball falls.
        step_s: between the positions of its path.
    """
    return fly(
        rig,
        law,
        released(rig, np.array([height_m])),
        np.zeros(1),
        has_rim=True,
        step_s=step_s,
        keep=True,
        impacts=solved_by(engine().ball_world(rig.ball.radius_m, CALIBRATED)),
    )


def released(rig: ShotRig, heights_m: Array) -> BallStates:
    """Place balls at rest straight above the touch point."""
    up = np.column_stack([np.zeros((len(heights_m), 2)), heights_m])
    return BallStates(rig.touch_m + up, np.zeros_like(up), np.zeros_like(up))


@dataclass(frozen=True)
class BounceShot:
    """One shot; see `Simulator`.

    Attributes:
        height_m: how far the ball falls.
        slope: exponent of the restitution over speed; see `SpeedLaw`.
        at_m_s: the impact's speed at which it has the restitution that is set.

    Raises:
        UsageError: a value is not finite or out of range.
    """

    rig: ShotRig
    height_m: float
    slope: float = 0.0
    at_m_s: float = 3.0
    rate_hz: float = 240.0

    parameters: tuple[Parameter, ...] = (RESTITUTION,)

    def __post_init__(self) -> None:
        if not 0.005 <= self.height_m <= 50:
            raise UsageError(f"height_m {self.height_m:g} is not from 0.005 to 50 m")
        if not 1 <= self.rate_hz <= 20_000:
            raise UsageError(f"rate_hz {self.rate_hz:g} is not from 1 to 20000 Hz")

    @property
    def engine(self) -> str:
        """Engine that solves the impacts; the flights between are not the engine's."""
        return engine().name

    @property
    def step_hz(self) -> float:
        """Smallest multiple of `rate_hz` whose steps are `STEP_S` or shorter [Hz]."""
        return self.rate_hz * int(np.ceil(1 / (self.rate_hz * STEP_S)))

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """Simulate until the ball is below the hoop, with `values["restitution"]`."""
        if set(values) != {RESTITUTION.name}:
            raise UsageError(f"a shot takes the value restitution, not {sorted(values)}")
        law = SpeedLaw(RESTITUTION.checked(values[RESTITUTION.name]), self.slope, self.at_m_s)
        flights = shoot_in_engine(self.rig, law, self.height_m, 1 / self.step_hz)
        positions_m = flights.positions_m[:: round(self.step_hz / self.rate_hz), 0]
        stamps_ns = np.round(np.arange(len(positions_m)) * (1e9 / self.rate_hz)).astype(np.int64)
        info = EpisodeInfo(
            kind=KIND,
            source=f"{self.engine}, bounce shot",
            rig={
                "ball_diameter_m": 2 * self.rig.ball.radius_m,
                "shot_height_m": self.height_m,
                "hoop_forward_m": self.rig.hoop.forward_m,
                "hoop_up_m": self.rig.hoop.up_m,
                "hoop_free_radius_m": self.rig.hoop.free_radius_m,
                "plane_incline_deg": self.rig.plane.incline_deg,
            },
            truth={
                RESTITUTION.name: law.restitution,
                "restitution_slope": law.slope,
                "drag": self.rig.ball.air_drag_1_m,
                "success": float(flights.is_through[0]),
                "miss_distance_m": float(np.nan_to_num(np.hypot(*flights.offset_m[0]), nan=-1.0)),
            },
        )
        return Episode(info, {TOPIC: Signal(TOPIC, stamps_ns, positions_m, ("x", "y", "z"), "m")})
