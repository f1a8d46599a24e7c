"""Plan in Rerun: the paths of all shots, the best one marked, the plane, the hoop.

The best shot's ball flies on the shot's own time; everything else is static.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.planning.plan import Plan
from analysis.planning.plan_report import ball_lines, best_lines
from analysis.result_files import subject_of
from analysis.review.drawing import (
    GROUND,
    MUTED,
    WIDTH,
    Color,
    application_id,
    chart_view,
    log_grid,
    screen_radius,
    ticks,
)
from recorders.simulators.shot.flight import STEP_S
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import one_line

SHOT_TIME = "shot_time_s"  # the timeline that plays: seconds since the ball was let go
_BEST: Color = (255, 196, 60)
_PASSES: Color = (70, 200, 150)
_OFF_RIM: Color = (225, 110, 90)
_MISSES: Color = (95, 100, 115)
_BOARD: Color = (120, 104, 84)
_HOOP: Color = (235, 90, 60)

# Of a miss, either way: with larger ones in the chart, those at the hoop would be a line.
_MAX_CHART_M = 0.3


def write_shots(plan: Plan, path: Path) -> None:
    """Write the recording of a plan to `path` (.rrd).

    Raises:
        OSError: `path` cannot be written.
    """
    shown = f"{plan.rig} {plan.ball.law}".encode() + plan.heights_m.tobytes()
    identity = subject_of(plan.ball.logs) + hashlib.sha256(shown).hexdigest()[:16]
    stream = rr.RecordingStream(application_id("shot"), recording_id=identity)
    memory = stream.memory_recording()
    stream.send_recording_name("bounce shot")
    stream.log("shots", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _log_rig(stream, plan)
    _log_paths(stream, plan)
    _log_best(stream, plan)
    _log_misses(stream, plan)
    words = rr.TextDocument(_words(plan), media_type="text/markdown")
    stream.log("result", words, static=True)
    stream.send_blueprint(_blueprint(plan))
    stream.flush()
    path.write_bytes(memory.drain_as_bytes())
    stream.disconnect()


def _log_rig(stream: rr.RecordingStream, plan: Plan) -> None:
    plane, hoop = plan.rig.plane, plan.rig.hoop
    half_m = 3 * plan.rig.ball.radius_m
    along = np.outer([-half_m, plane.downhill_m], plane.downhill)
    across = np.array([[0.0, -half_m, 0.0], [0.0, half_m, 0.0]])
    corners = [along[0] + across[0], along[1] + across[0], along[1] + across[1]]
    corners.append(along[0] + across[1])
    board = rr.Mesh3D(
        vertex_positions=corners,
        triangle_indices=[[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]],
        albedo_factor=_BOARD,
    )
    stream.log("shots/plane", board, static=True)
    turns = np.linspace(0, 2 * np.pi, 73)
    ring = hoop.center_m + hoop.ring_radius_m * np.column_stack(
        [np.cos(turns), np.sin(turns), np.zeros_like(turns)]
    )
    rim = rr.LineStrips3D([ring], colors=[_HOOP], radii=[hoop.rim_m / 2])
    stream.log("shots/hoop", rim, static=True)


def _log_paths(stream: rr.RecordingStream, plan: Plan) -> None:
    """Log one entity per outcome, so that each can be hidden."""
    passing = plan.clearance_m > 0
    kinds = {
        "misses": (~passing & ~plan.flights.has_touched, (*_MISSES, 110)),
        "off_the_rim": (~passing & plan.flights.has_touched, (*_OFF_RIM, 130)),
        "passing": (passing, (*_PASSES, 220)),
    }
    for name, (chosen, color) in kinds.items():
        strips = [_path(plan, index) for index in np.flatnonzero(chosen).tolist()]
        if strips:
            lines = rr.LineStrips3D(strips, colors=[color], radii=screen_radius(0.8))
            stream.log(f"shots/{name}", lines, static=True)


def _log_best(stream: rr.RecordingStream, plan: Plan) -> None:
    index = plan.nearest if plan.best is None else plan.best.index
    path = _path(plan, index)
    line = rr.LineStrips3D([path], colors=[_BEST], radii=screen_radius(2.2))
    stream.log("shots/best/path", line, static=True)
    name = "nearest" if plan.best is None else "best"
    start = rr.Points3D(
        [path[0] + [0.0, 0.0, 2 * plan.rig.ball.radius_m]],
        labels=[f"{name}: {plan.heights_m[index]:.3f} m"],
        colors=[_BEST],
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log("shots/best/label", start, static=True)
    ball = rr.Ellipsoids3D.from_fields(
        half_sizes=[[plan.rig.ball.radius_m] * 3], colors=[_BEST], fill_mode="solid"
    )
    stream.log("shots/best/ball", ball, static=True)
    seconds = rr.TimeColumn(SHOT_TIME, duration=np.arange(len(path)) * STEP_S)
    centers = rr.Ellipsoids3D.columns(centers=path)
    stream.send_columns("shots/best/ball", indexes=[seconds], columns=centers)


def _path(plan: Plan, index: int) -> Array:
    """Return the ball's centres until its shot is over, shape (T, 3) [m]."""
    path = plan.flights.positions_m[:, index]
    moves = np.flatnonzero((path[1:] != path[:-1]).any(axis=1))
    return path[: moves[-1] + 2]


