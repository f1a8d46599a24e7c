"""Logs tuned on a Ray cluster: every machine reads and writes by the same paths."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from analysis.batch.one_log import Result, Work
from analysis.cluster import Cluster, on_cluster
from tunenet_logs.regular_file import real_path


def on_ray(
    cluster: Cluster,
    work: Callable[[Work], Result],
    items: Sequence[Work],
    lost: Callable[[Work], Result],
) -> Iterator[tuple[int, Result]]:
    """Do `work` on every log in a cluster; see `cluster.on_cluster`.

    Args:
        cluster: where.
        work: reads logs and writes results by paths that every machine sees.
        items: what is to be done; an actor's folder is not this one, so its paths become absolute.
        lost: the result of a log whose actor died twice.

    Raises:
        UsageError: Ray is not installed, nobody answers at the address, or the options fit no log.
    """
    absolute = [
        Work(real_path(item.log), real_path(item.name))
        if isinstance(item.log, Path)
        else replace(item, name=real_path(item.name))
        for item in items
    ]
    return on_cluster(cluster, work, absolute, lost)
