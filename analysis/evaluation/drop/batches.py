"""Run methods on test cases, spread over processes, with the same figures for any number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from analysis.estimators.base import Problem, Trace
from analysis.evaluation.drop.method_registry import Method
from analysis.evaluation.drop.targets import DropProblems, DropTarget
from analysis.processes import Piece, parallel_map
from recorders.simulators.contact import ContactSettings
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import Progress


class OverspentError(Exception):
    """Method that took more rollouts than it was allowed, or miscounts them: a defect."""


@dataclass(frozen=True)
class TargetBatch:
    """Method and some of the targets of a cell: what one process does in one go.

    Attributes:
        method: the method, ready to estimate.
        targets: the test cases.
        contact: of the simulator that it may roll out.
        rollouts: most that it may spend on a target.
    """

    method: Method
    targets: tuple[DropTarget, ...]
    contact: ContactSettings
    rollouts: int


def errors_of(batch: TargetBatch) -> Array:
    """Return the absolute errors after 0, 1, ... rollouts, shape (targets, 1 + rollouts).

    Raises:
        OverspentError: the method miscounts its rollouts.
    """
    problems = problems_in(batch.contact)
    method = batch.method
    errors = np.empty((len(batch.targets), batch.rollouts + 1))
    for row, target in zip(errors, batch.targets, strict=True):
        problem = problems.pose(target, free_release=method.free_release)
        trace = method.estimator.estimate(problem, batch.rollouts)
        _check_spending(method, problem, trace, batch.rollouts)
        row[:] = [abs(trace.after(n)[0] - target.truth) for n in range(batch.rollouts + 1)]
    return errors


@cache
def problems_in(contact: ContactSettings) -> DropProblems:
    """Return the test cases' problems in a simulator; one world a process."""
    return DropProblems(contact)


def _check_spending(method: Method, problem: Problem, trace: Trace, allowed: int) -> None:
    spent = [step.rollouts for step in trace.steps]
    if problem.rollouts > allowed:
        raise OverspentError(f"{method.name} spent {problem.rollouts} rollouts of {allowed}")
    if spent[0] != 0 or spent != sorted(spent) or spent[-1] > problem.rollouts:
        raise OverspentError(f"{method.name} says {spent} of {problem.rollouts} rollouts")


def estimate_batches(
    batches: Sequence[TargetBatch], jobs: int | None, progress: Progress
) -> list[Array]:
    """Run `errors_of` on every batch, in order, in `jobs` processes (default: all cores)."""
    pieces = [Piece(batch, len(batch.targets), batch.method.name) for batch in batches]
    return parallel_map(errors_of, pieces, jobs, progress, ("estimating", "target"))
