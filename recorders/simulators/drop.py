"""A ball dropped on a plane in a physics engine, with a coefficient of restitution."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from recorders.simulators.base import BallWorld, Parameter, engine
from recorders.simulators.contact import CALIBRATED, ContactSettings
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.errors import UsageError

TOPIC = "/ball/pose"
RESTITUTION = Parameter(
    name="restitution", unit="1", bounds=(0.0, 1.0), training_range=(0.0, 1.0), initial=0.0
)

# From what a camera can see and an engine can simulate, to far more than anybody drops.
_LIMITS = {
    "gap_m": (0.01, 1000.0, "m"),
    "radius_m": (0.001, 10.0, "m"),
    "rate_hz": (1.0, 20_000.0, "Hz"),
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


class Flight:
    """A falling and bouncing ball that can be advanced by any time, exactly.

    The engine's step is v += -g dt, then z += v dt. Half a kick ahead (leapfrog integration), that
    is the parabola itself whatever dt; so the step need not be small, only cut where the ball meets
    the plane. There one very short step lets the engine solve the contact.
    """

    _IMPACT_S = 1e-6
    """Length of the step that solves a contact: gravity changes the speed in it by 1e-5 m/s."""

    _OVERLAP_M = 1e-9
    """How far the ball is let into the plane: the engine acts only on what touches."""

    def __init__(self, world: BallWorld, gap_m: float, restitution: float) -> None:
        world.place(gap_m, restitution)
        self._world = world
        self._gravity = world.contact.gravity_m_s2
        self._height_m = world.radius_m + gap_m
        self._speed_m_s = 0.0
        self._at_rest = False

    def advance(self, seconds: float) -> float:
        """Advance by `seconds`; the centre's height then [m]."""
        world, gravity = self._world, self._gravity
        while seconds > self._IMPACT_S:
            impact_s = math.inf
            if not self._at_rest:
                gap_m = max(self._height_m - world.radius_m + self._OVERLAP_M, 0.0)
                reach = math.sqrt(self._speed_m_s**2 + 2 * gravity * gap_m)
                impact_s = (self._speed_m_s + reach) / gravity
            if impact_s > seconds:
                self._fly(seconds)
                break
            if impact_s > self._IMPACT_S:
                self._fly(impact_s)
            world.set_speed(self._speed_m_s + gravity * self._IMPACT_S)
            self._height_m, self._speed_m_s = world.step(self._IMPACT_S)
            if abs(self._speed_m_s) < world.contact.resting_speed_m_s:
                self._speed_m_s, self._at_rest = 0.0, True
            seconds -= impact_s + self._IMPACT_S
        return self._height_m

    def _fly(self, seconds: float) -> None:
        kick = self._gravity * seconds
        if self._at_rest:
            self._world.set_speed(kick)  # the ground bears the weight
            self._height_m, _ = self._world.step(seconds)
            return
        self._world.set_speed(self._speed_m_s + kick / 2)
        self._height_m, speed_m_s = self._world.step(seconds)
        self._speed_m_s = speed_m_s - kick / 2


class DropSimulator:
    """The drop of the paper's second experiment (mass 1 kg, plane's restitution 1).

    With the calibrated settings sample 0 is the start; with the paper's, samples are taken after
    each step, as its authors do.

    Args:
        rig: what is dropped from where, and how it is sampled.
        contact: how impacts are solved.
        world: with that ball and these contacts; one of the default engine if None.
    """

    parameters = (RESTITUTION,)

    def __init__(
        self, rig: DropRig, contact: ContactSettings = CALIBRATED, world: BallWorld | None = None
    ) -> None:
        self.rig = rig
        self.contact = contact
        self._world = world or engine().ball_world(rig.radius_m, contact)
        self.engine = self._world.engine
        self.step_hz = rig.rate_hz

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
        rig, world = self.rig, self._world
        period_s = 1.0 / rig.rate_hz
        heights_m = np.full(rig.samples, rig.radius_m + rig.gap_m)
        if self.contact.meet_impacts:
            flight = Flight(world, rig.gap_m, restitution)
            for index in range(1, rig.samples):
                falling_s = index * period_s - rig.hold_s
                if falling_s > 0:
                    heights_m[index] = flight.advance(min(period_s, falling_s))
        else:
            world.place(rig.gap_m, restitution)
            held = min(round(rig.hold_s * rig.rate_hz), rig.samples)
            heights_m[held:] = world.steps(period_s, rig.samples - held)
        ticks = np.arange(len(heights_m)) + (0 if self.contact.meet_impacts else 1)
        stamps_ns = self.rig.start_ns + np.round(ticks * (1e9 / self.rig.rate_hz)).astype(np.int64)
        positions = np.column_stack([np.zeros((len(heights_m), 2)), heights_m])
        info = EpisodeInfo(
            kind="drop",
            source=self.engine,
            preset=self.contact.name,
            rig={
                "ball_diameter_m": 2 * self.rig.radius_m,
                "drop_height_m": self.rig.gap_m,
            },
            truth={RESTITUTION.name: restitution},
        )
        return Episode(info, {TOPIC: Signal(TOPIC, stamps_ns, positions, ("x", "y", "z"), "m")})
