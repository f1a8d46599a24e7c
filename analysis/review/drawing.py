"""Drawing primitives of a review: colours, timelines, sizes, and charts for any timeline."""

from __future__ import annotations

import math
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.terminal_table import quantity
from tunenet_logs.arrays import Array

Color = tuple[int, int, int]  # red, green and blue, 0 to 255 each
GROUND: Color = (16, 18, 24)  # behind charts and scenes: nearly black, as Rerun's own views are
OBSERVED: Color = (255, 255, 255)
MUTED: Color = (140, 140, 140)
SUCCESS: Color = (60, 190, 130)
FAILURE: Color = (235, 95, 75)
# One colour for one meaning in every review; white, the most legible, is what was recorded.
FITTED: Color = (255, 95, 165)

IMPACT: Color = (255, 90, 90)

# Cold to warm: readable on a dark ground, and apart for the colour-blind.
_RAMP: tuple[Color, ...] = (
    (112, 100, 190),
    (66, 120, 220),
    (40, 165, 200),
    (60, 190, 130),
    (160, 205, 60),
    (255, 165, 40),
)

LOG_TIME = "log_time_s"  # the timeline that plays: seconds since the log's first sample
ITERATION = "iteration"  # the timeline that is scrubbed: k of the tuning


def ramp(k: int, count: int) -> Color:
    """Return the colour of iteration `k` of `count`, interpolated linearly."""
    place = k / max(count - 1, 1) * (len(_RAMP) - 1)
    low = min(int(place), len(_RAMP) - 2)
    pairs = zip(_RAMP[low], _RAMP[low + 1], strict=True)
    red, green, blue = (round(a + (place - low) * (b - a)) for a, b in pairs)
    return red, green, blue


def entity_of(*parts: str) -> str:
    """Return the path of an entity whose parts may be any text; slashes split them further."""
    return rr.new_entity_path([name for part in parts for name in part.split("/") if name])


def application_id(kind: str) -> str:
    """Return a unique application id for each review that is written.

    Rerun shows another recording of the same id in the layout that it saw first, on disk until it
    is reset, no matter what blueprint that recording has.
    """
    return f"tunenet {kind} {uuid.uuid4().hex[:16]}"


def at_seconds(seconds: Array) -> rr.TimeColumn:
    """Return the index of rows at these times on `LOG_TIME`, shape (T,) [s]."""
    return rr.TimeColumn(LOG_TIME, duration=seconds)


def by_iteration(count: int, first_s: float) -> list[tuple[rr.TimeColumn, range]]:
    """Return each timeline's index of what is drawn per iteration, and the iterations it shows.

    On `ITERATION` these are all of them; on `LOG_TIME` it is the last one, the result, from
    `first_s` on.
    """
    return [
        (rr.TimeColumn(ITERATION, sequence=np.arange(count)), range(count)),
        (at_seconds(np.array([first_s])), range(count - 1, count)),
    ]


def plainly(value: float) -> str:
    """Format with two significant digits and no power of ten: "5.5", "260"."""
    return f"{float(f'{value:.2g}'):.10g}"


# Steps between ticks that a low plot has room for, and room beyond its values, of their span.
_MAX_TICKS, _EDGE = 5, 0.04


def ticked(low: float, high: float) -> tuple[float, float]:
    """Widen [low, high] to a plot's axis with at least two ticks.

    Rerun marks only multiples of powers of ten, where there is room for them. An axis that is
    symmetric about 0 stays so.
    """
    span = high - low
    step = 10.0 ** math.floor(math.log10(span))
    if span > _MAX_TICKS * step:
        step *= 10
    below, above = math.floor(low / step) * step, math.ceil(high / step) * step
    inside = math.floor(high / step) - math.ceil(low / step) + 1
    if inside == 0 or (inside == 1 and low == -high):
        low, high = below, above
    elif inside == 1 and (below == low or 0 < above - high <= low - below):
        high = above
    elif inside == 1:
        low = below
    room = _EDGE * (high - low)
    return low - room, high + room


def screen_radius(points: float) -> Any:
    """Return a radius in points of the screen, independent of the zoom."""
    return [rr.Radius.ui_points(points)]


