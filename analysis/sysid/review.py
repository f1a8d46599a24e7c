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
from tunenet_logs.analysis.record import excess
from tunenet_logs.analysis.review import drawing as draw
from tunenet_logs.analysis.sysid.columns import Column, noise_of, noises_of
from tunenet_logs.analysis.sysid.fit import HeldOut, SimulatorFit, later_part
from tunenet_logs.analysis.sysid.source import SimulatorDetection
from tunenet_logs.episode import Array, Signal
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


def log_observed(stream: rr.RecordingStream, entity: str, seconds: Array, values: Array) -> None:
    """Log observations as a broad line, lowest as plots draw entities by name."""
    style: list[tuple[str, draw.Color, float]] = [("observed", draw.OBSERVED, 3.2)]  # points wide
    draw.log_lines(stream, f"{entity}/as_observed", seconds, values[:, None], style)


def log_upright(
    stream: rr.RecordingStream, entity: str, second: float, span: tuple[float, float]
) -> None:
    """Log a vertical line across a plot that shows `span`."""
    values = np.array(draw.ticked(*span))[:, None]
    # It lasts a microsecond: a plot has no such thing as an instant with two values.
    draw.log_lines(stream, entity, second + np.array([0.0, 1e-6]), values, [("", draw.MUTED, 1.0)])


# ---- Data that the review draws: columns over the log's time

MAIN = 4  # columns of the first tab: as many have axes with ticks; the others have a tab


@dataclass(frozen=True, eq=False)
class Iterate:
    """One iteration, and how it is drawn."""

    name: str  # "k=3", "refined"
    color: draw.Color  # of its line
    width: float  # of its line [points]
    values: Array  # of the tuned parameters, shape (P,)
    started: dict[str, float]  # all parameters by name, those of the initial state, too


@dataclass(frozen=True, eq=False)
class ShownColumn:
    """One column of the log with those of all iterations."""

    name: str  # short, without unit
    unit: str  # of its values
    noise: float  # standard deviation, by what the result leaves of it where it jumps
    seconds: Array  # since the log's first sample, shape (T,)
    observed: Array  # shape (T,)
    simulated: Array  # of each iteration, shape (T, K); NaN where it shows nothing
    fitted: Array | None  # of a fit to the first part of the log, shape (T,); None if there is none
    given: Array | None  # of the simulator as given, likewise
    rms: Array  # residual of each iteration, shape (K,)
    # Hold-out residual of the fit to the first part, and of the simulator as given; None without.
    held_out_rms: tuple[float, float] | None
    held_out_s: float | None  # where its hold-out begins, on the axis of `seconds`; None without
    commanded: Array | None = None  # what its joint was asked for, shape (T,); None without
    tuned: Array | None = None  # of the result, wherever it begins anew, shape (T,)
    spread: float = 0.0  # standard deviation of what was observed
    is_noise_known: bool = False  # whether the log tells it: what moves is less rough by far

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
    """Data of one tuning's review, but for the scene."""

    every: tuple[ShownColumn, ...]  # those that vary most, relative to their noise, first
    iterates: tuple[Iterate, ...]  # the last is the result
    drawn: tuple[int, ...]  # indices of the iterates that are drawn over the log's time
    parameters: tuple[Parameter, ...]  # that were tuned, P of them
    interval95: Array | None  # of the result, shape (P, 2); None if no valid one exists
    held_out_s: float | None  # start of the first hold-out; None if there is none
    first_s: float  # first stamp [s since the log's first sample]
    # Of a run that is held out, its columns and name; () and "" where a part of each log is.
    others: tuple[ShownColumn, ...] = ()
    run: str = ""

    @property
    def columns(self) -> tuple[ShownColumn, ...]:
        """Columns that are drawn: more would be too small to read."""
        return self.every[:16]

    @property
    def predicted(self) -> tuple[ShownColumn, ...]:
        """Columns whose prediction is drawn."""
        return self.others[:MAIN] or (self.main if self.held_out_s is not None else ())

    @property
    def main(self) -> tuple[ShownColumn, ...]:
        """Columns of the first tab."""
        return self.columns[:MAIN]


