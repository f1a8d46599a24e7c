"""Review of a drop: heights and residuals, the ball in 3D, the iterations, and their layout.

The video and the bounces, which not every tuning has, are in `film` and `bounces`.
"""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.drop.checks import MAX_EXCESS_PERCENT
from analysis.drop.detection import AnyDetection
from analysis.drop.review.bounces import bounce_view, log_bounces
from analysis.drop.review.film import log_film
from analysis.drop.review.review_data import ReviewData, review_data
from analysis.drop.review.sound import log_beside, sound_of, time_axis
from analysis.record import Tuning
from analysis.review.drawing import (
    GROUND,
    IMPACT,
    ITERATION,
    LOG_TIME,
    OBSERVED,
    Color,
    Iterates,
    at_seconds,
    by_iteration,
    chart_view,
    iterates_view,
    log_grid,
    log_iterates,
    plainly,
    screen_radius,
    send_scalars,
    ticked,
    ticks,
)
from analysis.terminal_table import markdown_table, quantity

_MANY = 200  # samples above which dots would hide the lines
_MM = 1000.0  # millimetres in a metre: an axis does not show numbers as small as residuals in m
# Quantile of the result's residuals that their axis must show, and room around it, as a factor.
_TYPICAL, _HEADROOM = 0.98, 1.3

_LIMIT: Color = (190, 70, 70)
_TABLE: Color = (70, 70, 78)

_BALL = 0.045  # a drawn ball's radius in drop heights: larger than life, to be seen
_PITCH = 4.5  # from ball to ball, in radii: room for their labels
# Of the chart of heights, in its heights: it fills a larger and squarer view than others.
_HEIGHTS_WIDTH = 1.7


