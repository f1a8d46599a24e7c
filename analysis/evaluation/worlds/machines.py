"""Simulate a pendulum, an arm and a block without an engine, with their owners' MuJoCo models.

SciPy integrates the first two; the block slides in closed form. A model's values are wrong where
they are to be tuned. Of each machine there are logs that leave a parameter unidentifiable, and
models of another machine. `sample_logs/models` is made by

    python -m tunenet_logs.analysis.evaluation.worlds.machines
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from math import cos, sin
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

from tunenet_logs.analysis.api import save_episode
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal

# ---- Logs: quantities, their sensors, and the model that goes with them.

START_NS = 1_700_000_000_123_456_789  # of all logs, by their own clock
NOISE = 0.02  # white noise of a sensor, over the standard deviation of what it measures
GRAVITY_M_S2 = 9.81  # that MuJoCo assumes, and the machines feel
STATES_HZ = 100.0


@dataclass(frozen=True, eq=False)
class ModelLog:
    """A user's log and model, and the truth."""

    episode: Episode  # the log, as it is read
    truth: Mapping[str, float]  # by the addresses of what is tuned
    model: str  # the text of the MJCF file, whose values are wrong where they are to be tuned
    tune: tuple[str, ...]  # what stands after `--tune`, with ranges
    # the signals without noise, by name, each of shape (T, C)
    clean: Mapping[str, Array]
    # standard deviation of the noise of each column, by signal, each of shape (C,)
    noise: Mapping[str, Array]
    unidentifiable: tuple[str, ...] = ()  # addresses of what is unidentifiable from this log


@dataclass(frozen=True, eq=False)
class Sensed:
    """Quantity before its sensor."""

    seconds: Array  # when it is sampled, after the log's start, shape (T,)
    values: Array  # shape (T, C)
    columns: tuple[str, ...]  # the C names
    unit: str
    # standard deviation of its sensor, in the values' unit; None for `NOISE` of the values' own; 0
    # of what is known
    noise: float | None = None


def sample_times(length_s: float, rate_hz: float, rng: np.random.Generator) -> Array:
    """Draw times of samples from 0 on, with jitter, shape (T,) [s]; whole nanoseconds."""
    seconds = np.arange(0.0, length_s, 1 / rate_hz)
    most_s = 0.4 / rate_hz
    # about an even clock; stamps say when they were taken
    seconds[1:] += np.clip(rng.normal(0.0, 2e-4, len(seconds) - 1), -most_s, most_s)
    return np.round(seconds * 1e9) * 1e-9


def recorded(
    sensed: Mapping[str, Sensed],
    noise: float,
    rng: np.random.Generator,
    truth: Mapping[str, float],
    model: str,
    tune: tuple[str, ...],
) -> ModelLog:
    """Record quantities at so many times the usual noise; a joint held still has the other's."""
    signals: dict[str, Signal] = {}
    sizes: dict[str, Array] = {}
    for name, one in sensed.items():
        size = np.full(len(one.columns), one.noise or 0.0)
        if one.noise is None:
            moved = np.std(one.values, axis=0)
            size = NOISE * np.where(moved > 1e-9, moved, np.max(moved))
        sizes[name] = noise * size
        values = one.values + sizes[name] * rng.standard_normal(one.values.shape)
        stamps_ns = START_NS + np.round(1e9 * one.seconds).astype(np.int64)
        signals[name] = Signal(name, stamps_ns, values, one.columns, one.unit)
    clean = {name: one.values for name, one in sensed.items()}
    return ModelLog(Episode(EpisodeInfo(), signals), truth, model, tune, clean, sizes)


# ---- Pendulum with viscous and dry friction, integrated from reversal to reversal.

JOINT = "hinge"  # by the name of which log and model know it
PENDULUM_DAMPING, FRICTION, ARMATURE, MASS = (
    f"joint/{JOINT}.damping",
    f"joint/{JOINT}.frictionloss",
    f"joint/{JOINT}.armature",
    "body/bob.mass",
)

_PENDULUM_TUNE = (f"{PENDULUM_DAMPING}=0:0.2", f"{FRICTION}=0:0.3", f"{ARMATURE}=0:0.1")

