"""3D scene of a model as observed, and as simulated after tuning."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.record import Tuning
from analysis.review.camera import eye_controls
from analysis.review.drawing import GROUND, OBSERVED, Color, at_seconds, screen_radius
from analysis.sysid.experiment import SimulatorDetection
from analysis.sysid.review.review_data import SimulatorReviewData
from analysis.sysid.review.shapes import log_shapes
from recorders.simulators.mujoco.model_frames import free_joint, seen_in_world
from recorders.simulators.mujoco.model_scene import ModelScene, Shape
from recorders.simulators.mujoco.model_sensors import SensedSignal
from recorders.simulators.mujoco.model_simulator import ModelSimulator
from tunenet_logs.arrays import Array

_FIXED: Color = (92, 98, 114)
_FLOOR: Color = (40, 43, 52)  # Greys: what does not move
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