def simulator_review_data(tuning: Tuning) -> SimulatorReviewData:
    """Collect the data from a tuning that compared a log with a simulator."""
    found: SimulatorDetection = tuning.detection
    target = found.connected.target
    assert tuning.trace is not None
    fit: SimulatorFit | None = tuning.trace.fit.detail if tuning.trace.fit else None
    unseen = fit.held_out if fit else None
    held = unseen if unseen is not None and unseen.simulated is not None else None
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
                draw.ramp(k, count) if count > 1 else draw.ramp(1, 2),
                draw.BOLD if is_last else draw.FINE,
                np.asarray(step.values, dtype=np.float64),
                dict(step.evaluation.episode.info.truth),
            )
        )
    varying = [-one.spread / max(one.noise, 1e-9 * one.spread, 1e-300) for one in target.columns]
    order = np.argsort(varying, kind="stable")
    # Shorten names to "position elbow", or "tool/pose x" of /robot/tool/pose; longer if two are
    # equal. In letters: a title's room in a laptop's view.
    short: list[str] = []
    for one in target.columns:
        topic, _, measured = one.signal.rpartition(".")
        last = measured if topic else "/".join(measured.strip("/").split("/")[-2:])
        short.append(f"{last} {one.name}")
    counts = Counter(short)
    names = [
        short_name(name if counts[name] == 1 else one.label, 34)
        for name, one in zip(short, target.columns, strict=True)
    ]
    noises = noises_of(target, seen[:, -1] - target.values)
    columns = [
        _shown(number, names[number], found, seen, fit, held, float(noises[number]))
        for number in order.tolist()
    ]
    # A few are drawn over the log's time; all of them can be scrubbed.
    lines = np.unique(np.linspace(0, count - 1, min(count, 8)).round().astype(int))
    interval = tuning.interval95
    return SimulatorReviewData(
        tuple(columns),
        tuple(iterates),
        tuple(lines.tolist()),
        tuple(tuning.parameters),
        None if interval is None else np.asarray(interval),
        min((one.held_out_s for one in columns if one.held_out_s is not None), default=None),
        found.offset_s + float(target.seconds.min()),
        *_of_run(unseen),
    )


def _of_run(held: HeldOut | None) -> tuple[tuple[ShownColumn, ...], str]:
    """Collect the columns of a run that is held out, those that vary most first, and its name."""
    if held is None or held.whole is None:
        return (), ""
    found: list[tuple[float, ShownColumn]] = []
    ends = np.cumsum([len(one.values) for one in held.columns]).tolist()
    for number, (column, end) in enumerate(zip(held.columns, ends, strict=True)):
        every = draw.drawn_every(column.seconds)
        given, predicted = held.whole[:, end - len(column.values) : end][:, ::every]
        shown = ShownColumn(
            short_name(f"{column.signal.partition(': ')[2].rpartition('.')[2]} {column.name}", 34),
            column.unit,
            column.noise,
            column.seconds[::every],
            column.values[::every],
            np.zeros((len(given), 0)),
            predicted,
            given,
            np.zeros(0),
            (float(held.rms[number]), float(held.before[number])),
            float(column.seconds[0]),
            spread=column.spread,
            is_noise_known=_is_noise_known(column, held.whole[1, end - len(column.values) : end]),
        )
        found.append((column.spread / max(column.noise, 1e-9 * column.spread, 1e-300), shown))
    found.sort(key=lambda one: -one[0])
    return tuple(shown for _, shown in found), held.columns[0].signal.partition(":")[0]


def _shown(
    number: int,
    name: str,
    found: SimulatorDetection,
    seen: Array,
    fit: SimulatorFit | None,
    held: HeldOut | None,
    noise: float,
) -> ShownColumn:
    target = found.connected.target
    column = target.columns[number]
    every = draw.drawn_every(column.seconds)
    later = found.connected.later
    later = (later_part(target) if later is None else later)[target.which == number]
    kept = np.flatnonzero(target.which == number)[::every]
    off = seen[target.which == number] - column.values[:, None]
    counts = np.maximum(np.isfinite(off).sum(axis=0), 1)
    tuned = seen[:, -1] if fit is None else fit.simulated
    return ShownColumn(
        name,
        column.unit,
        noise,
        column.seconds[::every] + found.offset_s,
        column.values[::every],
        seen[kept],
        None if held is None or held.simulated is None else held.simulated[kept],
        None if fit is None else fit.first[kept],
        np.sqrt(np.nansum(off**2, axis=0) / counts),
        None if held is None else (float(held.rms[number]), float(held.before[number])),
        None if held is None else float(column.seconds[later][0]) + found.offset_s,
        _commanded(found, number, column.seconds[::every]),
        tuned[kept],
        column.spread,
        _is_noise_known(column, tuned[target.which == number]),
    )


