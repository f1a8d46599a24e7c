"""Review of a ledger in Rerun: every log's values with their intervals, and a table of all.

Nothing in it moves: a chart's rows are sorted by the value, so that one sees the spread, the widest
intervals, and what is unlike the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from tunenet_logs.analysis.presentation import markdown_table, number_words, quantity
from tunenet_logs.analysis.review import drawing as draw
from tunenet_logs.analysis.review.tuning import VERDICT_COLORS
from tunenet_logs.episode import Array
from tunenet_logs.terminal import one_line, short_name

Columns = Mapping[str, Sequence[Any]]
_MAX_CHARTS = 6  # of values, those that most logs have first
_MAX_LISTED = 200  # logs in the table
_WIDTH = 1.5  # of a chart without its names and figures, in its heights
_HANG = 0.055  # see `RowAxes`
_UNLIKE: draw.Color = (255, 60, 200)
_MISFIT = "fit_excess_percent"


def write_overview(columns: Columns, path: Path) -> None:
    """Write the overview of a ledger as a Rerun recording."""
    verdicts = np.array([str(one) for one in columns["verdict"]])
    logs = [one_line(Path(str(one)).name) for one in columns["log"]]
    names = [name for name in columns if f"{name}_low" in columns]
    values = {name: _numbers(columns[name]) for name in names}
    names = [name for name in names if np.isfinite(values[name]).any()]
    names.sort(key=lambda name: -np.count_nonzero(np.isfinite(values[name])))
    names = names[:_MAX_CHARTS]
    said = {name: _title(name) for name in names}
    with draw.written(path, "overview", "overview") as recording:
        views: list[rrb.View] = []
        unlike: dict[str, NDArray[np.bool_]] = {}
        for number, name in enumerate(names):
            ends = np.stack([_numbers(columns[f"{name}_{end}"]) for end in ("low", "high")], axis=1)
            unlike[name] = _unlike(values[name], ends)
            chart = recording, f"chart_{number}", said[name]
            views.append(_log_values(*chart, logs, verdicts, values[name], ends, unlike[name]))
        misfit = _numbers(columns.get(_MISFIT, [None] * len(logs)))
        if np.isfinite(misfit).any():
            chart = recording, "misfit", "misfit [%]"  # beyond the noise; a longer tab would be cut
            none = np.full((len(logs), 2), np.nan)
            views.append(
                _log_values(*chart, logs, verdicts, misfit, none, np.zeros(len(logs), bool))
            )
        draw.log_words(recording, "table", _table(columns, logs, names, said))
        draw.log_words(recording, "summary", _summary(logs, verdicts, names, said, values, unlike))
        table = rrb.TextDocumentView(origin="/table", name="logs in the order they were tuned")
        layout = rrb.Horizontal(
            rrb.Vertical(*([rrb.Tabs(*views)] if views else []), table),
            rrb.TextDocumentView(origin="/summary", name="summary"),
            column_shares=[3, 1],
        )
        recording.send_blueprint(draw.blueprint(layout, rrb.TimePanel(state="hidden")))


_UNITS = {"_1_m": "1/m", "_kg_m": "kg·m²", "_kg": "kg", "_m": "m", "_s": "s", "_rad": "rad"}


def _title(column: str) -> str:
    """Name a ledger's column, which ends with its unit: "drag [1/m]"."""
    end = next((end for end in _UNITS if column.endswith(end)), "")
    return quantity(column.removesuffix(end).replace("_", " "), _UNITS.get(end, "1"))


def _unlike(values: Array, ends: Array) -> NDArray[np.bool_]:
    """Return which values are outliers by the median absolute deviation and by their intervals."""
    known = values[np.isfinite(values)]
    if len(known) < 8:  # with fewer, none is called an outlier
        return np.zeros(len(values), bool)
    middle = np.median(known)
    spread = 1.4826 * float(np.median(np.abs(known - middle)))
    with np.errstate(invalid="ignore"):
        off = np.abs(values - middle)
        half = np.nan_to_num(np.abs(ends - values[:, None]).max(axis=1))
        return (off > 5.0 * max(spread, 1e-12)) & (off > half + 2.0 * spread)


