"""Simulate arms with code and constants that the fit does not share.

An arm as it is: links that weigh something else than the description says, a base that is not
level, encoders off zero, rotors, gears with Stribeck and load-dependent friction and ripple, hoses,
sensors that drift. It moves along sums of sines, and a driver reports what it feels. Torques come
from the recursive Newton-Euler algorithm; sizes are fractions of each joint's highest torque.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal

# ---- Motions: each joint along a sum of sines, from rest to rest.

_TERMS = 3  # sines of a joint

_EASING_S = 1.0  # how long starting and stopping take


@dataclass(frozen=True, eq=False)
class StrangerMotion:
    """Joint positions over time."""

    middle: Array  # of each joint [rad], shape (J,)
    amplitudes: Array  # of each sine [rad], shape (K, J)
    rates: Array  # of each sine [rad/s], shape (K, J)
    phases: Array  # of each sine at 0 s [rad], shape (K, J)
    length_s: float  # from rest to rest

    @classmethod
    def drawn(cls, model: Any, rng: np.random.Generator) -> StrangerMotion:
        """Draw a motion of 6 to 10 s within the model's limits of position and speed."""
        shape = (_TERMS, model.nq)
        low = np.maximum(model.lowerPositionLimit, -2.8)
        high = np.minimum(model.upperPositionLimit, low + 5.6)
        length_s = float(rng.uniform(6.0, 10.0))
        rank = np.arange(1, _TERMS + 1)[:, None]
        rates = 2 * np.pi * rank / length_s
        rates = rates * rng.uniform(0.8, 1.2, shape)
        amplitudes = rng.normal(0.0, 0.5, shape) / rank
        fastest = np.minimum(model.velocityLimit, 1.5)
        reach = np.minimum(np.sum(np.abs(amplitudes), axis=0), (high - low) / 2.2)
        amplitudes *= reach / np.maximum(np.sum(np.abs(amplitudes), axis=0), 1e-9)
        middle = rng.uniform(low + reach, high - reach)
        motion = cls(middle, amplitudes, rates, rng.uniform(0, 6.28, shape), length_s)
        seconds = np.linspace(0.0, length_s, 1000)
        steepest = np.abs(np.gradient(motion.at(seconds), seconds, axis=0)).max(axis=0)
        slower = np.minimum(1.0, fastest / np.maximum(steepest, 1e-9))
        return replace(motion, amplitudes=amplitudes * slower)

    def at(self, seconds: Array) -> Array:
        """Return positions [rad] at times of shape (T,), shape (T, J); eased in and out."""
        ends = (np.minimum(seconds, self.length_s - seconds) / _EASING_S).clip(0.0, 1.0)
        ease = ends**3 * (10 - 15 * ends + 6 * ends**2)
        waves = self.rates * seconds[:, None, None] + self.phases
        return self.middle + ease[:, None] * np.sum(self.amplitudes * np.sin(waves), axis=1)


# ---- The arm and its troubles: a run of it with its driver's torques, and a log of two runs.

GRAVITY_M_S2 = 9.80665  # standard gravity
_FINE_HZ = 400.0  # at which torques are computed, to be reported late and at other rates
DRAW = 0x57A6  # makes a seed this world's own


@dataclass(frozen=True)
class Troubles:
    """Sizes of an arm's imperfections; those in parts are of each joint's highest torque."""

    noise: float = 0.001  # white, in parts
    offset: float = 0.0  # of a sensor's zero, in parts
    dry: float = 0.0  # Coulomb friction, in parts; Stribeck's peak is up to 60 % more
    viscous: float = 0.0  # in parts, for 1 rad/s
    load: float = 0.0  # friction as a fraction of what the gear carries
    ripple: float = 0.0  # amplitude of a gear's, in parts
    hoses: float = 0.0  # amplitude of what a joint's hoses pull, in parts
    drift: float = 0.0  # of a sensor's zero from the empty run to the other, in parts
    warming: float = 0.0  # what it drifts by within a run, in parts
    gain: float = 0.0  # a fraction
    link_mass: float = 0.0  # a fraction
    link_centre_m: float = 0.0  # of each axis
    link_inertia: float = 0.0  # a fraction
    rotor_kg_m2: float = 0.0  # reflected to the joint
    tilt_rad: float = 0.0  # of the base about each level axis
    zero_rad: float = 0.0  # of each encoder
    lag_s: float = 0.0  # of torques behind positions, at most

    def times(self, factor: float) -> Troubles:
        """Scale all of them but the noise."""
        sizes = {item.name: factor * getattr(self, item.name) for item in fields(self)}
        return replace(self, **{**sizes, "noise": self.noise})


