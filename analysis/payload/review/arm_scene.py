"""The 3D scene: the arm along its measured path, with what it holds."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.payload.review.story import PayloadReviewData
from analysis.review.colors import MUTED
from analysis.review.sending import at_seconds, screen_radius
from recorders.simulators.arm.description import Arm
from recorders.simulators.arm.frames import rotation_from_rpy
from recorders.simulators.arm.kinematics import LinkPoses, link_poses
from tunenet_logs.arrays import Array

_GROUND = (16, 18, 24)
_LINES = (52, 55, 64)
_ARM = (150, 156, 170)
_JOINT = (92, 98, 114)
_GRIPPER = (205, 208, 214)
_AXES = ((230, 90, 90), (110, 200, 110), (100, 150, 255))

_THICK, _THIN = 0.042, 0.026
"""Radii of the first link and of the last one; like all sizes here in reaches of the arm."""
_PALM = 0.5
"""Share of the way to the tool frame."""
_GRIP, _FINGER = 0.3, 0.010
"""Half of the fingers' distance, in lengths of the gripper; their radius."""
_SMALLEST, _LARGEST = 0.018, 0.15
_WATER_KG_M3 = 1000.0
_TILES = 5
_TILE = 0.3
_AXIS = 0.28
_TRAIL_S = 1.0
_LABEL = 0.055

_UP_RAD, _ASIDE_RAD = 0.35, 0.85
_HALF_ACROSS, _HALF_UP = 0.36, 0.5
"""Tangents of half of what the camera sees."""
_ROOM = 0.04
_MOST_HZ = 30.0
_LEVEL = 0.3
"""A path's normal less horizontal than this: it is seen from the arm's side."""


def log_arm(stream: rr.RecordingStream, story: PayloadReviewData) -> None:
    """Send the entities of `arm_view`."""
    poses = _poses(story)
    seconds = story.seconds[_kept(story)]
    reach_m = _reach_m(story.arm)
    stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _log_ground(stream, reach_m)
    _log_links(stream, story.arm, reach_m)
    for frame in range(1, poses.position_m.shape[1]):
        columns = rr.Transform3D.columns(
            translation=poses.position_m[:, frame], mat3x3=poses.rotation[:, frame]
        )
        place = _frame(story.arm, frame)
        stream.send_columns(place, indexes=[at_seconds(seconds)], columns=columns)
    if any(one.is_prismatic for one in story.arm.joints):
        _log_slides(stream, seconds, poses, reach_m)
    _log_payload(stream, story, seconds, poses)


def arm_view(story: PayloadReviewData) -> rrb.View:
    """The camera stands where the path is seen from its front, and all of the arm fits."""
    poses = _poses(story)
    places = poses.position_m.reshape(-1, 3)
    middle = (places.min(axis=0) + places.max(axis=0)) / 2
    towards = _towards_eye(poses)
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    reach_m = _reach_m(story.arm)
    room_m = payload_radius_m(story.result.mass_kg, reach_m) + _ROOM * reach_m
    off = places - middle
    needed = [
        (np.abs(off @ across) + room_m) / half + off @ towards
        for across, half in ((right, _HALF_ACROSS), (np.cross(towards, right), _HALF_UP))
    ]
    eye = middle + float(np.max(needed)) * towards
    return rrb.Spatial3DView(
        origin="/scene",
        name="the arm along its measured path",
        background=_GROUND,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            position=eye.tolist(), look_target=middle.tolist(), eye_up=(0.0, 0.0, 1.0)
        ),
    )


def payload_radius_m(mass_kg: float, reach_m: float) -> float:
    """Of a ball of water of that mass, as far as it can be seen beside the arm."""
    water_m = (3 * max(mass_kg, 0.0) / (4 * math.pi * _WATER_KG_M3)) ** (1 / 3)
    return min(max(water_m, _SMALLEST * reach_m), _LARGEST * reach_m)


def _kept(story: PayloadReviewData) -> slice:
    """Samples that are shown: a motion looks smooth with fewer than a curve."""
    return slice(None, None, max(1, round(story.rate_hz / _MOST_HZ)))


def _poses(story: PayloadReviewData) -> LinkPoses:
    return link_poses(story.arm, story.position_rad[_kept(story)])


def _frame(arm: Arm, frame: int) -> str:
    return "scene/arm/tool" if frame == len(arm.joints) + 1 else f"scene/arm/link_{frame}"


def _reach_m(arm: Arm) -> float:
    """The arm's length along its joints."""
    steps = [one.origin_m for one in arm.joints] + [arm.tool_from_last_m]
    return max(sum(math.hypot(*one) for one in steps), 1e-3)


def _towards_eye(poses: LinkPoses) -> Array:
    """A unit vector from the scene to its camera."""
    tool = poses.position_m[:, -1]
    normal = np.linalg.svd(tool - tool.mean(axis=0))[2][2] if len(tool) > 2 else np.zeros(3)
    flat = normal[:2]
    if np.linalg.norm(flat) < _LEVEL:
        out = tool.mean(axis=0)[:2]
        flat = np.array([out[1], -out[0]]) if np.linalg.norm(out) > 0 else np.array([0.0, -1.0])
    if flat @ tool.mean(axis=0)[:2] < 0:
        flat = -flat
    azimuth = math.atan2(flat[1], flat[0]) + _ASIDE_RAD
    level = math.cos(_UP_RAD)
    return np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(_UP_RAD)])