def log_drop(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container:
    """Send all that is drawn of a drop; return the layout that shows it.

    Two tabs, to play and to scrub; with the video first where there is one.
    """
    data = review_data(tuning)
    iterates = Iterates(
        parameter="restitution",
        unit="1",
        names=tuple(curve.name for curve in data.simulated),
        values=tuple(next(iter(curve.values.values())) for curve in data.simulated),
        colors=tuple(curve.color for curve in data.simulated),
        span=(0.0, 1.0),
        interval95=data.interval95,
    )
    height_view, residual_view = _log_plots(stream, data)
    sound_view = _log_sound(stream, tuning, data)
    sounds = [] if sound_view is None else [sound_view]
    curves = rrb.Vertical(
        *(_log_scene(stream, data), height_view, *sounds, residual_view),
        row_shares=[4, 4, *[3.0] * len(sounds), 3],
    )
    height_chart = _log_height_chart(stream, data)
    log_iterates(stream, iterates, float(data.observed.seconds[0]))
    if data.bounces:
        log_bounces(stream, data)
    charts = [iterates_view(iterates), *([bounce_view(data)] if data.bounces else [])]
    result = rrb.TextDocumentView(origin="/result", name="result")
    name = f"overlay (timeline {LOG_TIME})"
    if tuning.detection.film is None:
        overlay = rrb.Horizontal(curves, result, column_shares=[3, 2], name=name)
    else:
        video, aspect = log_film(stream, tuning, data)
        share = min(max(3 * aspect, 1.2), 3.5)
        overlay = rrb.Horizontal(video, curves, result, column_shares=[share, 3, 3], name=name)
    step = rrb.TextDocumentView(origin="/step", name="iteration")
    scrub = rrb.Horizontal(
        height_chart,
        rrb.Vertical(step, *charts, row_shares=[3.6, *[2.8] * len(charts)]),
        column_shares=[5, 4],
        name=f"scrub (timeline {ITERATION})",
    )
    return rrb.Tabs(overlay, scrub, active_tab=0)


def _log_plots(stream: rr.RecordingStream, data: ReviewData) -> tuple[rrb.View, rrb.View]:
    """Send observed dots, the lines of all iterations and the residuals, over the log's time.

    The title is the legend: one in the plot would hide curves on a small screen.
    """
    for k, (curve, residual) in enumerate(zip(data.simulated, data.residuals, strict=True)):
        style = rr.SeriesLines(
            colors=[curve.color],
            names=[curve.label],
            widths=[curve.width],
            aggregation_policy="Off",
        )
        stream.log(f"height/k{k}", style, static=True)
        send_scalars(stream, f"height/k{k}", curve.seconds, curve.heights_m)
        stream.log(f"residual/k{k}", style, static=True)
        send_scalars(stream, f"residual/k{k}", residual.seconds, _MM * residual.heights_m)
    size = 1.0 if len(data.observed.seconds) > _MANY else 2.0
    points = rr.SeriesPoints(colors=[OBSERVED], names=["observed"], marker_sizes=[size])
    stream.log("height/observed", points, static=True)
    send_scalars(stream, "height/observed", data.observed.seconds, data.observed.heights_m)
    mark = rr.SeriesPoints(
        colors=[IMPACT], names=["impacts"], markers=["diamond"], marker_sizes=[6.0]
    )
    stream.log("height/impact", mark, static=True)
    send_scalars(stream, "height/impact", data.impacts_s, np.zeros(len(data.impacts_s)))
    height_m = data.drop_height_m
    shown = time_axis(*data.shown_s)
    height_view = rrb.TimeSeriesView(
        origin="/height",
        name="height [m]: observed white, iterations cold to warm",
        axis_x=shown,
        axis_y=rrb.ScalarAxis(range=ticked(0.0, 1.05 * height_m)),
        plot_legend=rrb.PlotLegend(visible=False),
    )
    limit_mm = _MM * MAX_EXCESS_PERCENT / 100 * height_m
    _log_limit(stream, data, limit_mm)
    reach_mm = _reach_mm(data, limit_mm)
    residual_view = rrb.TimeSeriesView(
        origin="/residual",
        name=f"simulated - observed [mm], red: ±{plainly(limit_mm)} is {MAX_EXCESS_PERCENT:g} %",
        axis_x=shown,
        axis_y=rrb.ScalarAxis(range=ticked(-reach_mm, reach_mm)),
        plot_legend=rrb.PlotLegend(visible=False),
    )
    return height_view, residual_view


def _log_sound(stream: rr.RecordingStream, tuning: Tuning, data: ReviewData) -> rrb.View | None:
    """Send the sound beside the ball; None where there is none, or it is silent."""
    sound = sound_of(tuning.episode)
    if sound is None:
        return None
    detection: AnyDetection = tuning.detection
    place = detection.start_ns, data.shown_s, float(data.observed.seconds[-1])
    ear = detection.ear
    if ear is None or ear.touches is None or ear.offset_s is None:
        return log_beside(stream, sound, *place, reason="" if ear is None else ear.reason)
    impacts_s = ear.touches.times_s - ear.offset_s
    return log_beside(stream, sound, *place, impacts_s, ear.offset_s)


def _log_limit(stream: rr.RecordingStream, data: ReviewData, limit_mm: float) -> None:
    """Send two lines, between which a difference cannot be seen with the eye."""
    ends_s = data.observed.seconds[[0, -1]]
    style = rr.SeriesLines(
        colors=[_LIMIT] * 2, names=["limit", "limit"], widths=[1.0] * 2, aggregation_policy="Off"
    )
    stream.log("residual/limit", style, static=True)
    send_scalars(stream, "residual/limit", ends_s, np.array([[limit_mm, -limit_mm]] * 2))


def _reach_mm(data: ReviewData, limit_mm: float) -> float:
    """Return how far the limit and the result's residuals go: earlier iterates run off."""
    last = data.residuals[-1]
    inside = (last.seconds >= data.release_s) & (last.seconds <= data.seen_s)
    off_mm = _MM * np.abs(last.heights_m[inside])
    usual_mm = float(np.quantile(off_mm, _TYPICAL)) if len(off_mm) else 0.0
    return _HEADROOM * max(usual_mm, limit_mm)


def _log_scene(stream: rr.RecordingStream, data: ReviewData) -> rrb.View:
    """Send the observed ball and those of all iterations, falling side by side in 3D."""
    curves = [data.observed, *data.simulated]
    height_m, radius = data.drop_height_m, _BALL * data.drop_height_m
    across = (np.arange(len(curves)) - (len(curves) - 1) / 2) * _PITCH * radius
    across[[0, -1]] += (
        np.array([-0.4, 0.4]) * _PITCH * radius
    )  # what was seen and the result stand apart
    half, thick = 2.5 * radius - across[0], 0.2 * radius
    stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    table = rr.Boxes3D(
        centers=[[0, 0, -thick]],
        half_sizes=[[half, 3 * radius, thick]],
        colors=[_TABLE],
        fill_mode="solid",
    )
    stream.log("scene/table", table, static=True)
    # Numbers alone: longer names would overlap on a small screen.
    labels = rr.Points3D(
        [[x, -3.2 * radius, 0] for x in across],
        labels=[
            "seen",
            *(curve.name.removeprefix("k=") for curve in data.simulated[:-1]),
            "result",
        ],
        colors=[curve.color for curve in curves],
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log("scene/labels", labels, static=True)
    for x, curve in zip(across, curves, strict=True):
        entity = f"scene/{curve.name.replace('=', '')}"
        ball = rr.Ellipsoids3D.from_fields(
            half_sizes=[[radius] * 3], colors=[curve.color], fill_mode="solid"
        )
        stream.log(entity, ball, static=True)
        # All at the observed times, or the balls would take their steps one after the other.
        heights = np.interp(data.observed.seconds, curve.seconds, curve.heights_m)
        centers = np.column_stack([np.full_like(heights, x), 0 * heights, heights + radius])
        columns = rr.Ellipsoids3D.columns(centers=centers)
        stream.send_columns(entity, indexes=[at_seconds(data.observed.seconds)], columns=columns)
    return rrb.Spatial3DView(
        origin="/scene",
        name="the ball as seen, and of each iteration",
        background=GROUND,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(  # from where the whole drop fills the view
            position=(0.0, -1.42 * height_m, 0.62 * height_m),
            look_target=(0.0, 0.0, 0.42 * height_m),
            eye_up=(0.0, 0.0, 1.0),
        ),
    )


def _log_height_chart(stream: rr.RecordingStream, data: ReviewData) -> rrb.View:
    """Send the observed curve, the iteration's over it, and the iteration in words at `step`."""
    start_s = data.release_s - 0.05 * (data.end_s - data.release_s)
    width_s, height_m = data.end_s - start_s, data.drop_height_m
    rows = [(-height / height_m, f"{height:g} m") for height in ticks(0.0, height_m)]
    marks = [
        ((second - start_s) / width_s * _HEIGHTS_WIDTH, f"{second:g} s")
        for second in ticks(start_s, data.end_s)
    ]
    log_grid(stream, "sheets/heights", _HEIGHTS_WIDTH, rows, marks, hang=0.035)
    drawn = []
    for curve in (data.observed, *data.simulated):
        inside = (curve.seconds >= start_s) & (curve.seconds <= data.end_s)
        x = (curve.seconds[inside] - start_s) / width_s * _HEIGHTS_WIDTH
        drawn.append(np.column_stack([x, -curve.heights_m[inside] / height_m]))
    observed, *simulated = drawn
    dots = rr.Points2D(observed, colors=[OBSERVED], radii=screen_radius(1.8))
    stream.log("sheets/heights/observed", dots, static=True)
    style = rr.LineStrips2D.from_fields(radii=screen_radius(0.8), draw_order=40.0)  # over dots
    stream.log("sheets/heights/simulated", style, static=True)
    stream.log("step", rr.TextDocument.from_fields(media_type="text/markdown"), static=True)
    words = [_step_words(k, data) for k in range(len(data.residuals))]
    for index, shown in by_iteration(len(simulated), float(data.observed.seconds[0])):
        strips = rr.LineStrips2D.columns(
            strips=[simulated[k] for k in shown], colors=[data.simulated[k].color for k in shown]
        )
        stream.send_columns("sheets/heights/simulated", indexes=[index], columns=strips)
        columns = rr.TextDocument.columns(text=[words[k] for k in shown])
        stream.send_columns("step", indexes=[index], columns=columns)
    title = "height above the table: observed (dots), simulated (line)"
    return chart_view("heights", title, _HEIGHTS_WIDTH)


def _step_words(k: int, data: ReviewData) -> str:
    """Describe an iteration: its vector, and how far its curve is from the observed one."""
    curve = data.residuals[k]
    inside = (curve.seconds >= data.release_s) & (curve.seconds <= data.seen_s)
    rms_mm = _MM * float(np.sqrt(np.mean(curve.heights_m[inside] ** 2)))
    units = {"drag": "1/m"}
    rows = [
        (quantity(name.replace("_", " "), units.get(name, "1")), f"**{value:.4f}**")
        for name, value in curve.values.items()
    ]
    return "\n\n".join(
        [
            f"# {curve.name}",
            markdown_table(("parameter", "value"), rows),
            f"{rms_mm:.2f} mm rms from the observed curve, from the release to the last bounce",
        ]
    )
