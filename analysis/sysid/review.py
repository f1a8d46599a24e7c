"""Review of a simulator: its motion beside the log, residuals, and hold-out prediction.

The log's timeline shows the observation and all iterations, in 3D for a MuJoCo model; the
iterations' timeline, one of them with its values. A fit to the first part of the log predicts the
rest.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.presentation import markdown_table, quantity, said_names
from tunenet_logs.analysis.review.drawing import (
    FITTED,
    GROUND,
    ITERATION,
    KEY_SHARES,
    LOG_TIME,
    MUTED,
    OBSERVED,
    WIDTH,
    Color,
    Iterates,
    at_seconds,
    by_iteration,
    chart_view,
    eye_controls,
    iterates_view,
    log_grid,
    log_iterates,
    log_key,
    ramp,
    screen_radius,
    send_scalars,
    span_of,
    ticked,
    ticks,
)
from tunenet_logs.analysis.sysid.fit import Column, HeldOut, SimulatorFit
from tunenet_logs.analysis.sysid.source import SimulatorDetection
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.base import Parameter
from tunenet_logs.recorders.simulators.model.rollout import (
    ModelScene,
    ModelSimulator,
    SensedSignal,
    Shape,
    free_joint,
    seen_in_world,
)
from tunenet_logs.recorders.simulators.mujoco import mujoco
from tunenet_logs.terminal import one_line, short_name

# ---- Curves over the log's time: observed under simulated ones, and vertical lines

_BROAD = 3.2  # width of what was observed [points]: it is seen beside a line that lies upon it
# What an upright line lasts: a plot has no such thing as an instant with two values.
_INSTANT_S = 1e-6


def log_lines(
    stream: rr.RecordingStream,
    entity: str,
    seconds: Array,
    values: Array,
    style: Sequence[tuple[str, Color, float]],
) -> None:
    """Log several curves as one entity.

    Args:
        stream: Of the review.
        entity: Of the curves.
        seconds: Shape (T,).
        values: Shape (T, C).
        style: Name, colour and width [points] of each.
    """
    names, colors, widths = zip(*style, strict=True)
    lines = rr.SeriesLines(colors=colors, names=names, widths=widths, aggregation_policy="Off")
    stream.log(entity, lines, static=True)
    send_scalars(stream, entity, seconds, values)


def log_observed(stream: rr.RecordingStream, entity: str, seconds: Array, values: Array) -> None:
    """Log observations as a broad line, lowest as plots draw entities by name."""
    style: list[tuple[str, Color, float]] = [("observed", OBSERVED, _BROAD)]
    log_lines(stream, f"{entity}/as_observed", seconds, values[:, None], style)


def log_upright(
    stream: rr.RecordingStream, entity: str, second: float, span: tuple[float, float]
) -> None:
    """Log a vertical line across a plot that shows `span`."""
    values = np.array(ticked(*span))[:, None]
    log_lines(stream, entity, second + np.array([0.0, _INSTANT_S]), values, [("", MUTED, 1.0)])


def plot(entity: str, title: str, span: tuple[float, float]) -> rrb.View:
    """Build a plot of an entity's curves whose axis shows `span` and has ticks."""
    return rrb.TimeSeriesView(
        origin=f"/{entity}",
        name=title,
        axis_y=rrb.ScalarAxis(range=ticked(*span)),
        plot_legend=rrb.PlotLegend(visible=False),
    )


# ---- Data that the review draws: columns over the log's time

MAIN = 4  # columns of the first tab: as many have axes with ticks; the others have a tab
_MAX_COLUMNS = 16  # that are drawn, those that vary most: more would be too small to read
# Of one curve: more can neither be told apart nor be loaded soon.
_MAX_CURVE_HZ, _MAX_SAMPLES = 120.0, 3000

_MAX_LINES = 8  # iterations over the log's time; all of them can be scrubbed
_MAX_NAME = 34  # of a column, in letters: a title's room in a laptop's view
_BOLD, _FINE = 1.6, 0.8  # widths of the result's curve and of earlier iterations' [points]
_MIN_NOISE = 1e-9  # of a column, as a share of its spread


