"""Simulate a drop on a plane in a physics engine: speed-dependent restitution and air drag."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from recorders.simulators.base import BallWorld, Parameter
from recorders.simulators.closed_form.flight import flown, flown_heights_m, lands_after_s
from recorders.simulators.contact import CALIBRATED, IMPACT_S, OVERLAP_M, ContactSettings
from recorders.simulators.engines import ball_world
from recorders.simulators.speed_law import SpeedLaw
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.errors import UsageError

TOPIC = "/ball/pose"
# At the speed of the first impact, e.
RESTITUTION = Parameter(
    name="restitution", unit="1", bounds=(0.0, 1.0), training_range=(0.0, 1.0), initial=0.0
)

# p of e (v / v_first)^-p: how the restitution falls with the impact's speed; see `SpeedLaw`.
SLOPE = Parameter(
    name="restitution_slope", unit="1", bounds=(-0.5, 0.5), training_range=(0.0, 0.15), initial=0.0
)

# k of dv/dt = -g - k v |v|: rho Cd A / (2 m) of the air, the ball's area and its mass.
DRAG = Parameter(name="drag", unit="1/m", bounds=(0.0, 2.0), training_range=(0.0, 0.3), initial=0.0)

REAL_BALL = (RESTITUTION, SLOPE, DRAG)  # what moves a real ball, in the order of a vector of them

# From what a camera can see and an engine can simulate, to far more than anybody drops.
_LIMITS = {
    "gap_m": (0.01, 1000.0, "m"),
    "radius_m": (0.001, 10.0, "m"),
    "rate_hz": (1.0, 20_000.0, "Hz"),
    "samples": (2, 1_000_000, ""),
    "hold_s": (0.0, 600.0, "s"),
    "speed_m_s": (-1000.0, 1000.0, "m/s"),
}

# Of a rollout at given times: a ball that keeps its height bounces as long as it is asked to.
_MAX_S = 3600.0


@dataclass(frozen=True)
class DropRig:
    """Set-up of a drop.

    Attributes:
        gap_m: height of the ball's underside over the plane when it is let go.
        speed_m_s: upward speed then: 0 for a ball that is dropped. Only with calibrated contacts.
        rate_hz: samples a second; with calibrated contacts the engine steps from impact to impact,
            else once a sample.
        hold_s: how long the ball is held before it is let go.
        start_ns: where the rig's clock is 0, and its first sample unless `times_s` says otherwise.
        times_s: sample times instead [s], increasing; empty for a uniform rate. Only with
            calibrated contacts.

    Raises:
        UsageError: a value is not finite or out of range.
    """

    gap_m: float = 1.0
    radius_m: float = 0.05
    rate_hz: float = 60.0
    samples: int = 400
    hold_s: float = 0.0
    start_ns: int = 0
    times_s: tuple[float, ...] = ()
    speed_m_s: float = 0.0

    def __post_init__(self) -> None:
        for item in fields(self):
            if item.name in _LIMITS:
                low, high, unit = _LIMITS[item.name]
                value = getattr(self, item.name)
                if item.name == "gap_m" and self.speed_m_s:
                    low = 0.0  # it flies already
                if not (math.isfinite(value) and low <= value <= high):
                    raise UsageError(
                        f"{item.name} {value:g} is not from {low:g} to {high:g} {unit}".rstrip()
                    )
        if self.times_s and not self.times_s[-1] <= _MAX_S:
            raise UsageError(
                f"its last sample is after {self.times_s[-1]:.4g} s, not within an hour"
            )

    def sample_s(self) -> Array:
        """Return the sample times [s after the start], shape (T,)."""
        if self.times_s:
            return np.array(self.times_s)
        return np.arange(self.samples) / self.rate_hz


class Flight:
    """A bouncing ball: the engine solves its impacts, the flights between are in closed form.

    The engine's step is v += -g dt, then z += v dt. It is given the speed with which that ends
    where the ball is after dt by the closed form of a flight in air; so a step may be long, and
    only has to end where the ball meets the plane. There one very short step lets the engine solve
    the contact, with the restitution at the impact's speed. Between two steps, positions are in
    closed form, too.
    """

    def __init__(
        self, world: BallWorld, gap_m: float, speed_m_s: float, law: SpeedLaw, drag_1_m: float
    ) -> None:
        world.place(gap_m, law.restitution)
        self._world = world
        self._law = law
        self._drag_1_m = drag_1_m
        self._gravity = world.contact.gravity_m_s2
        self._height_m = world.radius_m + gap_m
        self._speed_m_s = speed_m_s

    def heights_m(self, seconds: Array) -> Array:
        """Compute the centre's heights at increasing times since release, shape (T,)."""
        world, gravity, drag_1_m = self._world, self._gravity, self._drag_1_m
        heights_m = np.empty(len(seconds))
        now_s, first = 0.0, 0
        while first < len(seconds):
            gap_m = max(self._height_m - world.radius_m + OVERLAP_M, 0.0)
            lasts_s = lands_after_s(gap_m, self._speed_m_s, gravity, drag_1_m)
            last = int(np.searchsorted(seconds, now_s + lasts_s))
            since_s = np.maximum(seconds[first:last] - now_s, 0.0)
            heights_m[first:last] = flown_heights_m(
                self._height_m, self._speed_m_s, since_s, gravity, drag_1_m
            )
            if last == len(seconds):
                break
            self._fly(lasts_s / 2)  # off the plane in the first half, and onto it in the second
            self._fly(lasts_s / 2)
            world.set_restitution(float(self._law.at(np.array(-self._speed_m_s))))
            world.set_speed(self._speed_m_s + gravity * IMPACT_S)
            self._height_m, self._speed_m_s = world.step(IMPACT_S)
            now_s, first = now_s + lasts_s + IMPACT_S, last
            if abs(self._speed_m_s) < world.contact.resting_speed_m_s:
                heights_m[first:] = self._height_m  # the ground bears the weight
                break
        return heights_m

    def _fly(self, seconds: float) -> None:
        height_m, speed_m_s = flown(
            self._height_m, self._speed_m_s, seconds, self._gravity, self._drag_1_m
        )
        kick = self._gravity * seconds
        self._world.set_speed((height_m - self._height_m) / seconds + kick)
        self._height_m, _ = self._world.step(seconds)
        self._speed_m_s = speed_m_s


