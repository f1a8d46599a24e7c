"""Methods at work on test cases, spread over processes: the same figures however many there are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from analysis.estimators.base import Problem, Trace
from analysis.evaluation.drop_methods import Method
from analysis.evaluation.drop_targets import DropProblems, DropTarget
from analysis.processes import Piece, parallel_map
from recorders.simulators.contact import ContactSettings
from tunenet_logs.arrays import Array
from tunenet_logs.progress import Progress


class OverspentError(Exception):
    """A method took more rollouts than it was allowed, or says that it took fewer: a defect."""


@dataclass(frozen=True)
class Share:
    """A method and some of the targets of a cell: what one process does in one go.

    Attributes:
        rollouts: most that it may spend on a target.
    """

    method: Method
    targets: tuple[DropTarget, ...]
    contact: ContactSettings
    rollouts: int


def errors_of(share: Share) -> Array:
    """Absolute errors of the answers after 0, 1, ... rollouts, shape (targets, 1 + rollouts)."""
    problems = problems_in(share.contact)
    method = share.method
    errors = np.empty((len(share.targets), share.rollouts + 1))
    for row, target in zip(errors, share.targets, strict=True):
        problem = problems.pose(target, free_release=method.free_release)
        trace = method.estimator.estimate(problem, share.rollouts)
        _check(method, problem, trace, share.rollouts)
        row[:] = [abs(trace.after(n)[0] - target.truth) for n in range(share.rollouts + 1)]
    return errors


@cache
def problems_in(contact: ContactSettings) -> DropProblems:
    """Poses the test cases of a simulator; one world a process."""
    return DropProblems(contact)


def _check(method: Method, problem: Problem, trace: Trace, allowed: int) -> None:
    spent = [step.rollouts for step in trace.steps]
    if problem.rollouts > allowed:
        raise OverspentError(f"{method.name} spent {problem.rollouts} rollouts of {allowed}")
    if spent[0] != 0 or spent != sorted(spent) or spent[-1] > problem.rollouts:
        raise OverspentError(f"{method.name} says {spent} of {problem.rollouts} rollouts")


def work_all(shares: Sequence[Share], jobs: int | None, progress: Progress) -> list[Array]:
    """`errors_of` every share, in their order, in `jobs` processes (default: all cores)."""
    pieces = [Piece(share, len(share.targets), share.method.name) for share in shares]
    return parallel_map(errors_of, pieces, jobs, progress, ("estimating", "target"))
