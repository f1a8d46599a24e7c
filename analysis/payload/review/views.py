"""Review of a payload: torques, the arm in 3D, the mass, and the nuisance terms.

The log's timeline shows the torques of all iterations and their residuals; the iterations'
timeline, what one iteration's payload adds to the empty arm's torques. The arm is in `arm_scene`,
friction and other nuisance terms are in `terms`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.payload.review.arm_scene import log_arm
from analysis.payload.review.review_data import (
    PayloadReviewData,
    TorqueCurve,
    payload_review_data,
)
from analysis.payload.review.terms import log_terms
from analysis.record import Tuning
from analysis.review.drawing import (
    ITERATION,
    LOG_TIME,
    OBSERVED,
    WIDTH,
    Color,
    Iterates,
    by_iteration,
    chart_view,
    iterates_view,
    log_grid,
    log_iterates,
    screen_radius,
    send_scalars,
    span_of,
    ticked,
    ticks,
)
from analysis.review.key import KEY_SHARES, log_key
from recorders.simulators.arm.payload import PAYLOAD_MASS
from tunenet_logs.arrays import Array

_MANY_SAMPLES = 150  # above which dots of the usual size would hide the lines
# Of the residuals: what the axis must show, so that no spike makes it useless; and room beyond.
_TYPICAL_QUANTILE, _HEADROOM = 0.98, 1.3

# Joints that the first tab has room for, so that their axes have ticks; the others have a tab.
_PLAYED = 4

_COLUMNS = 3  # of a tab of residuals: titles and ticks fit on a laptop's screen
# Of the axes of torques, of a payload's part of them, and of residuals (half of it): less would
# make noise look like torque.
_MIN_SPAN_NM, _MIN_SHEET_NM, _MIN_REACH_NM = 2.0, 0.5, 0.05

_ROOM = 0.05  # above and below the curves of a sheet, of what they span
_ONE_COLUMN = 3  # joints whose charts lie one over the other; more take two columns
_MIN_SPAN_KG = 0.02  # of the mass's axis: less would make steps of a gram look large


def log_payload(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container:
    """Log all views of a payload's review, and return their layout."""
    data = payload_review_data(tuning)
    masses_kg = [curve.mass_kg for curve in data.simulated]
    iterates = Iterates(
        parameter="payload mass",
        unit=PAYLOAD_MASS.unit,
        names=tuple(curve.name for curve in data.simulated),
        values=tuple(masses_kg),
        colors=tuple(curve.color for curve in data.simulated),
        span=span_of([*masses_kg, *(data.interval95 or ())], _MIN_SPAN_KG),
        interval95=data.interval95,
    )
    torques, residuals = _log_torques(stream, data)
    key = _log_key(stream, data)
    arm = log_arm(stream, data)
    log_iterates(stream, iterates, float(data.seconds[0]))
    sheets = _log_sheets(stream, data)
    terms = log_terms(stream, data)
    overlay = rrb.Horizontal(
        arm,
        rrb.Vertical(key, rrb.Grid(*torques[:_PLAYED], grid_columns=2), row_shares=KEY_SHARES),
        rrb.TextDocumentView(origin="/result", name="result"),
        column_shares=[3.6, 6, 4.6],
        name=f"overlay (timeline {LOG_TIME})",
    )
    step = rrb.TextDocumentView(origin="/step", name="iteration")
    scrub = rrb.Horizontal(
        rrb.Grid(*sheets, grid_columns=2 if len(sheets) > _ONE_COLUMN else 1),
        rrb.Vertical(step, iterates_view(iterates)),
        column_shares=[5, 4],
        name=f"scrub (timeline {ITERATION})",
    )
    others = rrb.Grid(*terms, grid_columns=3, name="what else is in the torques")
    name = f"what is left (timeline {LOG_TIME})"
    tabs = [overlay, rrb.Grid(*residuals, grid_columns=_COLUMNS, name=name), scrub, others]
    if len(torques) > _PLAYED:
        name = f"other joints (timeline {LOG_TIME})"
        tabs.insert(1, rrb.Grid(*torques[_PLAYED:], grid_columns=2, name=name))
    return rrb.Tabs(*tabs, active_tab=0)


