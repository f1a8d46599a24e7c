"""Simulate a ball that drops on a plane: speed-dependent restitution and quadratic air drag.

First the closed forms: whole bounces in dimensionless numbers, vertical flight in air, and the
restitution's law over speed. `DropSimulator` then combines flights in closed form with impacts that
a physics engine solves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.base import (
    CALIBRATED,
    IMPACT_S,
    OVERLAP_M,
    BallWorld,
    ContactSettings,
    Parameter,
    check_limits,
)
from tunenet_logs.recorders.simulators.known import ball_world, engine

# ---- Bounces in closed form: u'' = -2 - drag u' |u'|, in drop heights H and sqrt(2 H / g)
#
# Time s counts from the first impact, height u from contact. Without drag the ball falls from u = 1
# at s = -1; n impacts later u = x (w - x), x the time since that impact, w the speed that it left.

_MIN_SPEED = 1e-5  # [drop heights, sqrt(2 H / g)]; a slower is at rest: it would rise 2.5e-11 H
_MIN_DRAG = 1e-9  # with less, a flight is a parabola
_LANDED = -17.0  # angle after which a flight is over, whatever the drag


@dataclass(frozen=True)
class Bounce:
    """A ball's bounces, in dimensionless numbers."""

    restitution: float  # at the first impact, e_1
    slope: float = 0.0  # p of e_n = e_1 (v_n / v_1)^-p, the restitution over speed
    drag: float = 0.0  # quadratic drag, deceleration over speed squared, times the drop height
    each: tuple[float, ...] = ()  # restitutions at the first impacts, where they follow no law
    constant_below: float = 0.0  # of the first speed: from there e stays; a power has no bound
    starts_in_flight: bool = False
    contact: float = 0.0  # duration of each impact's contact [sqrt(2 H / g)]

    def heights(self, places: Array) -> Array:
        """Compute heights u over contact at times s after the first impact, each of shape (T,)."""
        return flown_by([self], places[None])[0][0]

    def flights(self, last: float) -> tuple[Array, Array]:
        """Compute when flights up to a time s start, and their first speeds, each of shape (N,)."""
        starts, speeds = self._flights(last)
        return np.array(starts), np.array(speeds)

    def _flights(self, last: float) -> tuple[list[float], list[float]]:
        first, each, given = self.impact_speed, self.each, len(self.each)
        usual, power, has_drag = self.restitution, -self.slope, self.drag >= _MIN_DRAG
        per_speed, twice_rate = math.sqrt(self.drag / 2.0), math.sqrt(2.0 * self.drag)
        slowest = self.constant_below
        start, speed = self.contact, (each[0] if each else min(usual, 1.0)) * first
        starts, speeds, count = [start], [speed], 1
        # No log has 400 flights: the bound ends those of a restitution of almost 1.
        while start <= last and count < 400 and speed > _MIN_SPEED:
            lasted = impact = speed
            if has_drag:  # as in `flight`
                reach = speed * per_speed
                lasted = (math.atan(reach) + math.asinh(reach)) / twice_rate
                impact = speed / math.hypot(1.0, reach)
            if count < given:
                kept = each[count]
            else:
                ratio = impact / first
                kept = usual * (ratio if ratio > slowest else slowest) ** power
                kept = kept if kept < 1.0 else 1.0
            start += lasted + self.contact
            speed = kept * impact
            starts.append(start)
            speeds.append(speed)
            count += 1
        if speed <= _MIN_SPEED:
            speeds[-1] = 0.0
        return starts, speeds

    def arrivals(self, speeds: Array) -> Array:
        """Compute the speeds of the impacts before flights of these speeds, shape (N,)."""
        return np.array([self.impact_speed, *(self.flight(one)[1] for one in speeds[:-1].tolist())])

    @property
    def impact_speed(self) -> float:
        """Speed of the first impact [drop heights, sqrt(2 H / g)]."""
        if self.drag < _MIN_DRAG:
            return 2.0
        return math.sqrt(-2.0 * math.expm1(-2.0 * self.drag) / self.drag)

    @property
    def fall_time(self) -> float:
        """Duration of the fall: arccosh(e^drag) / sqrt(2 drag), exact for small drag, too."""
        if self.drag < _MIN_DRAG:
            return 1.0
        return math.asinh(math.sqrt(math.expm1(2.0 * self.drag))) / math.sqrt(2.0 * self.drag)

    def flight(self, speed: float) -> tuple[float, float]:
        """Compute duration and final speed of a flight that begins with `speed`."""
        # Up: v' = -2 - drag v^2 gives an arctan; down: the same with +, an asinh.
        if self.drag < _MIN_DRAG:
            return speed, speed
        reach = speed * math.sqrt(self.drag / 2.0)
        lasted = (math.atan(reach) + math.asinh(reach)) / math.sqrt(2.0 * self.drag)
        return lasted, speed / math.hypot(1.0, reach)


