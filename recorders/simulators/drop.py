"""A ball dropped on a plane in PyBullet, with a coefficient of restitution."""

from __future__ import annotations

import math
import weakref
from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from recorders.simulators.base import Parameter
from recorders.simulators.contact import CALIBRATED, ContactSettings
from recorders.simulators.engine import engine_name, pybullet
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.errors import UsageError

TOPIC = "/ball/pose"
RESTITUTION = Parameter(
    name="restitution", unit="1", bounds=(0.0, 1.0), training_range=(0.0, 1.0), initial=0.0
)

_LIMITS = {
    "gap_m": (0.01, 1000.0, "m"),
    "radius_m": (0.001, 10.0, "m"),
    "rate_hz": (10.0, 10_000.0, "Hz"),
    "samples": (2, 1_000_000, ""),
    "hold_s": (0.0, 600.0, "s"),
}


@dataclass(frozen=True)
class DropRig:
    """What is set up before the ball is let go.

    Attributes:
        gap_m: height of the ball's underside over the plane: the distance it falls.
        radius_m: of the ball.
        rate_hz: samples a second; the engine steps once a sample, and once more at each impact.
        samples: how many.
        hold_s: how long the ball is held before it is let go.
        start_ns: stamp of the first sample.

    Raises:
        UsageError: a value that is not finite or out of range.
    """

    gap_m: float = 1.0
    radius_m: float = 0.05
    rate_hz: float = 60.0
    samples: int = 400
    hold_s: float = 0.0
    start_ns: int = 0

    def __post_init__(self) -> None:
        for item in fields(self):
            if item.name in _LIMITS:
                low, high, unit = _LIMITS[item.name]
                value = getattr(self, item.name)
                if not (math.isfinite(value) and low <= value <= high):
                    raise UsageError(
                        f"{item.name} {value:g} is not from {low:g} to {high:g} {unit}".rstrip()
                    )


class DropSimulator:
    """The drop of the paper's second experiment (mass 1 kg, plane's restitution 1).

    With the calibrated settings sample 0 is the start; with the paper's, samples are taken after
    each step, as its authors do.
    """

    parameters = (RESTITUTION,)

    def __init__(
        self, rig: DropRig, contact: ContactSettings = CALIBRATED, world: _World | None = None
    ) -> None:
        self.rig = rig
        self.contact = contact
        self._world = world or _World(rig.radius_m, contact)

    def with_rig(self, rig: DropRig) -> DropSimulator:
        """The same ball on another rig, without building the world again.

        Raises:
            UsageError: the ball's radius differs.
        """
        if rig.radius_m != self.rig.radius_m:
            raise UsageError(f"a ball of {self.rig.radius_m:g} m radius cannot change its size")
        return DropSimulator(rig, self.contact, self._world)

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """Drop the ball with `values["restitution"]`; see `Simulator.rollout`."""
        if set(values) != {RESTITUTION.name}:
            raise UsageError(f"a drop takes the value restitution, not {sorted(values)}")
        restitution = RESTITUTION.checked(values[RESTITUTION.name])
        heights_m = self._world.drop(restitution, self.rig)
        ticks = np.arange(len(heights_m)) + (0 if self.contact.meet_impacts else 1)
        stamps_ns = self.rig.start_ns + np.round(ticks * (1e9 / self.rig.rate_hz)).astype(np.int64)
        positions = np.column_stack([np.zeros((len(heights_m), 2)), heights_m])
        info = EpisodeInfo(
            kind="drop",
            source=engine_name(),
            preset=self.contact.name,
            rig={
                "ball_diameter_m": 2 * self.rig.radius_m,
                "drop_height_m": self.rig.gap_m,
            },
            truth={RESTITUTION.name: restitution},
        )
        return Episode(info, {TOPIC: Signal(TOPIC, stamps_ns, positions, ("x", "y", "z"), "m")})