def _is_noise_known(column: Column, simulated: Array) -> bool:
    """Return whether a column's noise is that of its sensor: what is simulated has half of it."""
    moves = noise_of(simulated[np.isfinite(simulated)])
    return not column.is_jumpy and moves < 0.5 * column.noise


def _commanded(found: SimulatorDetection, number: int, seconds: Array) -> Array | None:
    """Return the commanded position of a column's joint, each held until the next, shape (T,)."""
    target = found.connected.target
    column = target.columns[number]
    if not column.signal.endswith(".position"):
        return None
    for drive in getattr(found.connected.simulator, "drives", ()):
        signal: Signal = drive.signal
        is_of_these = signal.name.endswith(".position") and signal.unit == column.unit
        if drive.is_effort or not is_of_these or column.name not in signal.columns:
            continue
        values = signal.values[:, signal.columns.index(column.name)]
        good = np.isfinite(values)
        if not good.any():
            continue
        at_s = (signal.stamps_ns[good] - target.start_ns) * 1e-9
        places = np.searchsorted(at_s, seconds, side="right") - 1
        return np.where(places < 0, np.nan, values[good][np.maximum(places, 0)])
    return None


# ---- Hold-out views: prediction of a log's end by a fit to its beginning

# Cold, as the first iteration, and warm, as the result.
_GIVEN, _PREDICTED = draw.ramp(1, 6), draw.ramp(5, 6)
_ONE_COLUMN = 3  # charts that lie one over the other; more take two columns


def log_held_out(stream: rr.RecordingStream, data: SimulatorReviewData) -> rrb.Container:
    """Log the hold-out predictions of the main columns, and their errors in words."""
    views: list[rrb.View] = []
    for number, column in enumerate(data.predicted):
        assert column.fitted is not None
        assert column.given is not None
        assert column.held_out_s is not None
        entity, later = f"held_out/{number}", column.seconds >= column.held_out_s
        for name, values, color, width in (
            ("given", column.given, _GIVEN, 0.8),
            ("fitted", np.where(later, np.nan, column.fitted), draw.FITTED, 1.6),
            ("predicted", np.where(later, column.fitted, np.nan), _PREDICTED, 1.6),
        ):
            if (good := np.isfinite(values)).any():
                times_s, curve = column.seconds[good], values[good, None]
                draw.log_lines(stream, f"{entity}/{name}", times_s, curve, [(name, color, width)])
        span = column.shown(column.fitted)
        log_observed(stream, entity, column.seconds, column.observed)
        title = column.title("predicted")
        if not data.run:
            log_upright(stream, f"{entity}/begins", column.held_out_s, span)
            title = column.title(f"predicted from {column.held_out_s:.2f} s")
        views.append(draw.plot_view(entity, title, draw.ticked(*span)))
    entries: list[tuple[str, list[draw.Color]]] = [
        ("observed", [draw.OBSERVED]),
        ("simulator as given", [_GIVEN]),
        *([] if data.run else [("fit to the first part", [draw.FITTED])]),
        ("what it predicts", [_PREDICTED]),
    ]
    key = draw.log_key(stream, entries, "held_out_key")
    # Describe the hold-out errors, column by column.
    rows = [
        (column.title(), *(f"{number:.3g}" for number in (*column.held_out_rms, column.noise)))
        for column in data.others or data.columns
        if column.held_out_rms is not None
    ]
    head = ("rms", "predicted", "as given", "noise")
    words = [
        f"# {one_line(data.run)}" if data.run else f"# from {data.held_out_s:.2f} s on",
        "Nothing was fitted to this run but its start."
        if data.run
        else "The simulator was fitted a second time, to what is before; what comes after, it has "
        "not seen. Only the start of what comes after is fitted to it.",
        markdown_table(head, rows),
    ]
    draw.log_words(stream, "held_out_words", "\n\n".join(words))
    return rrb.Horizontal(
        rrb.Vertical(key, rrb.Vertical(*views), row_shares=draw.KEY_SHARES),
        rrb.TextDocumentView(origin="/held_out_words", name="prediction"),
        column_shares=[3, 1.6],
        name=f"held-out prediction (timeline {draw.LOG_TIME})",
    )


# ---- Shapes of a model's bodies, each in its body's frame


