"""The charts of a whole campaign, a row a ball: restitution with its spread, and success rates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan

import rerun as rr
import rerun.blueprint as rrb

from analysis.campaign.rates import Rate, Spread
from analysis.review.colors import MUTED, OBSERVED, SUCCESS, Color
from analysis.review.grid import GROUND, filled, mixed, ticks
from analysis.review.sending import screen_radius
from tunenet_logs.wording import short_name

_WIDTH = 1.25
_NAMES, _FIGURES = 0.6, 0.85
"""Room left of the chart for names, and right of it for figures."""

_HANG = 0.06
"""A label hangs from its place by half a line."""

_MOST_LETTERS = 22
_TUNED: Color = (255, 165, 40)
_PAPER: Color = (190, 150, 255)
_LINES = (60, 62, 70)
_THICK = 0.16
"""Of a row: how high a bar is."""

_LEAST_SPAN = 0.1
_HALF_ROW = 0.3


@dataclass(frozen=True)
class _Rows:
    """Where the rows of a chart are, from top to bottom, and what its axis spans."""

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


def log_rates(stream: rr.RecordingStream, overall: Sequence[Rate], balls: Sequence[Rate]) -> None:
    """Send the entities of `rate_view`: each share, its Wilson interval, the paper's figure."""
    every = [*overall, *balls]
    rows = _Rows(len(every), 0.0, 1.0)
    sheet = "sheets/rates"
    _log_frame(
        stream,
        sheet,
        rows,
        [(share / 4, f"{25 * share} %") for share in range(5)],
        [one.name for one in every],
        [_rate_words(one) for one in every],
    )
    counted = [(row, one) for row, one in enumerate(every) if one.count]
    _log_bars(
        stream,
        f"{sheet}/intervals",
        [
            (rows.y(row), rows.x(one.interval95[0]), rows.x(one.interval95[1]))
            for row, one in counted
        ],
        rows.pitch * _THICK,
        mixed(SUCCESS, 0.45),
    )
    _log_dots(
        stream, f"{sheet}/shares", [(rows.x(one.share), rows.y(row)) for row, one in counted],
        SUCCESS, 4.0,
    )  # fmt: skip
    published = [
        (rows.x(one.published), rows.y(row))
        for row, one in enumerate(every)
        if one.published is not None
    ]
    strips = [
        [[x, y - _HALF_ROW * rows.pitch], [x, y + _HALF_ROW * rows.pitch]] for x, y in published
    ]
    marks = rr.LineStrips2D(strips, colors=[_PAPER], radii=screen_radius(1.5), draw_order=18.0)
    stream.log(f"{sheet}/published", marks, static=True)


def log_spreads(stream: rr.RecordingStream, spreads: Sequence[Spread]) -> None:
    """Send the entities of `spread_view`: each attempt's value, and each ball's mean and spread."""
    ends = [value for one in spreads for value in one.values]
    ends += [end for one in spreads for pair in one.intervals95 if pair for end in pair]
    low, high = (min(ends), max(ends)) if ends else (0.0, 1.0)
    more = max(0.0, _LEAST_SPAN - (high - low)) / 2 + 0.05 * (high - low)
    rows = _Rows(max(1, len(spreads)), low - more, high + more)
    sheet = "sheets/spreads"
    marks = [(value, f"{value:.6g}") for value in ticks(rows.low, rows.high, 5)]
    names, words = [one.ball for one in spreads], [_spread_words(one) for one in spreads]
    _log_frame(stream, sheet, rows, marks, names, words)
    spread = [
        (rows.y(row), rows.x(one.mean - one.deviation), rows.x(one.mean + one.deviation))
        for row, one in enumerate(spreads)
        if not isnan(one.deviation)
    ]
    thick = 2 * _HALF_ROW * rows.pitch
    _log_bars(stream, f"{sheet}/deviation", spread, thick, mixed(_TUNED, 0.2))
    dots: list[tuple[float, float]] = []
    bars: list[list[list[float]]] = []
    for row, one in enumerate(spreads):
        steps = max(1, len(one.values) - 1)
        for index, (value, pair) in enumerate(zip(one.values, one.intervals95, strict=True)):
            y = rows.y(row) + (index / steps - 0.5) * 2 * 0.8 * _HALF_ROW * rows.pitch
            dots.append((rows.x(value), y))
            if pair is not None:
                bars.append([[rows.x(end), y] for end in pair])
    lines = rr.LineStrips2D(bars, colors=[_TUNED], radii=screen_radius(0.7), draw_order=15.0)
    stream.log(f"{sheet}/intervals", lines, static=True)
    _log_dots(stream, f"{sheet}/values", dots, _TUNED, 2.2)


def rate_view() -> rrb.View:
    """Shares of success by what the checks said of the drop, and by ball."""
    return _view("rates", "success rates, bars: 95 % (Wilson), violet: the paper's")


def spread_view() -> rrb.View:
    """Restitutions by ball."""
    return _view("spreads", "restitution by ball: each attempt with its 95 %, band: mean ± sd")


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
        f"{rate.successes}/{rate.count} = {100 * rate.share:.0f} % "
        f"({100 * low:.0f} to {100 * high:.0f})"
    )


def _spread_words(spread: Spread) -> str:
    if isnan(spread.deviation):
        return f"{spread.mean:.4f} (1)"
    return f"{spread.mean:.4f} ± {spread.deviation:.4f} ({len(spread.values)})"


def _log_frame(
    stream: rr.RecordingStream,
    sheet: str,
    rows: _Rows,
    marks: Sequence[tuple[float, str]],
    names: Sequence[str],
    figures: Sequence[str],
) -> None:
    """Lines up from the marks, names on the left, figures on the right."""
    grid = [[[rows.x(value), -1.0], [rows.x(value), 0.0]] for value, _ in marks]
    lines = rr.LineStrips2D(grid, colors=[_LINES], radii=screen_radius(0.5))
    stream.log(f"{sheet}/grid", lines, static=True)
    labels = [([rows.x(value), 0.02], text) for value, text in marks]
    for row, (name, figure) in enumerate(zip(names, figures, strict=True)):
        labels.append(([-_NAMES / 2, rows.y(row) - _HANG], short_name(name, _MOST_LETTERS)))
        labels.append(([_WIDTH + _FIGURES / 2, rows.y(row) - _HANG], figure))
    colors = [MUTED] * len(marks) + [OBSERVED] * (2 * len(names))
    points = rr.Points2D(
        [place for place, _ in labels],
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
    """Filled bars, each as (y, left, right)."""
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
    places: Sequence[tuple[float, float]],
    color: Color,
    points: float,
) -> None:
    dots = rr.Points2D(places, colors=[color], radii=screen_radius(points), draw_order=20.0)
    stream.log(entity, dots, static=True)
