"""Drawing primitives of all reviews in Rerun: colours, timelines, charts, a legend, images.

`read_back` reads from a finished review what its JSON lacks: images with their track, signals.
"""

from __future__ import annotations

import math
import re
import uuid
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.result_files import review_name
from tunenet_logs.analysis.tracking.frames import kept_film, readable_frames
from tunenet_logs.episode import Array, Episode, Frame, median_step
from tunenet_logs.errors import LogError
from tunenet_logs.terminal import short_name

# ---- Camera: place that of a 3D view so that the whole scene is visible.


def scene_view(name: str, eye_m: Array, target_m: Array, origin: str = "/scene") -> rrb.View:
    """Return a 3D view that looks from one point at another, z up."""
    eye = rrb.EyeControls3D(
        position=eye_m.tolist(), look_target=target_m.tolist(), eye_up=(0.0, 0.0, 1.0)
    )
    return rrb.Spatial3DView(
        origin=origin, name=name, background=GROUND, line_grid=False, eye_controls=eye
    )


def eye_and_target(points_m: Array, azimuth_rad: float, margin_m: float) -> tuple[Array, Array]:
    """Place a camera far enough away to see all points: where it is, and where it looks."""
    middle = (points_m.min(axis=0) + points_m.max(axis=0)) / 2
    up_rad = 0.35  # from the level: links hide each other less
    level = math.cos(up_rad)
    towards = np.array(
        [level * math.cos(azimuth_rad), level * math.sin(azimuth_rad), math.sin(up_rad)]
    )
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    off = points_m - middle
    # With the tangents of half of what the camera sees of a view twice as high as wide.
    distances_m = [
        (np.abs(off @ across) + margin_m) / half + off @ towards
        for across, half in ((right, 0.25), (np.cross(towards, right), 0.5))
    ]
    return middle + float(np.max(distances_m)) * towards, middle


# ---- Colours, timelines, and sizes on the screen.

Color = tuple[int, int, int]  # red, green and blue, 0 to 255 each
# One colour for one meaning in every review; white, the most legible, is what was recorded.
GROUND: Color = (16, 18, 24)  # behind charts and scenes: nearly black, as Rerun's own views are
OBSERVED: Color = (255, 255, 255)
MUTED: Color = (140, 140, 140)
SUCCESS: Color = (60, 190, 130)
FAILURE: Color = (235, 95, 75)
GRID: Color = (60, 62, 70)  # just above the ground
FITTED: Color = (255, 95, 165)
IMPACT: Color = (255, 90, 90)
BOLD, FINE = 1.6, 0.8  # widths of the result's curve and of earlier iterations' [points]
# Cold to warm: readable on a dark ground, and apart for the colour-blind.
_RAMP: tuple[Color, ...] = (
    (112, 100, 190),
    (66, 120, 220),
    (40, 165, 200),
    (60, 190, 130),
    (160, 205, 60),
    (255, 165, 40),
)
RESULT = _RAMP[-1]  # what the values of the tuning give
LOG_TIME = "log_time_s"  # the timeline that plays: seconds since the log's first sample
ITERATION = "iteration"  # the timeline that is scrubbed: k of the tuning
SCRUB = f"scrub (timeline {ITERATION}, to be chosen below)"  # the name of its tab


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


def ticked(low: float, high: float) -> tuple[float, float]:
    """Widen [low, high] to a plot's axis with at least two ticks.

    Rerun marks only multiples of powers of ten, where there is room for them. An axis that is
    symmetric about 0 stays so.
    """
    span = high - low
    step = 10.0 ** math.floor(math.log10(span))
    if span > 5 * step:  # a low plot has no room for more ticks
        step *= 10
    below, above = math.floor(low / step) * step, math.ceil(high / step) * step
    inside = math.floor(high / step) - math.ceil(low / step) + 1
    if inside == 0 or (inside == 1 and low == -high):
        low, high = below, above
    elif inside == 1 and (below == low or 0 < above - high <= low - below):
        high = above
    elif inside == 1:
        low = below
    room = 0.04 * (high - low)
    return low - room, high + room


def screen_radius(points: float) -> Any:
    """Return a radius in points of the screen, independent of the zoom."""
    return [rr.Radius.ui_points(points)]


