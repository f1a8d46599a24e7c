"""The second experiment: every method on the same targets, rollout by rollout."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from analysis.evaluation.drop_methods import Method
from analysis.evaluation.drop_networks import Effort, train_networks
from analysis.evaluation.drop_posteriors import Posteriors, credible_coverage, train_posteriors
from analysis.evaluation.drop_targets import TARGET_SETS, DropTarget, TargetSet, draw_targets
from analysis.evaluation.intervals import Coverage, interval_coverages
from analysis.evaluation.method_registry import NPE, Table, roster
from analysis.evaluation.results import Cell, DropResults, Group, Outcome
from analysis.evaluation.shares import Share, work_all
from recorders.simulators.contact import CALIBRATED, PAPER, ContactSettings
from tunenet_logs.arrays import Array
from tunenet_logs.progress import Progress

NOISE_M = 0.01
"""Of the noisy cells: what a good tracker leaves."""

_MOST: Mapping[Group, int] = {"paper": 100, "user": 100, "ours": 100}
_MOST_CALIBRATED: Mapping[Group, int] = {"user": 40, "ours": 100}
"""A rollout takes 3 ms there, and three of a user's methods go on for as long as they may."""

_MOST_NOISY: Mapping[Group, int] = {"paper": 10, "user": 10, "ours": 40}
_MOST_ABLATION: Mapping[Group, int] = {"paper": 10}

_CHUNK = 5
"""Targets in a share: few, so that the processes end together."""


@dataclass(frozen=True)
class DropOrder:
    """What is asked of the experiment.

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
class _Round:
    """A cell before it is filled.

    Attributes:
        most: rollouts that a method is allowed there, by whose it is.
    """

    cell: Cell
    table: Table
    which: TargetSet
    contact: ContactSettings
    most: Mapping[Group, int]

    def drawn(self, count: int, seed: int) -> list[DropTarget]:
        """The seed's targets."""
        return draw_targets(self.which, count, seed, self.cell.noise_m)

    def shares(
        self, method: Method, targets: Sequence[DropTarget], rollouts: int | None
    ) -> list[Share]:
        """A method's work on them, in pieces; `rollouts` as in `DropOrder`."""
        most = min(method.budget, self.most[method.group])
        most = most if rollouts is None else min(most, rollouts)
        return [
            Share(method, tuple(targets[at : at + _CHUNK]), self.contact, most)
            for at in range(0, len(targets), _CHUNK)
        ]


def run_drop(order: DropOrder, progress: Progress) -> DropResults:
    """Train, draw, estimate.

    The same order gives the same figures, whatever its `jobs`.

    Raises:
        UsageError: a method is unknown, or needs a library that is not installed.
    """
    chosen = roster(order.methods)
    networks = {
        seed: train_networks(chosen.networks, seed, order.jobs, progress, order.effort)
        for seed in order.seeds
    }
    posteriors: Posteriors = {}
    if chosen.has_posteriors:
        noises_m = (0.0, NOISE_M)
        posteriors = train_posteriors(order.seeds, noises_m, order.jobs, progress, order.effort)
    shares: list[Share] = []
    columns: list[tuple[_Round, Method, slice]] = []
    for one in _rounds():
        drawn = {seed: one.drawn(order.targets, seed) for seed in order.seeds}
        methods = [
            chosen.methods(
                *(one.table, networks[seed], _truths(drawn[seed]), seed),
                posteriors.get((seed, one.cell.noise_m)),
            )
            for seed in order.seeds
        ]
        for column in zip(*methods, strict=True):  # one method, made anew for each seed
            start = len(shares)
            for method, targets in zip(column, drawn.values(), strict=True):
                shares += one.shares(method, targets, order.rollouts)
            columns.append((one, column[0], slice(start, len(shares))))
    done = work_all(shares, order.jobs, progress)
    outcomes = [_outcome(one, method, done[place], order) for one, method, place in columns]
    with_posteriors = [
        (one.cell, shares[place]) for one, method, place in columns if method.name == NPE
    ]
    credible = credible_coverage(with_posteriors, order.jobs, progress)
    coverage: tuple[Coverage, ...] = ()
    if order.methods is None:
        coverage = interval_coverages(order.seeds, order.targets, order.jobs, progress)
    told = tuple(outcomes), coverage, credible
    return DropResults(order.seeds, order.targets, *told, order.rollouts)


def _outcome(one: _Round, method: Method, parts: Sequence[Array], order: DropOrder) -> Outcome:
    errors = np.concatenate(parts).reshape(len(order.seeds), order.targets, -1)
    return Outcome(one.cell, method.name, method.label, method.group, method.budget, errors)


def _rounds() -> list[_Round]:
    rounds = []
    simulators: tuple[tuple[Table, ContactSettings, Mapping[Group, int]], ...]
    simulators = (("paper", PAPER, _MOST), ("calibrated", CALIBRATED, _MOST_CALIBRATED))
    for table, contact, most_clean in simulators:
        for noise_m, most in ((0.0, most_clean), (NOISE_M, _MOST_NOISY)):
            for which in TARGET_SETS:
                cell = Cell("drop", table, which.name, noise_m)
                rounds.append(_Round(cell, table, which, contact, most))
    for which in TARGET_SETS[:2]:
        cell = Cell("ablation", "paper", which.name, 0.0)
        rounds.append(_Round(cell, "ablation", which, PAPER, _MOST_ABLATION))
    return rounds


def _truths(targets: Sequence[DropTarget]) -> Array:
    return np.array([target.truth for target in targets])