class DropSimulator:
    """The drop of the paper's second experiment (mass 1 kg, plane's restitution 1).

    With the calibrated settings sample 0 is the start, the restitution may fall with the impact's
    speed, and the air may slow the ball. With the paper's, samples are taken after each step, as
    its authors do, and there is one restitution and the engine's damping.

    Args:
        contact: how impacts are solved.
        world: with that ball and these contacts; one of the default engine if None.
    """

    def __init__(
        self, rig: DropRig, contact: ContactSettings = CALIBRATED, world: BallWorld | None = None
    ) -> None:
        self.rig = rig
        self.contact = contact
        self.parameters = REAL_BALL if contact.meet_impacts else (RESTITUTION,)
        self._world = world or ball_world(rig.radius_m, contact)
        self.engine = self._world.engine
        self.step_hz = rig.rate_hz

    def with_rig(self, rig: DropRig) -> DropSimulator:
        """Put the same ball on another rig, without building the world again.

        Raises:
            UsageError: the ball's radius differs.
        """
        if rig.radius_m != self.rig.radius_m:
            raise UsageError(f"a ball of {self.rig.radius_m:g} m radius cannot change its size")
        return DropSimulator(rig, self.contact, self._world)

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """Drop the ball; `values` left out are 0. See `Simulator.rollout`.

        Args:
            values: by name: the restitution, and as far as they are not 0 the others.
        """
        known = {parameter.name: parameter for parameter in self.parameters}
        if RESTITUTION.name not in values or not values.keys() <= known.keys():
            takes = ", ".join(known)
            raise UsageError(f"a drop takes the values {takes}, not {sorted(values)}")
        truth = {name: one.checked(values.get(name, 0.0)) for name, one in known.items()}
        seconds = self.rig.sample_s()
        stamps_ns = self.rig.start_ns + np.round(seconds * 1e9).astype(np.int64)
        if self.contact.meet_impacts:
            heights_m = self._flown(truth, seconds)
        else:
            heights_m = self._stepped(truth[RESTITUTION.name])
            stamps_ns += round(1e9 / self.rig.rate_hz)
        positions = np.column_stack([np.zeros((len(heights_m), 2)), heights_m])
        info = EpisodeInfo(
            kind="drop",
            source=self.engine,
            preset=self.contact.name,
            rig={
                "ball_diameter_m": 2 * self.rig.radius_m,
                "drop_height_m": self.rig.gap_m,
            },
            truth=truth,
        )
        return Episode(info, {TOPIC: Signal(TOPIC, stamps_ns, positions, ("x", "y", "z"), "m")})

    def _flown(self, values: Mapping[str, float], seconds: Array) -> Array:
        """Compute the centre's heights [m], shape (T,), each impact met."""
        rig, drag_1_m = self.rig, values[DRAG.name]
        lands_s = lands_after_s(rig.gap_m, rig.speed_m_s, self.contact.gravity_m_s2, drag_1_m)
        first = flown(rig.gap_m, rig.speed_m_s, lands_s, self.contact.gravity_m_s2, drag_1_m)
        law = SpeedLaw(values[RESTITUTION.name], values[SLOPE.name], -first[1])
        flight = Flight(self._world, rig.gap_m, rig.speed_m_s, law, drag_1_m)
        heights_m = np.full(len(seconds), rig.radius_m + rig.gap_m)
        free = seconds > rig.hold_s
        heights_m[free] = flight.heights_m(seconds[free] - rig.hold_s)
        return heights_m

    def _stepped(self, restitution: float) -> Array:
        """Simulate the centre's heights after each plain step [m], shape (T,)."""
        rig = self.rig
        heights_m = np.full(rig.samples, rig.radius_m + rig.gap_m)
        self._world.place(rig.gap_m, restitution)
        held = min(round(rig.hold_s * rig.rate_hz), rig.samples)
        heights_m[held:] = self._world.steps(1.0 / rig.rate_hz, rig.samples - held)
        return heights_m