def flown_by(balls: Sequence[Bounce], places: Array) -> tuple[Array, Array]:
    """Compute heights u and upward speeds u' of balls at times s, all of shape (K, T), at once.

    A flight is an angle: its rate times the time to its apex. The speed over the terminal one is
    the angle's tan on the way up and its tanh on the way down, and heights are logarithms of these.
    """
    drags = [max(ball.drag, _MIN_DRAG) for ball in balls]
    falls = [ball.fall_time for ball in balls]
    # All flights in one list; the first of each ball is the fall, of which the apex is known.
    starts: list[float] = []
    speeds: list[float] = []
    at = np.empty(places.shape, np.intp)
    first: list[int] = []
    for ball, row, flight in zip(balls, places, at, strict=True):
        own, left = ball._flights(float(row.max(initial=0.0)))
        first.append(len(starts))
        np.add(np.array(own).searchsorted(row, side="right"), len(starts), out=flight)
        starts += (0.0, *own)
        speeds += (0.0, *left)
    rates = np.sqrt(np.array(drags) * 2.0)
    rate = np.repeat(rates, np.diff(first, append=len(starts)))
    reach = np.array(speeds)
    reach *= rate / 2
    apexes = np.array(starts)
    apexes += np.arctan(reach) / rate
    tops = np.log1p(reach * reach) / rate**2
    apexes[first], tops[first] = np.negative(falls), 1.0
    # Before the fall the ball is held, or it rises: pi / 2 is infinitely fast.
    rates = rates[:, None]
    earliest = np.negative([[fall] for fall in falls])
    earliest -= np.array([[1.5 * ball.starts_in_flight] for ball in balls]) / rates
    angles = apexes[at]
    angles -= np.maximum(places, earliest)
    angles *= rates
    np.maximum(angles, _LANDED, out=angles)
    paces = np.where(angles > 0.0, np.tan(angles), np.tanh(angles))
    heights = np.log1p(paces * np.abs(paces))
    np.abs(heights, out=heights)
    heights /= -(rates**2)
    heights += tops[at]
    flies = (heights > 0.0) | (places < 0.0)  # else it is at rest, or in a contact
    heights *= flies
    paces *= flies
    paces *= 2.0 / rates
    return heights, paces


# ---- Vertical flight in closed form: dv/dt = -g - k v |v|, with the drag k [1/m]
#
# Upward that is a tangent of time, downward a hyperbolic one; without drag it is a parabola. A fall
# has the rate sqrt(g k) [1/s] and the terminal speed sqrt(g / k) [m/s].

# With less drag a flight is a parabola: over 100 m the air changes it by 1e-7.
_MIN_FLIGHT_DRAG_1_M = 1e-9


def flown(
    height_m: float, speed_m_s: float, seconds: float, gravity_m_s2: float, drag_1_m: float
) -> tuple[float, float]:
    """Compute height [m] and upward speed [m/s] after a time of free flight."""
    if drag_1_m < _MIN_FLIGHT_DRAG_1_M:
        after = speed_m_s - gravity_m_s2 * seconds
        return height_m + (speed_m_s + after) / 2 * seconds, after
    rate, terminal = math.sqrt(gravity_m_s2 * drag_1_m), math.sqrt(gravity_m_s2 / drag_1_m)
    if speed_m_s > 0:
        angle = math.atan(speed_m_s / terminal)
        rises_s = angle / rate
        if seconds < rises_s:
            left = angle - rate * seconds
            rise = math.log(math.cos(left) / math.cos(angle)) / drag_1_m
            return height_m + rise, terminal * math.tan(left)
        height_m += math.log(math.hypot(1.0, speed_m_s / terminal)) / drag_1_m
        seconds, speed_m_s = seconds - rises_s, 0.0
    # The downward part of a flight is a later part of a fall from rest.
    since = math.atanh(min(-speed_m_s / terminal, _MAX_TERMINAL_SHARE))
    until = since + rate * seconds
    fall_m = (_log_cosh(until) - _log_cosh(since)) / drag_1_m
    return height_m - fall_m, -terminal * math.tanh(until)


