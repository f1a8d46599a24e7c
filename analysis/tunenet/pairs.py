"""Training data: observations simulated in parallel, and their pairs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from analysis.cluster import Cluster, on_cluster
from analysis.processes import streamed
from tunenet_logs.arrays import Array
from tunenet_logs.errors import TuneNetError
from tunenet_logs.terminal import Progress

Item = TypeVar("Item")

# Who makes rollouts: a cluster, or so many processes of this machine; None for all its cores.
Workers: TypeAlias = Cluster | int | None

# Items that a worker is given: few enough for all to end together, enough to outweigh giving.
_MAX_AT_A_TIME, _CHUNKS = 50, 128


@dataclass(frozen=True, eq=False)
class PairSet:
    """Pairs of rollouts whose parameters are known.

    Attributes:
        observations: Shape (N, L, C).
        values: Parameters of each, shape (N, P).
        proposed: Index of o_P of each pair, shape (M,).
        target: Index of o_T of each pair, shape (M,).
    """

    observations: Array
    values: Array
    proposed: NDArray[np.intp]
    target: NDArray[np.intp]

    @property
    def residuals(self) -> Array:
        """Parameter residuals zeta_T - zeta_P, shape (M, P)."""
        return self.values[self.target] - self.values[self.proposed]


def observe_all(
    observe: Callable[[Sequence[Item]], Array],
    items: Sequence[Item],
    workers: Workers,
    progress: Progress,
) -> Array:
    """Map `observe` over all items in chunks, and concatenate in order, shape (N, L, C).

    Chunks do not depend on the number of workers, so the same items give the same bits.

    Args:
        observe: Observations of some items, as many of each; a function of a module.
        items: To observe.
        workers: Processes or a cluster.
        progress: Shows how many are done.

    Raises:
        TuneNetError: A worker died of the same items at each try.
    """
    size = max(1, min(_MAX_AT_A_TIME, len(items) // _CHUNKS + 1))
    chunks = [items[at : at + size] for at in range(0, len(items), size)]
    if isinstance(workers, Cluster):
        done = on_cluster(workers, observe, chunks, _gone)
    else:
        done = streamed(observe, chunks, workers, may_stay=True, lost=_gone)
    all_of_them: Array | None = None
    with progress.bar(len(items), "simulating", "rollout") as bar:
        for at, part in done:
            each = len(part) // len(chunks[at])
            if all_of_them is None:
                all_of_them = np.empty((each * len(items), *part.shape[1:]), part.dtype)
            first = each * size * at
            all_of_them[first : first + len(part)] = part
            bar.update(len(chunks[at]))
    assert all_of_them is not None, "nothing to observe"
    return all_of_them


def _gone(chunk: Sequence[object]) -> Array:
    raise TuneNetError(
        f"a process that simulated {len(chunk)} rollouts died each time that they were tried; "
        "memory may be short: choose fewer --jobs"
    )


def consecutive_pairs(count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pair rollouts (0, 1), (2, 3), ...: each in one pair, as in the paper."""
    return np.arange(0, 2 * count, 2), np.arange(1, 2 * count, 2)


def mixed_pairs(
    values: Array, count: int, rng: np.random.Generator
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Draw pairs: half of any two rollouts, half close together, as the last iterations are.

    Args:
        values: Of the N rollouts, shape (N, P); close together is by the first one.
        count: Pairs wanted.
        rng: Random generator.
    """
    order = np.argsort(values[:, 0])
    proposed = rng.integers(len(values), size=count)
    anywhere = rng.integers(len(values), size=count)
    reach = 0.1 * len(values) * rng.random(count) * rng.standard_normal(count)
    near = np.clip(proposed + reach.astype(int), 0, len(values) - 1)
    target = np.where(rng.random(count) < 0.5, near, anywhere)
    return order[proposed], order[target]
