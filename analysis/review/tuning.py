"""Reviews in Rerun: of one tuning, and of a plan's shots.

In a tuning's, all that moves is on the log's time, so that one play button moves the balls and the
cursors together. A view shows only what is on the active timeline, so what is drawn for each
iteration is beside a static observed curve, for scrubbing `iteration`.
"""

from __future__ import annotations

import hashlib
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.components import AbsoluteTimeRange

from tunenet_logs.analysis.checks import Verdict
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.planning import Plan, ball_lines, best_lines
from tunenet_logs.analysis.presentation import checks_words, result_words, said_names
from tunenet_logs.analysis.record import Record
from tunenet_logs.analysis.result_files import review_name, subject_of
from tunenet_logs.analysis.review import drawing as draw
from tunenet_logs.episode import Array
from tunenet_logs.files import real_path
from tunenet_logs.recorders.simulators.shot import STEP_S
from tunenet_logs.terminal import one_line, short_name

# ---- Plan: the paths of all shots, the best one marked, the plane, the hoop.
# The best shot's ball flies on the shot's own time; everything else is static.

SHOT_TIME = "shot_time_s"  # the timeline that plays: seconds since the ball was let go
_BEST: draw.Color = (255, 196, 60)
_PASSES: draw.Color = (70, 200, 150)
_OFF_RIM: draw.Color = (225, 110, 90)
_MISSES: draw.Color = (95, 100, 115)