def _log_torques(
    stream: rr.RecordingStream, data: PayloadReviewData
) -> tuple[list[rrb.View], list[rrb.View]]:
    """Log two charts per joint: observed torques with those of all iterations, and the residuals.

    A torque's axis fits the observed and the result; earlier iterates may run off. That of
    residuals has the scale of the result's of most joints.
    """
    size = 1.0 if len(data.seconds) > _MANY_SAMPLES else 1.5
    curves = {"iterations": data.simulated}
    if data.fitted is not None:
        curves["fit"] = (data.fitted,)
    off = np.abs(data.result.effort_nm - data.observed_nm)
    usual = np.quantile(off, _TYPICAL_QUANTILE, axis=0)
    least = max(float(np.median(usual[data.used])), _MIN_REACH_NM)
    best = data.fitted or data.result
    torques: list[rrb.View] = []
    residuals: list[rrb.View] = []
    for joint in data.order:
        torque, residual = f"torque/joint_{joint + 1}", f"residual/joint_{joint + 1}"
        observed = data.observed_nm[:, joint]
        for name, lines in curves.items():
            values = np.column_stack([line.effort_nm[:, joint] for line in lines])
            _log_lines(stream, f"{torque}/{name}", lines, data.seconds, values)
            _log_lines(
                stream, f"{residual}/{name}", lines, data.seconds, values - observed[:, None]
            )
        points = rr.SeriesPoints(colors=[OBSERVED], names=["observed"], marker_sizes=[size])
        stream.log(f"{torque}/observed", points, static=True)
        send_scalars(stream, f"{torque}/observed", data.seconds, observed)
        shown = np.concatenate([observed, best.effort_nm[:, joint]])
        low, high = float(shown.min()), float(shown.max())
        more = max(0.0, _MIN_SPAN_NM - (high - low)) / 2
        reach = _HEADROOM * max(float(usual[joint]), least)
        unused = "" if data.used[joint] else ", not used"
        title = data.title(joint, "torque") + unused
        torques.append(_plot(torque, title, low - more, high + more))
        title = data.title(joint, "simulated - observed")
        residuals.append(_plot(residual, title, -reach, reach))
    return torques, residuals


def _plot(entity: str, title: str, low: float, high: float) -> rrb.View:
    """Build a plot whose axis shows these values and has ticks."""
    return rrb.TimeSeriesView(
        origin=f"/{entity}",
        name=title,
        axis_y=rrb.ScalarAxis(range=ticked(low, high)),
        plot_legend=rrb.PlotLegend(visible=False),
    )


def _log_key(stream: rr.RecordingStream, data: PayloadReviewData) -> rrb.View:
    """Log the legend of the curves."""
    entries: list[tuple[str, list[Color]]] = [("observed", [OBSERVED])]
    entries.append(("rigid arm, by iteration", [curve.color for curve in data.simulated]))
    if data.fitted is not None:
        entries.append((data.fitted.label, [data.fitted.color]))
    return log_key(stream, entries)


def _log_lines(
    stream: rr.RecordingStream,
    entity: str,
    curves: Sequence[TorqueCurve],
    seconds: Array,
    values: Array,
) -> None:
    """Log several curves as one entity, values of shape (T, curves)."""
    style = rr.SeriesLines(
        colors=[curve.color for curve in curves],
        names=[curve.label for curve in curves],
        widths=[curve.width for curve in curves],
        aggregation_policy="Off",
    )
    stream.log(entity, style, static=True)
    send_scalars(stream, entity, seconds, values)