def _log_misses(stream: rr.RecordingStream, plan: Plan) -> None:
    """Log the miss by height: short of the centre below the line, beyond it above."""
    heights, miss = plan.heights_m, plan.offset_m[:, 0]
    low, high = float(heights[0]), float(heights[-1])
    reach = float(np.nanmax(np.append(np.abs(miss[np.isfinite(miss)]), 1e-3)))
    reach = min(reach, _MAX_CHART_M)
    across = (heights - low) / (high - low) * WIDTH
    up = -(miss / reach + 1) / 2
    rows = [(-(at / reach + 1) / 2, f"{1000 * at:.0f}") for at in ticks(-reach, reach, 4)]
    marks = [((at - low) / (high - low) * WIDTH, f"{at:g}") for at in ticks(low, high)]
    log_grid(stream, "sheets/miss", WIDTH, rows, marks)
    colors = [_color(plan, index) for index in range(len(heights))]
    known = np.flatnonzero(np.abs(miss) <= reach)  # NaN is not
    dots = rr.Points2D(
        np.column_stack([across, up])[known],
        colors=[colors[index] for index in known],
        radii=screen_radius(2.5),
        draw_order=20.0,
    )
    stream.log("sheets/miss/shots", dots, static=True)
    if not len(known):
        said = rr.Points2D(
            [[WIDTH / 2, -0.75]],
            labels=["no ball comes down at the height of the hoop"],
            colors=[MUTED],
            radii=screen_radius(0.1),
            show_labels=True,
        )
        stream.log("sheets/miss/words", said, static=True)


def _color(plan: Plan, index: int) -> Color:
    if plan.best is not None and index == plan.best.index:
        return _BEST
    if plan.clearance_m[index] > 0:
        return _PASSES
    return _OFF_RIM if plan.flights.has_touched[index] else _MISSES


def _words(plan: Plan) -> str:
    best = plan.best
    head = "# no height scores" if best is None else f"# let go {best.height_m:.3f} m above"
    passing = int(np.count_nonzero(plan.clearance_m > 0))
    lines = [head, *(best_lines(plan) if best else ()), *ball_lines(plan)]
    lines.append(f"{passing} of {len(plan.heights_m)} heights pass without touching the rim")
    lines += [f"- {one_line(warning)}" for warning in plan.warnings]
    lines.append("yellow: the best; green: passes; red: touches the rim; grey: misses")
    return "\n\n".join(lines)


def _blueprint(plan: Plan) -> rrb.Blueprint:
    rig = plan.rig
    middle = np.array([rig.hoop.forward_m / 2, 0.0, (rig.release.highest_m + rig.hoop.up_m) / 2])
    size = max(rig.release.highest_m - rig.hoop.up_m, rig.hoop.forward_m) + 0.2
    eye = middle + size * np.array([0.25, -1.05, 0.2])
    scene = rrb.Spatial3DView(
        origin="/shots",
        name="shots",
        background=GROUND,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            position=eye.tolist(), look_target=middle.tolist(), eye_up=(0.0, 0.0, 1.0)
        ),
    )
    title = "miss [mm] by release height [m]: + beyond the hoop's centre, - short of it"
    right = rrb.Vertical(
        rrb.TextDocumentView(origin="/result", name="result"),
        chart_view("miss", title),
        row_shares=[3, 2],
    )
    return rrb.Blueprint(
        rrb.Horizontal(scene, right, column_shares=[3, 2]),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=SHOT_TIME),
        auto_views=False,
        auto_layout=False,
    )
