"""Methods at work on test cases, spread over processes: the same figures however many there are."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from multiprocessing import active_children, get_context

import numpy as np
from numpy.typing import NDArray

from analysis.estimators.base import Problem, Trace
from analysis.experiments.drop_methods import Method
from analysis.experiments.drop_targets import DropProblems, DropTarget
from recorders.simulators.contact import ContactSettings
from tunenet_logs.progress import Progress

Array = NDArray[np.float64]

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


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
    problems = _problems(share.contact)
    method = share.method
    errors = np.empty((len(share.targets), share.rollouts + 1))
    for row, target in zip(errors, share.targets, strict=True):
        problem = problems.pose(target, free_release=method.free_release)
        trace = method.estimator.estimate(problem, share.rollouts)
        _check(method, problem, trace, share.rollouts)
        row[:] = [abs(trace.after(n)[0] - target.truth) for n in range(share.rollouts + 1)]
    return errors


@cache
def _problems(contact: ContactSettings) -> DropProblems:
    """One world a process."""
    return DropProblems(contact)


def _check(method: Method, problem: Problem, trace: Trace, allowed: int) -> None:
    spent = [step.rollouts for step in trace.steps]
    if problem.rollouts > allowed:
        raise OverspentError(f"{method.name} spent {problem.rollouts} rollouts of {allowed}")
    if spent[0] != 0 or spent != sorted(spent) or spent[-1] > problem.rollouts:
        raise OverspentError(f"{method.name} says {spent} of {problem.rollouts} rollouts")


def work_all(shares: Sequence[Share], jobs: int | None, progress: Progress) -> list[Array]:
    """`errors_of` every share, in their order, in `jobs` processes (default: all cores)."""
    jobs = min(jobs or len(os.sched_getaffinity(0)), max(1, len(shares)))
    total = sum(len(share.targets) for share in shares)
    results: dict[int, Array] = {}
    with progress.bar(total, "estimating", "target") as bar, processes(jobs) as pool:
        with interrupts_held():  # this process ends its workers, quietly
            futures = {pool.submit(errors_of, share): at for at, share in enumerate(shares)}
        for future in as_completed(futures):
            at = futures[future]
            results[at] = future.result()
            bar.set_postfix_str(shares[at].method.name, refresh=False)
            bar.update(len(shares[at].targets))
    return [results[at] for at in range(len(shares))]


@contextmanager
def processes(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Processes of one thread each; an error or Ctrl-C ends them at once.

    They are used for one job too: how many threads add up a product decides its last bits.
    """
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"))
    try:
        yield pool
    except BaseException:
        for worker in active_children():
            worker.terminate()
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name)
            else:
                os.environ[name] = value
    pool.shutdown()


@contextmanager
def interrupts_held() -> Iterator[None]:
    """What is started here never sees Ctrl-C; this process does, as soon as it may."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