def log_moving(
    stream: rr.RecordingStream,
    entity: str,
    style: Any,
    seconds: Array,
    columns: Any,
    timeline: str = LOG_TIME,
) -> None:
    """Log the style of an entity, and columns of what it draws at these times, shape (T,) [s]."""
    stream.log(entity, style, static=True)
    index = rr.TimeColumn(timeline, duration=seconds)
    stream.send_columns(entity, indexes=[index], columns=columns)


def log_by_iteration(
    stream: rr.RecordingStream,
    entity: str,
    style: Any,
    first_s: float,
    columns_of: Callable[..., Any],
    **components: Sequence[Any] | Array,
) -> None:
    """Log an entity's style, and its components, of each a row for each iteration.

    On `ITERATION` these are all of them; on `LOG_TIME` it is the last one, the result, from
    `first_s` on.
    """
    stream.log(entity, style, static=True)
    count = len(next(iter(components.values())))
    for index, begin in (
        (rr.TimeColumn(ITERATION, sequence=np.arange(count)), 0),
        (rr.TimeColumn(LOG_TIME, duration=[first_s]), count - 1),
    ):
        columns = columns_of(**{name: rows[begin:] for name, rows in components.items()})
        stream.send_columns(entity, indexes=[index], columns=columns)


def log_dots(
    stream: rr.RecordingStream,
    entity: str,
    places: Any,
    colors: Sequence[Color],
    size: float,
    order: float | None = None,
) -> None:
    """Log dots of a 2D view, of one colour or each of its own; `size` is their radius [points]."""
    dots = rr.Points2D(places, colors=colors, radii=screen_radius(size), draw_order=order)
    stream.log(entity, dots, static=True)


def log_strips(
    stream: rr.RecordingStream,
    entity: str,
    strips: Any,
    colors: Sequence[tuple[int, ...]],
    size: float,
    order: float | None = None,
) -> None:
    """Log lines of a 2D view; `size` is half their width [points]."""
    lines = rr.LineStrips2D(strips, colors=colors, radii=screen_radius(size), draw_order=order)
    stream.log(entity, lines, static=True)


def result_view(*, has_checks: bool = True) -> rrb.View | rrb.Container:
    """Return the pane of a review's words: the result, and behind a tab every check."""
    result = rrb.TextDocumentView(origin="/result", name="result")
    if not has_checks:
        return result
    checks = rrb.TextDocumentView(origin="/checks", name="checks")
    return rrb.Tabs(result, checks, active_tab=0)


def log_words(stream: rr.RecordingStream, entity: str, words: str) -> None:
    """Log a text in Markdown."""
    stream.log(entity, rr.TextDocument(words, media_type="text/markdown"), static=True)


def log_labels(
    stream: rr.RecordingStream,
    entity: str,
    positions: Any,
    labels: Sequence[str],
    colors: Sequence[Color] = (MUTED,),
) -> None:
    """Log texts that stand at points of a 2D view, or of a 3D one."""
    points = rr.Points3D if len(positions) and len(positions[0]) == 3 else rr.Points2D
    radii = screen_radius(0.1)
    texts = points(positions, labels=labels, colors=colors, radii=radii, show_labels=True)
    stream.log(entity, texts, static=True)


@contextmanager
def written(path: Path, kind: str, identity: str, name: str = "") -> Iterator[rr.RecordingStream]:
    """Collect a recording in memory, then write it: Rerun's own sink waits on a full disk.

    Its application id is unique. Rerun shows another recording of the same id in the layout that it
    saw first, on disk until it is reset, no matter what blueprint that recording has.
    """
    stream = rr.RecordingStream(f"tunenet {kind} {uuid.uuid4().hex[:16]}", recording_id=identity)
    memory = stream.memory_recording()
    if name:
        stream.send_recording_name(name)
    yield stream
    stream.flush()
    path.write_bytes(memory.drain_as_bytes())
    stream.disconnect()


def blueprint(layout: rrb.View | rrb.Container, time_panel: rrb.TimePanel) -> rrb.Blueprint:
    """Return the blueprint of a review: its views and the time, no other panels."""
    return rrb.Blueprint(
        layout,
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        time_panel,
        auto_views=False,
        auto_layout=False,
    )


