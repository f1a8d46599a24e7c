"""How things get into a review: its two timelines, and sizes on the screen."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

LOG_TIME = "log_time_s"
"""Seconds since the log's first sample: what plays."""

ITERATION = "iteration"
"""k of the tuning: what is scrubbed."""


def entity_of(*parts: str) -> str:
    """The path of an entity whose parts may be anything: slashes in them part them further."""
    return rr.new_entity_path([one for part in parts for one in part.split("/") if one])


def at_seconds(seconds: NDArray[np.float64]) -> rr.TimeColumn:
    """An index on the log's time."""
    return rr.TimeColumn(LOG_TIME, duration=seconds)


def at_iterations(count: int) -> rr.TimeColumn:
    """An index 0, 1, ... on the iterations."""
    return rr.TimeColumn(ITERATION, sequence=np.arange(count))


def screen_radius(points: float) -> Any:
    """A radius in points of the screen, whatever the zoom."""
    return [rr.Radius.ui_points(points)]


def send_scalars(
    stream: rr.RecordingStream,
    entity: str,
    seconds: NDArray[np.float64],
    values: NDArray[np.float64],
) -> None:
    """A series over the log's time; several, where values have the shape (T, series)."""
    stream.send_columns(
        entity, indexes=[at_seconds(seconds)], columns=rr.Scalars.columns(scalars=values)
    )
