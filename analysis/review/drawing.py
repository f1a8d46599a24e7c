"""What every review draws with: colours, the two timelines, and sizes on the screen."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr

from tunenet_logs.arrays import Array

Color = tuple[int, int, int]
"""Red, green and blue, 0 to 255 each."""

GROUND: Color = (16, 18, 24)
"""Behind charts and scenes: nearly black, as Rerun's own views are."""

OBSERVED: Color = (255, 255, 255)
MUTED: Color = (140, 140, 140)
SUCCESS: Color = (60, 190, 130)
FAILURE: Color = (235, 95, 75)
FITTED: Color = (255, 95, 165)
"""One colour for one meaning in every review; white, the most legible, is what was recorded."""

_RAMP: tuple[Color, ...] = (
    (112, 100, 190),
    (66, 120, 220),
    (40, 165, 200),
    (60, 190, 130),
    (160, 205, 60),
    (255, 165, 40),
)
"""Cold to warm: readable on a dark ground, and apart for the colour-blind."""

LOG_TIME = "log_time_s"
"""The timeline that plays: seconds since the log's first sample."""

ITERATION = "iteration"
"""The timeline that is scrubbed: k of the tuning."""


def ramp(k: int, count: int) -> Color:
    """The colour of iteration `k` of `count`, linear between those of the ramp."""
    place = k / max(count - 1, 1) * (len(_RAMP) - 1)
    low = min(int(place), len(_RAMP) - 2)
    pairs = zip(_RAMP[low], _RAMP[low + 1], strict=True)
    red, green, blue = (round(a + (place - low) * (b - a)) for a, b in pairs)
    return red, green, blue


def entity_of(*parts: str) -> str:
    """The path of an entity whose parts may be anything: slashes in them part them further."""
    return rr.new_entity_path([name for part in parts for name in part.split("/") if name])


def at_seconds(seconds: Array) -> rr.TimeColumn:
    """The index of rows at these times on `LOG_TIME`, shape (T,) [s]."""
    return rr.TimeColumn(LOG_TIME, duration=seconds)


def by_iteration(count: int, first_s: float) -> list[tuple[rr.TimeColumn, range]]:
    """For what is drawn once an iteration: each timeline's index, and the iterations it shows.

    On `ITERATION` these are all of them; on `LOG_TIME` it is the last one, the result, from
    `first_s` on.
    """
    return [
        (rr.TimeColumn(ITERATION, sequence=np.arange(count)), range(count)),
        (at_seconds(np.array([first_s])), range(count - 1, count)),
    ]


def screen_radius(points: float) -> Any:
    """A radius in points of the screen, whatever the zoom."""
    return [rr.Radius.ui_points(points)]


def send_scalars(stream: rr.RecordingStream, entity: str, seconds: Array, values: Array) -> None:
    """Send a series over the log's time.

    Args:
        stream: the recording.
        entity: path of the series.
        seconds: on `LOG_TIME`, shape (T,) [s].
        values: shape (T,); or (T, S) for S series.
    """
    stream.send_columns(
        entity, indexes=[at_seconds(seconds)], columns=rr.Scalars.columns(scalars=values)
    )
