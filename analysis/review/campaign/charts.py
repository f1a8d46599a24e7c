"""Charts of a whole campaign, a row per ball: success rates, and restitutions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan

import rerun as rr
import rerun.blueprint as rrb

from analysis.campaign.rates import BallRestitutions, Rate
from analysis.review.drawing import (
    GROUND,
    MUTED,
    OBSERVED,
    SUCCESS,
    Color,
    filled,
    mixed,
    screen_radius,
    ticks,
)
from tunenet_logs.terminal import short_name

# Of the chart in its heights, of the names left of it, and of the figures right of it.
_WIDTH, _NAMES, _FIGURES = 0.85, 0.42, 0.56

_HANG = 0.03  # chart heights: half a line, by which Rerun hangs a label from its point
_MAX_LETTERS = 15  # of a name, as many as fit left of the chart
_MAX_ROWS = 12  # names above one another that do not overlap on a small screen; the tables have all
_TUNED: Color = (255, 165, 40)
_PAPER: Color = (190, 150, 255)
_LINES: Color = (60, 62, 70)

_THICK = 0.16  # how high a bar is, as a fraction of its row
_MIN_SPAN = 0.1  # of restitution: less would make noise look like a difference between balls
_HALF_ROW = 0.3  # half of what marks take up of a row, as its fraction: the rest keeps rows apart


@dataclass(frozen=True)
class _RowAxes:
    """Layout of a chart's rows, from top to bottom, and range of its axis."""

    count: int
    low: float
    high: float

    def y(self, row: int) -> float:
        return -1 + (row + 0.5) / self.count

    def x(self, value: float) -> float:
        return (value - self.low) / (self.high - self.low) * _WIDTH

    @property
    def pitch(self) -> float:
        return 1 / self.count


def log_rates(stream: rr.RecordingStream, every: Sequence[Rate]) -> rrb.View:
    """Log each success rate with its Wilson interval, and the paper's."""
    title = f"success rates{_cut(len(every))}, bars: 95 % (Wilson), violet: the paper's"
    every = every[:_MAX_ROWS]
    rows = _RowAxes(len(every), 0.0, 1.0)
    sheet = "sheets/rates"
    _log_frame(
        stream,
        sheet,
        rows,
        [(quarter / 4, f"{25 * quarter} %") for quarter in range(5)],
        [rate.name for rate in every],
        [_rate_words(rate) for rate in every],
    )
    counted = [(row, rate) for row, rate in enumerate(every) if rate.count]
    intervals = [
        (rows.y(row), rows.x(rate.interval95[0]), rows.x(rate.interval95[1]))
        for row, rate in counted
    ]
    _log_bars(stream, f"{sheet}/intervals", intervals, rows.pitch * _THICK, mixed(SUCCESS, 0.45))
    dots = [(rows.x(rate.fraction), rows.y(row)) for row, rate in counted]
    _log_dots(stream, f"{sheet}/shares", dots, SUCCESS, 4.0)
    published = [
        (rows.x(rate.published), rows.y(row))
        for row, rate in enumerate(every)
        if rate.published is not None
    ]
    strips = [
        [[x, y - _HALF_ROW * rows.pitch], [x, y + _HALF_ROW * rows.pitch]] for x, y in published
    ]
    marks = rr.LineStrips2D(strips, colors=[_PAPER], radii=screen_radius(1.5), draw_order=18.0)
    stream.log(f"{sheet}/published", marks, static=True)
    return _view("rates", title)