@dataclass(frozen=True, eq=False)
class Iterate:
    """One iteration, and how it is drawn.

    Attributes:
        name: "k=3", "refined".
        color: Of its line.
        width: Of its line [points].
        values: Of the tuned parameters, shape (P,).
        started: All parameters by name as simulated, those of the initial state, too.
    """

    name: str
    color: Color
    width: float
    values: Array
    started: dict[str, float]


@dataclass(frozen=True, eq=False)
class ShownColumn:
    """One column of the log with those of all iterations.

    Attributes:
        name: Short, without unit.
        unit: Of its values.
        noise: Standard deviation.
        seconds: Since the log's first sample, shape (T,).
        observed: Shape (T,).
        simulated: Of each iteration, shape (T, K); NaN where it shows nothing.
        fitted: Of a fit to the first part of the log, shape (T,); None if there is none.
        given: Of the simulator as given, likewise.
        rms: Residual of each iteration, shape (K,).
        held_out_rms: Hold-out residual of the fit to the first part, and of the simulator as
            given; None if there is none.
    """

    name: str
    unit: str
    noise: float
    seconds: Array
    observed: Array
    simulated: Array
    fitted: Array | None
    given: Array | None
    rms: Array
    held_out_rms: tuple[float, float] | None

    def title(self, what: str = "") -> str:
        """Format the name with its unit: "position elbow [rad]"."""
        unit = "" if self.unit in ("", "1") else f"[{short_name(self.unit, 12)}]"
        return " ".join(filter(None, (self.name, what, unit)))

    def shown(self, *curves: Array) -> tuple[float, float]:
        """Return the range of the observation and of these curves."""
        values = np.concatenate([self.observed, *(curve[np.isfinite(curve)] for curve in curves)])
        low, high = float(values.min()), float(values.max())
        least = max(6 * self.noise, 1e-6 * max(abs(low), abs(high)), 1e-9)
        more = max(0.0, least - (high - low)) / 2
        return low - more, high + more


@dataclass(frozen=True, eq=False)
class SimulatorReviewData:
    """Data of one tuning's review, but for the scene.

    Attributes:
        columns: Those that vary most, relative to their noise, first.
        left_out: How many more there are.
        iterates: The last is the result.
        drawn: Indices of the iterates that are drawn over the log's time.
        parameters: That were tuned, P of them.
        interval95: Of the result, shape (P, 2); None if no valid one exists.
        held_out_s: Start of the hold-out; None if there is none.
        first_s: First stamp [s since the log's first sample].
    """

    columns: tuple[ShownColumn, ...]
    left_out: int
    iterates: tuple[Iterate, ...]
    drawn: tuple[int, ...]
    parameters: tuple[Parameter, ...]
    interval95: Array | None
    held_out_s: float | None
    first_s: float

    @property
    def main(self) -> tuple[ShownColumn, ...]:
        """Columns of the first tab."""
        return self.columns[:MAIN]

    @property
    def others(self) -> tuple[ShownColumn, ...]:
        """Remaining columns."""
        return self.columns[MAIN:]


def simulator_review_data(tuning: Tuning) -> SimulatorReviewData:
    """Collect the data from a tuning that compared a log with a simulator."""
    found: SimulatorDetection = tuning.detection
    target = found.connected.target
    assert tuning.trace is not None
    fit: SimulatorFit | None = tuning.trace.fit.detail if tuning.trace.fit else None
    held = fit.held_out if fit else None
    seen = np.column_stack([np.full(len(target.values), np.nan)] * len(tuning.trace.steps))
    iterates: list[Iterate] = []
    count = len(tuning.trace.steps)
    for k, step in enumerate(tuning.trace.steps):
        assert step.evaluation is not None
        is_last = k == count - 1
        seen[:, k] = target.seen_in(step.evaluation.episode)
        iterates.append(
            Iterate(
                "refined" if is_last and fit is not None else f"k={k}",
                ramp(k, count) if count > 1 else ramp(1, 2),
                _BOLD if is_last else _FINE,
                np.asarray(step.values, dtype=np.float64),
                dict(step.evaluation.episode.info.truth),
            )
        )
    varying = [
        -one.spread / max(one.noise, _MIN_NOISE * one.spread, 1e-300) for one in target.columns
    ]
    order = np.argsort(varying, kind="stable")[:_MAX_COLUMNS]
    names = _names(target.columns)
    columns = [_shown(number, names[number], found, seen, fit, held) for number in order.tolist()]
    lines = np.unique(np.linspace(0, count - 1, min(count, _MAX_LINES)).round().astype(int))
    interval = tuning.interval95
    return SimulatorReviewData(
        tuple(columns),
        len(target.columns) - len(columns),
        tuple(iterates),
        tuple(lines.tolist()),
        tuple(tuning.parameters),
        None if interval is None else np.asarray(interval),
        None if held is None else held.from_s + found.offset_s,
        found.offset_s + float(target.seconds.min()),
    )