def log_shapes(
    stream: rr.RecordingStream,
    entity: str,
    shapes: Sequence[Shape],
    color: draw.Color,
    *,
    is_solid: bool,
) -> None:
    """Log shapes in the frame of the body that they belong to."""
    by_kind: dict[str, list[Shape]] = defaultdict(list)
    for shape in shapes:
        by_kind["box" if shape.kind == "plane" else shape.kind].append(shape)
    rgba = (*color, 255 if is_solid else 128)  # opacity of what is not solid
    for kind, some in by_kind.items():
        if kind == "mesh":
            for number, shape in enumerate(some):
                assert shape.vertices_m is not None
                assert shape.triangles is not None
                # Each triangle has its own corners, so that its side is flat, shaded by one normal.
                corners = shape.vertices_m[shape.triangles] @ shape.rotation.T + shape.position_m
                normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
                normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
                mesh = rr.Mesh3D(
                    vertex_positions=corners.reshape(-1, 3).astype(np.float32),
                    vertex_normals=np.repeat(normals, 3, axis=0).astype(np.float32),
                    albedo_factor=rgba,
                )
                stream.log(f"{entity}/mesh_{number}", mesh, static=True)
            continue
        sizes = np.array([shape.size_m for shape in some])
        middles = np.array([shape.position_m for shape in some])
        turns = np.empty((len(some), 4))  # quaternions w, x, y, z
        for turn, shape in zip(turns, some, strict=True):
            mujoco().mju_mat2Quat(turn, np.ascontiguousarray(shape.rotation).ravel())
        style: dict[str, Any] = {
            "quaternions": [rr.Quaternion(xyzw=turn[[1, 2, 3, 0]]) for turn in turns],
            "colors": [rgba],
            "fill_mode": "solid",
        }
        lengths, radii = 2 * sizes[:, 2], sizes[:, 0]
        if kind == "box":
            drawn = rr.Boxes3D(centers=middles, half_sizes=sizes, **style)
        elif kind == "ellipsoid":
            drawn = rr.Ellipsoids3D(centers=middles, half_sizes=sizes, **style)
        elif kind == "cylinder":
            drawn = rr.Cylinders3D(centers=middles, lengths=lengths, radii=radii, **style)
        else:
            begins = middles - np.array([one.rotation[:, 2] * one.size_m[2] for one in some])
            drawn = rr.Capsules3D(translations=begins, lengths=lengths, radii=radii, **style)
        stream.log(f"{entity}/{kind}", drawn, static=True)


# ---- 3D scene of the model as observed, and as simulated after tuning