class _World:
    """One physics client with a plane and a ball; used again for every rollout."""

    def __init__(self, radius_m: float, contact: ContactSettings) -> None:
        self._engine = engine = pybullet()
        self._contact = contact
        self._surface_m = radius_m
        self._client = client = engine.connect(engine.DIRECT)
        weakref.finalize(self, engine.disconnect, client)
        engine.setGravity(0, 0, -contact.gravity_m_s2, physicsClientId=client)
        if contact.engine:
            engine.setPhysicsEngineParameter(**dict(contact.engine), physicsClientId=client)
        plane = engine.createCollisionShape(engine.GEOM_PLANE, physicsClientId=client)
        sphere = engine.createCollisionShape(
            engine.GEOM_SPHERE, radius=radius_m, physicsClientId=client
        )
        self._plane = engine.createMultiBody(0, plane, physicsClientId=client)
        self._ball = engine.createMultiBody(1.0, sphere, physicsClientId=client)
        # Bullet multiplies the two restitutions, and a plane's is 0 by default.
        self._set_body(self._plane, restitution=1.0)

    def drop(self, restitution: float, rig: DropRig) -> NDArray[np.float64]:
        """Heights of the ball's centre [m], shape (rig.samples,)."""
        self._set_body(self._ball, restitution=restitution)
        self._place(self._surface_m + rig.gap_m)
        period_s = 1.0 / rig.rate_hz
        if self._contact.meet_impacts:
            return self._exact_flights(rig, period_s)
        return self._fixed_steps(rig, period_s)

    def _fixed_steps(self, rig: DropRig, period_s: float) -> NDArray[np.float64]:
        heights_m = np.full(rig.samples, self._surface_m + rig.gap_m)
        for index in range(round(rig.hold_s * rig.rate_hz), rig.samples):
            heights_m[index] = self._step(period_s)[0]
        return heights_m

    def _exact_flights(self, rig: DropRig, period_s: float) -> NDArray[np.float64]:
        """Steps of one period, cut where the ball meets the plane.

        The engine's step is v += -g dt, z += v dt. Held half a kick ahead (leapfrog), that is the
        parabola itself, whatever the step; so the step need not be small, only cut at impacts.
        """
        flight = _Flight(self, rig.gap_m)
        heights_m = np.full(rig.samples, self._surface_m + rig.gap_m)
        for index in range(1, rig.samples):
            falling_s = index * period_s - rig.hold_s
            if falling_s > 0:
                heights_m[index] = flight.advance(min(period_s, falling_s))
        return heights_m

    def _place(self, height_m: float) -> None:
        self._engine.resetBasePositionAndOrientation(
            self._ball, [0, 0, height_m], [0, 0, 0, 1], physicsClientId=self._client
        )
        self._set_speed(0.0)

    def _set_speed(self, speed_m_s: float) -> None:
        self._engine.resetBaseVelocity(
            self._ball, [0, 0, speed_m_s], [0, 0, 0], physicsClientId=self._client
        )

    def _step(self, period_s: float) -> tuple[float, float]:
        """Step once; the centre's height [m] and the ball's speed upward [m/s]."""
        self._engine.setTimeStep(period_s, physicsClientId=self._client)
        self._engine.stepSimulation(physicsClientId=self._client)
        place, _ = self._engine.getBasePositionAndOrientation(
            self._ball, physicsClientId=self._client
        )
        velocity, _ = self._engine.getBaseVelocity(self._ball, physicsClientId=self._client)
        return place[2], velocity[2]

    def _set_body(self, body: int, restitution: float) -> None:
        self._engine.changeDynamics(
            body, -1, restitution=restitution, **dict(self._contact.body),
            physicsClientId=self._client,
        )


class _Flight:
    """The ball between and at its impacts, whatever step it is asked to advance by."""

    _IMPACT_S = 1e-6
    _OVERLAP_M = 1e-9  # the engine acts only on what touches

    def __init__(self, world: _World, gap_m: float) -> None:
        self._world = world
        self._surface_m = world._surface_m
        self._height_m = self._surface_m + gap_m
        self._speed_m_s = 0.0
        self._at_rest = False
        self._gravity = world._contact.gravity_m_s2

    def advance(self, seconds: float) -> float:
        """The centre's height [m] after so many seconds more."""
        while seconds > self._IMPACT_S:
            meeting_s = math.inf if self._at_rest else self._time_to_impact_s()
            if meeting_s > seconds:
                self._fly(seconds)
                break
            if meeting_s > self._IMPACT_S:
                self._fly(meeting_s)
            self._rebound()
            seconds -= meeting_s + self._IMPACT_S
        return self._height_m

    def _time_to_impact_s(self) -> float:
        gap_m = max(self._height_m - self._surface_m + self._OVERLAP_M, 0.0)
        reach = math.sqrt(self._speed_m_s**2 + 2 * self._gravity * gap_m)
        return (self._speed_m_s + reach) / self._gravity

    def _fly(self, seconds: float) -> None:
        kick = self._gravity * seconds
        if self._at_rest:
            self._world._set_speed(kick)  # the ground bears the weight
            self._height_m, _ = self._world._step(seconds)
            return
        self._world._set_speed(self._speed_m_s + kick / 2)
        self._height_m, speed_m_s = self._world._step(seconds)
        self._speed_m_s = speed_m_s - kick / 2

    def _rebound(self) -> None:
        self._world._set_speed(self._speed_m_s + self._gravity * self._IMPACT_S)
        self._height_m, self._speed_m_s = self._world._step(self._IMPACT_S)
        if abs(self._speed_m_s) < self._world._contact.resting_speed_m_s:
            self._speed_m_s, self._at_rest = 0.0, True