_LENGTH_S = 8.0
_MASS_KG, _ARM_M, _INERTIA_KG_M2 = 1.0, 0.4, 0.005


# Dry friction's rows work against the speed that a step would end with: with a damping of 1.9 over
# the step (3800), friction turns over in the middle of a step in the mean, as dry friction does.
PENDULUM = """\
<mujoco model="pendulum">
  <option timestep="0.0005" integrator="implicitfast" gravity="{gravity}"/>
  <worldbody>
    <body name="bob">
      <joint name="hinge" type="hinge" axis="0 -1 0" damping="0.01" frictionloss="0.01"
             armature="0.002" solreffriction="-1e-6 -3800" solimpfriction="0.99 0.999 0.001 0.5 2"/>
      <inertial pos="0 0 -0.4" mass="{mass}" diaginertia="0.005 0.005 0.005"/>
    </body>
  </worldbody>
</mujoco>
"""

EARTH = f"0 0 -{GRAVITY_M_S2}"


@dataclass(frozen=True)
class Pendulum:
    """Pendulum released at rest."""

    damping: float  # [N·m·s/rad]
    friction: float  # dry [N·m]
    armature: float  # [kg·m²], beside the bob's own inertia
    angle_rad: float  # from which it is let go

    @property
    def inertia(self) -> float:
        """Moment about the hinge [kg·m²]."""
        return _MASS_KG * _ARM_M**2 + _INERTIA_KG_M2 + self.armature

    def pull(self, angle_rad: float) -> float:
        """Return gravity's torque [N·m]."""
        return -_MASS_KG * GRAVITY_M_S2 * _ARM_M * float(np.sin(angle_rad))

    def at(self, seconds: Array) -> Array:
        """Return angle [rad] and speed [rad/s] at increasing times from 0 on, shape (T, 2).

        Friction is exact: it has one sign from one reversal to the next, and holds the pendulum
        for good where gravity pulls less.
        """
        out = np.empty((len(seconds), 2))
        now_s, angle_rad, last_s = 0.0, self.angle_rad, float(seconds[-1])
        for _ in range(200):
            left = seconds >= now_s
            if abs(self.pull(angle_rad)) <= self.friction or now_s >= last_s:
                out[left] = (angle_rad, 0.0)
                return out
            solved = self._until_it_turns(now_s, angle_rad, last_s)
            now_s, angle_rad = float(solved.t[-1]), float(solved.y[0, -1])
            inside = left & (seconds <= now_s)
            out[inside] = solved.sol(seconds[inside]).T
        raise AssertionError("the pendulum turns too often")

    def _until_it_turns(self, now_s: float, angle_rad: float, last_s: float) -> Any:
        inertia, way = self.inertia, float(np.sign(self.pull(angle_rad)))

        def rates(_: float, state: Array) -> list[float]:
            torque = self.pull(state[0]) - self.damping * state[1] - way * self.friction
            return [state[1], torque / inertia]

        def turns(_: float, state: Array) -> float:
            return float(state[1])

        turns.terminal, turns.direction = True, -way  # pyright: ignore[reportFunctionMemberAccess]
        return solve_ivp(
            *(rates, (now_s, last_s + 1e-9), [angle_rad, way * 1e-12], "DOP853"),
            dense_output=True,
            events=turns,
            rtol=1e-11,
            atol=1e-11,
        )