def _log_ground(stream: rr.RecordingStream, reach_m: float) -> None:
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


def _log_links(stream: rr.RecordingStream, arm: Arm, reach_m: float) -> None:
    """Each link from its own joint to the next one, in its own frame."""
    ends = [one.origin_m for one in arm.joints]
    radii = np.linspace(_THICK, _THIN, len(ends) + 1) * reach_m
    stream.log("scene/arm/base", _capsules([((0, 0, 0), ends[0])], [radii[0]], _ARM), static=True)
    for number, radius in enumerate(radii[1:], start=1):
        place = f"scene/arm/link_{number}"
        if number < len(ends):
            parts = [((0, 0, 0), ends[number])]
            stream.log(place, _capsules(parts, [radius], _ARM), static=True)
        else:
            _log_gripper(stream, arm, place, radius, reach_m)
        hinge = rr.Ellipsoids3D(
            half_sizes=[[1.25 * radius] * 3], colors=[_JOINT], fill_mode="solid"
        )
        stream.log(f"{place}/joint", hinge, static=True)
        label = rr.Points3D(
            [[0, 0, 0]],
            labels=[str(number)],
            colors=[MUTED],
            radii=screen_radius(0.1),
            show_labels=True,
        )
        stream.log(f"{place}/number", label, static=True)


def _log_gripper(
    stream: rr.RecordingStream, arm: Arm, place: str, radius: float, reach_m: float
) -> None:
    """A palm and two fingers up to the tool frame, in the last link's."""
    tip = np.array(arm.tool_from_last_m)
    length = float(np.linalg.norm(tip))
    if length < 1e-3 * reach_m:
        return
    axes = rotation_from_rpy(arm.tool_from_last_rpy)
    aside = next((one for one in axes.T[[1, 2]] if abs(one @ tip) < 0.7 * length), axes[:, 0])
    aside = aside - (aside @ tip) / length**2 * tip
    aside *= _GRIP * length / np.linalg.norm(aside)
    palm = _PALM * tip
    stream.log(place, _capsules([((0, 0, 0), palm)], [radius], _ARM), static=True)
    fingers = [(palm + side * aside, tip + side * aside) for side in (-1, 1)]
    bones = [(palm - aside, palm + aside), *fingers]
    widths = [_FINGER * reach_m] * len(bones)
    stream.log(f"{place}/gripper", _capsules(bones, widths, _GRIPPER), static=True)


def _log_slides(
    stream: rr.RecordingStream, seconds: Array, poses: LinkPoses, reach_m: float
) -> None:
    """What joins the links of an arm whose joints slide."""
    strips = poses.position_m.astype(np.float32)
    style = rr.LineStrips3D.from_fields(colors=[_JOINT], radii=[_FINGER * reach_m])
    stream.log("scene/slides", style, static=True)
    columns = rr.LineStrips3D.columns(strips=list(strips))
    stream.send_columns("scene/slides", indexes=[at_seconds(seconds)], columns=columns)


def _log_payload(
    stream: rr.RecordingStream, story: PayloadReviewData, seconds: Array, poses: LinkPoses
) -> None:
    reach_m = _reach_m(story.arm)
    result, at_m = story.result, np.array(story.com_m)
    radius_m = payload_radius_m(result.mass_kg, reach_m)
    color = result.color if story.is_told else MUTED
    ball = rr.Ellipsoids3D(
        centers=[at_m], half_sizes=[[radius_m] * 3], colors=[color], fill_mode="solid"
    )
    stream.log("scene/arm/tool/payload", ball, static=True)
    centers = poses.position_m[:, -1] + poses.rotation[:, -1] @ at_m
    over = np.array([0.0, 0.0, radius_m + _LABEL * reach_m])
    style = rr.Points3D.from_fields(
        labels=[f"{result.mass_kg:.3f} kg" if story.is_told else "rejected"],
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
    """From point to point."""
    starts = np.array([start for start, _ in bones], np.float64)
    along = np.array([end for _, end in bones], np.float64) - starts
    return rr.Capsules3D(
        lengths=np.linalg.norm(along, axis=1),
        radii=radii,
        translations=starts,
        quaternions=[rr.Quaternion(xyzw=_from_z(one)) for one in along],
        colors=[color],
        fill_mode="solid",
    )


def _from_z(along: Array) -> Array:
    """The shortest turn from z to a direction, as a quaternion x, y, z, w."""
    length = float(np.linalg.norm(along))
    if length == 0 or along[2] <= -length * (1 - 1e-9):
        return np.array([1.0, 0.0, 0.0, 0.0]) if length else np.array([0.0, 0.0, 0.0, 1.0])
    x, y, z = along / length
    turn = np.array([-y, x, 0.0, 1 + z])
    return turn / np.linalg.norm(turn)