CLEAN = Troubles()  # an arm as its description says, with good sensors
# An arm with torque sensors behind its gears, well calibrated.
LIGHT = Troubles(
    noise=0.004,
    offset=0.006,
    dry=0.012,
    viscous=0.012,
    ripple=0.003,
    gain=0.01,
    link_mass=0.015,
    link_centre_m=0.0015,
    lag_s=0.01,
    drift=0.001,
)

# An arm with all that is known to go wrong.
FULL = Troubles(
    noise=0.006,
    offset=0.012,
    dry=0.03,
    viscous=0.03,
    load=0.04,
    ripple=0.006,
    hoses=0.01,
    drift=0.004,
    warming=0.002,
    gain=0.015,
    link_mass=0.03,
    link_centre_m=0.003,
    link_inertia=0.1,
    rotor_kg_m2=0.3,
    tilt_rad=0.009,
    zero_rad=0.006,
    lag_s=0.025,
)


@dataclass(frozen=True, eq=False)
class StrangerRun:
    """Run of a stranger's arm, as its driver gives it, and as it was."""

    episode: Episode  # `/joint_states` signals
    seconds: Array  # of them [s], shape (T,)
    # derivatives of the torques by mass and first moments in the tool frame, (T, J, 4)
    feels: Array
    noise_nm: Array  # standard deviation of each joint's white noise, shape (J,)


@dataclass(frozen=True, eq=False)
class StrangerLog:
    """Run with a payload, one without, and the truth."""

    held: StrangerRun  # with the payload
    empty: StrangerRun  # before it, along the same motion, with nothing in the hand
    mass_kg: float  # of the payload
    centre_m: Array  # of its mass, in the tool frame [m], shape (3,)


def stranger_log(urdf: Path, tool: str, seed: int, troubles: Troubles) -> StrangerLog:
    """Draw an arm, a motion and a payload of 0 to 2.5 kg, its centre 1.5 cm off."""
    rng = np.random.default_rng([seed, DRAW])
    arm = StrangerArm.drawn(urdf, tool, rng, troubles)
    mass_kg = float(rng.uniform(0.0, 2.5))
    away = rng.standard_normal(3)
    centre_m = 0.015 * away / np.linalg.norm(away)
    motion = StrangerMotion.drawn(arm.model, rng)
    rate_hz = float(rng.choice([50.0, 80.0, 100.0, 125.0]))
    empty = arm.run(motion, rate_hz, None, rng, before=True)
    held = arm.run(motion, rate_hz, (mass_kg, centre_m), rng, before=False)
    return StrangerLog(held, empty, mass_kg, centre_m)