# ---- Charts on any timeline: grid, filled areas, a parameter by iteration.

WIDTH = 2.8  # of a chart, in its heights: about the shape of the views that charts are given


def chart_view(name: str, title: str, width: float = WIDTH) -> rrb.View:
    """Return the view of the chart `name`, with margins for the grid's labels."""
    return rrb.Spatial2DView(
        origin=f"/sheets/{name}",
        name=title,
        background=GROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=(-0.32, width + 0.12), y_range=(-1.2, 0.36)),
    )


def log_grid(
    stream: rr.RecordingStream,
    sheet: str,
    width: float,
    rows: list[tuple[float, str]],
    marks: list[tuple[float, str]],
    hang: float = 0.085,
) -> None:
    """Log lines across at the rows, ticks below at the marks, and the labels of both."""
    lines = [[[0, y], [width, y]] for y, _ in rows] + [[[x, 0.02], [x, 0]] for x, _ in marks]
    log_strips(stream, f"{sheet}/grid", lines, [GRID], 0.5)
    places = [[-0.15, y - hang] for y, _ in rows] + [[x, 0.04] for x, _ in marks]
    log_labels(stream, f"{sheet}/labels", places, [text for _, text in rows + marks])


def log_filled(
    stream: rr.RecordingStream,
    entity: str,
    boxes: Iterable[tuple[float, float, float, float]],
    color: Color,
    order: float,
) -> None:
    """Log rectangles, (left, right, top, bottom), filled: Rerun's 2D boxes have outlines only."""
    strips: list[list[list[float]]] = []
    radii: list[float] = []
    for left, right, top, bottom in boxes:
        # 12 lines, each over half of the one before: so thin that the round corners look square.
        radius = min(right - left, bottom - top) / (12 + 1)
        for step in (radius * (1 + k) for k in range(12)):
            if right - left > bottom - top:
                strips.append([[x, top + step] for x in (left + radius, right - radius)])
            else:
                strips.append([[left + step, y] for y in (top + radius, bottom - radius)])
        radii += [radius] * 12
    lines = rr.LineStrips2D(strips, colors=[color], radii=radii, draw_order=order)
    stream.log(entity, lines, static=True)


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


def span_of(values: Sequence[float], least: float) -> tuple[float, float]:
    """Return a chart's range for these values, at least `least`, with room for labels."""
    low, high = min(values), max(values)
    reach = max(high - low, least)
    middle = (low + high) / 2
    # Room under and over the values, of what they span; figures stand over them
    return middle - (0.5 + 0.15) * reach, middle + (0.5 + 0.4) * reach


def log_iterates(
    stream: rr.RecordingStream,
    title: str,
    names: Sequence[str],
    values: Sequence[float],
    colors: Sequence[Color],
    span: tuple[float, float],
    interval95: tuple[float, float] | None,
    first_s: float,
    *,
    chart: str = "convergence",
    figures: str = ".4f",
    wide: float = 0.62,
) -> rrb.View:
    """Log a parameter by iteration, with the result's interval as a band; return its view.

    Of each iteration there are a name ("k=3"), a value and a colour. The chart shows the values of
    `span`; the log's time begins at `first_s`. Figures have this number format, and are so wide
    that none overlap, in heights of the chart.
    """
    low, high = span
    count, sheet = len(values), f"sheets/{chart}"
    # From a dot up to the place that its figure hangs from: more where figures are wide.
    rise = 0.24 * min(wide / 0.62, 1.6)
    margin = max(WIDTH / (2 * count), wide / 2)
    x = np.linspace(margin, WIDTH - margin, count)
    dots = np.column_stack([x, -(np.array(values) - low) / (high - low)])
    every = math.ceil(wide * (count - 1) / (WIDTH - 2 * margin)) if count > 1 else 1
    labelled = range(count - 1, -1, -every)  # backwards, so that the result is among them
    rows = [(-(value - low) / (high - low), f"{value:g}") for value in ticks(low, high, 2)]
    marks = [(float(x[k]), names[k]) for k in labelled]
    log_grid(stream, sheet, WIDTH, rows, marks)
    if interval95 is not None:
        title += ", band: 95 %"
        ends = [-(end - low) / (high - low) for end in interval95]
        half = max(ends[0] - ends[1], 0.008) / 2  # a narrower interval would not be seen
        middle = sum(ends) / 2
        color = mixed(colors[-1], 0.35)  # it must not hide dots and grid
        band = [(0.0, WIDTH, middle - half, middle + half)]
        log_filled(stream, f"{sheet}/interval", band, color, 1.0)
    log_strips(stream, f"{sheet}/line", [dots], [MUTED], 0.8)
    log_dots(stream, f"{sheet}/values", dots, colors, 5.0, 20.0)
    texts, places = [f"{values[k]:{figures}}" for k in labelled], dots[labelled] - [0, rise]
    log_labels(stream, f"{sheet}/figures", places, texts, [colors[k] for k in labelled])
    ring = rr.Points2D.from_fields(colors=[OBSERVED], radii=screen_radius(8.0), draw_order=10.0)
    current = f"{sheet}/current"
    log_by_iteration(stream, current, ring, first_s, rr.Points2D.columns, positions=dots)
    return chart_view(chart, title)


