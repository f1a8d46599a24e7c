"""Detect an arm's motion in an episode, and read those of its empty runs (tares).

A preset observes it by one reading per joint for any motion, or by all torques of the paper's
circle as they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from tunenet_logs.analysis.estimators.base import Observation
from tunenet_logs.analysis.experiment import Training, drop_invalid_samples, presets_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.payload.arm_card import ArmCard
from tunenet_logs.analysis.payload.arm_log import JOINT_UNITS, ArmLog, check_joints, read_arm_log
from tunenet_logs.analysis.payload.torque_fit import PayloadFit, fit_payload
from tunenet_logs.analysis.payload.torque_model import GAIN, ArmMotion, Convention, arm_motion
from tunenet_logs.analysis.tunenet.network import (
    HomogeneousNetwork,
    PairSet,
    PaperNetwork,
    Recipe,
    Workers,
    consecutive_pairs,
    observe_all,
)
from tunenet_logs.analysis.tunenet.weights import Purpose
from tunenet_logs.episode import Array, LeftOut
from tunenet_logs.errors import LogError, NotFoundError
from tunenet_logs.reader import read_episode, without_commands
from tunenet_logs.recorders.simulators.arm.description import Arm, Payload, jaco
from tunenet_logs.recorders.simulators.arm.path import (
    CIRCLE_RAD_S,
    JointPath,
    circle,
    circle_at,
    random_path,
)
from tunenet_logs.recorders.simulators.arm.payload import (
    PAYLOAD_MASS,
    TOPIC,
    PayloadSimulator,
    held_efforts_nm,
    joint_efforts_nm,
)
from tunenet_logs.terminal import Progress
from tunenet_logs.timing.stamps import jump_warnings, trim_clock_jumps

# ---- Presets: the network's observation of torques, and its training

# Joints that a reading is taken of, those that feel a payload most: a Jaco has as many.
READINGS = 7
# What the paper's network sees: 5 s of a Jaco's torques (Allevato et al. 2019).
PAPER_RATE_HZ = 60.0
PAPER_SAMPLES = 300
PAPER_JOINTS = 7
CIRCLE_S = 2 * np.pi / CIRCLE_RAD_S  # a turn
_NEAR_S = 0.05  # to the nearest torque: between samples further apart nothing is interpolated
# The paper's simulator, masses that networks learn from, and pairs (Allevato et al. 2019).
PAPER_GRAVITY_M_S2 = (0.0, 0.0, -10.0)
PAPER_MASS_KG = (0.0, 1.0)
_PAPER_PAIRS = 1000
# Random motions of our network, and masses along each: all 30 ordered pairs of a motion are learnt
# from, so that a pair costs little simulation.
_PATHS, _MASSES = 512, 6
_RATE_HZ = 20.0  # of a motion's samples: readings are sums over them, which more would not change


def payload_readings(effort_nm: Array, empty_nm: Array, per_kg_nm: Array) -> Observation:
    """Project torques, (T, J), to each joint's share of the mass, for any arm and motion.

    Torques beyond those of the empty arm are projected on what a kilogram adds; their sum over all
    joints is the least-squares mass. Means are removed from both, and so sensor offsets. Joints are
    ordered by how much of a payload they feel.
    """
    felt = per_kg_nm - per_kg_nm.mean(axis=0)
    beyond = effort_nm - empty_nm
    parts = (beyond * felt).sum(axis=0) / (felt**2).sum()
    order = np.argsort((felt**2).sum(axis=0))[::-1][:READINGS]
    values = np.zeros((READINGS, 1))
    values[: len(order), 0] = parts[order]
    axis = np.arange(1.0, READINGS + 1)
    return Observation(values, axis, "joint, by how much of a payload it feels", ("[kg]",))


def paper_torques(seconds: Array, effort_nm: Array, phase_s: float = 0.0) -> Observation:
    """Resample seven torques, (T, 7), at 60 Hz over the first 5 s of the paper's circle."""
    axis = np.arange(PAPER_SAMPLES) / PAPER_RATE_HZ
    along = (seconds + phase_s) % CIRCLE_S
    order = np.argsort(along)
    along, effort_nm = along[order], effort_nm[order]
    after = np.clip(np.searchsorted(along, axis), 1, len(along) - 1)
    nearest = np.minimum(np.abs(along[after] - axis), np.abs(along[after - 1] - axis))
    values = np.column_stack([np.interp(axis, along, column) for column in effort_nm.T])
    values[nearest > _NEAR_S] = np.nan
    names = tuple(f"joint {number} [N·m]" for number in range(1, PAPER_JOINTS + 1))
    return Observation(values, axis, "time [s]", names)


