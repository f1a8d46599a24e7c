"""Views of one iteration at a time: its curves over the observed ones, and its values."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.review.drawing import (
    ITERATION,
    OBSERVED,
    WIDTH,
    Iterates,
    by_iteration,
    chart_view,
    iterates_view,
    log_grid,
    log_iterates,
    screen_radius,
    span_of,
    ticks,
)
from analysis.review.said_names import said_names
from analysis.sysid.review.review_data import ShownColumn, SimulatorReviewData
from analysis.terminal_table import markdown_table, quantity
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import short_name

_MAX_PARAMETERS = 6  # that have a chart: more would be too small to read; the table has all
# Charts that lie one over the other; more take two columns, so wide in their heights.
_STACKED, _NARROW = 3, 1.4

_MAX_ROWS = 20  # of tables
_ROOM = 0.05  # above and below the curves of a sheet, of what they span
_BEYOND = 0.5  # how far guesses widen a chart, of what was observed; they are cut there
# What a number takes up across, in heights of a chart: the smaller this is, the more.
_STACKED_FIGURE, _SMALL_FIGURE = 1.0, 1.4

_MIN_SHARE = 0.02  # of a parameter's range: less is drawn as still


def log_scrub(stream: rr.RecordingStream, data: SimulatorReviewData) -> rrb.Container:
    """Log the views of one iteration, and each parameter by iteration."""
    width = WIDTH if len(data.main) <= _STACKED else _NARROW
    sheets: list[rrb.View] = []
    for number, column in enumerate(data.main):
        _log_sheet(stream, data, f"signal_{number}", column, width)
        sheets.append(chart_view(f"signal_{number}", column.title(), width))
    charts = [
        _log_parameter(stream, data, number)
        for number in range(min(len(data.parameters), _MAX_PARAMETERS))
    ]
    stream.log("step", rr.TextDocument.from_fields(media_type="text/markdown"), static=True)
    for index, chosen in by_iteration(len(data.iterates), data.first_s):
        words = rr.TextDocument.columns(text=[_words(data, k) for k in chosen])
        stream.send_columns("step", indexes=[index], columns=words)
    step = rrb.TextDocumentView(origin="/step", name="iteration")
    is_narrow = len(charts) <= _STACKED
    return rrb.Horizontal(
        rrb.Grid(*sheets, grid_columns=1 if len(sheets) <= _STACKED else 2),
        rrb.Grid(*charts, grid_columns=1 if is_narrow else 2),
        step,
        column_shares=[4.6, 3.2, 3.2] if is_narrow else [4.0, 4.2, 3.0],
        name=f"scrub (timeline {ITERATION})",
    )


def _log_sheet(
    stream: rr.RecordingStream,
    data: SimulatorReviewData,
    name: str,
    column: ShownColumn,
    width: float,
) -> None:
    """Log an iteration's curve over the observed one, which stays."""
    sheet = f"sheets/{name}"
    low, high = column.shown(column.simulated[:, -1])
    beyond = _BEYOND * (high - low)
    guessed = np.clip(column.simulated, low - beyond, high + beyond)
    low, high = column.shown(guessed.ravel())
    reach = (high - low) * (1 + 2 * _ROOM)
    bottom = (low + high - reach) / 2
    start_s = float(column.seconds[0])
    width_s = max(float(column.seconds[-1]) - start_s, 1e-9)
    x = (column.seconds - start_s) / width_s * width

    def points(values: Array) -> Array:
        good = np.isfinite(values)
        return np.column_stack([x, -(values - bottom) / reach])[good]

    rows = [(-(value - bottom) / reach, f"{value:g}") for value in ticks(bottom, bottom + reach, 3)]
    marks = [
        ((second - start_s) / width_s * width, f"{second:g} s")
        for second in ticks(start_s, start_s + width_s, 5 if width == WIDTH else 3)
    ]
    log_grid(stream, sheet, width, rows, marks)
    dots = rr.Points2D(points(column.observed), colors=[OBSERVED], radii=screen_radius(1.2))
    stream.log(f"{sheet}/observed", dots, static=True)
    style = rr.LineStrips2D.from_fields(radii=screen_radius(1.4), draw_order=40.0)
    stream.log(f"{sheet}/simulated", style, static=True)
    for index, chosen in by_iteration(len(data.iterates), data.first_s):
        strips = rr.LineStrips2D.columns(
            strips=[points(guessed[:, k]) for k in chosen],
            colors=[data.iterates[k].color for k in chosen],
        )
        stream.send_columns(f"{sheet}/simulated", indexes=[index], columns=strips)


def _log_parameter(stream: rr.RecordingStream, data: SimulatorReviewData, number: int) -> rrb.View:
    """Log one parameter by iteration, and the result's interval."""
    parameter = data.parameters[number]
    is_narrow = len(data.parameters) <= _STACKED
    values = [float(one.values[number]) for one in data.iterates]
    interval = None
    if data.interval95 is not None:
        interval = (float(data.interval95[number, 0]), float(data.interval95[number, 1]))
    low, high = parameter.training_range
    least = _MIN_SHARE * max(high - low, 1e-9)
    iterates = Iterates(
        parameter=parameter.name,
        unit=parameter.unit,
        names=tuple(one.name for one in data.iterates),
        values=tuple(values),
        colors=tuple(one.color for one in data.iterates),
        span=span_of([*values, *(interval or ())], least),
        interval95=interval,
        chart=f"parameter_{number}",
        title=quantity(
            short_name(said_names(one.name for one in data.parameters)[parameter.name], 26),
            parameter.unit if is_narrow else "1",
        ),
        figures=".4g",
        figure_width=_STACKED_FIGURE if is_narrow else _SMALL_FIGURE,
    )
    log_iterates(stream, iterates, data.first_s)
    return iterates_view(iterates)


def _words(data: SimulatorReviewData, k: int) -> str:
    """Describe an iteration: its values, and its residuals."""
    iterate = data.iterates[k]
    said = said_names(one.name for one in data.parameters)
    values = [
        (short_name(said[one.name], 32), f"{value:.5g}", "-" if one.unit == "1" else one.unit)
        for one, value in zip(data.parameters, iterate.values, strict=True)
    ]
    left = [
        (column.title(), f"{column.rms[k]:.3g}", f"{column.noise:.3g}") for column in data.columns
    ]
    lines = [
        f"# {iterate.name}",
        markdown_table(("parameter", "value", "unit"), values[:_MAX_ROWS]),
        markdown_table(("signal", "rms off", "noise"), left[:_MAX_ROWS]),
    ]
    return "\n\n".join(lines)
