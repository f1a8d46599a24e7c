"""Map the message types of others to what they hold: positions, joints, images, commands.

ROS and Foxglove types have the same fields in every encoding, so one line serves them all.
Quaternions are x, y, z, w; a stamp of 0 is not set.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from tunenet_logs.formats.base import RawChannel, UnusableError, ros_stamp_ns, time_ns
from tunenet_logs.formats.ros import ros_name

# Stamp [ns] (0: not set), of what ("": the topic's own), in which frame ("": any); x, y, z [m]; of
# a type with orientations also a unit quaternion x, y, z, w, NaN where the message gives none.
PositionSample = (
    tuple[int, str, str, float, float, float]
    | tuple[int, str, str, float, float, float, float, float, float, float]
)

_NO_ORIENTATION = (math.nan, math.nan, math.nan, math.nan)

_NORM_ERROR = 0.1  # of a quaternion; beyond it, it is none, such as one of zeros
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


# ---- Joints, images, sound, and what drives a robot.


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


# ---- All types, by the name that `type_key` gives; a new one is a line here, and one in `_SHAPES`.

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


# ---- Required fields of each type, for encodings that do not prove a message's type.
# A ROS message decodes only by the definition that we know. A protobuf schema can call anything a
# `foxglove.PoseInFrame`, and JSON can hold anything: there the fields are checked against these.


class Leaf(Enum):
    """A field without subfields; the value describes it in messages."""

    NUMBER = "a number"
    OPTIONAL = "a number that may be absent"
    WHOLE = "a whole number"
    FLAG = "true, false, 1 or 0"
    TEXT = "a text"
    DATA = "bytes"
    TIME = "a time in seconds and nanoseconds"


@dataclass(frozen=True)
class Fields:
    """A message with fields."""

    fields: Mapping[str, Shape]


@dataclass(frozen=True)
class Many:
    """A list of one shape."""

    of: Shape


@dataclass(frozen=True)
class Maybe:
    """A part that a message may lack, or have in another shape."""

    of: Shape


Shape = Leaf | Fields | Many | Maybe  # what a field of a message must be


def shape_of(channel: RawChannel) -> Fields:
    """Return the required shape of the channel's messages.

    Raises:
        UnusableError: its type is not supported in this encoding.
    """
    shape = _SHAPES.get(type_key(channel.type_name))
    if shape is None:
        raise UnusableError(f"its type is not read in {channel.encoding}")
    return shape


def _fields(**fields: Shape) -> Fields:
    return Fields(fields)


# Parts that several types have.
_POINT = _fields(x=Leaf.NUMBER, y=Leaf.NUMBER, z=Leaf.NUMBER)
_TURN = Maybe(_fields(x=Leaf.NUMBER, y=Leaf.NUMBER, z=Leaf.NUMBER, w=Leaf.NUMBER))
_FRAME = Maybe(Leaf.TEXT)
_POSE = _fields(position=_POINT, orientation=_TURN)
_HEADER = _fields(stamp=Leaf.TIME, frame_id=_FRAME)
_ROS_TRANSFORM = _fields(
    header=_HEADER,
    child_frame_id=Leaf.TEXT,
    transform=_fields(translation=_POINT, rotation=_TURN),
)
_TRANSFORM = _fields(
    timestamp=Leaf.TIME,
    parent_frame_id=_FRAME,
    child_frame_id=Leaf.TEXT,
    translation=_POINT,
    rotation=_TURN,
)
_JOINT = _fields(
    name=Leaf.TEXT, position=Leaf.OPTIONAL, velocity=Leaf.OPTIONAL, effort=Leaf.OPTIONAL
)
_PIXELS: dict[str, Shape] = {
    "width": Leaf.WHOLE,
    "height": Leaf.WHOLE,
    "encoding": Leaf.TEXT,
    "step": Leaf.WHOLE,
    "data": Leaf.DATA,
}
_PICTURE = _fields(timestamp=Leaf.TIME, format=Leaf.TEXT, data=Leaf.DATA)
_TRAJECTORY_POINT = _fields(
    positions=Many(Leaf.NUMBER),
    velocities=Many(Leaf.NUMBER),
    effort=Many(Leaf.NUMBER),
    time_from_start=Leaf.TIME,
)
_ONE_NUMBER = _fields(data=Leaf.NUMBER)
_SEVERAL_NUMBERS = _fields(data=Many(Leaf.NUMBER))
_SEVEN_JOINTS = Fields({f"joint{number}": Leaf.NUMBER for number in range(1, 8)})

# The fields that are read of each type, by the name that `type_key` gives.
_SHAPES: dict[str, Fields] = {
    "geometry_msgs/msg/PoseStamped": _fields(header=_HEADER, pose=_POSE),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _fields(
        header=_HEADER, pose=_fields(pose=_POSE)
    ),
    "geometry_msgs/msg/PointStamped": _fields(header=_HEADER, point=_POINT),
    "geometry_msgs/msg/TransformStamped": _ROS_TRANSFORM,
    "nav_msgs/msg/Odometry": _fields(header=_HEADER, pose=_fields(pose=_POSE)),
    "tf2_msgs/msg/TFMessage": _fields(transforms=Many(_ROS_TRANSFORM)),
    "foxglove.PoseInFrame": _fields(timestamp=Leaf.TIME, frame_id=_FRAME, pose=_POSE),
    "foxglove.Point3InFrame": _fields(timestamp=Leaf.TIME, frame_id=_FRAME, point=_POINT),
    "foxglove.Odometry": _fields(timestamp=Leaf.TIME, frame_id=_FRAME, pose=_POSE),
    "foxglove.FrameTransform": _TRANSFORM,
    "foxglove.FrameTransforms": _fields(transforms=Many(_TRANSFORM)),
    "sensor_msgs/msg/JointState": _fields(
        header=_HEADER,
        name=Many(Leaf.TEXT),
        position=Many(Leaf.NUMBER),
        velocity=Many(Leaf.NUMBER),
        effort=Many(Leaf.NUMBER),
    ),
    "foxglove.JointStates": _fields(timestamp=Leaf.TIME, joints=Many(_JOINT)),
    "kinova_msgs/msg/JointAngles": _SEVEN_JOINTS,
    "kinova_msgs/msg/JointTorque": _SEVEN_JOINTS,
    "kinova_msgs/msg/JointVelocity": _SEVEN_JOINTS,
    "trajectory_msgs/msg/JointTrajectory": _fields(
        header=_HEADER, joint_names=Many(Leaf.TEXT), points=Many(_TRAJECTORY_POINT)
    ),
    "std_msgs/msg/Float64MultiArray": _SEVERAL_NUMBERS,
    "std_msgs/msg/Float32MultiArray": _SEVERAL_NUMBERS,
    "std_msgs/msg/Float64": _ONE_NUMBER,
    "std_msgs/msg/Float32": _ONE_NUMBER,
    "geometry_msgs/msg/WrenchStamped": _fields(
        header=_HEADER, wrench=_fields(force=_POINT, torque=_POINT)
    ),
    "sensor_msgs/msg/CompressedImage": _fields(header=_HEADER, format=Leaf.TEXT, data=Leaf.DATA),
    "sensor_msgs/msg/Image": Fields({"header": _HEADER, "is_bigendian": Leaf.FLAG, **_PIXELS}),
    "tunenet_msgs/msg/TaskOutcome": _fields(
        header=_HEADER,
        task=Leaf.TEXT,
        ball=Leaf.TEXT,
        attempt=Leaf.WHOLE,
        success=Leaf.FLAG,
        shot_height=Leaf.OPTIONAL,
        miss_distance=Leaf.OPTIONAL,
        tuned_parameter=Leaf.OPTIONAL,
        drop_log=Leaf.TEXT,
        tuning=Leaf.TEXT,
        reason=Leaf.TEXT,
        note=Leaf.TEXT,
    ),
    "foxglove.CompressedImage": _PICTURE,
    "foxglove.CompressedVideo": _PICTURE,
    "foxglove.RawAudio": _fields(
        timestamp=Leaf.TIME,
        data=Leaf.DATA,
        format=Leaf.TEXT,
        sample_rate=Leaf.WHOLE,
        number_of_channels=Leaf.WHOLE,
    ),
    "foxglove.RawImage": Fields({"timestamp": Leaf.TIME, **_PIXELS}),
}