def circle_phase_s(path: JointPath) -> tuple[float, float]:
    """Find a motion's phase on the paper's circle at 0 s, and its worst distance from it [rad]."""
    if path.position_rad.shape[1] != PAPER_JOINTS:
        raise NotFoundError("the paper's network knows the Jaco alone; use --preset default")

    def off_rad(phase_s: float) -> Array:
        ideal = circle_at(path.seconds + phase_s).position_rad
        return np.angle(np.exp(1j * (path.position_rad - ideal)))

    def cost(phase_s: float) -> float:
        return float(np.sum(off_rad(phase_s) ** 2))

    # From some degrees apart down to microseconds.
    step_s = CIRCLE_S / 64
    phase_s = min((step_s * np.arange(64)).tolist(), key=cost)
    for _ in range(16):
        step_s /= 2
        phase_s = min((phase_s - step_s, phase_s, phase_s + step_s), key=cost)
    return phase_s % CIRCLE_S, float(np.abs(off_rad(phase_s)).max())


def observe_circle(masses_kg: Sequence[float]) -> Array:
    """Compute torques of the paper's circle, (N, 300, 7) [N·m], equal to a rollout's."""
    arm, path = jaco(), circle(PAPER_RATE_HZ, PAPER_SAMPLES / PAPER_RATE_HZ)
    return np.array(
        [joint_efforts_nm(arm, path, Payload(mass), PAPER_GRAVITY_M_S2) for mass in masses_kg]
    )


def _observe_paths(plans: Sequence[tuple[int, tuple[float, ...]]]) -> Array:
    """Observe payloads (masses) along random motions (seeds): (paths * masses, 7, 1)."""
    arm = jaco()
    found: list[Array] = []
    for seed, masses_kg in plans:
        path = random_path(arm, seed, _RATE_HZ)
        empty = joint_efforts_nm(arm, path)
        per_kg = joint_efforts_nm(arm, path, Payload(1.0)) - empty
        for mass in masses_kg:
            effort = joint_efforts_nm(arm, path, Payload(mass))
            found.append(payload_readings(effort, empty, per_kg).values)
    return np.array(found)


def _paper_pairs(count: int | None, seed: int, workers: Workers, progress: Progress) -> PairSet:
    """Make training pairs of two circles, masses U(0, 1) kg."""
    count = count or _PAPER_PAIRS
    masses = np.random.default_rng(seed).uniform(*PAPER_MASS_KG, 2 * count)
    observations = observe_all(observe_circle, masses.tolist(), workers, progress)
    return PairSet(observations, masses[:, None], *consecutive_pairs(count))


