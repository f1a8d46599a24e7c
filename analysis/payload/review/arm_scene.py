"""3D scene of the arm along its measured path, with its payload."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.payload.review.review_data import PayloadReviewData
from analysis.review.camera import eye_controls
from analysis.review.drawing import MUTED, at_seconds, screen_radius
from recorders.simulators.arm.description import Arm
from recorders.simulators.arm.path import LinkPoses, link_poses
from recorders.simulators.arm.rigid_bodies import rotation_from_rpy
from tunenet_logs.arrays import Array

_GROUND = (16, 18, 24)
_LINES = (52, 55, 64)
_ARM = (150, 156, 170)
_JOINT = (92, 98, 114)
_GRIPPER = (205, 208, 214)
# Greys, so that the payload alone has a colour; the base's axes x, y, z as usual.
_AXES = ((230, 90, 90), (110, 200, 110), (100, 150, 255))

# Radii of the first link and of the last one, in reaches of the arm as all sizes here: an arm of
# any size looks the same.
_THICK, _THIN = 0.042, 0.026

_PALM_FRACTION = 0.5  # of the way from the last joint to the tool frame; the fingers are the rest
# Half of the fingers' distance, in lengths of the gripper; their radius, in reaches.
_GRIP, _FINGER = 0.3, 0.010

# Radii of the payload, in reaches: it can be seen, and does not hide the arm.
_MIN_SIZE, _MAX_SIZE = 0.018, 0.15

_WATER_KG_M3 = 1000.0  # density of the ball that is drawn: the payload's is unknown
# Tiles of the ground along each side, the length of one and of the base's axes, in reaches.
_TILES, _TILE, _AXIS = 5, 0.3, 0.28

_TRAIL_S = 1.0  # of the path behind the payload: shows which way it moves
_LABEL = 0.055  # of the mass above the ball, in reaches
_ASIDE_RAD = 0.85  # of the camera, from the path's front: links hide each other less
_MARGIN = 0.04  # around the arm and its payload, in reaches
_MAX_HZ = 30.0  # poses that are sent: a screen shows few more
_LEVEL = 0.3  # a path's normal less horizontal than this: it is seen from the arm's side


def log_arm(stream: rr.RecordingStream, data: PayloadReviewData) -> rrb.View:
    """Log the ground, the arm in its poses, and its payload."""
    rate_hz = 1 / float(np.median(np.diff(data.seconds)))
    kept = slice(None, None, max(1, round(rate_hz / _MAX_HZ)))
    seconds, poses = data.seconds[kept], link_poses(data.arm, data.position_rad[kept])
    steps = [joint.origin_m for joint in data.arm.joints] + [data.arm.tool_from_last_m]
    reach_m = max(sum(math.hypot(*step) for step in steps), 1e-3)
    stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    tile, half = _TILE * reach_m, _TILES * _TILE * reach_m / 2
    at = [-half + tile * k for k in range(_TILES + 1)]
    lines = [[[x, -half, 0], [x, half, 0]] for x in at]
    lines += [[[-half, y, 0], [half, y, 0]] for y in at]
    grid = rr.LineStrips3D(lines, colors=[_LINES], radii=screen_radius(0.6))
    stream.log("scene/ground", grid, static=True)
    axes = rr.Arrows3D(
        vectors=_AXIS * reach_m * np.eye(3),
        colors=_AXES,
        radii=[0.006 * reach_m],
        labels=["x", "y", "z"],
        show_labels=True,
    )
    stream.log("scene/base_axes", axes, static=True)
    _log_links(stream, data.arm, reach_m)
    for frame in range(1, poses.position_m.shape[1]):
        columns = rr.Transform3D.columns(
            translation=poses.position_m[:, frame], mat3x3=poses.rotation[:, frame]
        )
        is_tool = frame == len(data.arm.joints) + 1
        entity = "scene/arm/tool" if is_tool else f"scene/arm/link_{frame}"
        stream.send_columns(entity, indexes=[at_seconds(seconds)], columns=columns)
    if any(joint.is_prismatic for joint in data.arm.joints):
        _log_slides(stream, seconds, poses, reach_m)
    radius_m = payload_radius_m(data.result.mass_kg, reach_m)
    _log_payload(stream, data, seconds, poses, radius_m, radius_m + _LABEL * reach_m)
    return _view(poses, radius_m + _MARGIN * reach_m)


def _view(poses: LinkPoses, margin_m: float) -> rrb.View:
    """Place the camera in front of the path so that all of the arm fits."""
    points = poses.position_m.reshape(-1, 3)
    # Along the normal of the plane that the tool moves in, turned aside and up.
    tool = poses.position_m[:, -1]
    outward = tool.mean(axis=0)[:2]
    normal = np.linalg.svd(tool - tool.mean(axis=0))[2][2] if len(tool) > 2 else np.zeros(3)
    flat = normal[:2]
    if np.linalg.norm(flat) < _LEVEL:
        reaches = np.linalg.norm(outward) > 0
        flat = np.array([outward[1], -outward[0]]) if reaches else np.array([0.0, -1.0])
    if flat @ outward < 0:
        flat = -flat
    azimuth_rad = math.atan2(flat[1], flat[0]) + _ASIDE_RAD
    return rrb.Spatial3DView(
        origin="/scene",
        name="the arm along its measured path",
        background=_GROUND,
        line_grid=False,
        eye_controls=eye_controls(points, azimuth_rad, margin_m),
    )


def payload_radius_m(mass_kg: float, reach_m: float) -> float:
    """Return the radius of a ball of water of that mass, clipped to what is visible."""
    water_m = (3 * max(mass_kg, 0.0) / (4 * math.pi * _WATER_KG_M3)) ** (1 / 3)
    return min(max(water_m, _MIN_SIZE * reach_m), _MAX_SIZE * reach_m)


def _log_links(stream: rr.RecordingStream, arm: Arm, reach_m: float) -> None:
    """Log each link from its own joint to the next one, in its own frame, and the gripper."""
    ends = [joint.origin_m for joint in arm.joints]
    radii = np.linspace(_THICK, _THIN, len(ends) + 1) * reach_m
    stream.log("scene/arm/base", _capsules([((0, 0, 0), ends[0])], [radii[0]], _ARM), static=True)
    for number, radius in enumerate(radii[1:], start=1):
        entity = f"scene/arm/link_{number}"
        if number < len(ends):
            parts = [((0, 0, 0), ends[number])]
            stream.log(entity, _capsules(parts, [radius], _ARM), static=True)
        hinge = rr.Ellipsoids3D(
            half_sizes=[[1.25 * radius] * 3], colors=[_JOINT], fill_mode="solid"
        )
        stream.log(f"{entity}/joint", hinge, static=True)
        label = rr.Points3D(
            [[0, 0, 0]],
            labels=[str(number)],
            colors=[MUTED],
            radii=screen_radius(0.1),
            show_labels=True,
        )
        stream.log(f"{entity}/number", label, static=True)
    tip = np.array(arm.tool_from_last_m)
    length = float(np.linalg.norm(tip))
    if length < 1e-3 * reach_m:
        return
    # The gripper: a palm and two fingers up to the tool frame, in the last link's.
    entity = f"scene/arm/link_{len(ends)}"
    axes = rotation_from_rpy(arm.tool_from_last_rpy)
    aside = next((axis for axis in axes.T[[1, 2]] if abs(axis @ tip) < 0.7 * length), axes[:, 0])
    aside = aside - (aside @ tip) / length**2 * tip
    aside *= _GRIP * length / np.linalg.norm(aside)
    palm = _PALM_FRACTION * tip
    stream.log(entity, _capsules([((0, 0, 0), palm)], [radii[-1]], _ARM), static=True)
    fingers = [(palm + side * aside, tip + side * aside) for side in (-1, 1)]
    bones = [(palm - aside, palm + aside), *fingers]
    widths = [_FINGER * reach_m] * len(bones)
    stream.log(f"{entity}/gripper", _capsules(bones, widths, _GRIPPER), static=True)


def _log_slides(
    stream: rr.RecordingStream, seconds: Array, poses: LinkPoses, reach_m: float
) -> None:
    """Log the connections of links with prismatic joints."""
    strips = poses.position_m.astype(np.float32)
    style = rr.LineStrips3D.from_fields(colors=[_JOINT], radii=[_FINGER * reach_m])
    stream.log("scene/slides", style, static=True)
    columns = rr.LineStrips3D.columns(strips=list(strips))
    stream.send_columns("scene/slides", indexes=[at_seconds(seconds)], columns=columns)


def _log_payload(
    stream: rr.RecordingStream,
    data: PayloadReviewData,
    seconds: Array,
    poses: LinkPoses,
    radius_m: float,
    label_m: float,
) -> None:
    """Log a ball in the tool frame, its mass `label_m` above it, and its path."""
    result, at_m = data.result, np.array(data.com_m)
    color = result.color if data.has_estimate else MUTED
    ball = rr.Ellipsoids3D(
        centers=[at_m], half_sizes=[[radius_m] * 3], colors=[color], fill_mode="solid"
    )
    stream.log("scene/arm/tool/payload", ball, static=True)
    centers = poses.position_m[:, -1] + poses.rotation[:, -1] @ at_m
    over = np.array([0.0, 0.0, label_m])
    style = rr.Points3D.from_fields(
        labels=[f"{result.mass_kg:.3f} kg" if data.has_estimate else "rejected"],
        colors=[color],
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log("scene/mass", style, static=True)
    index = at_seconds(seconds)
    columns = rr.Points3D.columns(positions=centers + over)
    stream.send_columns("scene/mass", indexes=[index], columns=columns)
    path = rr.LineStrips3D([centers], colors=[MUTED], radii=screen_radius(0.7))
    stream.log("scene/path", path, static=True)
    style = rr.LineStrips3D.from_fields(colors=[color], radii=screen_radius(1.8))
    stream.log("scene/trail", style, static=True)
    begins = np.searchsorted(seconds, seconds - _TRAIL_S)
    trails = [centers[begin : end + 1] for end, begin in enumerate(begins)]
    columns = rr.LineStrips3D.columns(strips=trails)
    stream.send_columns("scene/trail", indexes=[index], columns=columns)


def _capsules(
    bones: Sequence[tuple[Sequence[float] | Array, Sequence[float] | Array]],
    radii: Sequence[float],
    color: tuple[int, int, int],
) -> rr.Capsules3D:
    """Build capsules between pairs of points [m]."""
    starts = np.array([start for start, _ in bones], np.float64)
    along = np.array([end for _, end in bones], np.float64) - starts
    return rr.Capsules3D(
        lengths=np.linalg.norm(along, axis=1),
        radii=radii,
        translations=starts,
        quaternions=[rr.Quaternion(xyzw=_from_z(bone)) for bone in along],
        colors=[color],
        fill_mode="solid",
    )


def _from_z(along: Array) -> Array:
    """Return the shortest rotation from z to a direction, a quaternion x, y, z, w, shape (4,)."""
    length = float(np.linalg.norm(along))
    if length == 0 or along[2] <= -length * (1 - 1e-9):
        return np.array([1.0, 0.0, 0.0, 0.0]) if length else np.array([0.0, 0.0, 0.0, 1.0])
    x, y, z = along / length
    turn = np.array([-y, x, 0.0, 1 + z])
    return turn / np.linalg.norm(turn)
