"""Run the paper's first experiment, the mass in an arm's gripper (Allevato et al. 2019, table 1).

Networks learn from masses of 0 to 1 kg; validation targets are as heavy, test targets 1 kg heavier.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from analysis.estimators.base import Observation, Problem
from analysis.estimators.tunenet import TuneNet
from analysis.payload.presets import (
    PAPER_GRAVITY_M_S2,
    PAPER_MASS_KG,
    PAPER_RATE_HZ,
    PAPER_SAMPLES,
    TRAININGS,
    paper_torques,
    payload_readings,
)
from analysis.processes import Piece, parallel_map
from analysis.tunenet.network import Model
from analysis.tunenet.training import train
from recorders.simulators.arm.description import jaco
from recorders.simulators.arm.path import circle
from recorders.simulators.arm.payload import TOPIC, PayloadSimulator
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode
from tunenet_logs.terminal import Progress

Observe = Callable[[Episode], Observation]

ITERATIONS = 9  # K of the paper's table 1
TEST_SEEDS = 7_000_000  # targets are drawn from these and a seed; training from the seed alone
# By how much the targets are heavier than what was learnt from [kg].
SETS: Mapping[str, float] = {"validation": 0.0, "test": 1.0}

# Of the masses learnt from; the mean of the targets is as much heavier as they are.
TRAINED_MEAN_KG = sum(PAPER_MASS_KG) / 2

EFFORT = f"{TOPIC}.effort"


@dataclass(frozen=True)
class MassMethod:
    """Method, a row of the table.

    Attributes:
        name: what files call it.
        label: what the table calls it.
        iterations: K; 0 where nothing is iterated.
        paper: mean absolute errors of the paper on each set [kg]; None where it has none.
        percent: the paper's percent on the test set.
    """

    name: str
    label: str
    iterations: int
    paper: tuple[float | None, float | None] = (None, None)
    percent: float | None = None


METHODS = (
    MassMethod("paper", "TuneNet, paper's text", ITERATIONS, (0.011, 0.198), 13.2),
    MassMethod("paper-code", "TuneNet, z-scores", ITERATIONS, (0.011, 0.198), 13.2),
    MassMethod("one", "1 kg for every target", 0, (None, 0.504), 28.0),
    MassMethod("mean", "mean of the targets", 0, (0.25, 0.255), 17.1),
    MassMethod("secant", "secant through two rollouts", 2),
    MassMethod("default-1", "ours", 1),
    MassMethod("default", "ours", ITERATIONS),
)


@dataclass(frozen=True, eq=False)
class MassRow:
    """Errors of a method on one set.

    Attributes:
        errors: absolute errors [kg], shape (seeds, targets).
        percents: of the target's mass [%], of the same shape.
    """

    method: MassMethod
    which: str
    errors: Array
    percents: Array


@dataclass(frozen=True)
class MassOrder:
    """Settings of the experiment.

    Attributes:
        seeds: each with its own training and targets.
        targets: of each set and seed.
        jobs: processes; None for all cores.
        pairs: of training, in place of the presets'.
        epochs: likewise.
    """

    seeds: tuple[int, ...]
    targets: int
    jobs: int | None
    pairs: int | None = None
    epochs: int | None = None


def mass_rows(order: MassOrder, progress: Progress) -> list[MassRow]:
    """Run every method on the same targets, every seed in a process of its own."""
    pieces = [Piece((seed, order), 1, f"seed {seed}") for seed in order.seeds]
    done = parallel_map(_one_seed, pieces, order.jobs, progress, ("masses", "seed"))
    rows = []
    for method in METHODS:
        for which in SETS:
            found = np.stack([results[method.name, which] for results in done])
            errors = np.abs(found[:, 0] - found[:, 1])
            rows.append(MassRow(method, which, errors, 100 * errors / found[:, 1]))
    return rows


def _one_seed(work: tuple[int, MassOrder]) -> dict[tuple[str, str], Array]:
    """Return values and truths by method and set, each of shape (2, targets)."""
    seed, order = work
    simulator = PayloadSimulator(
        jaco(),
        circle(PAPER_RATE_HZ, PAPER_SAMPLES / PAPER_RATE_HZ),
        gravity_m_s2=PAPER_GRAVITY_M_S2,
    )
    networks = {name: _trained(name, seed, order) for name in TRAININGS}
    rng = np.random.default_rng([TEST_SEEDS, seed])
    found: dict[tuple[str, str], Array] = {}
    for which, heavier in SETS.items():
        initial = rng.uniform(*PAPER_MASS_KG, order.targets)
        truths = rng.uniform(*PAPER_MASS_KG, order.targets) + heavier
        values = _simple(simulator, truths, TRAINED_MEAN_KG + heavier)
        for name, model in networks.items():
            steps = _iterated(simulator, model, OBSERVE[name](simulator), initial, truths)
            values |= {name: steps[:, -1], f"{name}-1": steps[:, 1]}
        for method in METHODS:
            found[method.name, which] = np.array([values[method.name], truths])
    return found


def _simple(simulator: PayloadSimulator, truths: Array, mean_kg: float) -> dict[str, Array]:
    empty, per_kg = simulator.empty_efforts_nm, simulator.efforts_nm_per_kg
    beyond = np.array([simulator.efforts_nm(float(truth)) - empty for truth in truths])
    secant = np.tensordot(beyond, per_kg, 2) / (per_kg**2).sum()
    return {
        "one": np.ones(len(truths)),
        "mean": np.full(len(truths), mean_kg),
        "secant": secant,
    }


def _trained(name: str, seed: int, order: MassOrder) -> Model:
    preset, quiet = TRAININGS[name], Progress(quiet=True)
    pairs = preset.make_pairs(order.pairs, seed, 1, quiet)
    recipe = preset.recipe
    if order.epochs is not None:
        recipe = replace(recipe, epochs=order.epochs)
    return train(preset.network, pairs, recipe, seed, quiet)


def _iterated(
    simulator: PayloadSimulator, model: Model, observe: Observe, initial: Array, truths: Array
) -> Array:
    """Return the iterates of every target [kg], shape (targets, K + 1)."""
    name = simulator.parameters[0].name
    rows: list[list[float]] = []
    for guess, truth in zip(initial, truths, strict=True):
        target = observe(simulator.rollout({name: float(truth)}))
        problem = Problem(target, simulator, observe, np.array([guess]))
        trace = TuneNet(model).estimate(problem, ITERATIONS)
        rows.append([float(step.values[0]) for step in trace.steps])
    return np.array(rows)


def _observe_torques(_simulator: PayloadSimulator) -> Observe:
    def observe(episode: Episode) -> Observation:
        effort = episode.signals[EFFORT]
        return paper_torques(effort.seconds, effort.values)

    return observe


def _observe_readings(simulator: PayloadSimulator) -> Observe:
    empty, per_kg = simulator.empty_efforts_nm, simulator.efforts_nm_per_kg

    def observe(episode: Episode) -> Observation:
        return payload_readings(episode.signals[EFFORT].values, empty, per_kg)

    return observe


# What the network of each preset looks at.
OBSERVE: Mapping[str, Callable[[PayloadSimulator], Observe]] = {
    "default": _observe_readings,
    "paper": _observe_torques,
    "paper-code": _observe_torques,
}
