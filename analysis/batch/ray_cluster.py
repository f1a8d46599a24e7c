"""Tune logs on a Ray cluster whose machines share one file system."""

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
    """Map `work` over logs on a cluster; see `cluster.on_cluster`.

    Args:
        cluster: The cluster.
        work: Reads logs and writes results by paths that every machine sees.
        items: Logs to tune; paths are made absolute, as an actor has another working folder.
        lost: Builds the result of a log whose actor died twice.

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