def _log_sheets(stream: rr.RecordingStream, data: PayloadReviewData) -> list[rrb.View]:
    """Log per joint the observed torque and what the iteration's payload adds to the empty arm's.

    The entity `step` describes the iteration.
    """
    indexes = by_iteration(len(data.simulated), float(data.seconds[0]))
    for joint in data.order:
        _log_sheet(stream, data, joint, indexes)
    stream.log("step", rr.TextDocument.from_fields(media_type="text/markdown"), static=True)
    for index, chosen in indexes:
        words = rr.TextDocument.columns(text=[_words(data, k) for k in chosen])
        stream.send_columns("step", indexes=[index], columns=words)
    return [
        chart_view(f"torque_{joint + 1}", f"{data.title(joint)} beyond the empty arm")
        for joint in data.order
    ]


def _log_sheet(
    stream: rr.RecordingStream,
    data: PayloadReviewData,
    joint: int,
    indexes: Sequence[tuple[rr.TimeColumn, range]],
) -> None:
    """Log what payloads add to a joint's torque, over the observed torque, which stays."""
    sheet = f"sheets/torque_{joint + 1}"
    empty = data.empty_nm[:, joint]
    observed = data.observed_nm[:, joint] - empty
    simulated = [curve.effort_nm[:, joint] - empty for curve in data.simulated]
    fitted = None if data.fitted is None else data.fitted.effort_nm[:, joint] - empty
    shown = np.concatenate([observed, *simulated, [0.0]])
    reach = max(float(np.ptp(shown)), _MIN_SHEET_NM) * (1 + 2 * _ROOM)
    low = float(shown.min() + shown.max() - reach) / 2
    start_s, width_s = data.seconds[0], data.seconds[-1] - data.seconds[0]
    x = (data.seconds - start_s) / width_s * WIDTH

    def points(values: Array) -> Array:
        return np.column_stack([x, -(values - low) / reach])

    rows = [(-(value - low) / reach, f"{value:g}") for value in ticks(low, low + reach, 3)]
    marks = [
        (float((second - start_s) / width_s * WIDTH), f"{second:g} s")
        for second in ticks(start_s, data.seconds[-1])
    ]
    log_grid(stream, sheet, WIDTH, rows, marks)
    dots = rr.Points2D(points(observed), colors=[OBSERVED], radii=screen_radius(1.2))
    stream.log(f"{sheet}/observed", dots, static=True)
    if data.fitted is not None and fitted is not None:
        line = rr.LineStrips2D(
            [points(fitted)], colors=[data.fitted.color], radii=screen_radius(0.9)
        )
        stream.log(f"{sheet}/fit", line, static=True)
    style = rr.LineStrips2D.from_fields(radii=screen_radius(1.4), draw_order=40.0)
    stream.log(f"{sheet}/simulated", style, static=True)
    for index, chosen in indexes:
        strips = rr.LineStrips2D.columns(
            strips=[points(simulated[k]) for k in chosen],
            colors=[data.simulated[k].color for k in chosen],
        )
        stream.send_columns(f"{sheet}/simulated", indexes=[index], columns=strips)


def _words(data: PayloadReviewData, k: int) -> str:
    """Describe an iteration: its mass, and the RMS residual of its torques."""
    curve = data.simulated[k]
    rms_nm = float(np.sqrt(np.mean((curve.effort_nm - data.observed_nm) ** 2)))
    lines = [
        f"# {curve.name}",
        f"payload mass **{curve.mass_kg:.4f} kg**",
        f"{rms_nm:.3f} N·m rms from the observed torques",
        "Dots: observed torques less the empty arm's. Thick line: what this payload adds to them.",
    ]
    if data.fitted is not None:
        rms_nm = float(np.sqrt(np.mean((data.fitted.effort_nm - data.observed_nm) ** 2)))
        lines.append(
            f"Thin line: the fit, with friction, offsets and all else; {rms_nm:.3f} N·m rms is "
            "left."
        )
    return "\n\n".join(lines)
