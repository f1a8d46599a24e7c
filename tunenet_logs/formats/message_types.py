"""Map the message types of others to what they hold: positions, joints, images, commands.

ROS and Foxglove types have the same fields in every encoding, so one line serves them all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from tunenet_logs.formats.base import RawChannel
from tunenet_logs.formats.position_types import (
    PositionType,
    foxglove_point,
    foxglove_pose,
    foxglove_transform,
    frame_of,
    ros_point,
    ros_pose,
    ros_transform,
    ros_transforms,
)
from tunenet_logs.formats.ros import ros_name
from tunenet_logs.formats.stamps import ros_stamp_ns, time_ns


class JointSample(NamedTuple):
    """Joint states of one message: rad, rad/s, N·m; empty where it gives none."""

    stamp_ns: int
    names: tuple[str, ...]
    position: Sequence[float] | np.ndarray = ()
    velocity: Sequence[float] | np.ndarray = ()
    effort: Sequence[float] | np.ndarray = ()


@dataclass(frozen=True)
class JointType:
    """A type with joint states."""

    read: Callable[[Any], JointSample]


@dataclass(frozen=True, eq=False)
class PictureSample:
    """One message's image; `size` and `step` are those of uncompressed pixels.

    Attributes:
        step: bytes from one row to the next; 0 where rows are contiguous.
    """

    stamp_ns: int
    encoding: str
    data: Any
    size: tuple[int, int] | None = None
    step: int = 0
    is_bigendian: bool = False


@dataclass(frozen=True)
class PictureType:
    """A type with an image.

    Attributes:
        is_video: whether decoding an image needs those before it.
    """

    read: Callable[[Any], PictureSample]
    is_video: bool = False


class SoundSample(NamedTuple):
    """One message's sound.

    Attributes:
        stamp_ns: of the first sample.
        format: of `data`, as Foxglove names it.
        data: the bytes.
        rate_hz: samples per second.
        channels: number of interleaved channels.
    """

    stamp_ns: int
    format: str
    data: Any
    rate_hz: int
    channels: int


@dataclass(frozen=True)
class SoundType:
    """A type with sound."""

    read: Callable[[Any], SoundSample]


# Time after the start [ns]; positions, velocities, efforts, each empty where it does not say.
PlanPoint = tuple[
    int,
    "Sequence[float] | np.ndarray",
    "Sequence[float] | np.ndarray",
    "Sequence[float] | np.ndarray",
]


class PlanSample(NamedTuple):
    """Planned joint trajectory of one message: rad, rad/s, N·m; stamp 0 for "from now on"."""

    stamp_ns: int
    names: tuple[str, ...]
    points: Sequence[PlanPoint]


@dataclass(frozen=True)
class PlanType:
    """A type with a planned joint trajectory, which nobody measured."""

    read: Callable[[Any], PlanSample]


NumbersSample = Sequence[float] | np.ndarray  # numbers of which nobody says what they are


@dataclass(frozen=True)
class NumbersType:
    """A type with plain numbers, without a stamp."""

    read: Callable[[Any], NumbersSample]


# Stamp [ns] (0: not set); in which frame ("": any); force x, y, z [N]; torque x, y, z [N·m].
WrenchSample = tuple[int, str, float, float, float, float, float, float]


@dataclass(frozen=True)
class WrenchType:
    """A type with a force and a torque."""

    read: Callable[[Any], WrenchSample]


DriveType = PlanType | NumbersType | WrenchType  # a type of what drives a robot
# What a type of messages holds.
MessageType = PositionType | JointType | PictureType | SoundType | DriveType


def message_type_of(channel: RawChannel) -> MessageType | None:
    """Return what a channel's type holds; None if nothing that is used."""
    name = type_key(channel.type_name)
    if name in _KINOVA:
        return _kinova(channel.topic if name.endswith("Angles") else name)
    return _MESSAGE_TYPES.get(name)


def type_key(type_name: str) -> str:
    """Return the canonical name of a type, be it written by ROS 1, ROS 2 or Foxglove."""
    name = ros_name(type_name)
    package, _, plain = name.rpartition("/msg/")
    return f"foxglove.{plain}" if package in ("foxglove_msgs", "foxglove") else name


def _joint_state(message: Any) -> JointSample:
    names = tuple(message.name)
    return JointSample(
        ros_stamp_ns(message), names, message.position, message.velocity, message.effort
    )


def _dynamic_joints(message: Any) -> JointSample:
    """Return ros2_control's values by joint and interface; `JointRows` knows these names."""
    parts = list(zip(message.joint_names, message.interface_values, strict=True))
    names = tuple(f"{joint}/{name}" for joint, part in parts for name in part.interface_names)
    values = [np.asarray(part.values, np.float64) for _, part in parts]
    numbers = np.concatenate(values, axis=-1) if values else np.empty(0)
    return JointSample(ros_stamp_ns(message), names, numbers, numbers[..., :0], numbers[..., :0])


def _foxglove_joints(message: Any) -> JointSample:
    def values(field: str) -> list[float]:
        found = [_optional(joint, field) for joint in message.joints]
        return found if any(value == value for value in found) else []  # noqa: PLR0124 (NaN)

    names = tuple(joint.name for joint in message.joints)
    stamp_ns = time_ns(message.timestamp)
    return JointSample(stamp_ns, names, values("position"), values("velocity"), values("effort"))


