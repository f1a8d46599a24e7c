"""The ball and the plane in the engine, and flight that is exact between impacts."""

from __future__ import annotations

import math
import weakref
from typing import Any

from recorders.simulators.contact import ContactSettings
from recorders.simulators.engine import pybullet


class BallWorld:
    """One physics client with a plane at z = 0 and a ball of 1 kg; used for many rollouts."""

    def __init__(self, radius_m: float, contact: ContactSettings) -> None:
        self.radius_m = radius_m
        self.contact = contact
        self._engine = engine = pybullet()
        self._client = client = engine.connect(engine.DIRECT)
        weakref.finalize(self, engine.disconnect, client)
        engine.setGravity(0, 0, -contact.gravity_m_s2, physicsClientId=client)
        if contact.engine:
            engine.setPhysicsEngineParameter(**dict(contact.engine), physicsClientId=client)
        plane = engine.createCollisionShape(engine.GEOM_PLANE, physicsClientId=client)
        sphere = engine.createCollisionShape(
            engine.GEOM_SPHERE, radius=radius_m, physicsClientId=client
        )
        # Bullet multiplies the two restitutions, and a plane's is 0 by default.
        self._change(engine.createMultiBody(0, plane, physicsClientId=client), restitution=1.0)
        self._ball = engine.createMultiBody(1.0, sphere, physicsClientId=client)
        self._fresh = engine.saveState(physicsClientId=client)

    def place(self, gap_m: float, restitution: float) -> None:
        """Put the ball at rest with its underside `gap_m` over the plane.

        All else is forgotten: contacts that the engine keeps from one rollout would change the
        next, and its breaking threshold is one global of the process, which another world may
        have set.
        """
        self._engine.restoreState(self._fresh, physicsClientId=self._client)
        self._engine.setPhysicsEngineParameter(
            contactBreakingThreshold=self.contact.breaking_threshold_m,
            physicsClientId=self._client,
        )
        self._change(self._ball, restitution=restitution)
        self._engine.resetBasePositionAndOrientation(
            self._ball, [0, 0, self.radius_m + gap_m], [0, 0, 0, 1], physicsClientId=self._client
        )
        self.set_speed(0.0)

    def set_speed(self, speed_m_s: float) -> None:
        """Give the ball this speed upward."""
        self._engine.resetBaseVelocity(
            self._ball, [0, 0, speed_m_s], [0, 0, 0], physicsClientId=self._client
        )

    def step(self, period_s: float) -> tuple[float, float]:
        """Step once; the centre's height [m] and the ball's speed upward [m/s]."""
        engine, client = self._engine, self._client
        engine.setTimeStep(period_s, physicsClientId=client)
        engine.stepSimulation(physicsClientId=client)
        position, _ = engine.getBasePositionAndOrientation(self._ball, physicsClientId=client)
        velocity, _ = engine.getBaseVelocity(self._ball, physicsClientId=client)
        return position[2], velocity[2]

    def steps(self, period_s: float, count: int) -> list[float]:
        """Step so many times; the centre's height after each [m]."""
        client, ball = self._client, self._ball
        step = self._engine.stepSimulation
        pose = self._engine.getBasePositionAndOrientation
        self._engine.setTimeStep(period_s, physicsClientId=client)
        heights_m: list[float] = []
        for _ in range(count):
            step(physicsClientId=client)
            position, _ = pose(ball, physicsClientId=client)
            heights_m.append(position[2])
        return heights_m

    def _change(self, body: int, **dynamics: Any) -> None:
        dynamics |= dict(self.contact.body)
        self._engine.changeDynamics(body, -1, **dynamics, physicsClientId=self._client)


class Flight:
    """A falling and bouncing ball that can be advanced by any time, exactly.

    The engine's step is v += -g dt, then z += v dt. Held half a kick ahead (leapfrog), that is the
    parabola itself whatever dt; so the step need not be small, only cut where the ball meets the
    plane. There one very short step lets the engine solve the contact.
    """

    _IMPACT_S = 1e-6
    _OVERLAP_M = 1e-9  # the engine acts only on what touches

    def __init__(self, world: BallWorld, gap_m: float, restitution: float) -> None:
        world.place(gap_m, restitution)
        self._world = world
        self._gravity = world.contact.gravity_m_s2
        self._height_m = world.radius_m + gap_m
        self._speed_m_s = 0.0
        self._at_rest = False

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
        gap_m = max(self._height_m - self._world.radius_m + self._OVERLAP_M, 0.0)
        reach = math.sqrt(self._speed_m_s**2 + 2 * self._gravity * gap_m)
        return (self._speed_m_s + reach) / self._gravity

    def _fly(self, seconds: float) -> None:
        kick = self._gravity * seconds
        if self._at_rest:
            self._world.set_speed(kick)  # the ground bears the weight
            self._height_m, _ = self._world.step(seconds)
            return
        self._world.set_speed(self._speed_m_s + kick / 2)
        self._height_m, speed_m_s = self._world.step(seconds)
        self._speed_m_s = speed_m_s - kick / 2

    def _rebound(self) -> None:
        self._world.set_speed(self._speed_m_s + self._gravity * self._IMPACT_S)
        self._height_m, self._speed_m_s = self._world.step(self._IMPACT_S)
        if abs(self._speed_m_s) < self._world.contact.resting_speed_m_s:
            self._speed_m_s, self._at_rest = 0.0, True
