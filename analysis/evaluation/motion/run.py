"""Run motion prediction, the paper's table 3, by a tuned simulator or without.

Ground truth, Easy: 400 frames at 60 Hz in the paper's simulator. A tuner sees the whole recorded
drop, or its film by an unknown camera (Obs), finds the restitution, and one more rollout is its
prediction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from analysis.estimators.base import Estimator, Problem
from analysis.estimators.rollout_line import TuneNetThenLine
from analysis.estimators.tunenet import TuneNet
from analysis.evaluation.drop import networks as nets
from analysis.evaluation.drop.targets import EASY, DropProblems, DropTarget, draw_targets
from analysis.evaluation.methods.best_visited import BestVisited
from analysis.evaluation.motion.filmed_networks import train_ours_on_films, train_papers_on_films
from analysis.evaluation.motion.filmed_targets import FilmedProblems
from analysis.evaluation.motion.one_step.base import Memoryless, Stepper, predict, stand_still
from analysis.evaluation.motion.one_step.data import EngineStep, target_states, training_drops
from analysis.evaluation.motion.one_step.neural import NeuralRecipe, train_neural
from analysis.evaluation.motion.one_step.vrnn_training import VrnnRecipe, train_vrnn
from analysis.evaluation.motion.rows import (
    SEEN_STEPS,
    MotionError,
    MotionRow,
    motion_error,
    with_figures,
)
from analysis.tunenet.network import Model
from recorders.simulators.drop import TOPIC
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import Progress

ITERATIONS = 5  # K, rollouts that a tuner may spend: the paper's


@dataclass(frozen=True, eq=False)
class Tuners:
    """Networks trained for one seed.

    Attributes:
        paper_code: the paper's network, preset "paper-code".
        ours: for heights of the paper's simulator.
        paper_filmed: the paper's network for films, preset "paper".
        ours_filmed: for films of the paper's simulator.
    """

    paper_code: Model
    ours: Estimator
    paper_filmed: Model
    ours_filmed: Estimator


@dataclass(frozen=True)
class OneStepTraining:
    """Training of the one-step predictors: on `drops` drops, one simulation each.

    The paper's 800 pairs are as many drops to whoever learns from single ones.
    """

    drops: int = 800
    neural: NeuralRecipe = field(default_factory=NeuralRecipe)
    vrnn: VrnnRecipe = field(default_factory=VrnnRecipe)


def run_motion(
    seeds: Sequence[int],
    targets: int,
    jobs: int | None,
    progress: Progress,
    effort: nets.Effort | None = None,
) -> tuple[MotionRow, ...]:
    """Train the tuners and the one-step predictors of each seed, and measure them."""
    effort = effort or nets.Effort()
    tuners = partial(_tuners, jobs=jobs, progress=progress, effort=effort)
    return motion_table(seeds, targets, tuners, progress, _one_step_training(effort))


def _tuners(seed: int, *, jobs: int | None, progress: Progress, effort: nets.Effort) -> Tuners:
    wanted = (nets.PAPER_CODE, nets.OURS)
    networks = nets.train_networks(wanted, seed, jobs, progress, effort)
    papers_filmed, ours_filmed = (
        make(seed, jobs, progress, effort.pairs, effort.epochs)
        for make in (train_papers_on_films, train_ours_on_films)
    )
    return Tuners(
        networks[nets.PAPER_CODE],
        TuneNetThenLine(networks[nets.OURS]),
        papers_filmed,
        BestVisited(TuneNetThenLine(ours_filmed)),
    )


def _one_step_training(effort: nets.Effort) -> OneStepTraining:
    training = OneStepTraining()
    if effort.pairs is not None:
        training = replace(training, drops=effort.pairs)
    if effort.epochs is not None:
        neural = replace(training.neural, epochs=effort.epochs)
        training = replace(
            training, neural=neural, vrnn=replace(training.vrnn, epochs=effort.epochs)
        )
    return training


def motion_table(
    seeds: Sequence[int],
    count: int,
    tuners: Callable[[int], Tuners],
    progress: Progress,
    training: OneStepTraining | None = None,
) -> tuple[MotionRow, ...]:
    """Compute table 3, every row with a figure for each seed; 100 targets in the paper."""
    return with_figures(
        [motion_errors(seed, count, tuners(seed), progress, training) for seed in seeds]
    )


def motion_errors(
    seed: int,
    count: int,
    tuners: Tuners,
    progress: Progress,
    training: OneStepTraining | None = None,
) -> dict[str, MotionError]:
    """Return the figures of one seed by the names of their rows; see `motion_table`."""
    targets = draw_targets(EASY, count, seed)
    return {
        **tuning_errors(targets, tuners, progress),
        **one_step_errors(targets, seed, training or OneStepTraining(), progress),
    }


def tuning_errors(
    targets: Sequence[DropTarget], tuners: Tuners, progress: Progress
) -> dict[str, MotionError]:
    """Measure zero, un-tuned and tuned simulators, each rolled out once from the release."""
    problems, films = DropProblems(), FilmedProblems()
    methods: dict[str, tuple[Estimator, Callable[[DropTarget], Problem]]] = {
        "tunenet-obs": (TuneNet(tuners.paper_filmed), films.pose_papers),
        "ours-obs": (tuners.ours_filmed, films.pose_ours),
        "tunenet-gt": (TuneNet(tuners.paper_code), problems.pose),
        "ours": (tuners.ours, problems.pose),
    }
    true_m: list[Array] = []
    predicted_m: dict[str, list[Array]] = {name: [] for name in ("untuned", *methods)}
    with progress.bar(len(targets), "tuning", "drop") as bar:
        for target in targets:
            problem = problems.pose(target)
            true_m.append(problem.target.values[:, 0])
            predicted_m["untuned"].append(_heights_m(problem, problem.initial))
            for name, (method, pose) in methods.items():
                fresh = pose(target)  # a rollout that another has paid for is charged too
                estimate = method.estimate(fresh, ITERATIONS).estimate
                predicted_m[name].append(_heights_m(fresh, estimate))
            bar.update(1)
    truth = np.array(true_m)
    zero = {"zero": motion_error(np.zeros_like(truth), truth)}
    return zero | {
        name: motion_error(np.array(heights), truth) for name, heights in predicted_m.items()
    }


def one_step_errors(
    targets: Sequence[DropTarget], seed: int, training: OneStepTraining, progress: Progress
) -> dict[str, MotionError]:
    """Train and measure Neural and VRNN hybrid under each protocol, and the baselines."""
    drops = training_drops(training.drops, seed, progress)
    neural = train_neural(drops.states, training.neural, seed, progress)
    hybrid = train_vrnn(drops, training.vrnn, seed, progress)
    steps = drops.simulated.shape[1]
    seen = {"ahead": steps, "seen": SEEN_STEPS, "rollout": 0}
    predictors: list[tuple[str, Stepper, tuple[str, ...]]] = [
        ("neural", Memoryless(neural), ("ahead", "seen", "rollout")),
        ("hybrid", hybrid, ("ahead", "seen", "rollout")),
        ("middle", Memoryless(EngineStep()), ("ahead", "seen", "rollout")),
        ("still", Memoryless(stand_still), ("ahead",)),
    ]
    truth = target_states(targets)
    return {
        f"{name}-{protocol}": motion_error(predict(stepper, truth, seen[protocol]), truth[:, 1:, 0])
        for name, stepper, protocols in predictors
        for protocol in protocols
    }


def _heights_m(problem: Problem, values: Array) -> Array:
    """Return the ball's centre after each step, shape (400,) [m]."""
    return problem.evaluate(values).episode.signals[TOPIC].values[:, 2]