def write_shots(plan: Plan, path: Path) -> None:
    """Write the recording of a plan to `path` (.rrd)."""
    shown = f"{plan.rig} {plan.ball.law}".encode() + plan.heights_m.tobytes()
    identity = subject_of(plan.ball.logs) + hashlib.sha256(shown).hexdigest()[:16]
    with draw.written(path, "shot", identity, "bounce shot") as stream:
        stream.log("shots", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        plane, hoop = plan.rig.plane, plan.rig.hoop
        half_m = 3 * plan.rig.ball.radius_m
        top, bottom = np.outer([-half_m, plane.downhill_m], plane.downhill)
        left, right = np.array([[0.0, -half_m, 0.0], [0.0, half_m, 0.0]])
        board = rr.Mesh3D(
            vertex_positions=[top + left, bottom + left, bottom + right, top + right],
            triangle_indices=[[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]],
            albedo_factor=(120, 104, 84),
        )
        stream.log("shots/plane", board, static=True)
        turns = np.linspace(0, 2 * np.pi, 73)
        ring = hoop.center_m + hoop.ring_radius_m * np.column_stack(
            [np.cos(turns), np.sin(turns), np.zeros_like(turns)]
        )
        rim = rr.LineStrips3D([ring], colors=[(235, 90, 60)], radii=[hoop.rim_m / 2])
        stream.log("shots/hoop", rim, static=True)
        # Log one entity per outcome, so that each can be hidden.
        passing = plan.clearance_m > 0
        kinds = {
            "misses": (~passing & ~plan.flights.has_touched, (*_MISSES, 110)),
            "off_the_rim": (~passing & plan.flights.has_touched, (*_OFF_RIM, 130)),
            "passing": (passing, (*_PASSES, 220)),
        }
        for name, (chosen, color) in kinds.items():
            strips = [_shot_path(plan, index) for index in np.flatnonzero(chosen).tolist()]
            if strips:
                lines = rr.LineStrips3D(strips, colors=[color], radii=draw.screen_radius(0.8))
                stream.log(f"shots/{name}", lines, static=True)
        _log_best(stream, plan)
        _log_misses(stream, plan)
        # The result in words.
        best = plan.best
        head = "# no height scores" if best is None else f"# let go {best.height_m:.3f} m above"
        lines = [head, *(best_lines(plan) if best else ()), *ball_lines(plan)]
        count = np.count_nonzero(passing)
        lines.append(f"{count} of {len(plan.heights_m)} heights pass without touching the rim")
        lines += [f"- {one_line(warning)}" for warning in plan.warnings]
        draw.log_words(stream, "result", "\n\n".join(lines))
        stream.send_blueprint(_shot_blueprint(plan))


def _log_best(stream: rr.RecordingStream, plan: Plan) -> None:
    index = plan.nearest if plan.best is None else plan.best.index
    path = _shot_path(plan, index)
    line = rr.LineStrips3D([path], colors=[_BEST], radii=draw.screen_radius(2.2))
    stream.log("shots/best/path", line, static=True)
    name = "nearest" if plan.best is None else "best"
    above = [path[0] + [0.0, 0.0, 2 * plan.rig.ball.radius_m]]
    words = f"{name}: {plan.heights_m[index]:.3f} m"
    draw.log_labels(stream, "shots/best/label", above, [words], [_BEST])
    ball = rr.Ellipsoids3D.from_fields(
        half_sizes=[[plan.rig.ball.radius_m] * 3], colors=[_BEST], fill_mode="solid"
    )
    seconds = np.arange(len(path), dtype=np.float64) * STEP_S
    centers = rr.Ellipsoids3D.columns(centers=path)
    draw.log_moving(stream, "shots/best/ball", ball, seconds, centers, SHOT_TIME)


def _shot_path(plan: Plan, index: int) -> Array:
    """Return the ball's centres until its shot is over, shape (T, 3) [m]."""
    path = plan.flights.positions_m[:, index]
    moves = np.flatnonzero((path[1:] != path[:-1]).any(axis=1))
    return path[: moves[-1] + 2]


def _log_misses(stream: rr.RecordingStream, plan: Plan) -> None:
    """Log the miss by height: short of the centre below the line, beyond it above."""
    heights, miss = plan.heights_m, plan.offset_m[:, 0]
    low, high = float(heights[0]), float(heights[-1])
    reach = float(np.nanmax(np.append(np.abs(miss[np.isfinite(miss)]), 1e-3)))
    # With misses of more than .3 m in the chart, those at the hoop would be a line.
    reach = min(reach, 0.3)
    across = (heights - low) / (high - low) * draw.WIDTH
    up = -(miss / reach + 1) / 2
    rows = [(-(at / reach + 1) / 2, f"{1000 * at:.0f}") for at in draw.ticks(-reach, reach, 4)]
    marks = [((at - low) / (high - low) * draw.WIDTH, f"{at:g}") for at in draw.ticks(low, high)]
    draw.log_grid(stream, "sheets/miss", draw.WIDTH, rows, marks)
    known = np.flatnonzero(np.abs(miss) <= reach)  # NaN is not
    colors: list[draw.Color] = []
    for index in known:
        if plan.best is not None and index == plan.best.index:
            colors.append(_BEST)
        elif plan.clearance_m[index] > 0:
            colors.append(_PASSES)
        else:
            colors.append(_OFF_RIM if plan.flights.has_touched[index] else _MISSES)
    places = np.column_stack([across, up])[known]
    draw.log_dots(stream, "sheets/miss/shots", places, colors, 2.5, 20.0)
    if not len(known):
        words = "no ball comes down at the height of the hoop"
        draw.log_labels(stream, "sheets/miss/words", [[draw.WIDTH / 2, -0.75]], [words])


def _shot_blueprint(plan: Plan) -> rrb.Blueprint:
    rig = plan.rig
    middle = np.array([rig.hoop.forward_m / 2, 0.0, (rig.release.highest_m + rig.hoop.up_m) / 2])
    size = max(rig.release.highest_m - rig.hoop.up_m, rig.hoop.forward_m) + 0.2
    eye = middle + size * np.array([0.25, -1.05, 0.2])
    title = "shots: yellow the best, green passes, red touches the rim, grey misses"
    scene = draw.scene_view(title, eye, middle, "/shots")
    title = "miss [mm] by release height [m], + is beyond the centre"
    right = rrb.Vertical(
        rrb.TextDocumentView(origin="/result", name="result"),
        draw.chart_view("miss", title),
        row_shares=[3, 2],
    )
    time = rrb.TimePanel(state="collapsed", timeline=SHOT_TIME)
    return draw.blueprint(rrb.Horizontal(scene, right, column_shares=[3, 2]), time)


# ---- Verdict: a banner over a review, one coloured strip with large words.

VERDICT_COLORS: dict[Verdict, draw.Color] = {  # green, amber, red
    "ok": draw.SUCCESS,
    "suspect": (245, 185, 60),
    "rejected": draw.FAILURE,
}
VERDICT_SHARE = 0.075  # of a review's height


def log_verdict(stream: rr.RecordingStream, tuning: Tuning, record: Record) -> rrb.View:
    """Log the strip as static, so that it stays on any timeline, and return its view."""
    import cv2

    # Estimates and failed checks, as many as fit, in letters that OpenCV draws.
    failed = [check for check in record.checks if not check.passed]
    failed.sort(key=lambda check: not check.fatal)
    said = said_names(known.name for known in record.estimates)
    told = [
        f"{said[known.name]} {round(known.value, 3) + 0.0:.3f}"
        + ("" if known.unit == "1" else f" {known.unit}")
        for known in record.estimates
        if not isinstance(known.value, tuple)
    ]
    parts = [", ".join(told)]
    if failed:
        parts.append("failed: " + ", ".join(check.name for check in failed))
    elif record.reason:
        parts.append(record.reason.partition("; at the next")[0])
    words = "   ".join(filter(None, parts)).replace("·", " ").replace("²", "2")
    words = words.encode("ascii", "replace").decode()
    words = words if len(words) <= 120 else words[: 120 - 3] + "..."
    # The strip: its verdict in large letters, then the words.
    color = VERDICT_COLORS[record.verdict]
    width, height = 5000, 90  # between the shapes of the strip on small and large screens
    strip = np.full((height, width, 3), color, np.uint8)
    left, base = height // 3, round(0.76 * height)
    word, font = record.verdict.upper(), cv2.FONT_HERSHEY_DUPLEX
    cv2.putText(strip, word, (left, base), font, 2.6, draw.GROUND, 5, cv2.LINE_AA)
    (wide, _), _ = cv2.getTextSize(word, font, 2.6, 5)
    place = (left + wide + height // 2, base)
    cv2.putText(strip, words, place, font, 1.8, draw.GROUND, 3, cv2.LINE_AA)
    stream.log("verdict", rr.Image(strip).compress(jpeg_quality=95), static=True)
    # Format the log's name, its ball, and when it was recorded.
    name = os.fsencode(tuning.log.name).decode(errors="replace")
    parts = [short_name(name, 60) or "log", *([short_name(record.ball, 60)] if record.ball else [])]
    signals = tuning.episode.signals.values() if tuning.episode else ()
    starts_ns = [int(one.stamps_ns[0]) for one in signals if len(one.stamps_ns)]
    found = tuning.detection or tuning.refused
    film_ns = getattr(found, "start_ns", None)  # of what was filmed alone
    starts_ns += [] if film_ns is None else [film_ns]
    if starts_ns and min(starts_ns) > 10**17:  # from 1973 on: smaller stamps count from a start
        began = datetime.fromtimestamp(min(starts_ns) // 10**9, UTC)
        parts.append(f"recorded {began:%Y-%m-%d %H:%M} UTC")
    return rrb.Spatial2DView(
        origin="/verdict",
        name=f"{', '.join(parts)}: {record.verdict}",
        background=color,
        visual_bounds=rrb.VisualBounds2D(x_range=(0, width), y_range=(0, height)),
    )


# ---- Tuning: its recording and blueprint.


def write_review(tuning: Tuning, record: Record, path: Path) -> None:
    """Write the review of a tuning to `path` (.rrd)."""
    identity = os.fsencode(real_path(tuning.log)) + f" {tuning.preset} {tuning.digest}".encode()
    name = hashlib.sha256(identity).hexdigest()[:16]
    if record.provenance is not None and record.provenance.log_sha256:
        name = review_name(record.provenance.log_sha256)
    text = result_words(
        record, tuning.preset, tuning.experiment.occasion if tuning.experiment else None
    )
    title = os.fsencode(tuning.log.name).decode(errors="replace")
    with draw.written(path, tuning.task or "log", name, title) as stream:
        layout = tuning.experiment.review(stream, tuning) if tuning.experiment else None
        if tuning.detection is None or layout is None:
            # Log recorded signals by unit where the task found nothing; count curves left out.
            signals = tuning.episode.signals if tuning.episode else {}
            if layout is not None:  # marks of events are the same at each of them
                signals = {name: one for name, one in signals.items() if np.ptp(one.values)}
            curves = [(one, index) for one in signals.values() for index in range(len(one.columns))]
            by_unit: dict[str, list[str]] = {}
            most = 150  # more can neither be told apart nor be loaded soon
            for signal, index in curves[:most]:
                column = signal.columns[index]
                entity = draw.entity_of("recorded", signal.name, column)
                label = one_line(f"{signal.name} {column}")
                style = rr.SeriesLines(names=[label])
                columns = rr.Scalars.columns(scalars=signal.values[:, index])
                draw.log_moving(stream, entity, style, signal.seconds, columns)
                by_unit.setdefault(signal.unit, []).append(entity)
            last_s = max((float(one.seconds[-1]) for one in signals.values()), default=0.0)
            shown = list(by_unit.items())[:4]  # one for each unit: more would be too low to read
            # 24 names of all legends together fit beside the views on a laptop's screen.
            names = 24 // max(len(shown), 1)
            views = [_recorded_view(unit, some, last_s, names) for unit, some in shown]
            if len(curves) > most:
                text += f"\n\n- {len(curves) - most} more curves are not drawn"
            if layout is None and draw.log_recorded_film(stream, tuning):
                views = [rrb.Spatial2DView(origin="/film", name="recorded pictures")]
            # The evidence over all that was recorded, beside the result.
            result: rrb.View | rrb.Container = draw.result_view(has_checks=bool(record.checks))
            example = tuning.experiment.example(stream) if tuning.experiment else None
            if example is not None:
                result = rrb.Vertical(result, example, row_shares=[3, 2])
            parts: list[rrb.View | rrb.Container] = [] if layout is None else [layout]
            parts += [rrb.Vertical(*views)] if views else []
            layout = rrb.Horizontal(result)
            if parts:
                layout = rrb.Horizontal(rrb.Vertical(*parts), result, column_shares=[3, 2])
        stream.send_property("tuning", _properties(record))
        strip = log_verdict(stream, tuning, record)
        layout = rrb.Vertical(strip, layout, row_shares=[VERDICT_SHARE, 1 - VERDICT_SHARE])
        has_film = tuning.refused is not None and tuning.detection is None
        stream.send_blueprint(draw.blueprint(layout, _time_panel(record, has_film=has_film)))
        draw.log_words(stream, "result", text)
        if record.checks:
            draw.log_words(stream, "checks", checks_words(record))


def _properties(record: Record) -> rr.AnyValues:
    """Return what a server of recordings filters by: verdict, task, values with their ends."""
    told: dict[str, Any] = {"verdict": record.verdict, "task": record.task or "", "log": record.log}
    if record.ball:
        told["ball"] = record.ball
    if record.provenance is not None:
        told |= {"date": record.provenance.date, "engine": record.provenance.engine}
    for known in record.estimates:
        for one in known.components:
            told[one.name] = one.value
            if one.interval95 is not None:
                told[f"{one.name}_low"], told[f"{one.name}_high"] = one.interval95
    return rr.AnyValues(**{name: one for name, one in told.items() if one not in ("", None)})


def _time_panel(record: Record, *, has_film: bool) -> rrb.TimePanel:
    """Loop a motion from the release to the last bounce, or a video without a drop as a whole.

    A blueprint cannot set the cursor's start. One that plays shows the ball in its flight soon
    after opening; a paused one would show it at rest, where the recording ends.
    """
    curves = record.motion.curves
    play: dict[str, Any] = {}
    if curves is not None:
        first_ns, last_ns = (round(1e9 * float(at_s)) for at_s in curves.seconds[[0, -1]])
        play = {"loop_mode": "selection", "time_selection": AbsoluteTimeRange(first_ns, last_ns)}
        # At the true speed a short bounce would be over before it is looked at.
        play |= {"play_state": "playing", "playback_speed": 0.5}
    elif has_film:
        play = {"play_state": "playing", "loop_mode": "all"}
    return rrb.TimePanel(state="collapsed", timeline=draw.LOG_TIME, **play)


def _recorded_view(unit: str, entities: list[str], last_s: float, most_names: int) -> rrb.View:
    """Return the view of one unit's curves, with a legend beside them if it fits."""
    measured = {
        "m": "positions",
        "rad": "joint positions",
        "rad/s": "joint velocities",
        "N·m": "joint torques",
    }
    has_legend = len(entities) <= most_names
    # With a legend beside its curves an axis is longer.
    begin, end = 0.0, max(last_s, 1e-3) * (1.6 if has_legend else 1.0)
    seconds = rr.TimeRange(
        start=rrb.TimeRangeBoundary.absolute(seconds=begin),
        end=rrb.TimeRangeBoundary.absolute(seconds=end),
    )
    return rrb.TimeSeriesView(
        origin="/recorded",
        contents=[f"+ {one}" for one in entities],
        name=one_line(f"recorded {measured.get(unit, 'values')}" + f" [{unit}]" * bool(unit)),
        axis_x=rrb.TimeAxis(view_range=seconds),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop, visible=has_legend),
    )