def send_scalars(stream: rr.RecordingStream, entity: str, seconds: Array, values: Array) -> None:
    """Send a series over the log's time.

    Args:
        stream: The recording.
        entity: Path of the series.
        seconds: On `LOG_TIME`, shape (T,) [s].
        values: Shape (T,); or (T, S) for S series.
    """
    stream.send_columns(
        entity, indexes=[at_seconds(seconds)], columns=rr.Scalars.columns(scalars=values)
    )


WIDTH = 2.8  # of a chart, in its heights: about the shape of the views that charts are given
_LINES: Color = (60, 62, 70)  # of a grid: just above the ground
# Lines that fill a rectangle: so thin that its corners, round by their radius, look square.
_STRIPS = 12

# Chart heights that a figure takes up across; figures that would overlap are left out.
_FIGURE_WIDTH = 0.62

_FIGURE_RISE = 0.2  # chart heights from a dot up to the place that its figure hangs from
_MAX_RISEN = 1.6  # times that, in a chart whose figures are wide
_MIN_BAND = 0.008  # chart heights: a narrower interval would not be seen
_BAND = 0.35  # of the result's colour, above the ground: the band must not hide dots and grid
# Room under and over the values, of what they span; figures stand over them.
_BELOW, _OVER = 0.15, 0.4


def chart_view(name: str, title: str, width: float = WIDTH) -> rrb.View:
    """Return the view of the chart `name`, with margins for the grid's labels."""
    return rrb.Spatial2DView(
        origin=f"/sheets/{name}",
        name=title,
        background=GROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=(-0.2, width + 0.12), y_range=(-1.2, 0.36)),
    )


