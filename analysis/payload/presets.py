"""The payload's presets: which torques, network and training go together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.experiment import Preset, Training
from analysis.payload.readings import (
    PAPER_JOINTS,
    PAPER_RATE_HZ,
    PAPER_SAMPLES,
    READINGS,
    payload_readings,
)
from analysis.tunenet.checkpoint import Purpose
from analysis.tunenet.network import HomogeneousNetwork, PaperNetwork
from analysis.tunenet.pairs import PairSet, consecutive_pairs, observe_all
from analysis.tunenet.training import Recipe
from recorders.simulators.arm.description import Payload, jaco
from recorders.simulators.arm.dynamics import joint_efforts_nm
from recorders.simulators.arm.path import circle, random_path
from tunenet_logs.arrays import Array
from tunenet_logs.progress import Progress

PAPER_GRAVITY_M_S2 = (0.0, 0.0, -10.0)
PAPER_MASS_KG = (0.0, 1.0)
_PAPER_PAIRS = 1000
"""The paper's simulator, masses that networks learn from, and pairs (Allevato et al. 2019)."""

_PATHS, _MASSES = 512, 6
"""Random motions of our network, and masses along each: all 30 ordered pairs of a motion are
learnt from, so that a pair costs little simulation."""

_RATE_HZ = 20.0
"""Of a motion's samples: readings are sums over them, which more would not change."""

_NEAR_KG = 0.1
"""Standard deviation of half of a motion's masses about the others: a last iteration's pairs."""


def observe_circle(masses_kg: Sequence[float]) -> Array:
    """The paper's circle with each payload, shape (N, 300, 7) [N·m]; runs in worker processes.

    By inverse dynamics, which the rollout's torques equal.
    """
    arm, path = jaco(), circle(PAPER_RATE_HZ, PAPER_SAMPLES / PAPER_RATE_HZ)
    return np.array(
        [joint_efforts_nm(arm, path, Payload(mass), PAPER_GRAVITY_M_S2) for mass in masses_kg]
    )


def _observe_paths(plans: Sequence[tuple[int, tuple[float, ...]]]) -> Array:
    """Readings of payloads (masses) along random motions (seeds), shape (paths * masses, 7, 1)."""
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


def _paper_pairs(count: int | None, seed: int, jobs: int | None, progress: Progress) -> PairSet:
    """Two circles a pair, masses U(0, 1) kg."""
    count = count or _PAPER_PAIRS
    masses = np.random.default_rng(seed).uniform(*PAPER_MASS_KG, 2 * count)
    observations = observe_all(observe_circle, masses.tolist(), jobs, progress)
    return PairSet(observations, masses[:, None], *consecutive_pairs(count))


def _readings_pairs(count: int | None, seed: int, jobs: int | None, progress: Progress) -> PairSet:
    """All pairs of a few masses along one motion; half of the masses near another."""
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
    observations = observe_all(_observe_paths, plans, jobs, progress)
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


def _paper_preset(name: str, scaling: str) -> Training:
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
    "paper": _paper_preset("paper", "unit-inputs"),
    "paper-code": _paper_preset("paper-code", "z-score"),
}

PRESETS = {
    "default": Preset(True, "tunenet+refine", TRAININGS["default"]),
    **{name: Preset(False, "tunenet", TRAININGS[name]) for name in TRAININGS if name != "default"},
}
