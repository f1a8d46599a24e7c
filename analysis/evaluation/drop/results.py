"""Results of comparing methods: errors of every target, and the figures drawn from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from analysis.evaluation.drop.intervals import Coverage
from analysis.evaluation.drop.method_registry import Group
from analysis.evaluation.drop.published import published_error
from tunenet_logs.arrays import Array

Experiment = Literal["drop", "ablation"]

# Budgets at which methods are compared: the paper's K, and 40, our method's.
ROLLOUTS = (1, 5, 10, 40, 100)

# Methods that are given of the test targets what no method could know.
GIVEN_TRUTHS = ("mean", "entropy-search")

GIVEN_NOTE = "* is given the mean / the range of the test targets, as by its authors: not ranked."


@dataclass(frozen=True)
class Cell:
    """Conditions of a comparison: the same targets, observed alike, in the same simulator.

    Attributes:
        experiment: which table it belongs to.
        simulator: "paper" or "calibrated".
        which: name of the `TargetSet`.
        noise_m: standard deviation of the noise of each height of the target [m].
    """

    experiment: Experiment
    simulator: str
    which: str
    noise_m: float


@dataclass(frozen=True)
class Figures:
    """Figures of one method in one cell after some number of rollouts.

    Attributes:
        mae: mean over the seeds of the mean absolute error over the targets.
        median: of the errors of all targets of all seeds.
        lowest: mean absolute error of the best seed.
        highest: of the worst seed.
        paper: what the paper has in its place.
    """

    mae: float
    median: float
    lowest: float
    highest: float
    paper: float | None


@dataclass(frozen=True, eq=False)
class MethodErrors:
    """Errors of one method in one cell.

    Attributes:
        cell: where it competed.
        method: its name.
        label: as tables have it.
        group: whose it is.
        budget: rollouts after which it gives nothing new.
        errors: absolute error of the restitution of the answer after 0, 1, ... rollouts, shape
            (seeds, targets, 1 + rollouts that it was allowed).
    """

    cell: Cell
    method: str
    label: str
    group: Group
    budget: int
    errors: Array

    @property
    def is_given_truths(self) -> bool:
        """Whether it is given something of the test targets, so that it cannot be ranked."""
        return self.method in GIVEN_TRUTHS

    @property
    def shown(self) -> str:
        """Label; with a star where it `is_given_truths`."""
        return self.label + "*" * self.is_given_truths

    @property
    def allowed(self) -> int:
        """Number of rollouts that it was allowed."""
        return self.errors.shape[2] - 1

    def knows(self, rollouts: int) -> bool:
        """Check whether its answer after that many is known: it had them, or needs none."""
        return rollouts <= self.allowed or self.budget <= self.allowed

    def errors_after(self, rollouts: int) -> Array:
        """Return absolute errors, shape (seeds, targets); beyond its budget its answer stands.

        Raises:
            ValueError: it was not allowed as many, and might have used them.
        """
        if not self.knows(rollouts):
            raise ValueError(f"{self.method} was allowed {self.allowed} rollouts, not {rollouts}")
        return self.errors[:, :, min(rollouts, self.allowed)]

    def figures(self, rollouts: int) -> Figures:
        """Return mean, median and spread over the seeds after that many rollouts."""
        errors = self.errors_after(rollouts)
        means = errors.mean(axis=1)
        comparable = self.cell.simulator == "paper" and not self.cell.noise_m
        paper = published_error(self.cell.which, self.method, rollouts) if comparable else None
        lowest, highest = float(means.min()), float(means.max())
        return Figures(float(means.mean()), float(np.median(errors)), lowest, highest, paper)


@dataclass(frozen=True)
class Credible:
    """Coverage of the 95 % credible intervals of a posterior in a cell.

    Attributes:
        method: name of the one that has a posterior.
        targets: of all seeds.
        held: fraction of them whose interval contains the truth.
        held_se: its standard error.
        width: median of the intervals' widths.
    """

    cell: Cell
    method: str
    targets: int
    held: float
    held_se: float
    width: float


@dataclass(frozen=True, eq=False)
class DropResults:
    """Results of the second experiment.

    Attributes:
        seeds: of training and of the targets.
        targets: test cases for each seed and cell.
        outcomes: every method in every cell.
        coverage: of the intervals of recorded drops; empty where it was not measured.
        credible: coverage of neural posteriors' intervals; empty where there was none.
        rollouts: most that any method was allowed; None where the cells' own limits applied.
    """

    seeds: tuple[int, ...]
    targets: int
    outcomes: tuple[MethodErrors, ...]
    coverage: tuple[Coverage, ...] = ()
    credible: tuple[Credible, ...] = ()
    rollouts: int | None = None

    @property
    def columns(self) -> tuple[int, ...]:
        """Budgets of `ROLLOUTS` that were run."""
        return tuple(n for n in ROLLOUTS if self.rollouts is None or n <= self.rollouts)

    @property
    def cells(self) -> tuple[Cell, ...]:
        """Cells in the order in which they were run."""
        return tuple(dict.fromkeys(one.cell for one in self.outcomes))

    def of(self, cell: Cell) -> Sequence[MethodErrors]:
        """Return every method of a cell."""
        return [one for one in self.outcomes if one.cell == cell]