def pendulum_log(seed: int, noise: float = 1.0, run: int = 0) -> ModelLog:
    """Simulate a swing of 8 s, of which three parameters are tuned; each run has its own start."""
    rng = np.random.default_rng((seed, 1))
    pendulum = Pendulum(
        damping=float(np.exp(rng.uniform(np.log(0.02), np.log(0.1)))),
        friction=float(rng.uniform(0.02, 0.12)),
        armature=float(rng.uniform(0.01, 0.05)),
        angle_rad=float(rng.uniform(1.2, 2.4) * rng.choice([-1.0, 1.0])),
    )
    if run:
        rng = np.random.default_rng((seed, 1, run))
        angle_rad = float(rng.uniform(1.2, 2.4) * rng.choice([-1.0, 1.0]))
        pendulum = replace(pendulum, angle_rad=angle_rad)
    seconds = sample_times(_LENGTH_S, STATES_HZ, rng)
    motion = pendulum.at(seconds)
    sensed = {
        "/joint_states.position": Sensed(seconds, motion[:, :1], (JOINT,), "rad"),
        "/joint_states.velocity": Sensed(seconds, motion[:, 1:], (JOINT,), "rad/s"),
    }
    truth = {
        PENDULUM_DAMPING: pendulum.damping,
        FRICTION: pendulum.friction,
        ARMATURE: pendulum.armature,
    }
    model = PENDULUM.format(gravity=EARTH, mass=_MASS_KG)
    return recorded(sensed, noise, rng, truth, model, _PENDULUM_TUNE)


def pendulum_of_unknown_mass(seed: int, noise: float = 1.0) -> ModelLog:
    """Simulate the same with the bob's mass tuned as well: a swing determines ratios alone."""
    model = PENDULUM.format(gravity=EARTH, mass=1.3)
    log = _tuned_too(pendulum_log(seed, noise), MASS, _MASS_KG, "0.2:3", model)
    return replace(log, unidentifiable=tuple(log.truth))


def _tuned_too(log: ModelLog, address: str, truth: float, ends: str, model: str) -> ModelLog:
    """Return the log with one more parameter to tune, which is unidentifiable."""
    return replace(
        log,
        truth={**log.truth, address: truth},
        model=model,
        tune=(*log.tune, f"{address}={ends}"),
        unidentifiable=(address,),
    )


# ---- Planar two-link arm under delayed servos, with a payload at its tip.

LINKS_M = (0.4, 0.3)
LINKS_KG = (1.5, 1.0)
LINKS_KG_M2 = (0.02, 0.008)  # about the links' centres, which are in their middles
ARMATURE_KG_M2, DAMPING = 0.02, 0.3
KP, KV = np.array([120.0, 60.0]), np.array([12.0, 3.0])

_TERMS = 3
_EASING_S = 0.5
_ARM_TOLERANCE = 1e-9