def _log_values(
    recording: rr.RecordingStream,
    chart: str,
    title: str,
    logs: Sequence[str],
    verdicts: NDArray[Any],
    values: Array,
    ends: Array,
    unlike: NDArray[np.bool_],
) -> rrb.View:
    """Log a row for each value, the largest on top, with its interval; return the view."""
    order = np.argsort(-values, kind="stable")
    order = order[np.isfinite(values[order])]
    shown = values[order]
    low, high = float(shown.min()), float(shown.max())
    # Of intervals as much as a chart of the values has room for.
    near = np.clip(ends[order], low - (high - low), high + (high - low))
    low, high = float(np.nanmin([low, *near[:, 0]])), float(np.nanmax([high, *near[:, 1]]))
    more = 0.05 * (high - low) or max(0.01 * abs(high), 1e-6)
    rows = draw.RowAxes(len(order), low - more, high + more, _WIDTH, _HANG)
    sheet = f"sheets/{chart}"
    marks = [(value, f"{value:.6g}") for value in draw.ticks(rows.low, rows.high, 6)]
    is_named = len(order) <= draw.MAX_ROWS
    told = [at for at in range(len(order)) if is_named or unlike[order[at]]]
    told = told[:: max(-(-len(told) // draw.MAX_ROWS), 1)]
    named = [logs[int(order[at])] if at in told else "" for at in range(len(order))]
    figures = [
        number_words(float(value)) + _half(pair) if at in told else ""
        for at, (value, pair) in enumerate(zip(shown, ends[order], strict=True))
    ]
    draw.log_frame(recording, sheet, rows, marks, named, figures)
    places = np.array([[rows.x(value), rows.y(row)] for row, value in enumerate(shown)])
    bars = [
        [[rows.x(end), rows.y(row)] for end in pair]
        for row, pair in enumerate(near.tolist())
        if np.isfinite(pair).all()
    ]
    draw.log_strips(recording, f"{sheet}/intervals", bars, [draw.MUTED], 0.9, 15.0)
    colors = [VERDICT_COLORS.get(verdict, draw.MUTED) for verdict in verdicts[order].tolist()]
    size = 4.0 if len(order) <= 50 else 2.0
    draw.log_dots(recording, f"{sheet}/values", places, colors, size, 20.0)
    if unlike.any():
        circled = places[unlike[order]]
        draw.log_dots(recording, f"{sheet}/unlike", circled, [_UNLIKE], size + 2.0, 18.0)
    return rows.view(chart, title)


def _half(pair: Array) -> str:
    return f" ± {float(np.ptp(pair)) / 2:.2g}" if np.isfinite(pair).all() else ""


def _table(
    columns: Columns, logs: Sequence[str], names: Sequence[str], said: Mapping[str, str]
) -> str:
    """Format a row for each log, its values with half of their intervals; reasons follow."""
    cells: dict[str, list[str]] = {
        "log": [short_name(log, 40) for log in logs],
        "verdict": list(map(str, columns["verdict"])),
    }
    for name in names:
        ends = np.stack([_numbers(columns[f"{name}_{end}"]) for end in ("low", "high")], axis=1)
        cells[said[name]] = [
            number_words(float(value)) + _half(pair) if np.isfinite(value) else "-"
            for value, pair in zip(_numbers(columns[name]), ends, strict=True)
        ]
    rows = list(zip(*cells.values(), strict=True))
    lines = [markdown_table(tuple(cells), rows[:_MAX_LISTED])]
    if len(rows) > _MAX_LISTED:
        lines.append(f"{len(rows) - _MAX_LISTED} more are in ledger.parquet")
    # Below the table, where long ones take several lines: a column would end off the screen.
    for name in ("reason", "error"):
        told = zip(logs[:_MAX_LISTED], columns.get(name, ()), strict=False)
        lines += [f"**{short_name(log, 40)}**: {one_line(one)}" for log, one in told if one]
    return "\n\n".join(lines)


def _summary(
    logs: Sequence[str],
    verdicts: NDArray[Any],
    names: Sequence[str],
    said: Mapping[str, str],
    values: Mapping[str, Array],
    unlike: Mapping[str, NDArray[np.bool_]],
) -> str:
    """Describe the ledger: counts, the spread of each value, and what is unlike the others."""
    counts = ", ".join(f"{int(np.sum(verdicts == one))} {one}" for one in VERDICT_COLORS)
    lines = [f"# {len(logs)} logs", f"{counts}.", *(["Bars: 95 % intervals."] if names else [])]
    if any(one.any() for one in unlike.values()):
        lines.append("Pink: unlike the others, by more than their spread and its own interval.")
    for name in names:
        known = values[name][np.isfinite(values[name])]
        low, middle, high = map(number_words, np.percentile(known, (5, 50, 95)).tolist())
        spread = f"median {middle}; 90 % from {low} to {high}"
        if len(known) < 3:
            spread = " and ".join(number_words(float(value)) for value in np.sort(known))
        lines += [f"## {said[name]}", spread]
        which = np.flatnonzero(unlike[name])
        if len(which):
            told = ", ".join(
                f"{logs[at]} ({number_words(float(values[name][at]))})" for at in which[:10]
            )
            more = f" and {len(which) - 10} more" if len(which) > 10 else ""
            lines.append(f"unlike the others: {told}{more}")
    return "\n\n".join(lines)


def _numbers(cells: Sequence[Any]) -> Array:
    """Convert cells to numbers, NaN where there is none."""
    return np.array([np.nan if one is None else float(one) for one in cells])
