"""Simulate the payload task: an arm moves along a path with an unknown mass.

The torques are those of an engine's inverse dynamics, or of the motors in a rollout (the paper's
first experiment). `driver_episode` adds the errors of sensors, model and timing with which a real
arm's driver publishes them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass, field, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal, median_step
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.arm.description import Arm, Payload
from tunenet_logs.recorders.simulators.arm.path import JointPath
from tunenet_logs.recorders.simulators.base import UPRIGHT_GRAVITY_M_S2, Parameter, RolloutSettings
from tunenet_logs.recorders.simulators.known import engine

# ---- Disturbances: between ideal torques and a driver's messages


@dataclass(frozen=True)
class FieldClock:
    """Update rate of each field of a message [Hz]; inf: new in every message."""

    position_hz: float = math.inf
    velocity_hz: float = math.inf
    effort_hz: float = math.inf

    def __post_init__(self) -> None:
        for item in fields(self):
            if not getattr(self, item.name) > 0:
                raise UsageError(f"{item.name} is over 0, not {getattr(self, item.name):g}")


# Measured in a log of 65 messages a second: between new values the old ones are repeated.
KINOVA_CLOCK = FieldClock(position_hz=30.0, velocity_hz=16.0, effort_hz=58.0)


@dataclass(frozen=True)
class Disturbances:
    """Errors between ideal torques and a driver's messages; none by default.

    What is drawn for each joint is a tuple, base to tool; empty for none.
    """

    torque_noise_nm: float = 0.0  # standard deviation, white
    offset_nm: tuple[float, ...] = ()  # added to each joint's torque
    viscous_nm_s: tuple[float, ...] = ()  # viscous friction [N·m s/rad]
    coulomb_nm: tuple[float, ...] = ()  # Coulomb friction
    gain_error: tuple[float, ...] = ()  # 0.03 for a torque read 3 % too large
    lag_s: float = 0.0  # delay of the torques
    link_mass_error: tuple[float, ...] = ()  # 0.05 for a link 5 % heavier than the description says
    link_com_error_m: tuple[tuple[float, float, float], ...] = ()  # offset of its centre of mass
    rate_hz: float | None = None  # messages a second; None for one at each of the path's samples
    jitter_s: float = 0.0  # standard deviation of a message's time
    clock: FieldClock = field(default_factory=FieldClock)  # update rates of the fields
    position_noise_rad: float = 0.0  # standard deviation, white
    position_step_rad: float = 0.0  # quantisation step of positions; 0 for none
    velocity_noise_rad_s: float = 0.0  # standard deviation, white
    noise_seed: int = 0  # of what is drawn anew for each sample

    def __post_init__(self) -> None:
        for item in fields(self):
            values = np.ravel(getattr(self, item.name))
            if item.name in ("rate_hz", "clock", "noise_seed"):
                continue
            if not np.all(np.abs(values.astype(np.float64)) <= 1e6):  # more counts as infinite
                raise UsageError(f"{item.name} {getattr(self, item.name)} is not finite")
        for item in fields(self):  # all single ones are deviations, delays or steps
            value = getattr(self, item.name)
            if item.default == 0.0 and item.name != "noise_seed" and value < 0:
                raise UsageError(f"{item.name} {value:g} is below 0")
        if self.rate_hz is not None and not 1 <= self.rate_hz <= 20_000:
            raise UsageError(f"rate_hz {self.rate_hz:g} is not from 1 to 20000")

    @property
    def lead_s(self) -> float:
        """Duration of the path that precedes the first message [s]."""
        return self.lag_s + 1 / min(astuple(self.clock)) + 4 * self.jitter_s

    def another_run(self) -> Disturbances:
        """Copy with the noise redrawn, as for another run of the same arm (tare)."""
        return replace(self, noise_seed=self.noise_seed + 1)

    def in_words(self) -> dict[str, str]:
        """Describe the disturbances for a log's notes."""
        words: dict[str, str] = {}
        for item in fields(self):
            value = getattr(self, item.name)
            if value == item.default or item.name in ("clock", "noise_seed") or value == ():
                continue
            words[item.name] = ", ".join(f"{number:.6g}" for number in np.ravel(value).tolist())
        if self.clock != FieldClock():
            words["fields_hz"] = ", ".join(f"{rate_hz:g}" for rate_hz in astuple(self.clock))
        return words