@dataclass(frozen=True, eq=False)
class _Motion:
    """Motion of all B bodies."""

    seconds: Array  # since the log's first sample, shape (T,)
    positions_m: Array  # shape (T, B, 3)
    rotations: Array  # shape (T, B, 3, 3)


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
    # At most 30 poses a second, 3000, and 300 000 of all bodies: a screen shows few more.
    end_s = float(seconds[-1])
    # A screen shows few more than 30 poses a second; all bodies have 300 000 together at most.
    most = min(3000, max(300_000 // max(scene.model.nbody, 1), 2))
    moments = np.linspace(0.0, end_s, int(np.clip(math.ceil(end_s * 30.0) + 1, 2, most)))
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
        beyond = 0.3 * float(np.linalg.norm(high - low))
        near = np.clip(corners, low - beyond, high + beyond)
        corners = np.concatenate([seen_corners, near])
    size_m = max(float(np.linalg.norm(np.ptp(corners, axis=0))), 1e-3)
    stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _log_fixed(stream, scene, simulated, corners, size_m)
    if observed is not None:
        _log_motion(stream, "observed", scene, observed, draw.OBSERVED, is_solid=True)
    _log_motion(stream, "simulated", scene, simulated, result.color, is_solid=False)
    _log_points(stream, sensed, moments, start_ns, at_s)
    title = f"white: seen{'' if is_whole else ' in part'}; warm: tuned"
    title = "the tuned model, dots: as observed" if observed is None else title
    # Across the motion, by default on the side of -y, and a little aside.
    normal = np.linalg.svd(np.cov(corners.T))[2][2]
    flat = normal[:2] if np.linalg.norm(normal[:2]) >= 0.3 else np.array([0.0, -1.0])
    if flat[1] > 0 or (flat[1] == 0 and flat[0] < 0):
        flat = -flat
    azimuth_rad = math.atan2(flat[1], flat[0]) + 0.5
    return draw.scene_view(title, *draw.eye_and_target(corners, azimuth_rad, 0.08 * size_m))


def _observed(
    model: Any, sensed: Sequence[SensedSignal], moments: Array, start_ns: int, simulated: Array
) -> tuple[Array | None, bool]:
    """Return coordinates as observed at (T,) [s], or as simulated where the log shows none."""
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
    # Moments that a camera is placed by
    some = np.unique(np.linspace(0, len(motion.seconds) - 1, 60).round().astype(int))
    found: list[Array] = []
    for shape in scene.shapes:
        if shape.kind == "plane":
            continue
        half = shape.size_m + ([0, 0, shape.size_m[0]] if shape.kind == "capsule" else 0)
        own = shape.position_m + signs * half @ shape.rotation.T
        turned = own @ motion.rotations[some, shape.body].swapaxes(1, 2)
        found.append((turned + motion.positions_m[some, shape.body][:, None]).reshape(-1, 3))
    return np.concatenate(found) if found else motion.positions_m[some].reshape(-1, 3)


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
        log_shapes(stream, entity, solid, (92, 98, 114), is_solid=True)  # greys: it does not move
        planes = [shape for shape in shapes if shape.kind == "plane"]
        if planes:
            turn, at = motion.rotations[0, body], motion.positions_m[0, body]
            boxes = [_slab(one, turn.T @ (middle - at), size_m) for one in planes]
            log_shapes(stream, f"{entity}/planes", boxes, (40, 43, 52), is_solid=True)


def _slab(plane: Shape, middle_m: Array, size_m: float) -> Shape:
    """Convert a plane to a thin box just below it; an infinite one is put under the scene."""
    reach = 0.8 * size_m  # half the side of a plane without an end, of the scene's size
    has_end = plane.size_m[:2] > 0
    half = np.where(has_end, np.minimum(plane.size_m[:2], 4 * reach), reach)
    off = plane.rotation.T @ (middle_m - plane.position_m)
    off[:2] = np.where(has_end, 0.0, off[:2])
    thin_m = 0.002 * size_m  # half its thickness
    off[2] = -thin_m
    position = plane.position_m + plane.rotation @ off
    size = np.array([*half, thin_m])
    return Shape("box", plane.body, position, plane.rotation, size)


def _log_motion(
    stream: rr.RecordingStream,
    name: str,
    scene: ModelScene,
    motion: _Motion,
    color: draw.Color,
    *,
    is_solid: bool,
) -> None:
    """Log all moving bodies that have a shape."""
    by_body: dict[int, list[Shape]] = defaultdict(list)
    for shape in scene.shapes:
        by_body[shape.body].append(shape)
    index = rr.TimeColumn(draw.LOG_TIME, duration=motion.seconds)
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
            style = rr.Points3D.from_fields(colors=[draw.OBSERVED], radii=draw.screen_radius(4.0))
            columns = rr.Points3D.columns(positions=np.column_stack(known))
            draw.log_moving(stream, entity, style, at_s, columns)


# ---- Views of one iteration at a time: its curves over the observed ones, and its values

_MAX_ROWS = 20  # of tables


def log_scrub(stream: rr.RecordingStream, data: SimulatorReviewData) -> rrb.Container:
    """Log the views of one iteration, and each parameter by iteration."""
    width = draw.WIDTH if len(data.main) <= _ONE_COLUMN else 1.4
    sheets: list[rrb.View] = []
    for number, column in enumerate(data.main):
        # An iteration's curve over the observed one; guesses are cut where they would widen the
        # chart by more than half of what was observed.
        low, high = column.shown(column.simulated[:, -1])
        beyond = 0.5 * (high - low)
        guessed = np.clip(column.simulated, low - beyond, high + beyond)
        low, high = column.shown(guessed.ravel())
        reach = (high - low) * (1 + 2 * 0.05)  # with room above and below
        bottom = (low + high - reach) / 2
        draw.log_sheet(
            stream,
            f"sheets/signal_{number}",
            column.seconds,
            column.observed,
            guessed,
            [one.color for one in data.iterates],
            (bottom, bottom + reach),
            width=width,
            first_s=data.first_s,
        )
        sheets.append(draw.chart_view(f"signal_{number}", column.title(), width))
    # More charts would be too small to read; the table has all.
    charts = [
        _log_parameter(stream, data, number) for number in range(min(len(data.parameters), 6))
    ]
    words = [_iteration_words(data, k) for k in range(len(data.iterates))]
    step = draw.log_steps(stream, words, data.first_s)
    is_narrow = len(charts) <= _ONE_COLUMN
    return rrb.Horizontal(
        rrb.Grid(*sheets, grid_columns=1 if len(sheets) <= _ONE_COLUMN else 2),
        rrb.Grid(*charts, grid_columns=1 if is_narrow else 2),
        step,
        column_shares=[4.6, 3.2, 3.2] if is_narrow else [4.0, 4.2, 3.0],
        name=draw.SCRUB,
    )


def _log_parameter(stream: rr.RecordingStream, data: SimulatorReviewData, number: int) -> rrb.View:
    """Log one parameter by iteration, and the result's interval."""
    parameter = data.parameters[number]
    is_narrow = len(data.parameters) <= _ONE_COLUMN
    values = [float(one.values[number]) for one in data.iterates]
    interval = None
    if data.interval95 is not None:
        interval = (float(data.interval95[number, 0]), float(data.interval95[number, 1]))
    low, high = parameter.training_range
    least = 0.02 * max(high - low, 1e-9)  # less is drawn as still
    said = said_names(one.name for one in data.parameters)[parameter.name]
    return draw.log_iterates(
        stream,
        quantity(short_name(said, 26), parameter.unit if is_narrow else "1"),
        [one.name for one in data.iterates],
        values,
        [one.color for one in data.iterates],
        draw.span_of([*values, *(interval or ())], least),
        interval,
        data.first_s,
        chart=f"parameter_{number}",
        figures=".4g",
        # A number takes up more heights of a chart across, the smaller the chart is.
        wide=1.0 if is_narrow else 1.4,
    )


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


_BAND = 2.0  # standard deviations of the noise that are drawn around no residual


def log_simulator(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container:
    """Log all views of a simulator's review, and return their layout."""
    data = simulator_review_data(tuning)
    _log_signals(stream, data, is_tuned=tuning.estimate is not None)
    curves, residuals = _log_plots(stream, data)
    main, others = curves[: len(data.main)], curves[len(data.main) :]
    entries: list[tuple[str, list[draw.Color]]] = [("observed", [draw.OBSERVED]), _iterations(data)]
    if data.held_out_s is not None:
        entries.append((f"{data.held_out_s:.2f} s: held out", [draw.MUTED]))
    if any(one.commanded is not None for one in data.main):
        entries.append(("thin: commanded", [draw.MUTED]))
    key = draw.log_key(stream, entries)
    overlay = rrb.Vertical(
        key,
        rrb.Vertical(*main),  # one time axis above the other, and wide enough for ticks
        row_shares=draw.KEY_SHARES,
    )
    scene = log_scene(stream, tuning, data)
    parts: list[rrb.View | rrb.Container] = [] if scene is None else [scene]
    parts += [overlay, draw.result_view()]
    shares = [6.0, 4.6] if scene is None else [3.8, 6.4, 4.4]
    tabs: list[rrb.Container] = [
        rrb.Horizontal(*parts, column_shares=shares, name=f"overlay (timeline {draw.LOG_TIME})")
    ]
    if others:
        left_out = len(data.every) - len(data.columns)
        more = f", {left_out} more are not drawn" if left_out else ""
        name = f"other signals{more} (timeline {draw.LOG_TIME})"
        grid = rrb.Grid(*others, grid_columns=_across(len(others)))
        key = draw.key_view(len(entries))
        tabs.append(rrb.Vertical(key, grid, row_shares=draw.KEY_SHARES, name=name))
    left_view = draw.log_key(
        stream,
        [_iterations(data), (f"± {_BAND:g} standard deviations of the noise", [draw.OBSERVED])],
        "residual_key",
    )
    left = rrb.Grid(*residuals, grid_columns=_across(len(residuals)))
    name = f"residuals (timeline {draw.LOG_TIME})"
    tabs.append(rrb.Vertical(left_view, left, row_shares=draw.KEY_SHARES, name=name))
    tabs.append(log_scrub(stream, data))
    if data.predicted:
        tabs.append(log_held_out(stream, data))
    return rrb.Tabs(*tabs, active_tab=0)


def _across(count: int) -> int:
    """Return the columns of a grid of so many charts, wide enough for ticks of time."""
    return max(round(math.sqrt(count * 0.7)), 1)


def _log_plots(
    stream: rr.RecordingStream, data: SimulatorReviewData
) -> tuple[list[rrb.View], list[rrb.View]]:
    """Log each column's curves over the observed one, and its residuals over the band of noise.

    Iterates before the result may run off.
    """
    curves: list[rrb.View] = []
    residuals: list[rrb.View] = []
    for number, column in enumerate(data.columns):
        entity, residual = f"signal/{number}", f"residual/{number}"
        unit = "" if column.unit in ("", "1") else f" {one_line(column.unit)}"
        style = [
            (f"{one.name}  {column.rms[k]:.3g}{unit} rms", one.color, one.width)
            for k, one in enumerate(data.iterates)
            if k in data.drawn
        ]
        span, values = column.shown(column.simulated[:, -1]), column.simulated[:, data.drawn]
        draw.log_lines(stream, f"{entity}/iterations", column.seconds, values, style)
        log_observed(stream, entity, column.seconds, column.observed)
        if (asked := column.commanded) is not None and (good := np.isfinite(asked)).any():
            line: list[tuple[str, draw.Color, float]] = [("commanded", draw.MUTED, 1.0)]
            times_s, steps = column.seconds[good], asked[good, None]
            draw.log_lines(stream, f"{entity}/commanded", times_s, steps, line)
        if column.held_out_s is not None:
            log_upright(stream, f"{entity}/held_out", column.held_out_s, span)
        curves.append(draw.plot_view(entity, column.title(), draw.ticked(*span)))
        off = values - column.observed[:, None]
        draw.log_lines(stream, f"{residual}/iterations", column.seconds, off, style)
        band = _BAND * column.noise
        ends, bounds = column.seconds[[0, -1]], np.array([[-band, band]] * 2)
        draw.log_lines(
            stream, f"{residual}/noise", ends, bounds, [("noise", draw.OBSERVED, 1.0)] * 2
        )
        # The axis shows most of the result's residual, so that no spike makes it useless.
        last = np.abs(off[np.isfinite(off[:, -1]), -1])
        usual = float(np.quantile(last, 0.98)) if len(last) else 0.0
        least = max(1e-6 * float(np.abs(column.observed).max()), 1e-9)
        reach = 1.3 * max(usual, band, least)
        title = column.title("simulated - observed")
        residuals.append(draw.plot_view(residual, title, draw.ticked(-reach, reach)))
    return curves, residuals


def _log_signals(stream: rr.RecordingStream, data: SimulatorReviewData, *, is_tuned: bool) -> None:
    """Log the columns for pages: of a run that is held out, then of what was fitted.

    Those first of which most is left beside their noise, measured by how much a column varies, or a
    tenth of the most of its unit, as a hold-out is.
    """
    every = [*data.every, *data.others]

    def left(one: ShownColumn) -> float:
        result = one.fitted if one.tuned is None else one.tuned
        off = np.full(1, np.inf) if result is None else result - one.observed
        off = off[np.isfinite(off)]
        rms = float(np.sqrt(np.mean(off**2))) if len(off) else math.inf
        most = max(other.spread for other in every if other.unit == one.unit)
        return excess(rms, one.noise) / max(one.spread, 0.1 * most, 1e-12)

    others = sorted(data.others, key=left, reverse=True)[: draw.MAX_SIGNALS // 2]
    rest = sorted(data.every, key=left, reverse=True)[: draw.MAX_SIGNALS - len(others)]
    for number, one in enumerate([*others, *rest]):
        given = one.simulated[:, 0] if one.given is None else one.given
        result = "tuned" if is_tuned else "closest"
        curves = {"given": given, result: one.tuned, "predicted": one.fitted}
        if one.fitted is not None and one.held_out_s is not None:
            curves["predicted"] = np.where(one.seconds < one.held_out_s, np.nan, one.fitted)
        shown = draw.ReviewedSignal(
            f"{data.run} {one.name}" if one in others else one.name,
            "" if one.unit == "1" else one.unit,
            one.seconds,
            one.observed,
            {name: curve for name, curve in curves.items() if curve is not None},
            one.noise if one.is_noise_known else math.nan,
            math.nan if one.held_out_s is None else one.held_out_s,
        )
        draw.log_signal(stream, number, shown)


def _iterations(data: SimulatorReviewData) -> tuple[str, list[draw.Color]]:
    return "iterations", [data.iterates[k].color for k in data.drawn]