def log_grid(
    stream: rr.RecordingStream,
    sheet: str,
    width: float,
    rows: list[tuple[float, str]],
    marks: list[tuple[float, str]],
    hang: float = 0.085,
) -> None:
    """Log lines across at the rows, ticks below at the marks, and the labels of both.

    Args:
        stream: The recording.
        sheet: Path of the chart's entity.
        width: Of the chart, in its heights.
        rows: (y, label) of each.
        marks: (x, label) of each.
        hang: How far a row's label is raised to be beside its line, as Rerun hangs it from its
            point. Less in a larger view, where text is smaller.
    """
    lines = [[[0, y], [width, y]] for y, _ in rows] + [[[x, 0.02], [x, 0]] for x, _ in marks]
    grid = rr.LineStrips2D(lines, colors=[_LINES], radii=screen_radius(0.5))
    stream.log(f"{sheet}/grid", grid, static=True)
    labels = rr.Points2D(
        [[-0.09, y - hang] for y, _ in rows] + [[x, 0.04] for x, _ in marks],
        labels=[text for _, text in rows + marks],
        colors=[MUTED],
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log(f"{sheet}/labels", labels, static=True)


def filled(
    left: float, right: float, top: float, bottom: float
) -> tuple[list[list[list[float]]], float]:
    """Fill a rectangle with lines, and return their radius: Rerun's 2D boxes have outlines only."""
    width, height = right - left, bottom - top
    radius = min(width, height) / (_STRIPS + 1)  # each line covers half of the one before
    steps = [radius * (1 + k) for k in range(_STRIPS)]
    if width > height:
        ends = left + radius, right - radius
        return [[[x, top + step] for x in ends] for step in steps], radius
    ends = top + radius, bottom - radius
    return [[[left + step, y] for y in ends] for step in steps], radius


def mixed(color: Color, fraction: float) -> Color:
    """Blend this fraction of `color` into the background."""
    pairs = zip(GROUND, color, strict=True)
    red, green, blue = (round(low + fraction * (high - low)) for low, high in pairs)
    return red, green, blue


def ticks(low: float, high: float, count: int = 5) -> list[float]:
    """Return about `count` ticks in [low, high], multiples of 1, 2 or 5 times a power of 10."""
    raw = (high - low) / count
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * min((1, 2, 5, 10), key=lambda factor: abs(factor * power - raw))
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [round(k * step, 6) for k in range(first, last + 1)]


@dataclass(frozen=True)
class Iterates:
    """One parameter at each iteration.

    Attributes:
        parameter: In words.
        unit: "1" if it has none.
        names: Of the iterations, "k=3", "refined".
        values: Of the parameter, in `unit`.
        colors: Of the iterations.
        span: Range of the chart.
        interval95: Of the result; None if no valid one exists.
        chart: Name of the chart that shows them.
        title: Of the chart; "" for the parameter's.
        figures: Number format.
        figure_width: Width of a number, in heights of the chart.
    """

    parameter: str
    unit: str
    names: tuple[str, ...]
    values: tuple[float, ...]
    colors: tuple[Color, ...]
    span: tuple[float, float]
    interval95: tuple[float, float] | None
    chart: str = "convergence"
    title: str = ""
    figures: str = ".4f"
    figure_width: float = _FIGURE_WIDTH


def span_of(values: Sequence[float], least: float) -> tuple[float, float]:
    """Return a chart's range for these values, at least `least`, with room for labels."""
    low, high = min(values), max(values)
    reach = max(high - low, least)
    middle = (low + high) / 2
    return middle - (0.5 + _BELOW) * reach, middle + (0.5 + _OVER) * reach


def log_iterates(stream: rr.RecordingStream, iterates: Iterates, first_s: float) -> None:
    """Log the entities of `iterates_view`; the log's time begins at `first_s`."""
    low, high = iterates.span
    count = len(iterates.values)
    sheet, wide = f"sheets/{iterates.chart}", iterates.figure_width
    rise = _FIGURE_RISE * min(wide / _FIGURE_WIDTH, _MAX_RISEN)

    def y(value: float) -> float:
        return -(value - low) / (high - low)

    margin = max(WIDTH / (2 * count), wide / 2)
    x = np.linspace(margin, WIDTH - margin, count)
    dots = np.column_stack([x, [y(value) for value in iterates.values]])
    every = math.ceil(wide * (count - 1) / (WIDTH - 2 * margin)) if count > 1 else 1
    labelled = range(count - 1, -1, -every)  # backwards, so that the result is among them
    rows = [(y(value), f"{value:g}") for value in ticks(low, high, 2)]
    marks = [(float(x[k]), iterates.names[k]) for k in labelled]
    log_grid(stream, sheet, WIDTH, rows, marks)
    if iterates.interval95 is not None:
        ends = [y(end) for end in iterates.interval95]
        half = max(ends[0] - ends[1], _MIN_BAND) / 2
        middle = sum(ends) / 2
        strips, radius = filled(0.0, WIDTH, middle - half, middle + half)
        color = mixed(iterates.colors[-1], _BAND)
        band = rr.LineStrips2D(strips, colors=[color], radii=[radius], draw_order=1.0)
        stream.log(f"{sheet}/interval", band, static=True)
    line = rr.LineStrips2D([dots], colors=[MUTED], radii=screen_radius(0.8))
    stream.log(f"{sheet}/line", line, static=True)
    values = rr.Points2D(dots, colors=iterates.colors, radii=screen_radius(5.0), draw_order=20.0)
    stream.log(f"{sheet}/values", values, static=True)
    figures = rr.Points2D(
        [dots[k] - [0, rise] for k in labelled],
        labels=[f"{iterates.values[k]:{iterates.figures}}" for k in labelled],
        colors=[iterates.colors[k] for k in labelled],
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log(f"{sheet}/figures", figures, static=True)
    ring = rr.Points2D.from_fields(colors=[OBSERVED], radii=screen_radius(8.0), draw_order=10.0)
    stream.log(f"{sheet}/current", ring, static=True)
    for index, shown in by_iteration(count, first_s):
        columns = rr.Points2D.columns(positions=dots[shown])
        stream.send_columns(f"{sheet}/current", indexes=[index], columns=columns)


def iterates_view(iterates: Iterates) -> rrb.View:
    """Return the view of the parameter by iteration, with the result's interval as a band."""
    words = f"{quantity(iterates.parameter, iterates.unit)} by iteration"
    title = iterates.title or words
    return chart_view(iterates.chart, title + (", band: 95 %" if iterates.interval95 else ""))