def log_restitutions(stream: rr.RecordingStream, balls: Sequence[BallRestitutions]) -> rrb.View:
    """Log each attempt's restitution, and each ball's mean and standard deviation."""
    title = f"restitution by ball{_cut(len(balls))}: each attempt with its 95 %, band: mean ± sd"
    balls = balls[:_MAX_ROWS]
    ends = [value for ball in balls for value in ball.values]
    ends += [end for ball in balls for pair in ball.intervals95 if pair for end in pair]
    low, high = (min(ends), max(ends)) if ends else (0.0, 1.0)
    more = max(0.0, _MIN_SPAN - (high - low)) / 2 + 0.05 * (high - low)
    rows = _RowAxes(max(1, len(balls)), low - more, high + more)
    sheet = "sheets/spreads"
    marks = [(value, f"{value:.6g}") for value in ticks(rows.low, rows.high, 5)]
    figures = [
        f"{ball.mean:.4f} (1)"
        if isnan(ball.sd)
        else f"{ball.mean:.4f} ± {ball.sd:.4f} ({len(ball.values)})"
        for ball in balls
    ]
    _log_frame(stream, sheet, rows, marks, [ball.name for ball in balls], figures)
    deviations = [
        (rows.y(row), rows.x(ball.mean - ball.sd), rows.x(ball.mean + ball.sd))
        for row, ball in enumerate(balls)
        if not isnan(ball.sd)
    ]
    thick = 2 * _HALF_ROW * rows.pitch
    _log_bars(stream, f"{sheet}/deviation", deviations, thick, mixed(_TUNED, 0.2))
    dots: list[tuple[float, float]] = []
    bars: list[list[list[float]]] = []
    for row, ball in enumerate(balls):
        steps = max(1, len(ball.values) - 1)
        for index, (value, pair) in enumerate(zip(ball.values, ball.intervals95, strict=True)):
            y = rows.y(row) + (index / steps - 0.5) * 2 * 0.8 * _HALF_ROW * rows.pitch
            dots.append((rows.x(value), y))
            if pair is not None:
                bars.append([[rows.x(end), y] for end in pair])
    lines = rr.LineStrips2D(bars, colors=[_TUNED], radii=screen_radius(0.7), draw_order=15.0)
    stream.log(f"{sheet}/intervals", lines, static=True)
    _log_dots(stream, f"{sheet}/values", dots, _TUNED, 2.2)
    if not balls:
        said = rr.Points2D(
            [[_WIDTH / 2, -0.5]],
            labels=["no drop was tuned"],
            colors=[MUTED],
            radii=screen_radius(0.1),
            show_labels=True,
        )
        stream.log(f"{sheet}/words", said, static=True)
    return _view("spreads", title)


def _cut(count: int) -> str:
    """Say how many rows the chart has if not all."""
    return "" if count <= _MAX_ROWS else f" (the first {_MAX_ROWS} of {count})"


def _view(name: str, title: str) -> rrb.View:
    bounds = rrb.VisualBounds2D(
        x_range=(-_NAMES - 0.05, _WIDTH + _FIGURES + 0.05), y_range=(-1.04, 0.16)
    )
    return rrb.Spatial2DView(
        origin=f"/sheets/{name}", name=title, background=GROUND, visual_bounds=bounds
    )


def _rate_words(rate: Rate) -> str:
    if not rate.count:
        return "none"
    low, high = rate.interval95
    return (
        f"{rate.successes}/{rate.count} = {100 * rate.fraction:.0f} % "
        f"({100 * low:.0f} to {100 * high:.0f})"
    )


def _log_frame(
    stream: rr.RecordingStream,
    sheet: str,
    rows: _RowAxes,
    marks: Sequence[tuple[float, str]],
    names: Sequence[str],
    figures: Sequence[str],
) -> None:
    """Log grid lines at the marks, names on the left, figures on the right."""
    grid = [[[rows.x(value), -1.0], [rows.x(value), 0.0]] for value, _ in marks]
    lines = rr.LineStrips2D(grid, colors=[_LINES], radii=screen_radius(0.5))
    stream.log(f"{sheet}/grid", lines, static=True)
    labels = [([rows.x(value), 0.02], text) for value, text in marks]
    for row, (name, figure) in enumerate(zip(names, figures, strict=True)):
        labels.append(([-_NAMES / 2, rows.y(row) - _HANG], short_name(name, _MAX_LETTERS)))
        labels.append(([_WIDTH + _FIGURES / 2, rows.y(row) - _HANG], figure))
    colors = [MUTED] * len(marks) + [OBSERVED] * (2 * len(names))
    points = rr.Points2D(
        [position for position, _ in labels],
        labels=[text for _, text in labels],
        colors=colors,
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log(f"{sheet}/labels", points, static=True)


def _log_bars(
    stream: rr.RecordingStream,
    entity: str,
    bars: Sequence[tuple[float, float, float]],
    thick: float,
    color: Color,
) -> None:
    """Log filled bars, each as (y, left, right)."""
    strips: list[list[list[float]]] = []
    radii: list[float] = []
    for y, left, right in bars:
        lines, radius = filled(left, max(right, left + 0.004), y - thick / 2, y + thick / 2)
        strips += lines
        radii += [radius] * len(lines)
    stream.log(
        entity, rr.LineStrips2D(strips, colors=[color], radii=radii, draw_order=5.0), static=True
    )


def _log_dots(
    stream: rr.RecordingStream,
    entity: str,
    positions: Sequence[tuple[float, float]],
    color: Color,
    points: float,
) -> None:
    dots = rr.Points2D(positions, colors=[color], radii=screen_radius(points), draw_order=20.0)
    stream.log(entity, dots, static=True)