@dataclass(frozen=True)
class PlanarArm:
    """Planar arm; angles are 0 where it hangs down, the elbow's against the first link."""

    payload_kg: float  # at the tip
    delay_s: float  # after which a servo obeys a command
    elbow_is_held: bool = False  # whether a brake holds the elbow where the first command wants it

    def weight(self, first_rad: float, second_rad: float) -> tuple[float, float]:
        """Return the gravity torques of the joints [N·m]."""
        first_m, second_m = LINKS_M
        second = LINKS_KG[1] * second_m / 2 + self.payload_kg * second_m
        first = LINKS_KG[0] * first_m / 2 + (LINKS_KG[1] + self.payload_kg) * first_m
        tip = GRAVITY_M_S2 * second * sin(first_rad + second_rad)
        return GRAVITY_M_S2 * first * sin(first_rad) + tip, tip

    def accelerations(
        self, angles_rad: tuple[float, float], speeds: tuple[float, float], torques: Array
    ) -> tuple[float, float]:
        """Return joint accelerations [rad/s²] under the servos' torques [N·m], shape (2,)."""
        first_m, second_m = LINKS_M
        tip_kg_m2 = 0.4 * self.payload_kg * 0.02**2
        # moments of the second link and the payload about the elbow, first and second
        moment = LINKS_KG[1] * second_m / 2 + self.payload_kg * second_m
        elbow = LINKS_KG_M2[1] + LINKS_KG[1] * (second_m / 2) ** 2
        elbow += tip_kg_m2 + self.payload_kg * second_m**2
        carried = LINKS_KG_M2[0] + LINKS_KG[0] * (first_m / 2) ** 2
        carried += (LINKS_KG[1] + self.payload_kg) * first_m**2
        cross = first_m * moment * cos(angles_rad[1])
        swing = first_m * moment * sin(angles_rad[1])
        weight = self.weight(*angles_rad)
        first = float(torques[0]) - DAMPING * speeds[0] - weight[0]
        first += swing * (2 * speeds[0] + speeds[1]) * speeds[1]
        second = float(torques[1]) - DAMPING * speeds[1] - weight[1] - swing * speeds[0] ** 2
        shoulder = carried + elbow + 2 * cross + ARMATURE_KG_M2
        if self.elbow_is_held:
            return first / shoulder, 0.0
        both, elbow = elbow + cross, elbow + ARMATURE_KG_M2
        area = shoulder * elbow - both**2
        return (elbow * first - both * second) / area, (shoulder * second - both * first) / area

    def moved(self, seconds: Array, told_s: Array, told_rad: Array) -> tuple[Array, Array, Array]:
        """Integrate angles [rad], speeds [rad/s] and servo torques [N·m], each (T, 2).

        Args:
            seconds: increasing, from 0 on, shape (T,).
            told_s: when commands are given, from 0 on, shape (K,).
            told_rad: the commands, each held until the next, shape (K, 2); before the first is
                obeyed the arm rests where the first holds it.
        """
        edges = told_s + self.delay_s
        wanted = told_rad[np.maximum(np.searchsorted(edges, seconds, "right") - 1, 0)]
        state = np.concatenate([self._rest(told_rad[0]), np.zeros(2)])
        states = np.empty((len(seconds), 4))
        states[seconds < edges[0]] = state
        ends = np.append(edges[1:], max(seconds[-1], edges[-1]) + 1e-3)
        for start_s, end_s, command in zip(edges, ends, told_rad, strict=True):
            inside = (seconds >= start_s) & (seconds < end_s)
            solved = solve_ivp(
                self._rates,
                (start_s, end_s),
                state,
                "DOP853",
                t_eval=np.append(seconds[inside], end_s),
                args=(command,),
                rtol=_ARM_TOLERANCE,
                atol=_ARM_TOLERANCE,
            )
            states[inside] = solved.y[:, :-1].T
            state = solved.y[:, -1]
        angles_rad, speeds = states[:, :2], states[:, 2:]
        return angles_rad, speeds, KP * (wanted - angles_rad) - KV * speeds

    def _rates(self, _: float, state: Array, command: Array) -> Array:
        torques = KP * (command - state[:2]) - KV * state[2:]
        first_rad, second_rad, first, second = state.tolist()
        pulls = self.accelerations((first_rad, second_rad), (first, second), torques)
        return np.array([first, second, *pulls])

    def _rest(self, command: Array) -> Array:
        """Solve for where the servos hold the arm, shape (2,) [rad]."""

        def unheld(angles_rad: Array) -> Array:
            torques = KP * (command - angles_rad) - self.weight(*angles_rad.tolist())
            if self.elbow_is_held:
                torques[1] = command[1] - angles_rad[1]
            return torques

        return np.asarray(fsolve(unheld, command, xtol=1e-12), np.float64)


# ---- Logs of the arm, with its owner's model.

JOINTS = ("shoulder", "elbow")
PAYLOAD, DELAY, ELBOW_DAMPING = "body/payload.mass", "delay/commands", "joint/elbow.damping"

_ARM_TUNE = (f"{PAYLOAD}=0.05:3", f"{DELAY}=0:0.1")

ELBOW = '<joint name="elbow" type="hinge" axis="0 -1 0" damping="0.3" armature="0.02"/>'
ELBOW_SERVO = '<position name="elbow" joint="elbow" kp="60" kv="3"/>'

_BRAKE = """\
  <equality>
    <joint joint1="elbow" polycoef="{angle:.9f} 0 0 0 0" solref="0.002 1"
           solimp="0.99 0.9999 0.001 0.5 2"/>
  </equality>
"""

_ARM = """\
<mujoco model="planar arm">
  <option timestep="0.001" integrator="RK4" gravity="{gravity}"/>
  <worldbody>
    <body name="upper_arm">
      <joint name="shoulder" type="hinge" axis="0 -1 0" damping="0.3" armature="0.02"/>
      <inertial pos="0 0 -{first_middle:g}" mass="1.5" diaginertia="0.02 0.02 0.002"/>
      <body name="forearm" pos="0 0 -{first:g}"{turned}>
        {elbow}
        <inertial pos="0 0 -{second_middle:g}" mass="1" diaginertia="0.008 0.008 0.001"/>
        <body name="payload" pos="0 0 -{second:g}">
          <inertial pos="0 0 0" mass="1" diaginertia="0.00016 0.00016 0.00016"/>
        </body>
      </body>
    </body>
  </worldbody>
{brake}  <actuator>
    <position name="shoulder" joint="shoulder" kp="120" kv="12"/>
    {servo}
  </actuator>
</mujoco>
"""


