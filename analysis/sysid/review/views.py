"""Review of a simulator: its motion beside the log, residuals, and hold-out prediction.

The log's timeline shows the observation and all iterations, in 3D for a MuJoCo model
(`motion_scene`); the iterations' timeline, one of them with its values (`scrub`). A fit to the
first part of the log predicts the rest (`held_out`).
"""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.record import Tuning
from analysis.review.drawing import LOG_TIME, MUTED, OBSERVED, Color
from analysis.review.key import KEY_SHARES, log_key
from analysis.sysid.review.curves import log_lines, log_observed, log_upright, plot
from analysis.sysid.review.held_out import log_held_out
from analysis.sysid.review.motion_scene import log_scene
from analysis.sysid.review.review_data import (
    ShownColumn,
    SimulatorReviewData,
    simulator_review_data,
)
from analysis.sysid.review.scrub import log_scrub
from tunenet_logs.terminal import one_line

_ONE_COLUMN = 3  # charts that lie one over the other; more take two columns
# Of the residuals: what the axis must show, so that no spike makes it useless; and room beyond.
_TYPICAL_QUANTILE, _HEADROOM = 0.98, 1.3

_BAND = 2.0  # standard deviations of the noise that are drawn around no residual


def log_simulator(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container:
    """Log all views of a simulator's review, and return their layout."""
    data = simulator_review_data(tuning)
    curves = [_log_curves(stream, data, number) for number in range(len(data.columns))]
    residuals = [_log_residuals(stream, data, number) for number in range(len(data.columns))]
    main, others = curves[: len(data.main)], curves[len(data.main) :]
    overlay = rrb.Vertical(_log_key(stream, data), _grid(main), row_shares=KEY_SHARES)
    scene = log_scene(stream, tuning, data)
    parts: list[rrb.View | rrb.Container] = [] if scene is None else [scene]
    parts += [overlay, rrb.TextDocumentView(origin="/result", name="result")]
    shares = [6.0, 4.6] if scene is None else [4.2, 5.2, 4.8]
    tabs: list[rrb.Container] = [
        rrb.Horizontal(*parts, column_shares=shares, name=f"overlay (timeline {LOG_TIME})")
    ]
    if others:
        more = f", {data.left_out} more are not drawn" if data.left_out else ""
        name = f"other signals{more} (timeline {LOG_TIME})"
        tabs.append(rrb.Grid(*others, grid_columns=_across(len(others)), name=name))
    left_view = log_key(stream, _residual_entries(data), "residual_key")
    left = rrb.Grid(*residuals, grid_columns=_across(len(residuals)))
    name = f"residuals (timeline {LOG_TIME})"
    tabs.append(rrb.Vertical(left_view, left, row_shares=KEY_SHARES, name=name))
    tabs.append(log_scrub(stream, data))
    if data.held_out_s is not None:
        tabs.append(log_held_out(stream, data))
    return rrb.Tabs(*tabs, active_tab=0)


def _across(count: int) -> int:
    """Return the columns of a grid of so many charts."""
    return int(np.ceil(np.sqrt(count * 0.8)))


def _grid(views: list[rrb.View]) -> rrb.Container:
    return rrb.Grid(*views, grid_columns=2 if len(views) > _ONE_COLUMN else 1)


def _lines(data: SimulatorReviewData, column: ShownColumn) -> list[tuple[str, Color, float]]:
    """Return the style of each iteration's line."""
    unit = "" if column.unit in ("", "1") else f" {one_line(column.unit)}"
    return [
        (f"{one.name}  {column.rms[k]:.3g}{unit} rms", one.color, one.width)
        for k, one in enumerate(data.iterates)
        if k in data.drawn
    ]


def _log_curves(stream: rr.RecordingStream, data: SimulatorReviewData, number: int) -> rrb.View:
    """Log observed under simulated curves; iterates before the result may run off."""
    column, entity = data.columns[number], f"signal/{number}"
    span = column.shown(column.simulated[:, -1])
    values = column.simulated[:, data.drawn]
    log_lines(stream, f"{entity}/iterations", column.seconds, values, _lines(data, column))
    log_observed(stream, entity, column.seconds, column.observed)
    if data.held_out_s is not None:
        log_upright(stream, f"{entity}/held_out", data.held_out_s, span)
    return plot(entity, column.title(), span)


def _log_residuals(stream: rr.RecordingStream, data: SimulatorReviewData, number: int) -> rrb.View:
    """Log the residuals of the iterations, and the band of noise."""
    column, entity = data.columns[number], f"residual/{number}"
    off = column.simulated[:, data.drawn] - column.observed[:, None]
    log_lines(stream, f"{entity}/iterations", column.seconds, off, _lines(data, column))
    band = _BAND * column.noise
    ends = column.seconds[[0, -1]]
    values = np.array([[-band, band]] * 2)
    style: list[tuple[str, Color, float]] = [("noise", OBSERVED, 1.0)] * 2
    log_lines(stream, f"{entity}/noise", ends, values, style)
    last = np.abs(off[:, -1])
    last = last[np.isfinite(last)]
    usual = float(np.quantile(last, _TYPICAL_QUANTILE)) if len(last) else 0.0
    least = max(1e-6 * float(np.abs(column.observed).max()), 1e-9)
    reach = _HEADROOM * max(usual, band, least)
    return plot(entity, column.title("simulated - observed"), (-reach, reach))


def _log_key(stream: rr.RecordingStream, data: SimulatorReviewData) -> rrb.View:
    entries: list[tuple[str, list[Color]]] = [("observed", [OBSERVED]), _iterations(data)]
    if data.held_out_s is not None:
        entries.append((f"{data.held_out_s:.2f} s: held out", [MUTED]))
    return log_key(stream, entries)


def _iterations(data: SimulatorReviewData) -> tuple[str, list[Color]]:
    return "iterations", [data.iterates[k].color for k in data.drawn]


def _residual_entries(data: SimulatorReviewData) -> list[tuple[str, list[Color]]]:
    return [_iterations(data), (f"± {_BAND:g} standard deviations of the noise", [OBSERVED])]
