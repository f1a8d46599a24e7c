"""Figures of several logs: their curves over each other, their values with intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from analysis.comparison import ComparedGroup, ComparedQuantity, Comparison
from analysis.record import Record
from analysis.report.drop_figures import in_metres, thinned
from analysis.report.style import (
    COLUMN_IN,
    MUTED,
    WIDE_IN,
    Drawing,
    drawable,
    log_style,
    new_figure,
    styled,
)
from analysis.terminal_table import quantity

_MAX_CURVES = 14  # over each other: more cannot be told apart
_MAX_POINTS = 300  # drawn of each of them
_MAX_ROWS = 40  # of a chart of values
_MAX_CHARTS = 6


@styled
def overlay_drawing(comparison: Comparison) -> Drawing | None:
    """Plot observed and simulated heights of several drops from their first impact."""
    numbered = [
        (number, label, record)
        for number, (label, record) in enumerate(
            zip(comparison.labels, comparison.records, strict=True), 1
        )
        if record.motion.curves is not None and record.rebounds and record.estimates
    ]
    metres = [one for one in numbered if in_metres(one[2])]
    shown = (metres or numbered)[:_MAX_CURVES]
    if len(shown) < 2:
        return None
    figure = new_figure(WIDE_IN, 3.0)
    axes = figure.subplots()
    for place, (number, label, record) in enumerate(shown):
        color, pattern = log_style(place)
        curves = record.motion.curves
        assert curves is not None
        part = thinned(len(curves.seconds), _MAX_POINTS)
        seconds = curves.seconds[part] - first_impact_s(record)
        axes.plot(seconds, curves.observed_m[part], ".", color=color, markersize=2, alpha=0.5)
        axes.plot(
            seconds,
            curves.simulated_m[part],
            color=color,
            linestyle=pattern,
            linewidth=1.0,
            label=f"{number}  {drawable(label)}",
        )
    axes.axvline(0, color=MUTED, linewidth=0.5)
    axes.set_xlabel("time from the first impact [s]")
    axes.set_ylabel("height [m]" if metres else "height [drop heights]")
    figure.legend(loc="outside right upper")
    left = len(numbered) - len(shown)
    caption = "Heights from the first impact on: points as observed, lines as tuned."
    caption += f" {left} more drops are not drawn." if left else ""
    labels = ", ".join(f"{number} {label}" for number, label, _ in shown)
    alt = f"Curves of height over time of {len(shown)} drops: {labels}."
    return Drawing("curves", "Curves over each other", caption, alt, figure)


def first_impact_s(record: Record) -> float:
    """Return the time of the first impact, on the log's clock."""
    window = record.window or {}
    return window.get("impact_s", record.rebounds[0].impact_s if record.rebounds else 0.0)


@styled
def values_drawing(comparison: Comparison, group: ComparedGroup) -> Drawing | None:
    """Plot a group's values with their intervals, a chart each; None for a single log."""
    charts = [one for one in group.quantities if len(one.values) > 1][:_MAX_CHARTS]
    if not charts:
        return None
    labels = group.labels[:_MAX_ROWS]
    columns = min(3, len(charts))
    rows = -(-len(charts) // columns)
    width_in = WIDE_IN if columns > 1 else COLUMN_IN
    figure = new_figure(width_in, (0.55 + 0.19 * len(labels)) * rows + 0.1)
    grid = np.ravel(figure.subplots(rows, columns, squeeze=False))
    for axes in grid[len(charts) :]:
        axes.set_axis_off()
    numbers = {label: number for number, label in enumerate(comparison.labels, 1)}
    for index, (axes, one) in enumerate(zip(grid, charts, strict=False)):
        _draw_values(axes, one, labels)
        names = [str(numbers[label]) for label in labels]
        if index % columns == 0:
            names = [f"{drawable(label, 22)}  {numbers[label]}" for label in labels]
        axes.set_yticks(range(len(labels)), names)
        axes.set_ylim(len(labels) - 0.5, -0.5)
        axes.grid(visible=False, axis="y")
        axes.set_title(drawable(quantity(one.name, one.unit)), pad=3)
    caption = "Values with 95 % intervals; hollow: suspect, or without an interval."
    if len(group.labels) > len(labels):
        caption += f" {len(group.labels) - len(labels)} more logs are not drawn."
    words = "; ".join(_in_words(one) for one in charts)
    return Drawing("values", f"Values: {group.title}", caption, words, figure)


def _draw_values(axes, one: ComparedQuantity, labels: Sequence[str]) -> None:  # noqa: ANN001
    rows = {label: row for row, label in enumerate(labels)}
    for value in one.values:
        row = rows.get(value.label)
        if row is None:
            continue
        color, _ = log_style(0)
        if value.interval95 is not None:
            axes.plot(value.interval95, [row, row], color=color, linewidth=1.2)
        is_sure = value.verdict == "ok" and value.interval95 is not None
        fill = color if is_sure else "white"
        axes.plot([value.value], [row], "o", color=color, markerfacecolor=fill, markersize=4)


def _in_words(one: ComparedQuantity) -> str:
    values = [value.value for value in one.values if math.isfinite(value.value)]
    return f"{one.name} from {min(values):.4f} to {max(values):.4f} in {len(values)} logs"


def comparison_drawings(comparison: Comparison) -> list[Drawing]:
    """Make all figures of a comparison, the curves first."""
    drawings = [overlay_drawing(comparison)]
    drawings += [values_drawing(comparison, group) for group in comparison.groups]
    return [drawing for drawing in drawings if drawing is not None]