def arm_model(
    *,
    gravity: str = EARTH,
    links_m: tuple[float, float] = LINKS_M,
    held_rad: float | None = None,
    welded_rad: float | None = None,
) -> str:
    """Return the MJCF text of an owner's model.

    Args:
        gravity: three numbers [m/s²].
        links_m: lengths of the two links, with their centres in the middle.
        held_rad: where a brake holds the elbow; None without one.
        welded_rad: angle between the links of a model that has no elbow; None of one that has.
    """
    has_elbow = welded_rad is None
    return _ARM.format(
        gravity=gravity,
        first=links_m[0],
        second=links_m[1],
        first_middle=links_m[0] / 2,
        second_middle=links_m[1] / 2,
        turned="" if welded_rad is None else f' axisangle="0 -1 0 {np.degrees(welded_rad):.6f}"',
        elbow=ELBOW * has_elbow,
        servo=ELBOW_SERVO * has_elbow,
        brake="" if held_rad is None else _BRAKE.format(angle=held_rad),
    )


def arm_log(seed: int, noise: float = 1.0, run: int = 0) -> ModelLog:
    """Simulate a motion of 8 s, of which payload and delay are tuned; each run has its own."""
    return _arm_log((seed, 2), noise, elbow_is_held=False, run=run)


def arm_with_a_brake(seed: int, noise: float = 1.0) -> ModelLog:
    """Simulate the same with the elbow held, so that its damping is unidentifiable."""
    return _arm_log((seed, 3), noise, elbow_is_held=True)


def _arm_log(
    seeds: tuple[int, int], noise: float, *, elbow_is_held: bool, run: int = 0
) -> ModelLog:
    rng = np.random.default_rng(seeds)
    payload_kg = float(np.exp(rng.uniform(np.log(0.2), np.log(2.0))))
    arm = PlanarArm(payload_kg, float(rng.uniform(0.005, 0.06)), elbow_is_held)
    if run:
        rng = np.random.default_rng((*seeds, run))
    # Commands are sums of sines of some 0.6 rad about some posture, eased in from rest.
    shape = (_TERMS, 2)
    middle = np.array([rng.uniform(0.3, 1.2), rng.uniform(-0.3, 1.0)])
    shares = rng.uniform(0.5, 1.0, shape)
    amplitudes = 0.6 * shares / np.sum(shares, axis=0)
    amplitudes[:, 1] *= not elbow_is_held
    rates = 2 * np.pi * rng.uniform(0.15, 1.2, shape)
    phases = rng.uniform(0, 2 * np.pi, shape)
    told_s = sample_times(_LENGTH_S, 50.0, rng)
    share = (told_s / _EASING_S).clip(0.0, 1.0)
    waves = np.sum(amplitudes * np.sin(rates * told_s[:, None, None] + phases), axis=1)
    told_rad = middle + (share**2 * (3 - 2 * share))[:, None] * waves
    seconds = sample_times(_LENGTH_S, STATES_HZ, rng)
    angles_rad, speeds, torques = arm.moved(seconds, told_s, told_rad)
    sensed = {
        "/joint_states.position": Sensed(seconds, angles_rad, JOINTS, "rad"),
        "/joint_states.velocity": Sensed(seconds, speeds, JOINTS, "rad/s"),
        "/joint_states.effort": Sensed(seconds, torques, JOINTS, "N·m"),
        "/joint_commands.position": Sensed(told_s, told_rad, JOINTS, "rad", 0.0),
    }
    truth = {PAYLOAD: arm.payload_kg, DELAY: arm.delay_s}
    log = recorded(sensed, noise, rng, truth, arm_model(), _ARM_TUNE)
    if not elbow_is_held:
        return log
    return _tuned_too(log, ELBOW_DAMPING, 0.3, "0:2", arm_model(held_rad=float(middle[1])))