def _optional(joint: Any, field: str) -> float:
    if hasattr(joint, "HasField") and not joint.HasField(field):
        return float("nan")
    value = getattr(joint, field, None)
    return float("nan") if value is None else float(value)


# Seven numbers in the same fields, in degrees where they are angles; without a header.
_KINOVA = frozenset(
    ("kinova_msgs/msg/JointAngles", "kinova_msgs/msg/JointTorque", "kinova_msgs/msg/JointVelocity")
)

# The fields of these, and what the joints are called.
_KINOVA_NAMES = tuple(f"joint{number}" for number in range(1, 8))


def _kinova(name: str) -> JointType:
    """Return the reader of Kinova's headerless messages in degrees; the topic marks torques."""
    last = name.rpartition("/")[2].lower()

    def read(message: Any) -> JointSample:
        values = np.array([getattr(message, name) for name in _KINOVA_NAMES], np.float64)
        if "torque" in last:
            return JointSample(0, _KINOVA_NAMES, effort=values)
        if "velocity" in last:
            return JointSample(0, _KINOVA_NAMES, velocity=np.radians(values))
        return JointSample(0, _KINOVA_NAMES, position=np.radians(values))

    return JointType(read)


def _trajectory(message: Any) -> PlanSample:
    points = [
        (time_ns(point.time_from_start), point.positions, point.velocities, point.effort)
        for point in message.points
    ]
    return PlanSample(ros_stamp_ns(message), tuple(message.joint_names), points)


def _wrench(message: Any) -> WrenchSample:
    force, torque = message.wrench.force, message.wrench.torque
    parts = (force.x, force.y, force.z, torque.x, torque.y, torque.z)
    x, y, z, around_x, around_y, around_z = map(float, parts)
    return ros_stamp_ns(message), frame_of(message.header), x, y, z, around_x, around_y, around_z


_NUMBERS = NumbersType(attrgetter("data"))
_NUMBER = NumbersType(lambda message: (float(message.data),))


def _compressed_image(message: Any) -> PictureSample:
    return PictureSample(ros_stamp_ns(message), message.format, message.data)


def _image(message: Any) -> PictureSample:
    return _raw(ros_stamp_ns(message), message, bool(message.is_bigendian))


def _raw(stamp_ns: int, message: Any, is_bigendian: bool = False) -> PictureSample:
    size = (int(message.width), int(message.height))
    encoding, step = str(message.encoding), int(message.step)
    return PictureSample(stamp_ns, encoding, message.data, size, step, is_bigendian)


def _foxglove_image(message: Any) -> PictureSample:
    return PictureSample(time_ns(message.timestamp), message.format, message.data)


def _raw_audio(message: Any) -> SoundSample:
    rate_hz, channels = int(message.sample_rate), int(message.number_of_channels)
    stamp_ns = time_ns(message.timestamp)
    return SoundSample(stamp_ns, message.format, message.data, rate_hz, channels)


# By the name that `type_key` gives; a new type is one line here, and one in `shapes.py`.
_MESSAGE_TYPES: dict[str, MessageType] = {
    "geometry_msgs/msg/PoseStamped": ros_pose("pose"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": ros_pose("pose.pose"),
    "geometry_msgs/msg/PointStamped": ros_point("point"),
    "geometry_msgs/msg/TransformStamped": PositionType(ros_transform, names_one=True),
    "nav_msgs/msg/Odometry": ros_pose("pose.pose"),
    "tf2_msgs/msg/TFMessage": PositionType(ros_transforms),
    "foxglove.PoseInFrame": PositionType(foxglove_pose),
    "foxglove.Point3InFrame": PositionType(foxglove_point),
    "foxglove.Odometry": PositionType(foxglove_pose),
    "foxglove.FrameTransform": PositionType(lambda message: (foxglove_transform(message),)),
    "foxglove.FrameTransforms": PositionType(
        lambda message: [foxglove_transform(transform) for transform in message.transforms]
    ),
    "sensor_msgs/msg/JointState": JointType(_joint_state),
    "control_msgs/msg/DynamicJointState": JointType(_dynamic_joints),
    "foxglove.JointStates": JointType(_foxglove_joints),
    "trajectory_msgs/msg/JointTrajectory": PlanType(_trajectory),
    "std_msgs/msg/Float64MultiArray": _NUMBERS,
    "std_msgs/msg/Float32MultiArray": _NUMBERS,
    "std_msgs/msg/Float64": _NUMBER,
    "std_msgs/msg/Float32": _NUMBER,
    "geometry_msgs/msg/WrenchStamped": WrenchType(_wrench),
    "sensor_msgs/msg/CompressedImage": PictureType(_compressed_image),
    "sensor_msgs/msg/Image": PictureType(_image),
    "foxglove.CompressedImage": PictureType(_foxglove_image),
    "foxglove.RawImage": PictureType(lambda message: _raw(time_ns(message.timestamp), message)),
    "foxglove.CompressedVideo": PictureType(_foxglove_image, is_video=True),
    "foxglove.RawAudio": SoundType(_raw_audio),
}
