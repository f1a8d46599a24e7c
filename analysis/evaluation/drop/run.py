"""Run the second experiment: every method on the same targets, rollout by rollout."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from analysis.evaluation.drop.batches import TargetBatch, estimate_batches
from analysis.evaluation.drop.intervals import Coverage, interval_coverages
from analysis.evaluation.drop.method_registry import NPE, Group, Method, Table, choose_methods
from analysis.evaluation.drop.networks import Effort, train_networks
from analysis.evaluation.drop.posteriors import Posteriors, credible_coverage, train_posteriors
from analysis.evaluation.drop.results import Cell, DropResults, MethodErrors
from analysis.evaluation.drop.targets import TARGET_SETS, DropTarget, TargetSet, draw_targets
from recorders.simulators.contact import CALIBRATED, PAPER, ContactSettings
from tunenet_logs.terminal import Progress

NOISE_M = 0.01  # standard deviation of a height in the noisy cells [m]: what a good tracker leaves
# Rollouts a target, by whose a method is; as in the paper's table 2.
_MAX: Mapping[Group, int] = {"paper": 100, "user": 100, "ours": 100}

# A rollout takes 3 ms there, and three of a user's methods go on for as long as they may.
_MAX_CALIBRATED: Mapping[Group, int] = {"user": 40, "ours": 100}

_MAX_NOISY: Mapping[Group, int] = {"paper": 10, "user": 10, "ours": 40}
# Fewer where the paper has no figure beside which they would stand.
_MAX_ABLATION: Mapping[Group, int] = {"paper": 10}

_BATCH = 5  # targets in a batch: few, so that the processes end together


@dataclass(frozen=True)
class DropExperiment:
    """Settings of the experiment.

    Attributes:
        seeds: each trains its own networks and draws its own targets.
        targets: test cases for each seed, set and noise.
        methods: names of those that compete; None for all.
        jobs: processes; None for all cores.
        effort: of training, in place of the presets'.
        rollouts: most that any method may spend; None for the cells' own limits.
    """

    seeds: tuple[int, ...]
    targets: int
    methods: tuple[str, ...] | None = None
    jobs: int | None = None
    effort: Effort | None = None
    rollouts: int | None = None


@dataclass(frozen=True)
class _EmptyCell:
    """Cell before it is filled.

    Attributes:
        most: rollouts that a method is allowed there, by whose it is.
    """

    cell: Cell
    table: Table
    which: TargetSet
    contact: ContactSettings
    most: Mapping[Group, int]

    def batches(
        self, method: Method, targets: Sequence[DropTarget], rollouts: int | None
    ) -> list[TargetBatch]:
        """Split a method's work on the targets; `rollouts` as in `DropExperiment`."""
        most = min(method.budget, self.most[method.group])
        most = most if rollouts is None else min(most, rollouts)
        return [
            TargetBatch(method, tuple(targets[at : at + _BATCH]), self.contact, most)
            for at in range(0, len(targets), _BATCH)
        ]


def run_drop(order: DropExperiment, progress: Progress) -> DropResults:
    """Train, draw, estimate.

    The same order gives the same figures for any `jobs`.

    Raises:
        UsageError: a method is unknown, or needs a library that is not installed.
    """
    chosen = choose_methods(order.methods)
    networks = {
        seed: train_networks(chosen.networks, seed, order.jobs, progress, order.effort)
        for seed in order.seeds
    }
    posteriors: Posteriors = {}
    if chosen.has_posteriors:
        noises_m = (0.0, NOISE_M)
        posteriors = train_posteriors(order.seeds, noises_m, order.jobs, progress, order.effort)
    batches: list[TargetBatch] = []
    columns: list[tuple[Cell, Method, slice]] = []
    for empty in _empty_cells():
        cell = empty.cell
        drawn = {
            seed: draw_targets(empty.which, order.targets, seed, cell.noise_m)
            for seed in order.seeds
        }
        methods = [
            chosen.methods(
                *(empty.table, networks[seed]),
                np.array([target.truth for target in drawn[seed]]),
                *(seed, posteriors.get((seed, cell.noise_m))),
            )
            for seed in order.seeds
        ]
        for column in zip(*methods, strict=True):  # one method, made anew for each seed
            start = len(batches)
            for method, targets in zip(column, drawn.values(), strict=True):
                batches += empty.batches(method, targets, order.rollouts)
            columns.append((cell, column[0], slice(start, len(batches))))
    done = estimate_batches(batches, order.jobs, progress)
    outcomes: list[MethodErrors] = []
    for cell, method, own in columns:
        errors = np.concatenate(done[own]).reshape(len(order.seeds), order.targets, -1)
        name, label = method.name, method.label
        outcomes.append(MethodErrors(cell, name, label, method.group, method.budget, errors))
    with_posteriors = [(cell, batches[own]) for cell, method, own in columns if method.name == NPE]
    credible = credible_coverage(with_posteriors, order.jobs, progress)
    coverage: tuple[Coverage, ...] = ()
    if order.methods is None:
        coverage = interval_coverages(order.seeds, order.targets, order.jobs, progress)
    return DropResults(
        order.seeds, order.targets, tuple(outcomes), coverage, credible, order.rollouts
    )


def _empty_cells() -> list[_EmptyCell]:
    cells = []
    simulators: tuple[tuple[Table, ContactSettings, Mapping[Group, int]], ...]
    simulators = (("paper", PAPER, _MAX), ("calibrated", CALIBRATED, _MAX_CALIBRATED))
    for table, contact, most_clean in simulators:
        for noise_m, most in ((0.0, most_clean), (NOISE_M, _MAX_NOISY)):
            for which in TARGET_SETS:
                cell = Cell("drop", table, which.name, noise_m)
                cells.append(_EmptyCell(cell, table, which, contact, most))
    for which in TARGET_SETS[:2]:
        cell = Cell("ablation", "paper", which.name, 0.0)
        cells.append(_EmptyCell(cell, "ablation", which, PAPER, _MAX_ABLATION))
    return cells