# ---- Charts of rows: names on the left, figures on the right, and a value in between.

# Widths of the names left of a chart, and of the figures right of it, in its heights.
_NAMES, _FIGURES = 0.42, 0.56
MAX_ROWS = 12  # whose names do not overlap on a small screen; the tables have all
HALF_ROW = 0.3  # half of what marks take up of a row: the rest keeps rows apart


@dataclass(frozen=True)
class RowAxes:
    """Layout of a chart's rows, from top to bottom, and range of its axis."""

    count: int
    low: float
    high: float
    width: float = 0.85  # of the chart without names and figures, in its heights
    hang: float = 0.03  # half a line, by which Rerun hangs a label from its point, likewise

    def y(self, row: int) -> float:
        """Height of a row's middle."""
        return -1 + (row + 0.5) / self.count

    def x(self, value: float) -> float:
        """Place of a value on the axis."""
        return (value - self.low) / (self.high - self.low) * self.width

    @property
    def pitch(self) -> float:
        """Height of a row."""
        return 1 / self.count

    def view(self, name: str, title: str) -> rrb.View:
        """Return the view of the chart `name`."""
        across = (-_NAMES - 0.05, self.width + _FIGURES + 0.05)
        return rrb.Spatial2DView(
            origin=f"/sheets/{name}",
            name=title,
            background=GROUND,
            visual_bounds=rrb.VisualBounds2D(x_range=across, y_range=(-1.04, 0.16)),
        )


def log_frame(
    stream: rr.RecordingStream,
    sheet: str,
    rows: RowAxes,
    marks: Sequence[tuple[float, str]],
    names: Sequence[str],
    figures: Sequence[str],
) -> None:
    """Log grid lines at the marks, names on the left, figures on the right."""
    grid = [[[rows.x(value), -1.0], [rows.x(value), 0.0]] for value, _ in marks]
    log_strips(stream, f"{sheet}/grid", grid, [GRID], 0.5)
    labels = [([rows.x(value), 0.02], text) for value, text in marks]
    for row, (name, figure) in enumerate(zip(names, figures, strict=True)):
        # As many letters as fit left of the chart.
        texts = (-_NAMES / 2, short_name(name, 15)), (rows.width + _FIGURES / 2, figure)
        labels += [([x, rows.y(row) - rows.hang], text) for x, text in texts if text]
    colors = [MUTED] * len(marks) + [OBSERVED] * (len(labels) - len(marks))
    places, texts = [place for place, _ in labels], [text for _, text in labels]
    log_labels(stream, f"{sheet}/labels", places, texts, colors)


def log_bars(
    stream: rr.RecordingStream,
    entity: str,
    bars: Sequence[tuple[float, float, float]],
    thick: float,
    color: Color,
) -> None:
    """Log filled bars, each as (y, left, right)."""
    half = thick / 2
    boxes = [(left, max(right, left + 0.004), y - half, y + half) for y, left, right in bars]
    log_filled(stream, entity, boxes, color, 5.0)


# ---- Curves over the log's time, and the same ones of one iteration at a time.