def flown_heights_m(
    heights_m: Array, speeds_m_s: Array, seconds: Array, gravity_m_s2: float, drag_1_m: float
) -> Array:
    """Compute heights [m] after times of free flights, all of shape (T,); see `flown`."""
    if drag_1_m < _MIN_FLIGHT_DRAG_1_M:
        return heights_m + (speeds_m_s - gravity_m_s2 / 2 * seconds) * seconds
    rate, terminal = math.sqrt(gravity_m_s2 * drag_1_m), math.sqrt(gravity_m_s2 / drag_1_m)
    rising = np.maximum(speeds_m_s / terminal, 0.0)
    apex = np.arctan(rising)  # an angle, see `flown_by`
    angles = rate * seconds
    tops = 0.5 * np.log1p(rising**2)
    falling = np.minimum(np.maximum(speeds_m_s / -terminal, 0.0), _MAX_TERMINAL_SHARE)
    since = np.arctanh(falling)
    until = since + np.maximum(angles - apex, 0.0)
    log_cosh = np.where(
        until < 1,
        np.log1p(2 * np.sinh(np.minimum(until, 1.0) / 2) ** 2),
        until + np.log1p(np.exp(-2 * until)) - math.log(2),
    )
    log_cosh += 0.5 * np.log1p(-(falling**2))  # less that of the speed that it begins with
    below = np.where(angles < apex, -np.log(np.cos(np.maximum(apex - angles, 0.0))), log_cosh)
    return heights_m + (tops - below) / drag_1_m


def lands_after_s(height_m: float, speed_m_s: float, gravity_m_s2: float, drag_1_m: float) -> float:
    """Compute the time to reach height 0 from this height [m] and upward speed [m/s]."""
    if drag_1_m < _MIN_FLIGHT_DRAG_1_M:
        reach = math.sqrt(speed_m_s**2 + 2 * gravity_m_s2 * height_m)
        return (speed_m_s + reach) / gravity_m_s2
    rate, terminal = math.sqrt(gravity_m_s2 * drag_1_m), math.sqrt(gravity_m_s2 / drag_1_m)
    before_s = 0.0
    if speed_m_s > 0:
        before_s = math.atan(speed_m_s / terminal) / rate
        height_m += math.log(math.hypot(1.0, speed_m_s / terminal)) / drag_1_m
        speed_m_s = 0.0
    fallen_s = math.atanh(min(-speed_m_s / terminal, _MAX_TERMINAL_SHARE)) / rate
    fallen_m = _log_cosh(rate * fallen_s) / drag_1_m
    log_cosh = drag_1_m * (height_m + fallen_m)  # of the fall to come; e^it is out of range over 20
    if log_cosh > 20:
        return before_s + (log_cosh + math.log(2)) / rate - fallen_s
    return before_s + math.asinh(math.sqrt(math.expm1(2 * log_cosh))) / rate - fallen_s


_MAX_TERMINAL_SHARE = 1 - 1e-12  # a fall from rest comes no nearer to its terminal speed


def _log_cosh(value: float) -> float:
    """Compute log(cosh(value)), also where cosh is too large, or too near to 1."""
    if value < 1:
        return math.log1p(2 * math.sinh(value / 2) ** 2)
    return value + math.log1p(math.exp(-2 * value)) - math.log(2)


# ---- Restitution over impact speed

# The law is constant below this speed: no ball is measured there, and a power law has no bound.
MIN_SPEED_M_S = 0.05


@dataclass(frozen=True)
class SpeedLaw:
    """Power law of the restitution, e(v) = restitution (v / at_m_s)^-slope."""

    restitution: float  # at an impact of `at_m_s`
    slope: float = 0.0  # p; 0 for one restitution at all speeds
    at_m_s: float = 3.0  # speed along the surface's normal

    def __post_init__(self) -> None:
        if not 0 <= self.restitution <= 1:
            raise UsageError(f"restitution {self.restitution:g} is not a number from 0 to 1")
        if not abs(self.slope) <= 1:
            raise UsageError(f"slope {self.slope:g} is not a number from -1 to 1")
        if not (math.isfinite(self.at_m_s) and self.at_m_s > 0):
            raise UsageError(f"impact speed {self.at_m_s:g} m/s is not over 0")

    def at(self, speeds_m_s: Array) -> Array:
        """Compute the restitution, 0 to 1, at impacts of these speeds [m/s], of their shape."""
        ratio = np.maximum(speeds_m_s, MIN_SPEED_M_S) / self.at_m_s
        return np.clip(self.restitution * ratio**-self.slope, 0.0, 1.0)

    def at_speed(self, speed_m_s: float) -> float:
        """Compute the restitution, 0 to 1, at one impact of this speed [m/s]."""
        ratio = max(speed_m_s, MIN_SPEED_M_S) / self.at_m_s
        return min(max(self.restitution * ratio**-self.slope, 0.0), 1.0)


