"""A parameter by iteration, drawn so that it stays in view on either timeline."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.record import interval_words, quantity
from analysis.review.colors import MUTED, OBSERVED, Color
from analysis.review.grid import WIDTH, chart_view, filled, log_grid, mixed, ticks
from analysis.review.sending import at_iterations, at_seconds, screen_radius

_ROOM = 0.36
"""That a figure takes up."""

_ABOVE = 0.2
"""Of a figure above its dot: it hangs from its place."""

_LEAST_BAND = 0.008
"""Of the chart's height: what can be seen."""

_BAND = 0.35
"""Of its colour, above the ground."""

_BELOW, _OVER = 0.15, 0.4
"""Room under and over the values, of what they span."""


@dataclass(frozen=True)
class Iterates:
    """One parameter at each iteration.

    Attributes:
        parameter: in words.
        unit: "1" where it has none.
        names: of the iterations, "k=3", "refined".
        span: least and most value that the chart shows.
        interval95: of the result; None where none is honest.
    """

    parameter: str
    unit: str
    names: tuple[str, ...]
    values: tuple[float, ...]
    colors: tuple[Color, ...]
    span: tuple[float, float]
    interval95: tuple[float, float] | None


def span_of(values: Sequence[float], least: float) -> tuple[float, float]:
    """What a chart of these shows, with room for their figures; `least` or more."""
    low, high = min(values), max(values)
    reach = max(high - low, least)
    middle = (low + high) / 2
    return middle - (0.5 + _BELOW) * reach, middle + (0.5 + _OVER) * reach


def log_iterates(stream: rr.RecordingStream, iterates: Iterates, first_s: float) -> None:
    """Send the entities of `iterates_view`; the log's time begins at `first_s`."""
    low, high = iterates.span
    count = len(iterates.values)

    def up(value: float) -> float:
        return -(value - low) / (high - low)

    margin = max(WIDTH / (2 * count), _ROOM / 2)
    x = np.linspace(margin, WIDTH - margin, count)
    dots = np.column_stack([x, [up(one) for one in iterates.values]])
    every = math.ceil(_ROOM * (count - 1) / (WIDTH - 2 * margin)) if count > 1 else 1
    shown = range(count - 1, -1, -every)  # the last is the result
    rows = [(up(value), f"{value:g}") for value in ticks(low, high, 4)]
    marks = [(float(x[k]), iterates.names[k]) for k in shown]
    log_grid(stream, "sheets/convergence", WIDTH, rows, marks)
    if iterates.interval95 is not None:
        ends = [up(end) for end in iterates.interval95]
        half = max(ends[0] - ends[1], _LEAST_BAND) / 2
        middle = sum(ends) / 2
        strips, radius = filled(0.0, WIDTH, middle - half, middle + half)
        color = mixed(iterates.colors[-1], _BAND)
        band = rr.LineStrips2D(strips, colors=[color], radii=[radius], draw_order=1.0)
        stream.log("sheets/convergence/interval", band, static=True)
    line = rr.LineStrips2D([dots], colors=[MUTED], radii=screen_radius(0.8))
    stream.log("sheets/convergence/line", line, static=True)
    values = rr.Points2D(dots, colors=iterates.colors, radii=screen_radius(5.0), draw_order=20.0)
    stream.log("sheets/convergence/values", values, static=True)
    figures = rr.Points2D(
        [dots[k] - [0, _ABOVE] for k in shown],
        labels=[f"{iterates.values[k]:.4f}" for k in shown],
        colors=[iterates.colors[k] for k in shown],
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log("sheets/convergence/figures", figures, static=True)
    ring = rr.Points2D.from_fields(colors=[OBSERVED], radii=screen_radius(8.0), draw_order=10.0)
    stream.log("sheets/convergence/current", ring, static=True)
    last_only = at_seconds(np.array([first_s]))
    for index, chosen in ((at_iterations(count), dots), (last_only, dots[-1:])):
        columns = rr.Points2D.columns(positions=chosen)
        stream.send_columns("sheets/convergence/current", indexes=[index], columns=columns)


def iterates_view(iterates: Iterates) -> rrb.View:
    """The parameter against iteration, the current one ringed, the result's interval as a band."""
    title = f"{quantity(iterates.parameter, iterates.unit)} by iteration"
    if iterates.interval95 is not None:
        title += f", band: 95 %, {interval_words(*iterates.interval95)}"
    return chart_view("convergence", title)
