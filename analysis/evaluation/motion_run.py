"""Table 3 with everything that it needs trained first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from analysis.estimators.tunenet_line import TuneNetLine
from analysis.evaluation import drop_networks as nets
from analysis.evaluation.filmed_networks import train_ours_on_films, train_papers_on_films
from analysis.evaluation.methods.best_visited import BestVisited
from analysis.evaluation.motion import OneStepTraining, Tuners, motion_table
from analysis.evaluation.motion_rows import MotionRow
from tunenet_logs.progress import Progress


def run_motion(
    seeds: Sequence[int],
    targets: int,
    jobs: int | None,
    progress: Progress,
    effort: nets.Effort | None = None,
) -> tuple[MotionRow, ...]:
    """Train the tuners and the one-step predictors of each seed, and measure them.

    Args:
        seeds: each trains its own networks and draws its own targets.
        targets: test cases for each seed.
        jobs: processes that simulate; None for all cores.
        progress: shows what is under way.
        effort: of all training, in place of the presets'; a pair is a drop to those that predict.
    """
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
        TuneNetLine(networks[nets.OURS]),
        papers_filmed,
        BestVisited(TuneNetLine(ours_filmed)),
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