def _readings_pairs(count: int | None, seed: int, workers: Workers, progress: Progress) -> PairSet:
    """Make all pairs of a few masses along one motion; half of the masses near another."""
    rng = np.random.default_rng(seed)
    each = _MASSES * (_MASSES - 1)
    paths = _PATHS if count is None else -(-count // each)
    masses = rng.uniform(*PAPER_MASS_KG, (paths, _MASSES))
    half = _MASSES // 2
    # Half of a motion's masses lie .1 kg (sd) from the others: a last iteration's pairs.
    near = masses[:, :half] + 0.1 * rng.standard_normal((paths, half))
    masses[:, half:] = np.clip(near, *PAPER_MASS_KG)
    seeds = rng.integers(2**31, size=paths)
    plans = list(zip(seeds.tolist(), map(tuple, masses.tolist()), strict=True))
    observations = observe_all(_observe_paths, plans, workers, progress)
    first, second = np.nonzero(~np.eye(_MASSES, dtype=bool))
    starts = _MASSES * np.arange(paths)[:, None]
    proposed, target = (starts + first).ravel(), (starts + second).ravel()
    return PairSet(observations, masses.reshape(-1, 1), proposed[:count], target[:count])


_PAPER_RECIPE = Recipe(
    optimizer="sgd",
    learning_rate=1e-2,
    decay=0.99,
    decay_epochs=50,
    weight_decay=1e-3,
    loss="norm",
    scaling="unit-inputs",
    epochs=1000,
    batch=50,
)
_OUR_RECIPE = Recipe(
    optimizer="adamw",
    learning_rate=3e-3,
    weight_decay=0.01,
    loss="relative",
    scaling="raw",
    epochs=40,
    batch=256,
)
_SHARES = "each joint's share of the mass, by how much it feels"
_TORQUES = "seven torques, 300 samples at 60 Hz along the circle"
TRAININGS = {
    "default": Training(
        Purpose("payload", "default", _SHARES, READINGS, 1, (_RATE_HZ,)),
        HomogeneousNetwork(),
        _OUR_RECIPE,
        _readings_pairs,
    )
} | {
    name: Training(
        Purpose("payload", name, _TORQUES, PAPER_SAMPLES * PAPER_JOINTS, 1, (PAPER_RATE_HZ,)),
        PaperNetwork(),
        replace(_PAPER_RECIPE, scaling=scaling),
        _paper_pairs,
    )
    for name, scaling in (("paper", "unit-inputs"), ("paper-code", "z-score"))
}
PRESETS = presets_of(TRAININGS, (PAYLOAD_MASS,), (PAYLOAD_MASS,))


# ---- Motion of an arm and of its empty runs, as one preset observes it

EFFORT = f"{TOPIC}.effort"  # the simulated torques


@dataclass(frozen=True, eq=False)
class Tare:
    """Empty run as it was read."""

    log: ArmLog
    motion: ArmMotion


def read_tares(arm: Arm, log: ArmLog, selection: TuneOptions) -> tuple[Tare, ...]:
    """Read a selection's empty runs, all different, as the log was read."""
    found: list[Tare] = []
    for tare in selection.tares:
        name = f" {tare}" if isinstance(tare, Path) else ""
        try:
            recorded = read_episode(tare, selection.reading) if isinstance(tare, Path) else tare
            recorded = without_commands(recorded)
            recorded = drop_invalid_samples(recorded) if isinstance(tare, Path) else recorded
            episode = trim_clock_jumps(recorded)
            prefer = selection.topic or log.effort.topic
            has_joints = any(signal.unit in JOINT_UNITS for signal in episode.signals_of(prefer))
            empty = read_arm_log(
                episode,
                arm,
                topic=prefer if has_joints else None,
                torque_constants=selection.effort_constants,
            )
            check_joints(empty.joints, log.joints)
            mass_kg = episode.info.truth.get(PAYLOAD_MASS.name, 0.0)
            if mass_kg > 0:
                raise NotFoundError(
                    f"held {mass_kg:g} kg, as it says", "name a run with nothing in the gripper"
                )
            if _is_same_run(empty, log):
                raise NotFoundError(
                    "has the torques of the log itself",
                    "name another run, with nothing in the gripper",
                )
            motion = arm_motion(empty)
        except (LogError, NotFoundError) as error:
            reason = error.what.removeprefix(f"{tare}: ")
            raise NotFoundError(f"--tare{name}: {reason}", error.remedy) from error
        if any(_is_same_run(known.log, empty) for known in found):
            raise NotFoundError(f"--tare{name}: is a run that was named before; name each one once")
        warnings = (*empty.warnings, *jump_warnings(recorded))
        found.append(Tare(replace(empty, warnings=warnings), motion))
    return tuple(found)


def _is_same_run(known: ArmLog, other: ArmLog) -> bool:
    """Return whether most torques of one log occur bit by bit in the other."""
    there = {row.tobytes() for row in known.effort.values}
    same = sum(row.tobytes() in there for row in other.effort.values)
    # No other run repeats half of a log's torques bit by bit.
    return same > 0.5 * len(other.effort.values)


@dataclass(frozen=True, eq=False)
class PayloadDetection:
    """An arm's motion in an episode with its torques, as one preset observes it.

    The driver's torque convention (sign, with or without the arm's weight) is identified by the
    fit, which is made when first needed, and is the result of the method "fit" too.
    """

    physical: bool  # whether the preset observes the arm's own motion, or the paper's circle
    arm: Arm  # without a payload
    log: ArmLog  # fresh samples of its joints
    start_ns: int  # origin of the log's clock
    motion: ArmMotion  # joint motion at any time
    tares: tuple[Tare, ...]  # runs with an empty gripper
    # possible torque conventions, as far as the user does not state one
    conventions: tuple[Convention, ...]
    warnings: tuple[str, ...]  # for the user
    card: ArmCard | None = None  # what other runs identified of the arm; None for nothing
    gain: float = GAIN  # usual error of the torques, as a fraction

    @property
    def topic(self) -> str:
        """Topic of the torques."""
        return self.log.effort.topic

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        """Samples missing from torques and positions, the tares' too."""
        of_tares = (one for tare in self.tares for one in tare.log.left_out)
        return (*self.log.left_out, *(one._replace(name=f"tare: {one.name}") for one in of_tares))

    @property
    def window(self) -> Mapping[str, float]:
        """Times of the first and last torque used [s]."""
        return {"start_s": float(self.path.seconds[0]), "end_s": float(self.path.seconds[-1])}

    @property
    def extent(self) -> tuple[str, str]:
        """Duration of the motion."""
        return "motion", f"{self.path.seconds[-1] - self.path.seconds[0]:.1f} s"

    @cached_property
    def path(self) -> JointPath:
        """Joint positions, velocities and accelerations at the torques' stamps."""
        return JointPath(self.motion.seconds, *self.motion.at(self.motion.seconds))

    @cached_property
    def fit(self) -> PayloadFit:
        """Fit of payload and nuisance terms to the torques."""
        known = self.card.learnt if self.card else None
        try:
            fit = fit_payload(
                self.arm,
                self.motion,
                [tare.motion for tare in self.tares],
                conventions=self.conventions,
                known=known,
                gain=self.gain,
            )
        except np.linalg.LinAlgError as error:
            if self.card is None:
                raise
            raise NotFoundError(
                f"--arm-card {self.card.file}: what it says of the arm and these torques go "
                "together with no arm; write the card anew"
            ) from error
        most_kg = PAYLOAD_MASS.bounds[1]
        if fit.held.mass_kg > most_kg:
            raise NotFoundError(
                f"these torques hold {fit.held.mass_kg:.3g} kg, over {most_kg:g} kg",
                "say their unit with --effort-unit, or record torques in N·m",
            )
        return fit

    @cached_property
    def phase_s(self) -> float | None:
        """Phase on the paper's circle where the log's clock begins; None if the preset needs none.

        NotFoundError where it is another motion, or too little of it is there.
        """
        if self.physical:
            return None
        phase_s, off_rad = circle_phase_s(self.path)
        # A controller is this far off the circle [rad], another motion farther.
        if off_rad > 0.1:
            raise NotFoundError(
                "the paper's network knows one motion, the circle of `tunenet-record --simulate "
                f"payload`; this one is up to {off_rad:.2f} rad off it: use --preset default"
            )
        seconds = self.path.seconds[-1] - self.path.seconds[0]
        if seconds < 4:  # of 5: the network fills in what little is missing
            raise NotFoundError(
                f"{seconds:.1f} s of the circle are there, the paper's network needs "
                "4 s: record a whole turn, or use --preset default"
            )
        return phase_s

    @cached_property
    def effort_nm(self) -> Array:
        """Torques with the joint's sign, the arm's weight included [N·m], shape (T, J)."""
        if self.fit.convention.has_gravity:
            return self.fit.effort_nm
        return self.fit.effort_nm + held_efforts_nm(self.arm.without_limits(), self.path)

    @cached_property
    def simulator(self) -> PayloadSimulator:
        """Simulator of the arm along its own path, with the payload's centre as fitted."""
        free = self.arm.without_limits()
        if not self.physical:
            return PayloadSimulator(free, self.path, gravity_m_s2=PAPER_GRAVITY_M_S2)
        return PayloadSimulator(free, self.path, self.fit.held.centre.likely_m)

    def observe(self, effort_nm: Array) -> Observation:
        """Observe torques along the path [N·m], shape (T, J), as the preset's network does."""
        if self.phase_s is not None:
            return paper_torques(self.path.seconds, effort_nm, self.phase_s)
        own = self.simulator
        return payload_readings(effort_nm, own.empty_efforts_nm, own.efforts_nm_per_kg)