def _shown(
    number: int,
    name: str,
    found: SimulatorDetection,
    seen: Array,
    fit: SimulatorFit | None,
    held: HeldOut | None,
) -> ShownColumn:
    target = found.connected.target
    column = target.columns[number]
    every = _every(column.seconds)
    kept = np.flatnonzero(target.which == number)[::every]
    off = seen[target.which == number] - column.values[:, None]
    counts = np.maximum(np.isfinite(off).sum(axis=0), 1)
    return ShownColumn(
        name,
        column.unit,
        column.noise,
        column.seconds[::every] + found.offset_s,
        column.values[::every],
        seen[kept],
        None if held is None else held.simulated[kept],
        None if held is None or fit is None else fit.first[kept],
        np.sqrt(np.nansum(off**2, axis=0) / counts),
        None if held is None else (float(held.rms[number]), float(held.before[number])),
    )


def _every(seconds: Array) -> int:
    """Return the decimation of samples for drawing."""
    gap_s = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 1.0
    return max(
        round(1 / (gap_s * _MAX_CURVE_HZ)) if gap_s > 0 else 1,
        -(-len(seconds) // _MAX_SAMPLES),
        1,
    )


def _names(columns: tuple[Column, ...]) -> list[str]:
    """Shorten names to "position elbow"; longer if two are equal."""
    short = [f"{_last(one.signal)} {one.name}" for one in columns]
    counts = Counter(short)
    chosen = [
        name if counts[name] == 1 else one.label for name, one in zip(short, columns, strict=True)
    ]
    return [short_name(name, _MAX_NAME) for name in chosen]


def _last(signal: str) -> str:
    """Return the joint quantity, else the end of a topic: "tool/pose" of /robot/tool/pose."""
    topic, _, quantity = signal.rpartition(".")
    return quantity if topic else "/".join(signal.strip("/").split("/")[-2:])


# ---- Hold-out views: prediction of a log's end by a fit to its beginning

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
    words = rr.TextDocument(_held_out_words(data), media_type="text/markdown")
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


def _held_out_words(data: SimulatorReviewData) -> str:
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


# ---- Shapes of a model's bodies, each in its body's frame

_HALF = 128  # opacity of what is not solid


def log_shapes(
    stream: rr.RecordingStream,
    entity: str,
    shapes: Sequence[Shape],
    color: Color,
    *,
    is_solid: bool,
) -> None:
    """Log shapes in the frame of the body that they belong to."""
    by_kind: dict[str, list[Shape]] = defaultdict(list)
    for shape in shapes:
        by_kind["box" if shape.kind == "plane" else shape.kind].append(shape)
    rgba = (*color, 255 if is_solid else _HALF)
    for kind, some in by_kind.items():
        if kind == "mesh":
            for number, shape in enumerate(some):
                _log_mesh(stream, f"{entity}/mesh_{number}", shape, rgba)
            continue
        sizes = np.array([shape.size_m for shape in some])
        middles = np.array([shape.position_m for shape in some])
        style: dict[str, Any] = {
            "quaternions": [rr.Quaternion(xyzw=_xyzw(shape.rotation)) for shape in some],
            "colors": [rgba],
            "fill_mode": "solid",
        }
        if kind == "box":
            drawn = rr.Boxes3D(centers=middles, half_sizes=sizes, **style)
        elif kind == "ellipsoid":
            drawn = rr.Ellipsoids3D(centers=middles, half_sizes=sizes, **style)
        elif kind == "cylinder":
            lengths, radii = 2 * sizes[:, 2], sizes[:, 0]
            drawn = rr.Cylinders3D(centers=middles, lengths=lengths, radii=radii, **style)
        else:
            begins = middles - np.array([one.rotation[:, 2] * one.size_m[2] for one in some])
            lengths, radii = 2 * sizes[:, 2], sizes[:, 0]
            drawn = rr.Capsules3D(translations=begins, lengths=lengths, radii=radii, **style)
        stream.log(f"{entity}/{kind}", drawn, static=True)


def _log_mesh(
    stream: rr.RecordingStream, entity: str, shape: Shape, rgba: tuple[int, int, int, int]
) -> None:
    assert shape.vertices_m is not None
    assert shape.triangles is not None
    # Each triangle has its own corners, so that its side is flat and shaded by one normal.
    corners = shape.vertices_m[shape.triangles] @ shape.rotation.T + shape.position_m
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    mesh = rr.Mesh3D(
        vertex_positions=corners.reshape(-1, 3).astype(np.float32),
        vertex_normals=np.repeat(normals, 3, axis=0).astype(np.float32),
        albedo_factor=rgba,
    )
    stream.log(entity, mesh, static=True)


def _xyzw(rotation: Array) -> Array:
    """Convert a rotation to a quaternion x, y, z, w, shape (4,)."""
    found = np.empty(4)
    mujoco().mju_mat2Quat(found, np.ascontiguousarray(rotation).ravel())
    return found[[1, 2, 3, 0]]


# ---- 3D scene of the model as observed, and as simulated after tuning

_FIXED: Color = (92, 98, 114)
_FLOOR: Color = (40, 43, 52)  # greys: what does not move
_MAX_HZ, _MAX_MOMENTS = 30.0, 3000  # poses that are sent: a screen shows few more
_MAX_POSES = 300_000  # of all bodies together
_ASIDE_RAD = 0.5  # of the camera, from the front of what moves
_LEVEL = 0.3  # a normal less horizontal than this: it is seen from the front
_THIN = 0.002  # half the thickness of a plane, of the scene's size
_MARGIN = 0.08  # around what moves, of its size
# How far around what was observed the simulated model is still looked at, of its size.
_BEYOND = 0.3

_LOOKS = 60  # moments that a camera is placed by
_FLOOR_REACH = 0.8  # half the side of a plane without an end, of the scene's size


@dataclass(frozen=True, eq=False)
class _Motion:
    """Motion of all B bodies.

    Attributes:
        seconds: Since the log's first sample, shape (T,).
        positions_m: Shape (T, B, 3).
        rotations: Shape (T, B, 3, 3).
    """

    seconds: Array
    positions_m: Array
    rotations: Array


def log_scene(
    stream: rr.RecordingStream, tuning: Tuning, data: SimulatorReviewData
) -> rrb.View | None:
    """Log the model, white as observed and warm as simulated; None if it is no MuJoCo model."""
    found: SimulatorDetection = tuning.detection
    simulator = found.connected.simulator
    if not isinstance(simulator, ModelSimulator):
        return None
    scene = ModelScene(simulator.spec.copy().compile())
    result = data.iterates[-1]
    row = np.array([result.started.get(one.name, one.initial) for one in simulator.parameters])
    seconds, qpos = simulator.coordinates(row)
    start_ns = simulator.initial.stamp_ns
    moments = _moments(float(seconds[-1]), scene.model.nbody)
    # The last pose before each moment: rotations cannot be mixed number by number.
    qpos = qpos[np.clip(np.searchsorted(seconds, moments, "right") - 1, 0, None)]
    at_s = moments + found.offset_s + (start_ns - found.connected.target.start_ns) * 1e-9
    simulated = _Motion(at_s, *scene.poses(qpos))
    sensed = seen_in_world(scene.model, simulator.sensed)
    seen, is_whole = _observed(scene.model, sensed, moments, start_ns, qpos)
    observed = None if seen is None else _Motion(at_s, *scene.poses(seen))
    corners = _corners(scene, simulated)
    if observed is not None:  # a simulated body that flies away is let go
        seen_corners = _corners(scene, observed)
        low, high = seen_corners.min(axis=0), seen_corners.max(axis=0)
        beyond = _BEYOND * float(np.linalg.norm(high - low))
        near = np.clip(corners, low - beyond, high + beyond)
        corners = np.concatenate([seen_corners, near])
    size_m = max(float(np.linalg.norm(np.ptp(corners, axis=0))), 1e-3)
    stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _log_fixed(stream, scene, simulated, corners, size_m)
    if observed is not None:
        _log_motion(stream, "observed", scene, observed, OBSERVED, is_solid=True)
    _log_motion(stream, "simulated", scene, simulated, result.color, is_solid=False)
    _log_points(stream, sensed, moments, start_ns, at_s)
    return rrb.Spatial3DView(
        origin="/scene",
        name=_title(observed is not None, is_whole),
        background=GROUND,
        line_grid=False,
        eye_controls=eye_controls(corners, _azimuth_rad(corners), _MARGIN * size_m),
    )


def _title(is_observed: bool, is_whole: bool) -> str:
    if not is_observed:
        return "the tuned model, dots: as observed"
    rest = "" if is_whole else ", the rest as simulated"
    return f"white: as observed{rest}; warm: the tuned model"


def _moments(end_s: float, bodies: int) -> Array:
    """Return the stamps of the poses, shape (T,) [s]."""
    most = min(_MAX_MOMENTS, max(_MAX_POSES // max(bodies, 1), 2))
    return np.linspace(0.0, end_s, int(np.clip(math.ceil(end_s * _MAX_HZ) + 1, 2, most)))


def _observed(
    model: Any, sensed: Sequence[SensedSignal], moments: Array, start_ns: int, simulated: Array
) -> tuple[Array | None, bool]:
    """Return coordinates as observed, or as simulated where the log does not show them.

    Args:
        model: Compiled.
        sensed: What the log shows.
        moments: Since `start_ns`, shape (T,) [s].
        start_ns: Of the rollout.
        simulated: Shape (T, nq).

    Returns:
        Shape (T, nq); None if the log shows no coordinate. And whether it shows all.
    """
    qpos = simulated.copy()
    shown = np.zeros(model.nq, dtype=bool)
    for one in sensed:
        for column, sensor in zip(one.columns, one.sensors, strict=True):
            if sensor.kind == "jointpos":
                place = int(model.jnt_qposadr[model.joint(sensor.name).id])
            elif sensor.kind == "framepos":
                joint = free_joint(model, sensor.name)
                if joint is None:
                    continue
                place = int(model.jnt_qposadr[joint]) + sensor.axis
            else:
                continue
            track = _track(one, column, moments, start_ns)
            if track is not None:
                qpos[:, place], shown[place] = track, True
    return (qpos if shown.any() else None), bool(shown.all())


def _track(sensed: SensedSignal, column: str, moments: Array, start_ns: int) -> Array | None:
    """Interpolate a column, shape (T,)."""
    values = sensed.signal.values[:, sensed.signal.columns.index(column)]
    good = np.isfinite(values)
    if not good.any():
        return None
    at_s = (sensed.signal.stamps_ns[good] - start_ns) * 1e-9
    return np.interp(moments, at_s, values[good])


def _corners(scene: ModelScene, motion: _Motion) -> Array:
    """Return bounding points of all shapes but planes, at some stamps, shape (P, 3)."""
    signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
    some = np.unique(np.linspace(0, len(motion.seconds) - 1, _LOOKS).round().astype(int))
    found: list[Array] = []
    for shape in scene.shapes:
        if shape.kind == "plane":
            continue
        half = shape.size_m + ([0, 0, shape.size_m[0]] if shape.kind == "capsule" else 0)
        own = shape.position_m + signs * half @ shape.rotation.T
        turned = own @ motion.rotations[some, shape.body].swapaxes(1, 2)
        found.append((turned + motion.positions_m[some, shape.body][:, None]).reshape(-1, 3))
    return np.concatenate(found) if found else motion.positions_m[some].reshape(-1, 3)


def _azimuth_rad(points_m: Array) -> float:
    """Choose the camera's azimuth: across the motion, by default on the side of -y."""
    normal = np.linalg.svd(np.cov(points_m.T))[2][2]
    flat = normal[:2] if np.linalg.norm(normal[:2]) >= _LEVEL else np.array([0.0, -1.0])
    if flat[1] > 0 or (flat[1] == 0 and flat[0] < 0):
        flat = -flat
    return math.atan2(flat[1], flat[0]) + _ASIDE_RAD


def _log_fixed(
    stream: rr.RecordingStream, scene: ModelScene, motion: _Motion, corners: Array, size_m: float
) -> None:
    """Log fixed bodies, with planes as thin boxes."""
    moving = set(scene.moving)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    fixed: dict[int, list[Shape]] = defaultdict(list)
    for shape in scene.shapes:
        if shape.body not in moving:
            fixed[shape.body].append(shape)
    for body, shapes in fixed.items():
        entity = f"scene/fixed/body_{body}"
        place = rr.Transform3D(
            translation=motion.positions_m[0, body], mat3x3=motion.rotations[0, body]
        )
        stream.log(entity, place, static=True)
        solid = [shape for shape in shapes if shape.kind != "plane"]
        log_shapes(stream, entity, solid, _FIXED, is_solid=True)
        planes = [shape for shape in shapes if shape.kind == "plane"]
        if planes:
            turn, at = motion.rotations[0, body], motion.positions_m[0, body]
            boxes = [_slab(one, turn.T @ (middle - at), size_m) for one in planes]
            log_shapes(stream, f"{entity}/planes", boxes, _FLOOR, is_solid=True)


def _slab(plane: Shape, middle_m: Array, size_m: float) -> Shape:
    """Convert a plane to a thin box just below it; an infinite one is put under the scene."""
    reach = _FLOOR_REACH * size_m
    has_end = plane.size_m[:2] > 0
    half = np.where(has_end, np.minimum(plane.size_m[:2], 4 * reach), reach)
    off = plane.rotation.T @ (middle_m - plane.position_m)
    off[:2] = np.where(has_end, 0.0, off[:2])
    off[2] = -_THIN * size_m
    position = plane.position_m + plane.rotation @ off
    size = np.array([*half, _THIN * size_m])
    return Shape("box", plane.body, position, plane.rotation, size)


def _log_motion(
    stream: rr.RecordingStream,
    name: str,
    scene: ModelScene,
    motion: _Motion,
    color: Color,
    *,
    is_solid: bool,
) -> None:
    """Log all moving bodies that have a shape."""
    by_body: dict[int, list[Shape]] = defaultdict(list)
    for shape in scene.shapes:
        by_body[shape.body].append(shape)
    index = at_seconds(motion.seconds)
    for body in scene.moving:
        if body not in by_body:
            continue
        entity = f"scene/{name}/body_{body}"
        columns = rr.Transform3D.columns(
            translation=motion.positions_m[:, body].astype(np.float32),
            mat3x3=motion.rotations[:, body].astype(np.float32),
        )
        stream.send_columns(entity, indexes=[index], columns=columns)
        log_shapes(stream, entity, by_body[body], color, is_solid=is_solid)


def _log_points(
    stream: rr.RecordingStream,
    sensed: Sequence[SensedSignal],
    moments: Array,
    start_ns: int,
    at_s: Array,
) -> None:
    """Log observed positions of bodies, a dot each."""
    for number, one in enumerate(sensed):
        axes = [sensor.axis for sensor in one.sensors]
        if axes != [0, 1, 2] or any(sensor.kind != "framepos" for sensor in one.sensors):
            continue
        tracks = [_track(one, column, moments, start_ns) for column in one.columns]
        known = [track for track in tracks if track is not None]
        if len(known) == 3:
            entity = f"scene/points/{number}"
            style = rr.Points3D.from_fields(colors=[OBSERVED], radii=screen_radius(4.0))
            stream.log(entity, style, static=True)
            columns = rr.Points3D.columns(positions=np.column_stack(known))
            stream.send_columns(entity, indexes=[at_seconds(at_s)], columns=columns)


# ---- Views of one iteration at a time: its curves over the observed ones, and its values

_MAX_PARAMETERS = 6  # that have a chart: more would be too small to read; the table has all
# Charts that lie one over the other; more take two columns, so wide in their heights.
_STACKED, _NARROW = 3, 1.4

_MAX_ROWS = 20  # of tables
_ROOM = 0.05  # above and below the curves of a sheet, of what they span
_GUESS_BEYOND = 0.5  # how far guesses widen a chart, of what was observed; they are cut there
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
        words = rr.TextDocument.columns(text=[_iteration_words(data, k) for k in chosen])
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
    beyond = _GUESS_BEYOND * (high - low)
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


def _iteration_words(data: SimulatorReviewData, k: int) -> str:
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


# ---- Plots of curves and residuals, and the layout of all

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
