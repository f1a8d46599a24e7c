"""Curves over the log's time: observed under simulated ones, and vertical lines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.review.drawing import MUTED, OBSERVED, Color, send_scalars, ticked
from tunenet_logs.arrays import Array

_BROAD = 3.2  # width of what was observed [points]: it is seen beside a line that lies upon it
# What an upright line lasts: a plot has no such thing as an instant with two values.
_INSTANT_S = 1e-6


def log_lines(
    stream: rr.RecordingStream,
    entity: str,
    seconds: Array,
    values: Array,
    style: Sequence[tuple[str, Color, float]],
) -> None:
    """Log several curves as one entity.

    Args:
        stream: Of the review.
        entity: Of the curves.
        seconds: Shape (T,).
        values: Shape (T, C).
        style: Name, colour and width [points] of each.
    """
    names, colors, widths = zip(*style, strict=True)
    lines = rr.SeriesLines(colors=colors, names=names, widths=widths, aggregation_policy="Off")
    stream.log(entity, lines, static=True)
    send_scalars(stream, entity, seconds, values)


def log_observed(stream: rr.RecordingStream, entity: str, seconds: Array, values: Array) -> None:
    """Log observations as a broad line, lowest as plots draw entities by name."""
    style: list[tuple[str, Color, float]] = [("observed", OBSERVED, _BROAD)]
    log_lines(stream, f"{entity}/as_observed", seconds, values[:, None], style)


def log_upright(
    stream: rr.RecordingStream, entity: str, second: float, span: tuple[float, float]
) -> None:
    """Log a vertical line across a plot that shows `span`."""
    values = np.array(ticked(*span))[:, None]
    log_lines(stream, entity, second + np.array([0.0, _INSTANT_S]), values, [("", MUTED, 1.0)])


def plot(entity: str, title: str, span: tuple[float, float]) -> rrb.View:
    """Build a plot of an entity's curves whose axis shows `span` and has ticks."""
    return rrb.TimeSeriesView(
        origin=f"/{entity}",
        name=title,
        axis_y=rrb.ScalarAxis(range=ticked(*span)),
        plot_legend=rrb.PlotLegend(visible=False),
    )