# ---- Drop: flights in closed form, impacts solved by the engine

TOPIC = "/ball/pose"
# Name, unit, bounds, range of the training, first guess. e: at the speed of the first impact.
RESTITUTION = Parameter("restitution", "1", (0.0, 1.0), (0.0, 1.0), 0.0)
# p of e (v / v_first)^-p: how the restitution falls with the impact's speed; see `SpeedLaw`.
SLOPE = Parameter("restitution_slope", "1", (-0.5, 0.5), (0.0, 0.15), 0.0)
# k of dv/dt = -g - k v |v|: rho Cd A / (2 m) of the air, the ball's area and its mass.
DRAG = Parameter("drag", "1/m", (0.0, 2.0), (0.0, 0.3), 0.0)

REAL_BALL = (RESTITUTION, SLOPE, DRAG)  # what moves a real ball, in the order of its vector


@dataclass(frozen=True)
class DropRig:
    """Set-up of a drop: from what a camera sees and an engine simulates, to what nobody drops."""

    gap_m: Annotated[float, 0.0, 1000.0, "m"] = 1.0  # from the plane to the ball's underside
    radius_m: Annotated[float, 0.001, 10.0, "m"] = 0.05
    # Samples a second; with calibrated contacts the engine steps from impact to impact, else once a
    # sample.
    rate_hz: Annotated[float, 1.0, 20_000.0, "Hz"] = 60.0
    samples: Annotated[int, 2, 1_000_000] = 400
    hold_s: Annotated[float, 0.0, 600.0, "s"] = 0.0  # how long the ball is held
    start_ns: int = 0  # where the rig's clock is 0
    times_s: tuple[float, ...] = ()  # sample times instead [s], only with calibrated contacts
    # Upward, when it is let go; only with calibrated contacts. 0 is a drop.
    speed_m_s: Annotated[float, -1000.0, 1000.0, "m/s"] = 0.0

    def __post_init__(self) -> None:
        if not self.speed_m_s and not 0.01 <= self.gap_m <= 1000:
            raise UsageError(f"gap_m {self.gap_m:g} is not from 0.01 to 1000 m")
        check_limits(self)
        # A ball that keeps its height bounces for ever.
        if self.times_s and not self.times_s[-1] <= 3600:
            last_s = f"{self.times_s[-1]:.4g}"
            raise UsageError(f"its last sample is after {last_s} s, not within an hour")


def bounced_heights_m(
    world: BallWorld, rig: DropRig, law: SpeedLaw, drag_1_m: float, seconds: Array
) -> Array:
    """Compute the centre's heights [m] at increasing times since release, each of shape (T,).

    The engine solves the impacts, the flights between are in closed form. The engine's step is
    v += -g dt, then z += v dt. It is given the speed with which that ends where the ball is after
    dt by the closed form of a flight in air; so a step may be long, and only has to end where the
    ball meets the plane. There one very short step lets the engine solve the contact, with the
    restitution at the impact's speed.
    """
    gravity = world.contact.gravity_m_s2
    height_m, speed_m_s = world.radius_m + rig.gap_m, rig.speed_m_s
    world.place(rig.gap_m, law.restitution)
    if not len(seconds):
        return np.empty(0)
    # Of each flight: the height and speed that it begins with, when, and its first sample.
    flights: list[tuple[float, float, float, int]] = []
    now_s, first, rests = 0.0, 0, len(seconds)
    while first < len(seconds):
        flights.append((height_m, speed_m_s, now_s, first))
        gap_m = max(height_m - world.radius_m + OVERLAP_M, 0.0)
        lasts_s = lands_after_s(gap_m, speed_m_s, gravity, drag_1_m)
        last = int(seconds.searchsorted(now_s + lasts_s))
        if last == len(seconds):
            break
        half_s = lasts_s / 2
        for _ in range(2):  # off the plane in the first half, and onto it in the second
            end_m, after_m_s = flown(height_m, speed_m_s, half_s, gravity, drag_1_m)
            world.set_speed((end_m - height_m) / half_s + gravity * half_s)
            (height_m, _), speed_m_s = world.step(half_s), after_m_s
        world.set_restitution(law.at_speed(-speed_m_s))
        world.set_speed(speed_m_s + gravity * IMPACT_S)
        height_m, speed_m_s = world.step(IMPACT_S)
        now_s, first = now_s + lasts_s + IMPACT_S, last
        if abs(speed_m_s) < 0.01:  # [m/s]; the ground bears the weight
            rests = first
            break
    begun = np.array(flights)
    counts = np.diff(begun[:, 3].astype(np.intp), append=rests)
    from_m, speeds_m_s, starts_s = np.repeat(begun[:, :3], counts, axis=0).T
    since_s = np.maximum(seconds[:rests] - starts_s, 0.0)
    heights_m = np.full(len(seconds), height_m)
    heights_m[:rests] = flown_heights_m(from_m, speeds_m_s, since_s, gravity, drag_1_m)
    return heights_m


