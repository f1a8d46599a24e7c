"""Work in several processes: the same results, in the same order, however many there are."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import active_children, get_context
from typing import Generic, TypeVar

from tunenet_logs.commandline import BLAS_THREADS
from tunenet_logs.starting import heard, is_silent, silence_libraries
from tunenet_logs.stopping import signals_held
from tunenet_logs.terminal import Progress

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Piece(Generic[Item]):
    """What one process does in one go.

    Attributes:
        units: how much that is, for the progress bar.
        name: shown beside it.
    """

    item: Item
    units: int = 1
    name: str = ""


def parallel_map(
    work: Callable[[Item], Result],
    pieces: Sequence[Piece[Item]],
    jobs: int | None,
    progress: Progress,
    what: tuple[str, str],
    *,
    may_stay: bool = False,
    lost: Callable[[Item], Result] | None = None,
) -> list[Result]:
    """`work` on every piece, in `jobs` processes.

    Args:
        work: a function of a module, so that a process can find it.
        pieces: what is to be done.
        jobs: None for all cores.
        progress: shows what is under way.
        what: is done, and the name of a unit of it.
        may_stay: whether one job runs in this process, with as many threads as that has.
        lost: the result of an item whose process dies twice, the second time alone; without it a
            process that dies is an error.

    Returns:
        One result for each piece, in their order.
    """
    jobs = min(jobs or len(os.sched_getaffinity(0)), max(1, len(pieces)))
    total = sum(piece.units for piece in pieces)
    results: dict[int, Result] = {}
    with progress.bar(total, *what) as bar:

        def done(at: int, result: Result) -> None:
            results[at] = result
            if pieces[at].name:
                bar.set_postfix_str(pieces[at].name, refresh=False)
            bar.update(pieces[at].units)

        if jobs == 1 and may_stay:
            for at, piece in enumerate(pieces):
                done(at, work(piece.item))
            return list(results.values())
        with _pool(jobs) as pool:
            with signals_held(), heard():  # this process ends its workers, quietly
                futures = {pool.submit(work, piece.item): at for at, piece in enumerate(pieces)}
            for future in as_completed(futures):
                died = isinstance(future.exception(), BrokenProcessPool)
                if lost is None or not died:
                    done(futures[future], future.result())
        for at, piece in enumerate(pieces):  # a process that dies takes its pool with it
            if lost is not None and at not in results:
                with _pool(1) as pool:
                    with signals_held(), heard():
                        future = pool.submit(work, piece.item)
                    try:
                        done(at, future.result())
                    except BrokenProcessPool:
                        done(at, lost(piece.item))
    return [results[at] for at in range(len(pieces))]


@contextmanager
def _pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Processes of one thread each; an error or Ctrl-C ends them at once.

    The number of threads that add up a product decides its last bits.
    """
    before = {name: os.environ.get(name) for name in BLAS_THREADS}
    os.environ.update(dict.fromkeys(BLAS_THREADS, "1"))
    quiet = silence_libraries if is_silent() else None
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=quiet)
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
