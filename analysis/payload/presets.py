"""Presets of the payload experiment: the network's observation of torques, and its training.

One reading per joint for any motion, or all torques of the paper's circle as they are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.estimators.base import Observation
from analysis.experiment import Training, presets_of
from analysis.tunenet.checkpoint import Purpose
from analysis.tunenet.network import HomogeneousNetwork, PaperNetwork
from analysis.tunenet.pairs import PairSet, Workers, consecutive_pairs, observe_all
from analysis.tunenet.training import Recipe
from recorders.simulators.arm.description import Payload, jaco
from recorders.simulators.arm.dynamics import joint_efforts_nm
from recorders.simulators.arm.path import (
    CIRCLE_RAD_S,
    JointPath,
    circle,
    circle_at,
    random_path,
)
from recorders.simulators.arm.payload import PAYLOAD_MASS
from tunenet_logs.arrays import Array
from tunenet_logs.errors import NotFoundError
from tunenet_logs.terminal import Progress

# Joints that a reading is taken of, those that feel a payload most: a Jaco has as many.
READINGS = 7

PAPER_RATE_HZ = 60.0
PAPER_SAMPLES = 300
PAPER_JOINTS = 7  # what the paper's network sees: 5 s of a Jaco's torques (Allevato et al. 2019).
CIRCLE_S = 2 * np.pi / CIRCLE_RAD_S  # a turn
_NEAR_S = 0.05  # to the nearest torque: between samples further apart nothing is interpolated
# Phases that the search for the circle begins with, some degrees apart; then it halves its step,
# down to microseconds.
_COARSE, _HALVINGS = 64, 16

PAPER_GRAVITY_M_S2 = (0.0, 0.0, -10.0)
PAPER_MASS_KG = (0.0, 1.0)
# The paper's simulator, masses that networks learn from, and pairs (Allevato et al. 2019).
_PAPER_PAIRS = 1000

# Random motions of our network, and masses along each: all 30 ordered pairs of a motion are learnt
# from, so that a pair costs little simulation.
_PATHS, _MASSES = 512, 6

_RATE_HZ = 20.0  # of a motion's samples: readings are sums over them, which more would not change
# Standard deviation of half of a motion's masses about the others: a last iteration's pairs.
_NEAR_KG = 0.1


def payload_readings(effort_nm: Array, empty_nm: Array, per_kg_nm: Array) -> Observation:
    """Project torques to each joint's share of the mass: one network serves every arm and motion.

    Torques beyond those of the empty arm are projected on what a kilogram adds; their sum over all
    joints is the least-squares mass. Means are removed from both, and so sensor offsets. Joints are
    ordered by how much of a payload they feel.

    Args:
        effort_nm: Along a motion [N·m], shape (T, J).
        empty_nm: With an empty gripper, along the same motion [N·m], shape (T, J).
        per_kg_nm: What a kilogram adds to that [N·m], shape (T, J).

    Returns:
        Values in kg, shape (7, 1); 0 for joints that the arm lacks.
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
    """Resample seven torques at 60 Hz over the first 5 s of the paper's circle.

    Args:
        seconds: Of the torques [s], shape (T,), increasing.
        effort_nm: [N·m], shape (T, 7).
        phase_s: How far along the circle the arm is at 0 s [s].

    Returns:
        Values in N·m, shape (300, 7); NaN where there are no torques.
    """
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
    """Find a motion's phase on the paper's circle at 0 s, and its worst distance from it [rad].

    Raises:
        NotFoundError: It is the motion of another arm.
    """
    if path.position_rad.shape[1] != PAPER_JOINTS:
        raise NotFoundError("the paper's network knows the Jaco alone; use --preset default")

    def off_rad(phase_s: float) -> Array:
        ideal = circle_at(path.seconds + phase_s).position_rad
        return np.angle(np.exp(1j * (path.position_rad - ideal)))

    def cost(phase_s: float) -> float:
        return float(np.sum(off_rad(phase_s) ** 2))

    step_s = CIRCLE_S / _COARSE
    phase_s = min((step_s * np.arange(_COARSE)).tolist(), key=cost)
    for _ in range(_HALVINGS):
        step_s /= 2
        phase_s = min((phase_s - step_s, phase_s, phase_s + step_s), key=cost)
    return phase_s % CIRCLE_S, float(np.abs(off_rad(phase_s)).max())


def observe_circle(masses_kg: Sequence[float]) -> Array:
    """Compute torques of the paper's circle by inverse dynamics, shape (N, 300, 7) [N·m].

    They equal the rollout's torques. Runs in worker processes.
    """
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
    near = masses[:, :half] + _NEAR_KG * rng.standard_normal((paths, half))
    masses[:, half:] = np.clip(near, *PAPER_MASS_KG)
    seeds = rng.integers(2**31, size=paths)
    plans = [
        (int(path_seed), tuple(row)) for path_seed, row in zip(seeds, masses.tolist(), strict=True)
    ]
    observations = observe_all(_observe_paths, plans, workers, progress)
    first, second = np.nonzero(~np.eye(_MASSES, dtype=bool))
    starts = _MASSES * np.arange(paths)[:, None]
    proposed, target = (starts + first).ravel(), (starts + second).ravel()
    return PairSet(observations, masses.reshape(-1, 1), proposed[:count], target[:count])


def _paper_recipe(scaling: str) -> Recipe:
    return Recipe(
        optimizer="sgd",
        learning_rate=1e-2,
        decay=0.99,
        decay_epochs=50,
        weight_decay=1e-3,
        loss="norm",
        scaling=scaling,
        epochs=1000,
        batch=50,
    )


def _paper_training(name: str, scaling: str) -> Training:
    purpose = Purpose(
        task="payload",
        preset=name,
        observation="seven torques, 300 samples at 60 Hz along the circle",
        inputs=PAPER_SAMPLES * PAPER_JOINTS,
        outputs=1,
        rates_hz=(PAPER_RATE_HZ,),
    )
    return Training(purpose, PaperNetwork(), _paper_recipe(scaling), _paper_pairs)


_OURS = Training(
    Purpose(
        task="payload",
        preset="default",
        observation="each joint's share of the mass, by how much it feels",
        inputs=READINGS,
        outputs=1,
        rates_hz=(_RATE_HZ,),
    ),
    HomogeneousNetwork(),
    Recipe(
        optimizer="adamw",
        learning_rate=3e-3,
        weight_decay=0.01,
        loss="relative",
        scaling="raw",
        epochs=40,
        batch=256,
    ),
    _readings_pairs,
)

TRAININGS = {
    "default": _OURS,
    "paper": _paper_training("paper", "unit-inputs"),
    "paper-code": _paper_training("paper-code", "z-score"),
}

PRESETS = presets_of(TRAININGS, (PAYLOAD_MASS,), (PAYLOAD_MASS,))
