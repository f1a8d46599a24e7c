"""Training data: simulated observations on all cores, and which of them are paired."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.arrays import Array
from tunenet_logs.terminal import Progress

Item = TypeVar("Item")


@dataclass(frozen=True, eq=False)
class PairSet:
    """Pairs of rollouts whose parameters are known.

    Attributes:
        observations: shape (N, L, C).
        values: parameters of each, shape (N, P).
        proposed: index of o_P of each pair, shape (M,).
        target: index of o_T of each pair, shape (M,).
    """

    observations: Array
    values: Array
    proposed: NDArray[np.intp]
    target: NDArray[np.intp]

    @property
    def residuals(self) -> Array:
        """zeta_T - zeta_P, shape (M, P)."""
        return self.values[self.target] - self.values[self.proposed]


def observe_all(
    observe: Callable[[Sequence[Item]], Array],
    items: Sequence[Item],
    jobs: int | None,
    progress: Progress,
) -> Array:
    """`observe` over all items, chunk by chunk, in `jobs` processes (default: all cores).

    Returns:
        What it returned, in the order of the items, shape (N, L, C).
    """
    jobs = jobs or len(os.sched_getaffinity(0))
    size = max(1, min(50, len(items) // (2 * jobs) + 1))
    chunks = [items[at : at + size] for at in range(0, len(items), size)]
    parts: list[Array] = []
    with progress.bar(len(items), "simulating", "rollout") as bar:
        if jobs == 1:
            for chunk in chunks:
                parts.append(observe(chunk))
                bar.update(len(chunk))
        else:
            with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
                for chunk, part in zip(chunks, pool.map(observe, chunks), strict=True):
                    parts.append(part)
                    bar.update(len(chunk))
    return np.concatenate(parts)


def consecutive_pairs(count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(0, 1), (2, 3), ...: each rollout in one pair, as in the paper."""
    return np.arange(0, 2 * count, 2), np.arange(1, 2 * count, 2)


def mixed_pairs(
    values: Array, count: int, rng: np.random.Generator
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Half of them any two rollouts, half of them close together, where the last steps are made.

    Args:
        values: of the N rollouts, shape (N, P); close together is by the first one.
        count: pairs wanted.
        rng: where they are drawn from.
    """
    order = np.argsort(values[:, 0])
    proposed = rng.integers(len(values), size=count)
    anywhere = rng.integers(len(values), size=count)
    reach = 0.1 * len(values) * rng.random(count) * rng.standard_normal(count)
    near = np.clip(proposed + reach.astype(int), 0, len(values) - 1)
    target = np.where(rng.random(count) < 0.5, near, anywhere)
    return order[proposed], order[target]