@dataclass(frozen=True)
class DisturbanceScales:
    """Standard deviations of the disturbances, 0 for none; by default a real arm's."""

    torque_noise_nm: float = 0.2
    offset_nm: float = 0.3
    friction_nm: float = 0.5  # of viscous friction [N·m s/rad] and of Coulomb friction [N·m]
    gain_error: float = 0.03
    most_lag_s: float = 0.03  # lags are drawn uniformly from 0 to this
    link_mass_error: float = 0.05
    link_com_error_m: float = 0.003
    friction_opposes: bool = True  # friction is drawn against the motion; else of either sign


REAL_ARM = DisturbanceScales()
NO_ERRORS = DisturbanceScales(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def drawn(seed: int, arm: Arm, sizes: DisturbanceScales = REAL_ARM) -> Disturbances:
    """Draw one arm's disturbances from a seed: of torques, and of the arm's description."""
    # The same seed draws the same for every combination of sizes, scaled.
    rng = np.random.default_rng([seed, 0xD217])
    count = len(arm.joints)
    offset, viscous, coulomb, gain, mass = rng.normal(0.0, 1.0, (5, count))
    com, lag_fraction = rng.normal(0.0, 1.0, (count, 3)), rng.uniform()
    if sizes.friction_opposes:
        viscous, coulomb = np.abs(viscous), np.abs(coulomb)

    def scaled(values: Array, size: float) -> tuple[float, ...]:
        return tuple((size * values).tolist()) if size else ()

    com_m = tuple((x, y, z) for x, y, z in (sizes.link_com_error_m * com).tolist())
    return Disturbances(
        torque_noise_nm=sizes.torque_noise_nm,
        offset_nm=scaled(offset, sizes.offset_nm),
        viscous_nm_s=scaled(viscous, sizes.friction_nm),
        coulomb_nm=scaled(coulomb, sizes.friction_nm),
        gain_error=scaled(gain, sizes.gain_error),
        lag_s=float(sizes.most_lag_s * lag_fraction),
        link_mass_error=scaled(np.clip(mass, -4, 4), sizes.link_mass_error),
        link_com_error_m=com_m if sizes.link_com_error_m else (),
        noise_seed=2 * seed,
    )


def through_kinovas_driver(disturbances: Disturbances, rate_hz: float = 65.0) -> Disturbances:
    """Add a Kinova driver's jitter, stale fields and quantised positions."""
    # At 20 messages a second and fewer every field is new in each.
    return replace(
        disturbances,
        rate_hz=rate_hz,
        jitter_s=min(0.0015, 0.1 / rate_hz),
        clock=KINOVA_CLOCK if rate_hz > 20 else FieldClock(),
        position_noise_rad=2e-4,
        position_step_rad=1e-4,
        velocity_noise_rad_s=0.01,
    )


# ---- Inverse dynamics: joint torques along a path


def joint_efforts_nm(
    arm: Arm,
    path: JointPath,
    payload: Payload | None = None,
    gravity_m_s2: tuple[float, float, float] = UPRIGHT_GRAVITY_M_S2,
) -> Array:
    """Compute the torques that rigid links need on a path, (T, J) [N·m], or [N] of a slide."""
    return engine().inverse_dynamics(arm, path.checked(arm), payload, gravity_m_s2)


def held_efforts_nm(arm: Arm, path: JointPath) -> Array:
    """Compute the gravity torques, (T, J) [N·m], of the empty arm at each position of a path."""
    still = np.zeros_like(path.position_rad)
    return joint_efforts_nm(arm, JointPath(path.seconds, path.position_rad, still, still))


# ---- Rollout: the arm follows the path by position control

# The torques are those of rigid links: inverse dynamics along the path gives them too.
CALIBRATED = RolloutSettings("default")

# Gains and gravity of the paper's authors, the rest as PyBullet comes.
PAPER = RolloutSettings(
    "paper",
    gravity_m_s2=(0.0, 0.0, -10.0),
    position_gain=0.03,
    solver_iterations=50,
    is_damped=True,
)

PRESETS = {settings.name: settings for settings in (CALIBRATED, PAPER)}


@dataclass(frozen=True, eq=False)
class Rollout:
    """Recording of one rollout."""

    path: JointPath  # states before each recorded step; accelerations are those of the step
    effort_nm: Array  # motor torques in that step, shape (samples, J)


def roll_out(
    arm: Arm,
    path: JointPath,
    payload: Payload | None = None,
    settings: RolloutSettings = CALIBRATED,
) -> Rollout:
    """Follow a path and record the motors' torques, deterministically."""
    path.checked(arm)
    if not np.allclose(path.seconds, settings.times(), rtol=0, atol=1e-9):
        raise ValueError("a rollout's path is wanted at settings.times()")
    states = engine().position_control(arm, path, payload, settings)
    before, after = states[settings.burn_in - 1 : -1], states[settings.burn_in :]
    acceleration = (after[..., 1] - before[..., 1]) * settings.step_hz
    seconds = settings.times()[: settings.samples]
    return Rollout(JointPath(seconds, before[..., 0], before[..., 1], acceleration), after[..., 2])


# ---- Simulators of the payload's mass

TOPIC = "/joint_states"
PAYLOAD_MASS = Parameter(
    name="payload_mass", unit="kg", bounds=(0.0, 20.0), training_range=(0.0, 1.0), initial=0.5
)


@dataclass(eq=False)
class PayloadSimulator:
    """Torques along a path by inverse dynamics.

    They are linear in the mass, to which its inertia is proportional, so two runs of the engine
    serve all masses.
    """

    arm: Arm
    path: JointPath
    com_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gravity_m_s2: tuple[float, float, float] = UPRIGHT_GRAVITY_M_S2
    parameters = (PAYLOAD_MASS,)

    def __post_init__(self) -> None:
        self.path.checked(self.arm)
        self.engine = engine().name
        self.step_hz = 1 / median_step(self.path.seconds)

    @cached_property
    def empty_efforts_nm(self) -> Array:
        """Torques without a payload [N·m], shape (T, J)."""
        return joint_efforts_nm(self.arm, self.path, None, self.gravity_m_s2)

    @cached_property
    def efforts_nm_per_kg(self) -> Array:
        """Torques added by each kilogram [N·m/kg], shape (T, J)."""
        one = Payload(1.0, self.com_m)
        loaded = joint_efforts_nm(self.arm, self.path, one, self.gravity_m_s2)
        return loaded - self.empty_efforts_nm

    def efforts_nm(self, mass_kg: float) -> Array:
        """Torques that a mass takes [N·m], shape (T, J)."""
        return self.empty_efforts_nm + mass_kg * self.efforts_nm_per_kg

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """Move with `values["payload_mass"]`; see `Simulator.rollout`."""
        payload = _payload(values, self.com_m)
        info = payload_info(payload, f"{self.engine}, inverse dynamics", "default")
        return Episode(info, joint_signals(self.arm, self.path, self.efforts_nm(payload.mass_kg)))


@dataclass(eq=False)
class PayloadRollout:
    """Motor torques of a rollout in the engine, as the paper's authors made them."""

    arm: Arm
    path: JointPath  # at `settings.times()`
    com_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of the payload, in the tool frame
    settings: RolloutSettings = CALIBRATED  # of engine and motors
    keep_every: int = 4  # decimation of the steps: 4 makes 60 Hz of 240
    parameters = (PAYLOAD_MASS,)

    def __post_init__(self) -> None:
        self.engine, self.step_hz = engine().name, self.settings.step_hz

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """Move with `values["payload_mass"]`; see `Simulator.rollout`."""
        payload = _payload(values, self.com_m)
        recorded = roll_out(self.arm, self.path, payload, self.settings)
        kept = slice(None, None, self.keep_every)
        path = recorded.path.part(kept)
        info = payload_info(payload, f"{self.engine}, rollout", self.settings.name)
        return Episode(info, joint_signals(self.arm, path, recorded.effort_nm[kept]))


def joint_signals(arm: Arm, path: JointPath, effort_nm: Array) -> dict[str, Signal]:
    """Make a path's position, velocity and effort signals, named as in `/joint_states`."""
    stamps_ns = np.round((path.seconds - path.seconds[0]) * 1e9).astype(np.int64)
    return {
        f"{TOPIC}.{part}": Signal(f"{TOPIC}.{part}", stamps_ns, values, arm.joint_names, unit)
        for part, values, unit in (
            ("position", path.position_rad, "rad"),
            ("velocity", path.velocity_rad_s, "rad/s"),
            ("effort", effort_nm, "N·m"),
        )
    }


def payload_info(
    payload: Payload, source: str, preset: str, notes: Mapping[str, str] | None = None
) -> EpisodeInfo:
    """Make the log info of a simulated payload."""
    truth = {PAYLOAD_MASS.name: payload.mass_kg}
    truth |= {
        f"payload_com_{axis}": value for axis, value in zip("xyz", payload.com_m, strict=True)
    }
    return EpisodeInfo(kind="payload", source=source, preset=preset, truth=truth, notes=notes or {})


def _payload(values: Mapping[str, float], com_m: tuple[float, float, float]) -> Payload:
    if set(values) != {PAYLOAD_MASS.name}:
        raise UsageError(f"an arm takes the value {PAYLOAD_MASS.name}, not {sorted(values)}")
    return Payload(PAYLOAD_MASS.checked(values[PAYLOAD_MASS.name]), com_m)


# ---- Driver: a run as an arm's driver publishes it

STICKING_RAD_S = 0.01  # Coulomb friction changes its sign over about this speed, by a tanh


def perturbed(arm: Arm, disturbances: Disturbances) -> Arm:
    """Apply the link mass and centre-of-mass errors to an arm's description."""
    joints = list(arm.joints)
    for index, error in enumerate(_per_joint(arm, disturbances, "link_mass_error").tolist()):
        link = joints[index].link
        x, y, z, *more = (moment * (1 + error) for moment in link.inertia_kg_m2)
        heavier = replace(link, mass_kg=link.mass_kg * (1 + error), inertia_kg_m2=(x, y, z, *more))
        joints[index] = replace(joints[index], link=heavier)
    _per_joint(arm, disturbances, "link_com_error_m")
    for index, off_m in enumerate(disturbances.link_com_error_m):
        link = joints[index].link
        x, y, z = (at + off for at, off in zip(link.com_m, off_m, strict=True))
        joints[index] = replace(joints[index], link=replace(link, com_m=(x, y, z)))
    return replace(arm, joints=tuple(joints))


def driver_episode(
    arm: Arm, path: JointPath, payload: Payload | None, disturbances: Disturbances
) -> Episode:
    """Simulate a run along a path as the driver publishes it, deterministically."""
    rng = np.random.default_rng([disturbances.noise_seed, 0x4015])
    true_arm = perturbed(arm, disturbances)
    # Add friction, sensor gain and offset to ideal torques, shape (T, J) [N·m].
    ideal_nm = joint_efforts_nm(true_arm, path, payload)
    speed = path.velocity_rad_s
    friction = _per_joint(arm, disturbances, "viscous_nm_s") * speed
    friction += _per_joint(arm, disturbances, "coulomb_nm") * np.tanh(speed / STICKING_RAD_S)
    gain = 1 + _per_joint(arm, disturbances, "gain_error")
    effort_nm = gain * (ideal_nm + friction) + _per_joint(arm, disturbances, "offset_nm")
    # Draw the message stamps [s], shape (T,).
    start_s, end_s = float(path.seconds[0]) + disturbances.lead_s, float(path.seconds[-1])
    if disturbances.rate_hz is None:
        times = path.seconds[path.seconds >= start_s - 1e-12]
    else:
        count = math.floor((end_s - 4 * disturbances.jitter_s - start_s) * disturbances.rate_hz)
        times = start_s + np.arange(max(count + 1, 0)) / disturbances.rate_hz
    if len(times) < 2:
        raise UsageError(f"a path of {end_s - path.seconds[0]:.3g} s is too short for this driver")
    jitter = np.clip(rng.normal(0.0, 1.0, len(times)), -4, 4) * disturbances.jitter_s
    closest = 0.4 * float(np.diff(times).min())
    times = times + np.clip(jitter, -closest, closest)
    clock = disturbances.clock
    position_s, position_at = _fresh_times(times, clock.position_hz, rng)
    velocity_s, velocity_at = _fresh_times(times, clock.velocity_hz, rng)
    effort_s, effort_at = _fresh_times(times, clock.effort_hz, rng)
    position = _at(path.seconds, path.position_rad, position_s)
    velocity = _at(path.seconds, path.velocity_rad_s, velocity_s)
    effort = _at(path.seconds, effort_nm, effort_s - disturbances.lag_s)
    position = position + disturbances.position_noise_rad * rng.normal(0, 1, position.shape)
    velocity = velocity + disturbances.velocity_noise_rad_s * rng.normal(0, 1, velocity.shape)
    effort = effort + disturbances.torque_noise_nm * rng.normal(0, 1, effort.shape)
    if disturbances.position_step_rad:
        step = disturbances.position_step_rad
        position = np.round(position / step) * step
    still = np.zeros((len(times), len(arm.joints)))
    shown = JointPath(times, position[position_at], velocity[velocity_at], still)
    held = payload or Payload(0.0)
    source = f"{engine().name}, inverse dynamics"
    info = payload_info(held, source, "default", disturbances.in_words())
    return Episode(info, joint_signals(arm, shown, effort[effort_at]))


def _per_joint(arm: Arm, disturbances: Disturbances, name: str) -> Array:
    """Return a disturbance of all joints, shape (J,); zeros where there is none."""
    values = getattr(disturbances, name)
    if len(values) not in (0, len(arm.joints)):
        raise UsageError(f"{name} has {len(values)} values for {len(arm.joints)} joints")
    return np.array(values or [0.0] * len(arm.joints))


def _fresh_times(
    times: Array, rate_hz: float, rng: np.random.Generator
) -> tuple[Array, NDArray[np.int64]]:
    """Draw a field's update times [s], shape (F,), and which each message shows, shape (T,)."""
    if math.isinf(rate_hz):
        return times, np.arange(len(times))
    first = times[0] - rng.uniform() / rate_hz
    count = math.floor((times[-1] - first) * rate_hz) + 1
    fresh = first + np.arange(count) / rate_hz
    return fresh, np.searchsorted(fresh, times, side="right") - 1


def _at(seconds: Array, values: Array, wanted: Array) -> Array:
    """Interpolate samples by a cubic spline, shape (len(wanted), J)."""
    if np.array_equal(seconds, wanted):
        return np.array(values)
    from scipy.interpolate import CubicSpline

    return CubicSpline(seconds, values)(np.clip(wanted, seconds[0], seconds[-1]))
