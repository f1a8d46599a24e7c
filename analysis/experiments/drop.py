"""The second experiment: every method on the same targets, rollout by rollout."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from analysis.experiments.drop_methods import Method
from analysis.experiments.drop_networks import Networks, train_networks
from analysis.experiments.drop_roster import Entrant, entrants
from analysis.experiments.drop_targets import TARGET_SETS, DropTarget, TargetSet, draw_targets
from analysis.experiments.results import Cell, DropResults, Outcome
from analysis.experiments.shares import Share, work_all
from recorders.simulators.contact import CALIBRATED, PAPER, ContactSettings
from tunenet_logs.progress import Progress

NOISE_M = 0.01
"""Of the noisy cells: what a good tracker leaves."""

_MOST = 100
_MOST_NOISY = 10
_MOST_NOISY_OURS = 40
_ABLATION_MOST = 10
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
        epochs: of training, in place of the recipes', to try things out.
    """

    seeds: tuple[int, ...]
    targets: int
    methods: tuple[str, ...] | None = None
    jobs: int | None = None
    epochs: int | None = None


@dataclass(frozen=True)
class _Round:
    """A cell before it is filled."""

    cell: Cell
    which: TargetSet
    contact: ContactSettings
    chosen: Callable[[Entrant], bool]
    most: Callable[[Method], int]


def run_drop(order: DropOrder, progress: Progress) -> DropResults:
    """Train, draw, estimate.

    The same order gives the same figures, whatever its `jobs`.

    Raises:
        UsageError: a method is unknown, or needs a library that is not installed.
    """
    chosen = entrants(order.methods)
    wanted = {name for one in chosen for name in one.networks}
    networks = {
        seed: train_networks(wanted, seed, order.jobs, progress, order.epochs)
        for seed in order.seeds
    }
    shares: list[Share] = []
    places: list[tuple[_Round, Method, int, slice]] = []
    for one in _rounds():
        methods = {
            seed: _methods(chosen, one, networks[seed], _drawn(one, order, seed))
            for seed in order.seeds
        }
        for column in zip(*methods.values(), strict=True):
            start = len(shares)
            for seed, method in zip(order.seeds, column, strict=True):
                shares += _shares(one, method, _drawn(one, order, seed))
            places.append((one, column[0], len(order.seeds), slice(start, len(shares))))
    done = work_all(shares, order.jobs, progress)
    outcomes = []
    for one, method, seeds, place in places:
        errors = np.concatenate(done[place])
        errors = errors.reshape(seeds, order.targets, errors.shape[1])
        named = (method.name, method.label, method.group, method.budget)
        outcomes.append(Outcome(one.cell, *named, errors))
    return DropResults(order.seeds, order.targets, tuple(outcomes))


def _rounds() -> list[_Round]:
    rounds = []
    for noise_m in (0.0, NOISE_M):
        most = _allowed_noisy if noise_m else _allowed
        for which in TARGET_SETS:
            cell = Cell("drop", "paper", which.name, noise_m)
            rounds.append(_Round(cell, which, PAPER, _competes, most))
    for noise_m in (0.0, NOISE_M):
        most = _allowed_noisy if noise_m else _allowed
        for which in TARGET_SETS:
            cell = Cell("drop", "calibrated", which.name, noise_m)
            rounds.append(_Round(cell, which, CALIBRATED, _knows_the_calibrated, most))
    for which in TARGET_SETS[:2]:
        cell = Cell("ablation", "paper", which.name, 0.0)
        rounds.append(_Round(cell, which, PAPER, _is_ablation, _allowed_ablation))
    return rounds


def _competes(entrant: Entrant) -> bool:
    return entrant.experiment == "drop" and not entrant.calibrated


def _knows_the_calibrated(entrant: Entrant) -> bool:
    return entrant.experiment == "drop" and entrant.calibrated


def _is_ablation(entrant: Entrant) -> bool:
    return entrant.experiment == "ablation"


def _allowed(method: Method) -> int:
    return min(method.budget, _MOST)


def _allowed_noisy(method: Method) -> int:
    return min(method.budget, _MOST_NOISY_OURS if method.group == "ours" else _MOST_NOISY)


def _allowed_ablation(method: Method) -> int:
    return min(method.budget, _ABLATION_MOST)


def _drawn(one: _Round, order: DropOrder, seed: int) -> list[DropTarget]:
    return draw_targets(one.which, order.targets, seed, one.cell.noise_m)


def _methods(
    chosen: Sequence[Entrant], one: _Round, networks: Networks, targets: Sequence[DropTarget]
) -> list[Method]:
    truths = np.array([target.truth for target in targets])
    return [entrant.make(networks, truths) for entrant in chosen if one.chosen(entrant)]


def _shares(one: _Round, method: Method, targets: Sequence[DropTarget]) -> list[Share]:
    most = one.most(method)
    return [
        Share(method, tuple(targets[at : at + _CHUNK]), one.contact, most)
        for at in range(0, len(targets), _CHUNK)
    ]