@dataclass(frozen=True, eq=False)
class StrangerArm:
    """Arm as it is, drawn."""

    model: Any  # Pinocchio's, with the links and the tilt that this arm has
    frame: int  # of the tool, in the model
    limit_nm: Array  # highest torque of each joint [N·m], shape (J,)
    zero_rad: Array  # of each encoder, shape (J,)
    draws: dict[str, Array]  # without units, by what they are of; each of shape (J,) or (K, J)
    troubles: Troubles  # how large they become

    @classmethod
    def drawn(cls, urdf: Path, tool: str, rng: np.random.Generator, size: Troubles) -> StrangerArm:
        """Draw an arm of a description, with troubles of this size."""
        library = import_module("pinocchio")
        model = described_arm(urdf).copy()
        count = model.nq
        for at in range(1, model.njoints):
            body = model.inertias[at]
            mass = body.mass * (1 + size.link_mass * rng.standard_normal())
            lever = body.lever + size.link_centre_m * rng.standard_normal(3)
            inertia = body.inertia * (1 + size.link_inertia * rng.standard_normal())
            model.inertias[at] = library.Inertia(max(mass, 0.01), lever, inertia)
        tilt = size.tilt_rad * rng.standard_normal(2)
        down = np.array([np.sin(tilt[0]), np.sin(tilt[1]), 0.0])
        down[2] = -np.sqrt(1 - down @ down)
        model.gravity.linear = GRAVITY_M_S2 * down
        limit_nm = np.minimum(model.effortLimit, 500.0)  # a description without limits may say more
        names = ("offset", "drift", "warming", "gain")
        draws = {name: rng.standard_normal(count) for name in names}
        even = ("dry", "viscous", "peak", "slow", "load", "ripple", "hoses", "rotor", "lag", "lean")
        draws |= {name: rng.uniform(0.0, 1.0, count) for name in even}
        draws["teeth"] = rng.choice([2.0, 4.0, 7.0, 12.0, 20.0, 36.0], (3, count))
        draws["phase"] = rng.uniform(0.0, 2 * np.pi, (4, count))
        zero_rad = size.zero_rad * rng.standard_normal(count)
        frame = model.getFrameId(tool)
        return cls(model, frame, limit_nm, zero_rad, draws, size)

    def run(
        self,
        motion: StrangerMotion,
        rate_hz: float,
        payload: tuple[float, Array] | None,
        rng: np.random.Generator,
        *,
        before: bool,
    ) -> StrangerRun:
        """Simulate a run, as a driver gives it; payload [kg], centre [m] in the tool frame."""
        size, draw = self.troubles, self.draws
        fine = np.arange(0.0, motion.length_s, 1 / _FINE_HZ)
        where = motion.at(fine)
        speed = np.gradient(where, 1 / _FINE_HZ, axis=0)
        pull = np.gradient(speed, 1 / _FINE_HZ, axis=0)
        rigid = rigid_nm(self._loaded(payload), where, speed, pull)
        rigid += size.rotor_kg_m2 * draw["rotor"] * pull
        felt = rigid + self._friction_nm(rigid, speed) + self._place_nm(where)
        felt *= 1 + size.gain * draw["gain"]
        zero = size.offset * draw["offset"]
        if not before:
            zero = zero + size.drift * draw["drift"]
        warmth = size.warming * draw["warming"] * (1 - np.exp(-fine[:, None] / 4.0))
        felt += self.limit_nm * (zero + warmth)
        stamps = np.arange(0.3, motion.length_s - 0.1, 1 / rate_hz)
        stamps = stamps + rng.uniform(-0.05, 0.05, len(stamps)) / rate_hz
        late = stamps - size.lag_s * draw["lag"][0]
        noise_nm = size.noise * self.limit_nm
        effort = np.column_stack([np.interp(late, fine, one) for one in felt.T])
        effort += noise_nm * rng.standard_normal(effort.shape)
        shown = motion.at(stamps)
        feels = self._feels(shown, motion, stamps)
        said = shown - self.zero_rad + 1e-4 * rng.standard_normal(shown.shape)
        ns = (stamps * 1e9).astype(np.int64) + 1_700_000_000_000_000_000
        names = tuple(self.model.names[1:])
        parts = (("position", "rad", said), ("effort", "N·m", effort))
        signals = {
            f"/joint_states.{what}": Signal(f"/joint_states.{what}", ns, values, names, unit)
            for what, unit, values in parts
        }
        return StrangerRun(Episode(EpisodeInfo(), signals), stamps, feels, noise_nm)

    def _loaded(self, payload: tuple[float, Array] | None) -> Any:
        """Add a block of that mass [kg] and centre [m] in the tool frame to the model."""
        if payload is None:
            return self.model
        mass_kg, centre_m = payload
        block = np.diag([0.06**2 + 0.1**2, 0.05**2 + 0.1**2, 0.05**2 + 0.06**2])
        return holding(self.model, self.frame, mass_kg, centre_m, mass_kg / 12 * block)

    def _friction_nm(self, carried: Array, speed: Array) -> Array:
        """Return the friction of gears with torques [N·m] and speeds [rad/s], all (T, J)."""
        size, draw = self.troubles, self.draws
        way = np.tanh(speed / 0.004)
        slow_rad_s = 0.02 + 0.1 * draw["slow"]
        peak = 1 + 0.6 * draw["peak"] * np.exp(-((speed / slow_rad_s) ** 2))
        dry = size.dry * (0.3 + 1.4 * draw["dry"]) * self.limit_nm * peak
        dry = dry * (1 + 0.2 * (draw["lean"] - 0.5) * way)
        load = 2 * size.load * draw["load"] * np.abs(carried)
        viscous = 2 * size.viscous * draw["viscous"] * self.limit_nm
        return (dry + load) * way + viscous * speed

    def _place_nm(self, where: Array) -> Array:
        """Return what depends on a joint's position [rad]: gear ripple and hoses; (T, J)."""
        size, draw = self.troubles, self.draws
        rows = zip((1, 2, 3), draw["teeth"], draw["phase"][:3], strict=True)
        waves = [np.sin(teeth * where + phase) / rank for rank, teeth, phase in rows]
        ripple = 2 * size.ripple * draw["ripple"] * sum(waves)
        pull = np.sin(0.7 * where + draw["phase"][3]) + 0.3 * np.tanh(where - draw["phase"][0])
        return self.limit_nm * (ripple + 2 * size.hoses * draw["hoses"] * pull)

    def _feels(self, where: Array, motion: StrangerMotion, stamps: Array) -> Array:
        """Return the torques of 1 kg, and of 1 kg m along each axis, by differences; (T, J, 4)."""
        small = 1e-3
        speed = (motion.at(stamps + small) - motion.at(stamps - small)) / (2 * small)
        pull = (motion.at(stamps + small) - 2 * where + motion.at(stamps - small)) / small**2
        base = rigid_nm(self.model, where, speed, pull)
        columns = [rigid_nm(self._loaded((1.0, np.zeros(3))), where, speed, pull) - base]
        for axis in np.eye(3):
            moved = rigid_nm(self._loaded((1.0, 0.01 * axis)), where, speed, pull) - base
            columns.append((moved - columns[0]) / 0.01)
        return np.stack(columns, axis=-1)


