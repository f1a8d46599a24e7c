"""Hold-out views: prediction of a log's end by a fit to its beginning."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.review.drawing import FITTED, LOG_TIME, OBSERVED, Color, ramp
from analysis.review.key import KEY_SHARES, log_key
from analysis.sysid.review.curves import log_lines, log_observed, log_upright, plot
from analysis.sysid.review.review_data import ShownColumn, SimulatorReviewData
from analysis.terminal_table import markdown_table

_GIVEN, _PREDICTED = ramp(1, 6), ramp(5, 6)  # cold, as the first iteration, and warm, as the result
_ONE_COLUMN = 3


def log_held_out(stream: rr.RecordingStream, data: SimulatorReviewData) -> rrb.Container:
    """Log the hold-out predictions of the main columns, and their errors in words."""
    assert data.held_out_s is not None
    views = [_log_column(stream, data, number) for number in range(len(data.main))]
    entries: list[tuple[str, list[Color]]] = [
        ("observed", [OBSERVED]),
        ("simulator as given", [_GIVEN]),
        ("fit to the first part", [FITTED]),
        ("what it predicts", [_PREDICTED]),
    ]
    key = log_key(stream, entries, "held_out_key")
    words = rr.TextDocument(_words(data), media_type="text/markdown")
    stream.log("held_out_words", words, static=True)
    charts = rrb.Grid(*views, grid_columns=2 if len(views) > _ONE_COLUMN else 1)
    return rrb.Horizontal(
        rrb.Vertical(key, charts, row_shares=KEY_SHARES),
        rrb.TextDocumentView(origin="/held_out_words", name="prediction"),
        column_shares=[3, 1.6],
        name=f"held-out prediction (timeline {LOG_TIME})",
    )


def _log_column(stream: rr.RecordingStream, data: SimulatorReviewData, number: int) -> rrb.View:
    column, entity = data.columns[number], f"held_out/{number}"
    assert data.held_out_s is not None
    assert column.fitted is not None
    assert column.given is not None
    later = column.seconds > data.held_out_s
    span = column.shown(column.fitted)
    for name, values, color, width in (
        ("given", column.given, _GIVEN, 0.8),
        ("fitted", np.where(later, np.nan, column.fitted), FITTED, 1.6),
        ("predicted", np.where(later, column.fitted, np.nan), _PREDICTED, 1.6),
    ):
        good = np.isfinite(values)
        if good.any():
            style: list[tuple[str, Color, float]] = [(name, color, width)]
            log_lines(stream, f"{entity}/{name}", column.seconds[good], values[good, None], style)
    log_observed(stream, entity, column.seconds, column.observed)
    log_upright(stream, f"{entity}/begins", data.held_out_s, span)
    return plot(entity, column.title(f"predicted from {data.held_out_s:.2f} s"), span)


def _words(data: SimulatorReviewData) -> str:
    """Describe the hold-out errors, column by column."""
    rows = [_row(column) for column in data.columns if column.held_out_rms is not None]
    head = ("rms", "predicted", "as given", "noise")
    return "\n\n".join(
        [
            f"# from {data.held_out_s:.2f} s on",
            "The simulator was fitted a second time, to what is before; what comes after, it has "
            "not seen.",
            markdown_table(head, rows),
        ]
    )


def _row(column: ShownColumn) -> tuple[str, ...]:
    assert column.held_out_rms is not None
    numbers = (*column.held_out_rms, column.noise)
    return (column.title(), *(f"{number:.3g}" for number in numbers))