# ---- Zero-order hold: commands, held until the next one is obeyed, as steps see them.


@dataclass(frozen=True, eq=False)
class HeldCommands:
    """Commands as they are given."""

    seconds: Array  # when, increasing, shape (K,)
    values: Array  # each held until the next, the first from ever on, shape (K, C)

    def over_steps(self, step_s: float, count: int, delay_s: float) -> Array:
        """Average what is obeyed in each step from 0 on, shape (count, C).

        A mean changes smoothly with the delay; what is held at the steps' starts would jump.
        """
        edges: Array = np.arange(count + 1, dtype=np.float64) * step_s - delay_s
        return np.diff(self._integral(edges), axis=0) / step_s

    def _integral(self, seconds: Array) -> Array:
        """Integrate from the first command on, shape (T, C); negative before it."""
        lengths = np.diff(self.seconds)[:, None]
        sums = np.concatenate([np.zeros((1, self.values.shape[1])), self.values[:-1] * lengths])
        last = np.maximum(np.searchsorted(self.seconds, seconds, "right") - 1, 0)
        held_s = (seconds - self.seconds[last])[:, None]
        return np.cumsum(sums, axis=0)[last] + self.values[last] * held_s


# ---- Block that slides over the floor until friction has stopped it.

BLOCK_FRICTION, BLOCK_MASS = "geom/block.friction[0]", "body/block.mass"
POSE = "/block/pose"

_BLOCK_TUNE = (f"{BLOCK_FRICTION}=0.02:1.2",)
_NOISE_M = 1e-3
_BLOCK_KG = 1.5

# Of two geoms that touch, MuJoCo takes the larger friction. Its contacts push a sliding block off
# the floor, by friction times speed times damping over stiffness, and let it creep before it stops,
# by more the less they damp: this floor is stiff, damps little, and lets it creep by 0.15 mm at a
# friction of 0.65. A long step and a high impratio make it hop.
BLOCK = """\
<mujoco model="block on a floor">
  <option timestep="0.00025" cone="elliptic" impratio="0.1" gravity="{gravity}"/>
  <default>
    <geom solref="-60000 -150" solimp="0.999 0.999 0.0001 0.5 2"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" friction="0.01 0.005 0.0001"/>
    <body name="block" pos="0 0 0.03">
      <freejoint name="block"/>
      <geom name="block" type="box" size="0.2 0.2 0.03" mass="{mass}" friction="1 0.005 0.0001"/>
    </body>
  </worldbody>
</mujoco>
"""


def block_log(seed: int, noise: float = 1.0, run: int = 0) -> ModelLog:
    """Simulate a slide, without turning, and a second of rest, of which friction is tuned.

    Each run has its own start and speed.
    """
    rng = np.random.default_rng((seed, 4))
    friction = float(np.exp(rng.uniform(np.log(0.1), np.log(0.7))))
    if run:
        rng = np.random.default_rng((seed, 4, run))
    along, aside = rng.uniform(0.5, 2.5), rng.uniform(-0.1, 0.1)
    start_m, velocity_m_s = rng.uniform(-0.5, 0.5, 2), along * np.array([1.0, aside])
    stops_s = float(np.linalg.norm(velocity_m_s)) / (friction * GRAVITY_M_S2)
    seconds = sample_times(stops_s + 1.0, STATES_HZ, rng)
    slid_s = np.minimum(seconds, stops_s)[:, None]
    flat_m = start_m + velocity_m_s * (slid_s - slid_s**2 / (2 * stops_s))
    places_m = np.column_stack([flat_m, np.full(len(seconds), 0.03)])
    sensed = {POSE: Sensed(seconds, places_m, ("x", "y", "z"), "m", _NOISE_M)}
    model = BLOCK.format(gravity=EARTH, mass=_BLOCK_KG)
    return recorded(sensed, noise, rng, {BLOCK_FRICTION: friction}, model, _BLOCK_TUNE)


