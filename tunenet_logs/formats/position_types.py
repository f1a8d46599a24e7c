"""Extract positions, orientations and their frames from messages of ROS and Foxglove types."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from tunenet_logs.formats.stamps import ros_stamp_ns, time_ns

# Stamp [ns] (0: not set), of what ("": the topic's own), in which frame ("": any); x, y, z [m]; of
# a type with orientations also a unit quaternion x, y, z, w, NaN where the message gives none.
PositionSample = (
    tuple[int, str, str, float, float, float]
    | tuple[int, str, str, float, float, float, float, float, float, float]
)

_NO_ORIENTATION = (math.nan, math.nan, math.nan, math.nan)

_NORM_ERROR = 0.1  # of a quaternion, beyond which it is none, such as one of zeros
_MAX_FRAME = 200  # characters of a frame's name


@dataclass(frozen=True)
class PositionType:
    """A type with positions.

    Attributes:
        names_one: whether a message is of one body, whose name counts only among several.
    """

    read: Callable[[Any], Iterable[PositionSample]]
    names_one: bool = False


def frame_of(message: Any, name: str = "frame_id") -> str:
    """Return the frame name of a message or a header; "" where it has none."""
    frame = getattr(message, name, None)
    return frame[:_MAX_FRAME] if isinstance(frame, str) else ""


def ros_point(path: str) -> PositionType:
    """Return the reader of a type with a header, and a point at `path`."""
    point_of = attrgetter(path)

    def read(message: Any) -> Iterable[PositionSample]:
        point, header = point_of(message), message.header
        yield (
            ros_stamp_ns(message),
            "",
            frame_of(header),
            float(point.x),
            float(point.y),
            float(point.z),
        )

    return PositionType(read)


def ros_pose(path: str) -> PositionType:
    """Return the reader of a type with a header, and a pose at `path`."""
    pose_of = attrgetter(path)

    def read(message: Any) -> Iterable[PositionSample]:
        pose = pose_of(message)
        turn = _quaternion(getattr(pose, "orientation", None))
        name = frame_of(message, "child_frame_id")  # of odometry; a pose has none
        yield _placed(ros_stamp_ns(message), name, frame_of(message.header), pose.position, turn)

    return PositionType(read, names_one=True)


def ros_transform(message: Any) -> Iterable[PositionSample]:
    """Yield the pose of a ROS transform."""
    yield _ros_transform(message, frame_of(message, "child_frame_id"))


def ros_transforms(message: Any) -> Iterable[PositionSample]:
    """Return the poses of several ROS transforms, by child frame."""
    return [_ros_transform(one, one.child_frame_id) for one in message.transforms]


def foxglove_point(message: Any) -> Iterable[PositionSample]:
    """Yield the position of a Foxglove point."""
    point = message.point
    where = (float(point.x), float(point.y), float(point.z))
    yield time_ns(message.timestamp), "", frame_of(message), *where


def foxglove_pose(message: Any) -> Iterable[PositionSample]:
    """Yield the pose of a Foxglove message."""
    pose = message.pose
    turn = _quaternion(getattr(pose, "orientation", None))
    yield _placed(time_ns(message.timestamp), "", frame_of(message), pose.position, turn)


def foxglove_transform(transform: Any) -> PositionSample:
    """Return the pose of a Foxglove transform, by child frame."""
    parent = frame_of(transform, "parent_frame_id")
    turn = _quaternion(getattr(transform, "rotation", None))
    stamp_ns = time_ns(transform.timestamp)
    return _placed(stamp_ns, transform.child_frame_id, parent, transform.translation, turn)


def _ros_transform(message: Any, name: str) -> PositionSample:
    transform = message.transform
    turn = _quaternion(getattr(transform, "rotation", None))
    parent = frame_of(message.header)
    return _placed(ros_stamp_ns(message), name, parent, transform.translation, turn)


def _placed(
    stamp_ns: int, name: str, frame: str, point: Any, turn: tuple[float, float, float, float]
) -> PositionSample:
    return stamp_ns, name, frame, float(point.x), float(point.y), float(point.z), *turn


def _quaternion(part: Any) -> tuple[float, float, float, float]:
    """Return x, y, z, w; NaN where a message has no unit quaternion."""
    try:
        x, y, z, w = float(part.x), float(part.y), float(part.z), float(part.w)
    except (AttributeError, TypeError, ValueError):
        return _NO_ORIENTATION
    is_unit = abs(math.hypot(x, y, z, w) - 1.0) < _NORM_ERROR
    return (x, y, z, w) if is_unit else _NO_ORIENTATION