class DropSimulator:
    """The drop of the paper's second experiment (mass 1 kg, plane's restitution 1).

    With the calibrated settings sample 0 is the start, the restitution may fall with the impact's
    speed, and the air may slow the ball. With the paper's, samples are taken after each step, as
    its authors do, and there is one restitution and the engine's damping.
    """

    def __init__(
        self, rig: DropRig, contact: ContactSettings = CALIBRATED, world: BallWorld | None = None
    ) -> None:
        self.rig = rig
        self.contact = contact  # how impacts are solved
        self.parameters = REAL_BALL if contact.meet_impacts else (RESTITUTION,)
        # With that ball and these contacts; one of the default engine if None.
        self._world = world or ball_world(engine(), rig.radius_m, contact)
        self.engine = self._world.engine
        self.step_hz = rig.rate_hz

    def with_rig(self, rig: DropRig) -> DropSimulator:
        """Put the same ball on another rig, without building the world again."""
        if rig.radius_m != self.rig.radius_m:
            raise UsageError(f"a ball of {self.rig.radius_m:g} m radius cannot change its size")
        return DropSimulator(rig, self.contact, self._world)

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """Drop the ball; `values` left out are 0. See `Simulator.rollout`."""
        known = {parameter.name: parameter for parameter in self.parameters}
        if RESTITUTION.name not in values or not values.keys() <= known.keys():
            takes = ", ".join(known)
            raise UsageError(f"a drop takes the values {takes}, not {sorted(values)}")
        truth = {name: one.checked(values.get(name, 0.0)) for name, one in known.items()}
        rig, world, gravity = self.rig, self._world, self.contact.gravity_m_s2
        seconds = np.array(rig.times_s) if rig.times_s else np.arange(rig.samples) / rig.rate_hz
        stamps_ns = rig.start_ns + np.round(seconds * 1e9).astype(np.int64)
        heights_m = np.full(len(seconds), rig.radius_m + rig.gap_m)
        if self.contact.meet_impacts:
            drag_1_m = truth[DRAG.name]
            lands_s = lands_after_s(rig.gap_m, rig.speed_m_s, gravity, drag_1_m)
            first = flown(rig.gap_m, rig.speed_m_s, lands_s, gravity, drag_1_m)
            law = SpeedLaw(truth[RESTITUTION.name], truth[SLOPE.name], -first[1])
            free = seconds > rig.hold_s
            since_s = seconds[free] - rig.hold_s
            heights_m[free] = bounced_heights_m(world, rig, law, drag_1_m, since_s)
        else:  # after each plain step
            world.place(rig.gap_m, truth[RESTITUTION.name])
            held = min(round(rig.hold_s * rig.rate_hz), rig.samples)
            heights_m[held:] = world.steps(1.0 / rig.rate_hz, rig.samples - held)
            stamps_ns += round(1e9 / rig.rate_hz)
        positions = np.column_stack([np.zeros((len(heights_m), 2)), heights_m])
        info = EpisodeInfo(
            kind="drop",
            source=self.engine,
            preset=self.contact.name,
            rig={"ball_diameter_m": 2 * rig.radius_m, "drop_height_m": rig.gap_m},
            truth=truth,
        )
        return Episode(info, {TOPIC: Signal(TOPIC, stamps_ns, positions, ("x", "y", "z"), "m")})