def holding(model: Any, frame: int, mass_kg: float, centre_m: Array, inertia: Array) -> Any:
    """Attach a body to a model's hand, in the tool frame: centre (3,), inertia about it (3, 3)."""
    library, model = import_module("pinocchio"), model.copy()
    mount = model.frames[frame]
    at = mount.parentJoint
    body = library.Inertia(mass_kg, centre_m, inertia)
    model.inertias[at] = model.inertias[at] + mount.placement.act(body)
    return model


def rigid_nm(model: Any, where: Array, speed: Array, pull: Array) -> Array:
    """Return Newton-Euler torques along a motion [rad, rad/s, rad/s²], all (T, J)."""
    library, data = import_module("pinocchio"), model.createData()
    rows = zip(where, speed, pull, strict=True)
    return np.array([library.rnea(model, data, *row).copy() for row in rows])


@cache
def described_arm(urdf: Path) -> Any:
    """Load Pinocchio's model of a description; continuous joints become revolute."""
    text = urdf.read_text(encoding="utf-8").replace('"continuous"', '"revolute"')
    text = text.replace("<limit effort", '<limit lower="-6.3" upper="6.3" effort')
    model = import_module("pinocchio").buildModelFromXML(text)
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY_M_S2])
    return model


# ---- Several runs of one arm, as people have them who keep a card of theirs.


def stranger_runs(
    urdf: Path,
    tool: str,
    seed: int,
    troubles: Troubles,
    payloads: Sequence[tuple[float, Array] | None],
) -> list[StrangerRun]:
    """Draw an arm, and runs of it along other motions, its sensors' zeros drifting in between."""
    rng = np.random.default_rng([seed, DRAW, 1])
    arm = StrangerArm.drawn(urdf, tool, rng, troubles)
    rate_hz = float(rng.choice([50.0, 80.0, 100.0, 125.0]))
    runs: list[StrangerRun] = []
    for payload in payloads:
        motion = StrangerMotion.drawn(arm.model, rng)
        draws = {**arm.draws, "drift": rng.standard_normal(len(arm.limit_nm))}
        drifted = replace(arm, draws=draws)
        runs.append(drifted.run(motion, rate_hz, payload, rng, before=False))
    return runs
