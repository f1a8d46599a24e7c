"""Map work over processes of this machine, or over a Ray cluster with Ray Data.

Items under way when a worker dies are retried, each alone.
"""

from __future__ import annotations

import os
import signal
import socket
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import active_children, get_context, parent_process
from threading import Thread, current_thread, main_thread
from typing import Any, Generic, TypeVar

import numpy as np

from tunenet_logs.console import BLAS_THREADS
from tunenet_logs.errors import UsageError, pip_install
from tunenet_logs.process import heard, heard_wait, is_silent, signals_held, silence_libraries
from tunenet_logs.recorders.simulators.known import ENGINE_VARIABLE
from tunenet_logs.terminal import Progress

Item = TypeVar("Item")
Result = TypeVar("Result")


# ---- Ray cluster: one actor per core, libraries loaded once.

HERE = "local"  # the address of a cluster that is started on this machine for the work
_LOOPBACK = "127.0.0.1"
# Where such a cluster listens: Ray takes an address of the network in its place, and listens on
# all, unless this variable says that it is to stay on one machine.
_ONLY_HERE = "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"


@dataclass(frozen=True)
class Cluster:
    """Ray cluster to work on."""

    address: str = HERE  # of its head, "auto" for the one that this machine is part of, or `HERE`
    jobs: int | None = None  # number of actors; None for all cores of the cluster