def block_of_unknown_mass(seed: int, noise: float = 1.0) -> ModelLog:
    """Simulate the same with the mass tuned as well, which is unidentifiable."""
    model = BLOCK.format(gravity=EARTH, mass=1.0)
    return _tuned_too(block_log(seed, noise), BLOCK_MASS, _BLOCK_KG, "0.2:5", model)


# ---- Models of other machines, with which no tuning may be content.

_GRAVITIES = {
    "gravity of 1.62 m/s²": "0 0 -1.62",
    "gravity of 3.7 m/s²": "0 0 -3.7",
    "gravity turned by 90 degrees": f"-{GRAVITY_M_S2} 0 0",
}


def wrong_pendulums(_: ModelLog) -> dict[str, str]:
    """Return texts of models for any log, by what is wrong."""
    return {name: PENDULUM.format(gravity=one, mass=_MASS_KG) for name, one in _GRAVITIES.items()}


def wrong_arms(log: ModelLog) -> dict[str, str]:
    """Return wrong models for an arm's log: a missing elbow is welded where the log begins."""
    models = {name: arm_model(gravity=gravity) for name, gravity in _GRAVITIES.items()}
    angle_rad = float(log.episode.signals["/joint_states.position"].values[0, 1])
    models["no elbow"] = arm_model(welded_rad=angle_rad)
    for name, factor in (("longer", 1.3), ("shorter", 0.7)):
        first_m, second_m = (factor * np.array(LINKS_M)).tolist()
        models[f"links 30 % {name}"] = arm_model(links_m=(first_m, second_m))
    return models


def wrong_blocks(log: ModelLog) -> dict[str, str]:
    """Return wrong models for a block's log, but those that slide alike with other friction.

    A slide determines friction times gravity alone, so that less gravity is seen only where the
    friction that makes up for it is a tenth beyond the range.
    """
    models = {name: BLOCK.format(gravity=one, mass=_BLOCK_KG) for name, one in _GRAVITIES.items()}
    for name, gravity_m_s2 in zip(_GRAVITIES, (1.62, 3.7), strict=False):
        if log.truth[BLOCK_FRICTION] * GRAVITY_M_S2 / gravity_m_s2 < 1.1 * 1.2:
            del models[name]
    return models


# ---- Machines: what is tuned of each, what is unidentifiable from a log, and wrong models.


@dataclass(frozen=True)
class Machine:
    """Kind of machine."""

    name: str  # in words
    log: Callable[[int, float], ModelLog]  # of a seed and so many times the usual noise
    again: Callable[[int, float], ModelLog]  # another run of the very machine
    # the same with one more parameter, which is unidentifiable
    unidentifiable: Callable[[int, float], ModelLog]
    # texts of models that are of another machine than a log's, by what is wrong
    wrong: Callable[[ModelLog], Mapping[str, str]]


# `log` and `unidentifiable` give the same for the same seed and noise, whatever else is drawn.
MACHINES = (
    Machine(
        "pendulum",
        pendulum_log,
        partial(pendulum_log, run=1),
        pendulum_of_unknown_mass,
        wrong_pendulums,
    ),
    Machine("arm", arm_log, partial(arm_log, run=1), arm_with_a_brake, wrong_arms),
    Machine("block", block_log, partial(block_log, run=1), block_of_unknown_mass, wrong_blocks),
)


# ---- The sample logs of machines and their owners' models: the same bytes each time.

SEEDS = {"pendulum": 3, "arm": 5, "block": 2}


def write_samples(folder: Path) -> None:
    """Write a log, a model and what is tuned of it, for each machine."""
    folder.mkdir(parents=True, exist_ok=True)
    for machine in MACHINES:
        log = machine.log(SEEDS[machine.name], 1.0)
        save_episode(log.episode, folder / f"{machine.name}.mcap", overwrite=True)
        (folder / f"{machine.name}.xml").write_text(log.model)
        tuned = (text.replace("=", ":").split(":") for text in log.tune)
        lines = [f"{address}: [{low}, {high}]\n" for address, low, high in tuned]
        (folder / f"{machine.name}.yaml").write_text("".join(lines))


if __name__ == "__main__":
    write_samples(Path("sample_logs/models"))