def drawn_every(seconds: Array) -> int:
    """Choose every how many samples of a curve are drawn, with stamps of shape (T,).

    More than 120 Hz and 3000 samples can neither be told apart nor be loaded soon.
    """
    gap_s = median_step(seconds) if len(seconds) > 1 else 1.0
    return max(round(1 / (gap_s * 120.0)) if gap_s > 0 else 1, -(-len(seconds) // 3000), 1)


def log_lines(
    stream: rr.RecordingStream,
    entity: str,
    seconds: Array,
    values: Array,
    style: Sequence[tuple[str, Color, float]],
) -> None:
    """Log several curves, values (T, curves), as one entity; style: label, colour, width."""
    names, colors, widths = zip(*style, strict=True)
    lines = rr.SeriesLines(colors=colors, names=names, widths=widths, aggregation_policy="Off")
    log_moving(stream, entity, lines, seconds, rr.Scalars.columns(scalars=values))


def log_marks(
    stream: rr.RecordingStream,
    entity: str,
    name: str,
    color: Color,
    size: float,
    seconds: Array,
    values: Array,
    marker: str = "",
) -> None:
    """Log marks of a plot, dots unless another kind is named; nothing where there are none."""
    if len(seconds):
        kind: Any = {"markers": [marker]} if marker else {}
        style = rr.SeriesPoints(colors=[color], names=[name], marker_sizes=[size], **kind)
        log_moving(stream, entity, style, seconds, rr.Scalars.columns(scalars=values))


def plot_view(
    entity: str,
    title: str,
    span: tuple[float, float] | None = None,
    shown_s: tuple[float, float] | None = None,
    legend: rrb.PlotLegend | None = None,
) -> rrb.View:
    """Build a plot of an entity's curves: of the values of `span`, and of this log's time.

    No legend is shown if none is given: it would hide curves on a small screen.
    """
    axes = {}
    if shown_s is not None:
        ends = (rrb.TimeRangeBoundary.absolute(seconds=at_s) for at_s in shown_s)
        axes["axis_x"] = rrb.TimeAxis(view_range=rr.TimeRange(*ends))
    if span is not None:
        axes["axis_y"] = rrb.ScalarAxis(range=span)
    legend = legend or rrb.PlotLegend(visible=False)
    return rrb.TimeSeriesView(origin=f"/{entity}", name=title, plot_legend=legend, **axes)


def log_sheet(
    stream: rr.RecordingStream,
    sheet: str,
    seconds: Array,
    observed: Array,
    curves: Array,
    colors: Sequence[Color],
    span: tuple[float, float],
    *,
    fitted: tuple[Array, Color] | None = None,
    width: float = WIDTH,
    first_s: float | None = None,
) -> None:
    """Log each iteration's curve, (T, K), over the observed one, (T,), which stays.

    The chart shows the values of `span` and has this `width`; its result is there from `first_s`.
    """
    low, reach = span[0], span[1] - span[0]
    start_s = float(seconds[0])
    width_s = max(float(seconds[-1]) - start_s, 1e-9)
    x = (seconds - start_s) / width_s * width
    drawn = [observed, *curves.T] + ([fitted[0]] if fitted is not None else [])
    points = [
        np.column_stack([x, -(values - low) / reach])[np.isfinite(values)] for values in drawn
    ]
    rows = [(-(value - low) / reach, f"{value:g}") for value in ticks(low, low + reach, 3)]
    marks = [
        ((second - start_s) / width_s * width, f"{second:g} s")
        for second in ticks(start_s, start_s + width_s, 5 if width == WIDTH else 3)
    ]
    log_grid(stream, sheet, width, rows, marks)
    log_dots(stream, f"{sheet}/observed", points[0], [OBSERVED], 1.5)
    if fitted is not None:
        log_strips(stream, f"{sheet}/fit", points[-1:], [fitted[1]], 0.6)
    style = rr.LineStrips2D.from_fields(radii=screen_radius(1.2), draw_order=40.0)
    log_by_iteration(
        stream,
        f"{sheet}/simulated",
        style,
        start_s if first_s is None else first_s,
        rr.LineStrips2D.columns,
        strips=points[1 : 1 + len(colors)],
        colors=colors,
    )


def log_steps(stream: rr.RecordingStream, words: Sequence[str], first_s: float) -> rrb.View:
    """Log each iteration's text in Markdown, and return its view."""
    style = rr.TextDocument.from_fields(media_type="text/markdown")
    log_by_iteration(stream, "step", style, first_s, rr.TextDocument.columns, text=words)
    return rrb.TextDocumentView(origin="/step", name="iteration")


# ---- Legend: a strip above curves, where it hides none of them.

KEY_SHARES = (0.6, 8.0)  # heights of a key and of what is below it


def log_key(
    stream: rr.RecordingStream, entries: Sequence[tuple[str, Sequence[Color]]], entity: str = "key"
) -> rrb.View:
    """Log a legend of each entry's text and line colours, and return a view of it."""
    strips, colors = [], []
    for entry, (_, line_colors) in enumerate(entries):
        width = 0.3 / len(line_colors)  # of what an entry takes up
        for number, color in enumerate(line_colors):
            begin = entry - 0.3 / 2 + number * width
            strips.append([[begin, 0.0], [begin + width, 0.0]])
            colors.append(color)
    log_strips(stream, f"{entity}/lines", strips, colors, 2.0)
    places = [[float(entry), 0.02] for entry in range(len(entries))]
    log_labels(stream, f"{entity}/words", places, [text for text, _ in entries])
    return key_view(len(entries), entity)


def key_view(count: int, entity: str = "key") -> rrb.View:
    """Return another view of a legend of so many entries: a view shows in one container alone."""
    return rrb.Spatial2DView(
        origin=f"/{entity}",
        name="key",
        titlebar=False,
        visual_bounds=rrb.VisualBounds2D(x_range=(-0.5, count - 0.5), y_range=(-0.06, 0.18)),
    )


# ---- Recorded images: those of a log, reduced where that is enough.

_JPEG_QUALITY = 85  # 0 to 100: what the eye cannot tell from the original
_FONT = 0  # OpenCV's number of its plain sans serif


def log_recorded_film(stream: rr.RecordingStream, tuning: Tuning) -> bool:
    """Log the images of a log without a drop; return False if there are none."""
    episode = tuning.episode
    if episode is None or episode.signals or not episode.picture_topics:
        return False
    topic = episode.picture_topics[0]
    total = sum(channel.messages for channel in episode.channels if channel.topic == topic)
    every = max(1, -(-total // 240))  # where nothing was found: enough to see why, and soon loaded
    frames: list[Frame] = []
    for index, frame in enumerate(frames_to_show(episode, topic)):
        if index % every == 0:
            with suppress(LogError):
                frames.append(reduced(frame))
    if frames:
        send_pictures(stream, frames, frames[0].stamp_ns)
    return bool(frames)


def frames_to_show(episode: Episode, topic: str) -> Iterator[Frame]:
    """Yield a topic's frames as recorded; raw ones reduced, if that was done."""
    film = kept_film(episode, topic)
    if film is not None and film.is_bare and not film.is_part and film.pictures:
        return iter(film.pictures.values())
    return readable_frames(episode, topic)


def send_pictures(stream: rr.RecordingStream, frames: list[Frame], start_ns: int) -> None:
    """Send JPEG images on the log's time, which is 0 at `start_ns`."""
    seconds = np.array([(frame.stamp_ns - start_ns) * 1e-9 for frame in frames])
    columns = rr.EncodedImage.columns(
        blob=[frame.data for frame in frames], media_type=["image/jpeg"] * len(frames)
    )
    stream.send_columns(
        "film/picture", indexes=[rr.TimeColumn(LOG_TIME, duration=seconds)], columns=columns
    )


def reduced(frame: Frame) -> Frame:
    """Downsample a frame to a small JPEG."""
    import cv2

    picture = frame.decode(frame.coarse)
    height, width = picture.shape[:2]
    # Longer side of a reduced picture: about what a view on a screen shows [px]
    scale = min(1.0, 640 / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    bgr = cv2.cvtColor(small, cv2.COLOR_RGB2BGR)
    _, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return Frame(frame.stamp_ns, "jpeg", data.tobytes())


def blank_picture(size_px: tuple[int, int], words: str) -> bytes:
    """Make a JPEG of the background's colour with these words in the middle."""
    import cv2

    width, height = size_px
    sheet = np.full((height, width, 3), GROUND[::-1], np.uint8)
    (across, up), _ = cv2.getTextSize(words, _FONT, 1.0, 1)
    scale = 0.4 * width / across
    corner = round((width - scale * across) / 2), round((height + scale * up) / 2)
    cv2.putText(sheet, words, corner, _FONT, scale, MUTED[::-1], 1, cv2.LINE_AA)
    return cv2.imencode(".jpg", sheet, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()


# ---- Reading a review back.

_MAX_REVIEW_BYTES = 512 * 1024 * 1024  # of a review; ours keep under 50 MB of pictures
_SIGNAL = re.compile(r"/compared/(\d{1,2})")
MAX_SIGNALS = 12  # that are drawn of a model on a page: more would be too small to read


@dataclass(frozen=True, eq=False)
class ReviewedFilm:
    """Images of a filmed ball, and its track."""

    seconds: Array  # of each image on the log's time, increasing [s], shape (P,)
    pictures: tuple[bytes, ...]  # JPEG, P of them
    track_s: Array  # stamps of the track [s], shape (T,)
    centers_px: Array  # from the middle of an image's first pixel, shape (T, 2)
    radii_px: Array  # of the circle around it, in pixels of an image, shape (T,)
    # The tuned ball's path, or the segments of a refused track, shape (N, 2) each.
    paths_px: tuple[Array, ...]
    impacts_px: Array  # points of impact, shape (I, 2)
    is_refused: bool  # whether the track shows no drop


@dataclass(frozen=True, eq=False)
class ReviewedSignal:
    """One column of a log's signals, and what simulators show in its place."""

    name: str  # without unit, such as "joint 3" or "position elbow"
    unit: str  # of its values
    seconds: Array  # on the log's time [s], shape (T,)
    observed: Array  # shape (T,)
    # By name, shape (T,) each, NaN where there is nothing. Of a payload's torque "rigid", the arm
    # with the tuned payload, and "fitted", with friction, offsets and other nuisance terms. Of a
    # simulator "given", "tuned" or, if that was rejected, "closest", and "predicted" of what is
    # held out, by a fit to the rest.
    curves: Mapping[str, Array]
    noise: float = math.nan  # standard deviation of the observation; NaN where it is not known
    held_out_s: float = math.nan  # where what is held out begins; NaN without


@dataclass(frozen=True, eq=False)
class ReviewedLog:
    """Contents of one review."""

    film: ReviewedFilm | None = None  # None if it shows none
    signals: tuple[ReviewedSignal, ...] = ()  # in the order of the review; none for a ball


def log_signal(stream: rr.RecordingStream, number: int, signal: ReviewedSignal) -> None:
    """Log a signal for pages: no view shows it."""
    entity = f"compared/{number}"
    values = np.column_stack([signal.observed, *signal.curves.values()])
    style = [(name, MUTED, FINE) for name in ("observed", *signal.curves)]
    log_lines(stream, entity, signal.seconds, values, style)
    about = rr.AnyValues(
        name=signal.name, unit=signal.unit, noise=signal.noise, held_out_s=signal.held_out_s
    )
    stream.log(entity, about, static=True)


def read_back(path: Path, log_sha256: str) -> ReviewedLog:
    """Read the review of the log with this SHA-256."""
    if not path.is_file():
        raise LogError(f"{path.name} is not beside the JSON")
    if path.stat().st_size > _MAX_REVIEW_BYTES:
        raise LogError(f"{path.name} is larger than {_MAX_REVIEW_BYTES // 1_000_000} MB")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of an unfinished file: what is in it is said below
            reader = RrdReader(path)
            names = {entry.recording_id for entry in reader.recordings()}
            if not log_sha256 or names != {review_name(log_sha256)}:
                raise LogError(f"{path.name} is the review of another log")
            moving: dict[str, dict[str, Any]] = {}
            still: dict[str, dict[str, Any]] = {}
            for chunk in reader.stream():
                entity = str(chunk.entity_path)
                if not (entity.startswith("/film/") or _SIGNAL.fullmatch(entity)):
                    continue
                if not chunk.is_static and "log_time_s" not in chunk.timeline_names:
                    continue
                if chunk.num_rows > 1_000_000:
                    raise LogError("the review has more samples than any log")
                batch = chunk.to_record_batch()
                columns = dict(zip(batch.schema.names, batch.columns, strict=True))
                (still if chunk.is_static else moving).setdefault(entity, {}).update(columns)
            return ReviewedLog(_film(moving, still), _signals(moving, still))
    except (RuntimeError, ValueError, LookupError, TypeError, OSError) as error:
        raise LogError(f"{path.name} cannot be read ({short_name(error, 80)})") from error


def _seconds(columns: dict[str, Any]) -> Array:
    return columns["log_time_s"].cast("int64").to_numpy().astype(np.float64) * 1e-9


def _film(moving: dict[str, Any], still: dict[str, Any]) -> ReviewedFilm | None:
    shown = moving.get("/film/picture")
    if shown is None:
        return None
    seconds = _seconds(shown)[:20_000]
    pictures = tuple(bytes(_only(cell)) for cell in shown["EncodedImage:blob"].to_pylist())
    scale = still.get("/film/picture", {}).get("Transform3D:scale")
    scale = 1.0 if scale is None else float(_only(scale.to_pylist()[0])[0])
    if not (np.isfinite(scale) and scale > 0):
        raise LogError("the review's pictures have no size")
    # Time [s], centre and radius [px of the video] of each polygon around the ball.
    track = moving.get("/film/observed")
    cells = [] if track is None else track["LineStrips2D:strips"].to_pylist()
    polygons = [np.array(cell[0] if cell else [], np.float64).reshape(-1, 2) for cell in cells]
    # What stands for a circle has five corners or more.
    rows = [row for row, one in enumerate(polygons) if len(one) > 4 and np.isfinite(one).all()]
    track_s: Array = np.zeros(0) if track is None else _seconds(track)[rows]
    centers: Array = np.zeros((len(rows), 2))
    radii: Array = np.zeros(len(rows))
    for place, row in enumerate(rows):
        centers[place] = polygons[row][:-1].mean(axis=0)  # it ends where it begins
        radii[place] = np.hypot(*(polygons[row][0] - centers[place]))
    paths: list[Array] = []
    for entity in ("/film/path", "/film/track"):
        column = still.get(entity, {}).get("LineStrips2D:strips")
        strips = [] if column is None else column.to_pylist()
        paths += [np.array(one, np.float64).reshape(-1, 2) for one in (strips[0] if strips else ())]
    marks = still.get("/film/impacts", {}).get("Points2D:positions")
    impacts = np.zeros((0, 2)) if marks is None else np.array(marks.to_pylist()[0], np.float64)
    # From Rerun's origin, the corner of the first pixel, to ours, its middle; in the pixels of
    # images, which may be smaller than the video.
    return ReviewedFilm(
        seconds=seconds,
        pictures=pictures[: len(seconds)],
        track_s=track_s,
        centers_px=centers / scale - 0.5,
        radii_px=radii / scale,
        paths_px=tuple(path / scale - 0.5 for path in paths),
        impacts_px=impacts.reshape(-1, 2) / scale - 0.5,
        is_refused="/film/track" in still,
    )


def _only(cell: Any) -> Any:
    """Return the single value of a cell of one row."""
    return cell[0] if isinstance(cell, list) and len(cell) == 1 else cell


def _signals(moving: dict[str, Any], still: dict[str, Any]) -> tuple[ReviewedSignal, ...]:
    numbers = sorted(int(found[1]) for name in moving if (found := _SIGNAL.fullmatch(name)))
    signals: list[ReviewedSignal] = []
    for number in numbers:
        columns, about = moving[f"/compared/{number}"], still[f"/compared/{number}"]
        names = about["SeriesLines:names"].to_pylist()[0]
        observed, *curves = np.array(columns["Scalars:scalars"].to_pylist(), np.float64).T
        name, unit, noise, held_out_s = (
            _only(about[key].to_pylist()[0]) for key in ("name", "unit", "noise", "held_out_s")
        )
        both = dict(zip(map(str, names[1:]), curves, strict=True))
        told = both, float(noise), float(held_out_s)
        signals.append(ReviewedSignal(str(name), str(unit), _seconds(columns), observed, *told))
    return tuple(signals)