def on_cluster(
    cluster: Cluster,
    work: Callable[[Item], Result],
    items: Sequence[Item],
    lost: Callable[[Item], Result],
) -> Iterator[tuple[int, Result]]:
    """Map `work` over items on a cluster, in the order they are done; see `streamed`."""
    left = set(range(len(items)))
    with _connected(cluster) as actors:
        # Each task costs Ray some milliseconds; each actor has four tasks or more.
        at_a_time = max(1, min(16, len(items) // (actors * 4)))
        for many in (at_a_time, 1):
            rows = [{"number": at, "item": items[at]} for at in sorted(left)]
            for at, result in _done(work, rows, min(actors, max(1, len(rows))), many):
                if at in left:
                    left.remove(at)
                    yield at, result
            if not left:
                break
        for at in sorted(left):
            yield at, lost(items[at])


def _done(
    work: Callable[[Item], Result], rows: list[dict[str, Any]], actors: int, at_a_time: int
) -> Iterator[tuple[int, Result]]:
    """Yield the actors' results; nothing of those that die."""
    import ray.data

    if not rows:
        return
    given = ray.data.from_items(rows, override_num_blocks=-(-len(rows) // at_a_time))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "`ray_remote_args_fn` is deprecated")  # nothing else yet
        done = given.map_batches(
            _Worker,
            fn_constructor_args=(work,),
            concurrency=actors,
            batch_size=None,
            batch_format="numpy",
            num_cpus=1,
            # Dead actors restart, but tasks are not retried unasked.
            ray_remote_args_fn=lambda: {"max_restarts": -1, "max_task_retries": 0},
        )
    for batch in done.iter_batches(batch_size=None, batch_format="numpy", prefetch_batches=0):
        for at, (result, error) in zip(batch["number"].tolist(), batch["result"], strict=True):
            if error is not None:
                raise error
            yield at, result


class _Worker:
    """Actor: libraries and models are loaded once in it, by the first item."""

    def __init__(self, work: Callable[[Any], Any]) -> None:
        self._work = work

    def __call__(self, batch: Mapping[str, Any]) -> dict[str, Any]:
        """Return results by number, each with an error of `work`, raised where it is taken."""
        results = np.empty(len(batch["item"]), object)
        for at, item in enumerate(batch["item"]):
            try:
                results[at] = (self._work(item), None)
            except Exception as error:  # noqa: BLE001
                results[at] = (None, error)
        return {"number": batch["number"], "result": results}


@contextmanager
def _connected(cluster: Cluster) -> Iterator[int]:
    """Connect to a cluster, and yield the number of actors that its cores allow."""
    address, jobs = cluster.address, cluster.jobs
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    os.environ.setdefault("RAY_DEDUP_LOGS", "0")
    if address == HERE:  # read when Ray is imported, here and in the processes that it starts
        os.environ[_ONLY_HERE] = "0"
    try:
        import ray
        import ray.data
        from ray._private import ray_constants
    except ImportError as error:
        raise UsageError(
            f"--ray needs Ray ({error}); install the extra: {pip_install('cluster')}"
        ) from error
    import logging

    ray_constants.ENABLE_RAY_CLUSTER = address != HERE  # where somebody imported it before
    variables: dict[str, str] = dict.fromkeys(BLAS_THREADS, "1")
    if ENGINE_VARIABLE in os.environ:
        variables[ENGINE_VARIABLE] = os.environ[ENGINE_VARIABLE]
    begin = partial(
        ray.init,
        runtime_env={"env_vars": variables},
        include_dashboard=False if address == HERE else None,
        logging_level=logging.ERROR,
        log_to_driver=False,
        configure_logging=True,
    )
    stops = signal.getsignal(signal.SIGTERM)
    try:
        if ":" in address:  # Ray itself tries for minutes, and then ends the process
            host, _, port = address.removeprefix("ray://").rpartition(":")
            # A cluster's head takes a call within 10 s.
            socket.create_connection((host, int(port)), 10).close()
        if address == HERE:
            cores = jobs or len(os.sched_getaffinity(0))
            begin(address=HERE, num_cpus=cores, _node_ip_address=_LOOPBACK)
        else:
            begin(address=address)
    except (OSError, OverflowError, ValueError, RuntimeError) as error:
        raise UsageError(f"--ray {address}: no cluster answers ({error})") from error
    finally:
        if current_thread() is main_thread():  # Ray's own handler ends the process at once
            signal.signal(signal.SIGTERM, stops)
    context = ray.data.DataContext.get_current()
    context.max_errored_blocks = -1
    context.enable_progress_bars = False
    context.print_on_execution_start = False
    logging.getLogger("ray.data").setLevel(logging.CRITICAL)
    try:
        cores = int(ray.cluster_resources().get("CPU", 1))
        yield max(1, min(cores, jobs or cores))
    finally:
        ray.shutdown()
        os.environ.pop(_ONLY_HERE, None)


# ---- Processes of this machine: results and their order are deterministic.


@dataclass(frozen=True)
class Piece(Generic[Item]):
    """Unit of work of one process."""

    item: Item
    units: int = 1  # how much that is, for the progress bar
    name: str = ""  # shown beside it


def parallel_map(
    work: Callable[[Item], Result],
    pieces: Sequence[Piece[Item]],
    jobs: int | None,
    progress: Progress,
    what: tuple[str, str],
) -> list[Result]:
    """Map `work` over pieces as `streamed` does; results keep their order.

    `progress` shows a bar of the verb and the unit `what`. A process that dies is an error.
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

    A process that dies takes with it what all of them had under way: each is retried alone. `lost`
    builds the result of an item whose process died at each of these tries, too; without it a
    process that dies is an error (BrokenProcessPool). `jobs` is None for all cores; with `may_stay`
    one job runs in this process, with as many threads as that has.
    """
    jobs = min(jobs or len(os.sched_getaffinity(0)), max(1, len(items)))
    if jobs == 1 and may_stay:
        yield from ((at, work(item)) for at, item in enumerate(items))
        return
    waiting = deque(range(len(items)))
    while waiting:
        under_way: set[int] = set()
        try:
            with _pool(jobs) as pool:
                futures: dict[Future[Result], int] = {}
                while waiting or futures:
                    with signals_held(), heard():  # this process ends its workers, quietly
                        # Two for each process, so that results never pile up.
                        while waiting and len(futures) < 2 * jobs:
                            at = waiting.popleft()
                            under_way.add(at)
                            futures[pool.submit(work, items[at])] = at
                    heard_wait(partial(_any_done, futures))
                    for future in [one for one in futures if one.done()]:
                        result = future.result()
                        at = futures.pop(future)
                        under_way.discard(at)
                        yield at, result
        except BrokenProcessPool:
            if lost is None:
                raise
        for at in sorted(under_way):
            assert lost is not None
            for _ in range(2):  # one may have been killed for another's memory
                with suppress(BrokenProcessPool), _pool(1) as pool:
                    with signals_held(), heard():
                        future = pool.submit(work, items[at])
                    result = future.result()
                    break
            else:
                result = lost(items[at])
            yield at, result


def _any_done(futures: Iterable[Future[Any]], seconds: float) -> bool:
    return bool(wait(futures, seconds, FIRST_COMPLETED).done)


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

    def end_with_parent() -> None:
        if (parent := parent_process()) is not None:
            parent.join()
            os._exit(1)

    if silently:
        silence_libraries()
    Thread(target=end_with_parent, daemon=True).start()
