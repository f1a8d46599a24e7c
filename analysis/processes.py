"""Parallel map over processes with deterministic results and order."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import active_children, get_context, parent_process
from threading import Thread
from typing import Generic, TypeVar

from tunenet_logs.commandline import BLAS_THREADS
from tunenet_logs.starting import heard, is_silent, silence_libraries
from tunenet_logs.stopping import signals_held
from tunenet_logs.terminal import Progress

Item = TypeVar("Item")
Result = TypeVar("Result")

_AHEAD = 2  # items given out for each process: the next is there when one is done
_TRIES = 2  # of an item alone, after a process died: one may have been killed for another's memory


@dataclass(frozen=True)
class Piece(Generic[Item]):
    """Unit of work of one process.

    Attributes:
        units: How much that is, for the progress bar.
        name: Shown beside it.
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
) -> list[Result]:
    """Map `work` over pieces in `jobs` processes; results keep their order.

    Args:
        work: A function of a module, so that a process can import it.
        pieces: Units of work.
        jobs: None for all cores.
        progress: Shows what is under way.
        what: Verb and unit of the progress bar.

    Raises:
        BrokenProcessPool: A process died.
    """
    total = sum(piece.units for piece in pieces)
    results: dict[int, Result] = {}
    with progress.bar(total, *what) as bar:
        for at, result in streamed(work, [piece.item for piece in pieces], jobs):
            results[at] = result
            if pieces[at].name:
                bar.set_postfix_str(pieces[at].name, refresh=False)
            bar.update(pieces[at].units)
    return [results[at] for at in range(len(pieces))]


def streamed(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    jobs: int | None,
    *,
    may_stay: bool = False,
    lost: Callable[[Item], Result] | None = None,
) -> Iterator[tuple[int, Result]]:
    """Map `work` over items in `jobs` processes, and yield results as they are done.

    A process that dies takes with it what all of them had under way: each is retried alone.

    Args:
        work: A function of a module, so that a process can import it.
        items: Items to map.
        jobs: None for all cores.
        may_stay: Whether one job runs in this process, with as many threads as that has.
        lost: Builds the result of an item whose process died alone, too, at each try; without it a
            process that dies is an error.

    Yields:
        The index of an item, and its result.

    Raises:
        BrokenProcessPool: A process died, and there is no `lost`.
    """
    jobs = min(jobs or len(os.sched_getaffinity(0)), max(1, len(items)))
    if jobs == 1 and may_stay:
        yield from ((at, work(item)) for at, item in enumerate(items))
        return
    waiting = deque(range(len(items)))
    while waiting:
        under_way: set[int] = set()
        try:
            yield from _pooled(work, items, waiting, under_way, jobs)
        except BrokenProcessPool:
            if lost is None:
                raise
        for at in sorted(under_way):
            yield at, _alone(work, items[at], lost)


def _pooled(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    waiting: deque[int],
    under_way: set[int],
    jobs: int,
) -> Iterator[tuple[int, Result]]:
    """Run waiting items, few ahead at a time, so that results never pile up."""
    with _pool(jobs) as pool:
        futures: dict[Future[Result], int] = {}
        while waiting or futures:
            with signals_held(), heard():  # this process ends its workers, quietly
                while waiting and len(futures) < _AHEAD * jobs:
                    at = waiting.popleft()
                    under_way.add(at)
                    futures[pool.submit(work, items[at])] = at
            for future in wait(futures, return_when=FIRST_COMPLETED).done:
                result = future.result()
                at = futures.pop(future)
                under_way.discard(at)
                yield at, result


def _alone(
    work: Callable[[Item], Result], item: Item, lost: Callable[[Item], Result] | None
) -> Result:
    """Run one item in a process of its own, up to `_TRIES` times."""
    for _ in range(_TRIES):
        with suppress(BrokenProcessPool), _pool(1) as pool:
            with signals_held(), heard():
                future = pool.submit(work, item)
            return future.result()
    assert lost is not None
    return lost(item)


@contextmanager
def _pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Open a pool of single-threaded processes; an error or Ctrl-C ends them at once.

    The number of BLAS threads decides a product's last bits.
    """
    before = {name: os.environ.get(name) for name in BLAS_THREADS}
    os.environ.update(dict.fromkeys(BLAS_THREADS, "1"))
    pool = ProcessPoolExecutor(
        jobs, mp_context=get_context("spawn"), initializer=_begin, initargs=(is_silent(),)
    )
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


def _begin(silently: bool) -> None:
    """Initialise a worker, which ends with the process that started it."""
    if silently:
        silence_libraries()
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if (parent := parent_process()) is not None:
        parent.join()
        os._exit(1)
