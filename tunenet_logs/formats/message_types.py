"""Map the message types of others to what they hold: positions, joints, images, commands.

ROS and Foxglove types have the same fields in every encoding, so one row of `TYPES` serves them
all. Quaternions are x, y, z, w; a stamp of 0 is not set.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from typing import Any, Literal, NamedTuple

import numpy as np

from tunenet_logs import messages
from tunenet_logs.formats.base import (
    Listed,
    Maybe,
    Node,
    Plain,
    RawChannel,
    Structure,
    ros_stamp_ns,
    time_ns,
    type_key,
)


@dataclass(frozen=True)
class MessageType:
    """A type of messages."""

    # several `PositionSample`, a `JointSample`, two of these (measured and commanded), a
    # `PictureSample`, a `SoundSample`; of what drives a robot, a `PlanSample`, plain numbers
    # without a stamp, a `WrenchSample`; our `TaskOutcome`
    holds: Literal[
        "positions",
        "joints",
        "controller",
        "picture",
        "sound",
        "plan",
        "numbers",
        "wrench",
        "outcome",
    ]
    read: Callable[[Any], Any]  # gives that of a decoded message
    # that are read; a type or message without them is not used. Neither a protobuf schema nor JSON
    # proves what it is called
    fields: Structure
    definition: str = ""  # in ROS, of a type that no distribution defines
    # whether a message with positions is of one body, whose name counts only among several
    names_one: bool = False
    is_video: bool = False  # whether decoding a picture needs those before it

    @property
    def is_media(self) -> bool:
        """Whether it holds pictures or sound, which are read on demand."""
        return self.holds in ("picture", "sound")


# ---- What messages hold.

Values = Sequence[float] | np.ndarray
# Stamp [ns] (0: not set), of what ("": the topic's own), in which frame ("": any); x, y, z [m]; of
# a type with orientations also a unit quaternion x, y, z, w, NaN where the message gives none.
PositionSample = (
    tuple[int, str, str, float, float, float]
    | tuple[int, str, str, float, float, float, float, float, float, float]
)
# Stamp [ns] (0: not set); in which frame ("": any); force x, y, z [N]; torque x, y, z [N·m].
WrenchSample = tuple[int, str, float, float, float, float, float, float]
# Time after the start [ns]; positions, velocities, efforts, each empty where it does not say.
PlanPoint = tuple[int, Values, Values, Values]


class JointSample(NamedTuple):
    """Joint states of one message: rad, rad/s, N·m; empty where it gives none."""

    stamp_ns: int
    names: tuple[str, ...]
    position: Values = ()
    velocity: Values = ()
    effort: Values = ()


class PlanSample(NamedTuple):
    """Planned joint trajectory of one message: rad, rad/s, N·m; stamp 0 for "from now on"."""

    stamp_ns: int
    names: tuple[str, ...]
    points: Sequence[PlanPoint]


@dataclass(frozen=True, eq=False)
class PictureSample:
    """One message's image; `size` and `step` are those of uncompressed pixels."""

    stamp_ns: int
    encoding: str
    data: Any
    size: tuple[int, int] | None = None
    step: int = 0  # bytes from one row to the next; 0 where rows are contiguous
    is_bigendian: bool = False


class SoundSample(NamedTuple):
    """One message's sound; the stamp is that of its first sample, the format Foxglove's name."""

    stamp_ns: int
    format: str
    data: Any
    rate_hz: int
    channels: int


# ---- Read each of them.

_NO_ORIENTATION = (math.nan, math.nan, math.nan, math.nan)


def frame_of(message: Any, name: str = "frame_id") -> str:
    """Return the frame name of a message or a header; "" where it has none."""
    frame = getattr(message, name, None)
    return frame[:200] if isinstance(frame, str) else ""


def _of_ros(message: Any) -> tuple[int, str]:
    return ros_stamp_ns(message), frame_of(message.header)


def _of_foxglove(message: Any) -> tuple[int, str]:
    return time_ns(message.timestamp), frame_of(message)


def _point(path: str, origin: Callable[[Any], tuple[int, str]]) -> Callable[[Any], Any]:
    """Return the reader of a point at `path`."""
    point_of = attrgetter(path)

    def read(message: Any) -> Iterable[PositionSample]:
        point, (stamp_ns, frame) = point_of(message), origin(message)
        return ((stamp_ns, "", frame, *_xyz(point)),)

    return read


def _pose(path: str, origin: Callable[[Any], tuple[int, str]]) -> Callable[[Any], Any]:
    """Return the reader of a pose at `path`; odometry names its body, too."""
    pose_of = attrgetter(path)

    def read(message: Any) -> Iterable[PositionSample]:
        pose = pose_of(message)
        turn = getattr(pose, "orientation", None)
        name = frame_of(message, "child_frame_id")
        return (_placed(*origin(message), name, pose.position, turn),)

    return read


def _ros_transform(message: Any) -> PositionSample:
    part, name = message.transform, frame_of(message, "child_frame_id")
    return _placed(*_of_ros(message), name, part.translation, getattr(part, "rotation", None))


def _foxglove_transform(message: Any) -> PositionSample:
    parent, name = frame_of(message, "parent_frame_id"), frame_of(message, "child_frame_id")
    turn = getattr(message, "rotation", None)
    return _placed(time_ns(message.timestamp), parent, name, message.translation, turn)


def _placed(stamp_ns: int, frame: str, name: str, point: Any, turn: Any) -> PositionSample:
    """Return a sample, without orientation where `turn` is no unit quaternion, as one of zeros."""
    if isinstance(point.x, np.ndarray):  # of many messages
        four = np.full((4, len(point.x)), np.nan)
        with suppress(AttributeError, TypeError, ValueError):
            four[:] = turn.x, turn.y, turn.z, turn.w
        with np.errstate(over="ignore", invalid="ignore"):
            is_unit = np.abs(np.sqrt((four**2).sum(axis=0)) - 1.0) < 0.1
        return stamp_ns, name, frame, *_xyz(point), *np.where(is_unit, four, np.nan)
    try:
        parts = float(turn.x), float(turn.y), float(turn.z), float(turn.w)
    except (AttributeError, TypeError, ValueError):
        parts = _NO_ORIENTATION
    if not abs(math.hypot(*parts) - 1.0) < 0.1:  # NaN, too
        parts = _NO_ORIENTATION
    return stamp_ns, name, frame, *_xyz(point), *parts


def _xyz(point: Any) -> tuple[Any, Any, Any]:
    """Return its three numbers, or arrays of those of many messages."""
    if isinstance(point.x, np.ndarray):
        return point.x, point.y, point.z
    return float(point.x), float(point.y), float(point.z)


def _joint_state(message: Any) -> JointSample:
    given = message.position, message.velocity, message.effort
    return JointSample(ros_stamp_ns(message), tuple(message.name), *given)


def _dynamic_joints(message: Any) -> JointSample:
    """Return ros2_control's values by joint and interface; `JointRows` knows these names."""
    parts = list(zip(message.joint_names, message.interface_values, strict=True))
    names = tuple(f"{joint}/{name}" for joint, part in parts for name in part.interface_names)
    values = [np.asarray(part.values, np.float64) for _, part in parts]
    numbers = np.concatenate(values, axis=-1) if values else np.empty(0)
    return JointSample(ros_stamp_ns(message), names, numbers, numbers[..., :0], numbers[..., :0])


def _foxglove_joints(message: Any) -> JointSample:
    def values(field: str) -> list[float]:
        found = []
        for joint in message.joints:
            is_absent = hasattr(joint, "HasField") and not joint.HasField(field)
            value = None if is_absent else getattr(joint, field, None)
            found.append(math.nan if value is None else float(value))
        return [] if all(map(math.isnan, found)) else found

    names = tuple(joint.name for joint in message.joints)
    stamp_ns = time_ns(message.timestamp)
    return JointSample(stamp_ns, names, values("position"), values("velocity"), values("effort"))


# Seven numbers, in degrees where they are angles, without a header: what Kinova's fields are called
# and so its joints.
_KINOVA_NAMES = tuple(f"joint{number}" for number in range(1, 8))


def _kinova(quantity: str) -> Callable[[Any], JointSample]:
    def read(message: Any) -> JointSample:
        values = np.array([getattr(message, name) for name in _KINOVA_NAMES], np.float64)
        values = values if quantity == "effort" else np.radians(values)
        return JointSample(0, _KINOVA_NAMES, **{quantity: values})

    return read


def _trajectory(message: Any) -> PlanSample:
    points = [
        (time_ns(point.time_from_start), point.positions, point.velocities, point.effort)
        for point in message.points
    ]
    return PlanSample(ros_stamp_ns(message), tuple(message.joint_names), points)


def _controller_state(message: Any) -> tuple[JointSample, JointSample]:
    """Return what ros2_control's trajectory controller measured, and what it asked for."""
    stamp_ns, names = ros_stamp_ns(message), tuple(message.joint_names)

    def sample(*fields: str) -> JointSample:
        points = (getattr(message, field, None) for field in fields)
        point = next((one for one in points if one is not None), None)
        if point is None:
            raise ValueError(f"it has no {fields[0]}")
        return JointSample(stamp_ns, names, point.positions, point.velocities, point.effort)

    # As it was called until ROS 2 Humble, too.
    return sample("feedback", "actual"), sample("reference", "desired")


def _wrench(message: Any) -> WrenchSample:
    force, torque = message.wrench.force, message.wrench.torque
    x, y, z = float(force.x), float(force.y), float(force.z)
    return *_of_ros(message), x, y, z, float(torque.x), float(torque.y), float(torque.z)


def _pixels(stamp_ns: int, message: Any, is_bigendian: bool = False) -> PictureSample:
    size = (int(message.width), int(message.height))
    encoding, step = str(message.encoding), int(message.step)
    return PictureSample(stamp_ns, encoding, message.data, size, step, is_bigendian)


def _raw_audio(message: Any) -> SoundSample:
    rate_hz, channels = int(message.sample_rate), int(message.number_of_channels)
    stamp_ns = time_ns(message.timestamp)
    return SoundSample(stamp_ns, message.format, message.data, rate_hz, channels)


# ---- All types, by the name that `type_key` gives; a new one is a row here.


def _fields(parts: Mapping[str, Node] | None = None, /, **more: Node) -> Structure:
    return Structure("", {**(parts or {}), **more})


# Parts that several types have.
_NUMBERS = Listed(Plain.NUMBER)
_TEXTS = Listed(Plain.TEXT)
_XYZ = _fields(x=Plain.NUMBER, y=Plain.NUMBER, z=Plain.NUMBER)
_TURN = Maybe(_fields(_XYZ.fields, w=Plain.NUMBER))
_POSE = _fields(position=_XYZ, orientation=_TURN)
_FRAME = Maybe(Plain.TEXT)
_HEADER = {"header": _fields(stamp=Plain.TIME, frame_id=_FRAME)}
_STAMP = {"timestamp": Plain.TIME}
_ORIGIN = {**_STAMP, "frame_id": _FRAME}
_MOVED = {"translation": _XYZ, "rotation": _TURN}
_ROS_TRANSFORM = _fields(_HEADER, child_frame_id=Plain.TEXT, transform=_fields(_MOVED))
_TRANSFORM = _fields(_STAMP, parent_frame_id=_FRAME, child_frame_id=Plain.TEXT, **_MOVED)
_JOINT = _fields(dict.fromkeys(("position", "velocity", "effort"), Plain.OPTIONAL), name=Plain.TEXT)
_INTERFACE = _fields(interface_names=_TEXTS, values=_NUMBERS)
_SEVEN = _fields(dict.fromkeys(_KINOVA_NAMES, Plain.NUMBER))
_PICTURE = {"format": Plain.TEXT, "data": Plain.DATA}
_PIXELS: dict[str, Node] = dict.fromkeys(("width", "height", "step"), Plain.WHOLE)
_PIXELS |= {"encoding": Plain.TEXT, "data": Plain.DATA}
_POINT_FIELDS = ("positions", "velocities", "effort")
_PLAN_POINT = _fields(dict.fromkeys(_POINT_FIELDS, _NUMBERS), time_from_start=Plain.TIME)
_CONTROLLER: dict[str, Node] = dict.fromkeys(
    ("feedback", "actual", "reference", "desired"),
    Maybe(_fields(dict.fromkeys(_POINT_FIELDS, _NUMBERS))),
)
_OUTCOME: dict[str, Node] = dict.fromkeys(
    ("task", "ball", "drop_log", "tuning", "reason", "note"), Plain.TEXT
)
_OUTCOME |= dict.fromkeys(("shot_height", "miss_distance", "tuned_parameter"), Plain.OPTIONAL)
_OUTCOME |= {"attempt": Plain.WHOLE, "success": Plain.FLAG}
# Foxglove's types as ROS messages; they begin alike.
_FOXGLOVE = "builtin_interfaces/Time timestamp\nstring frame_id\n"
_FOXGLOVE_TRANSFORM = """\
builtin_interfaces/Time timestamp
string parent_frame_id
string child_frame_id
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
"""
_DYNAMIC_JOINTS = f"""\
std_msgs/Header header
string[] joint_names
control_msgs/InterfaceValue[] interface_values
{"=" * 80}
MSG: control_msgs/InterfaceValue
string[] interface_names
float64[] values
"""
_positions = partial(MessageType, "positions")
_joints = partial(MessageType, "joints")
_picture = partial(MessageType, "picture")
_ROS_POSE, _FOXGLOVE_POSE = _pose("pose", _of_ros), _pose("pose", _of_foxglove)
_POSE_FIELDS = _fields(_ORIGIN, pose=_POSE)
_ODOMETRY = _positions(
    _pose("pose.pose", _of_ros), _fields(_HEADER, pose=_fields(pose=_POSE)), names_one=True
)
_NUMBER = MessageType("numbers", lambda message: (float(message.data),), _fields(data=Plain.NUMBER))
_ARRAY = MessageType("numbers", attrgetter("data"), _fields(data=_NUMBERS))
_FOXGLOVE_PICTURE = _picture(
    lambda message: PictureSample(time_ns(message.timestamp), message.format, message.data),
    _fields(_STAMP, **_PICTURE),
    messages.VIDEO_FIELDS,
)
_KINOVA = {"Angles": "position", "Torque": "effort", "Velocity": "velocity"}
TYPES: dict[str, MessageType] = {
    "geometry_msgs/msg/PoseStamped": _positions(
        _ROS_POSE, _fields(_HEADER, pose=_POSE), names_one=True
    ),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _ODOMETRY,
    "nav_msgs/msg/Odometry": _ODOMETRY,
    "geometry_msgs/msg/PointStamped": _positions(
        _point("point", _of_ros), _fields(_HEADER, point=_XYZ)
    ),
    "geometry_msgs/msg/TransformStamped": _positions(
        lambda message: (_ros_transform(message),), _ROS_TRANSFORM, names_one=True
    ),
    "tf2_msgs/msg/TFMessage": _positions(
        lambda message: [*map(_ros_transform, message.transforms)],
        _fields(transforms=Listed(_ROS_TRANSFORM)),
        "geometry_msgs/TransformStamped[] transforms",  # of ROS 1, where it is another package's
    ),
    "foxglove.PoseInFrame": _positions(
        _FOXGLOVE_POSE, _POSE_FIELDS, f"{_FOXGLOVE}geometry_msgs/Pose pose"
    ),
    "foxglove.Odometry": _positions(_FOXGLOVE_POSE, _POSE_FIELDS),
    "foxglove.Point3InFrame": _positions(
        _point("point", _of_foxglove),
        _fields(_ORIGIN, point=_XYZ),
        f"{_FOXGLOVE}geometry_msgs/Point point",
    ),
    "foxglove.FrameTransform": _positions(
        lambda message: (_foxglove_transform(message),), _TRANSFORM, _FOXGLOVE_TRANSFORM
    ),
    "foxglove.FrameTransforms": _positions(
        lambda message: [*map(_foxglove_transform, message.transforms)],
        _fields(transforms=Listed(_TRANSFORM)),
        "foxglove_msgs/FrameTransform[] transforms",
    ),
    "sensor_msgs/msg/JointState": _joints(
        _joint_state,
        _fields(_HEADER, name=_TEXTS, position=_NUMBERS, velocity=_NUMBERS, effort=_NUMBERS),
    ),
    "control_msgs/msg/DynamicJointState": _joints(
        _dynamic_joints,
        _fields(_HEADER, joint_names=_TEXTS, interface_values=Listed(_INTERFACE)),
        _DYNAMIC_JOINTS,
    ),
    "control_msgs/msg/JointTrajectoryControllerState": MessageType(
        "controller", _controller_state, _fields(_HEADER, joint_names=_TEXTS, **_CONTROLLER)
    ),
    "foxglove.JointStates": _joints(_foxglove_joints, _fields(_STAMP, joints=Listed(_JOINT))),
    **{
        f"kinova_msgs/msg/Joint{name}": _joints(_kinova(what), _SEVEN, messages.SEVEN_JOINTS)
        for name, what in _KINOVA.items()
    },
    "trajectory_msgs/msg/JointTrajectory": MessageType(
        "plan", _trajectory, _fields(_HEADER, joint_names=_TEXTS, points=Listed(_PLAN_POINT))
    ),
    "std_msgs/msg/Float64MultiArray": _ARRAY,
    "std_msgs/msg/Float32MultiArray": _ARRAY,
    "std_msgs/msg/Float64": _NUMBER,
    "std_msgs/msg/Float32": _NUMBER,
    "geometry_msgs/msg/WrenchStamped": MessageType(
        "wrench", _wrench, _fields(_HEADER, wrench=_fields(force=_XYZ, torque=_XYZ))
    ),
    "sensor_msgs/msg/CompressedImage": _picture(
        lambda message: PictureSample(ros_stamp_ns(message), message.format, message.data),
        _fields(_HEADER, **_PICTURE),
    ),
    "sensor_msgs/msg/Image": _picture(
        lambda message: _pixels(ros_stamp_ns(message), message, bool(message.is_bigendian)),
        _fields(_HEADER, **_PIXELS, is_bigendian=Plain.FLAG),
    ),
    "foxglove.CompressedImage": _FOXGLOVE_PICTURE,
    "foxglove.CompressedVideo": replace(_FOXGLOVE_PICTURE, is_video=True),
    "foxglove.RawImage": _picture(
        lambda message: _pixels(time_ns(message.timestamp), message),
        _fields(_STAMP, **_PIXELS),
        f"{_FOXGLOVE}uint32 width\nuint32 height\nstring encoding\nuint32 step\nuint8[] data",
    ),
    "foxglove.RawAudio": MessageType(
        "sound",
        _raw_audio,
        _fields(_STAMP, **_PICTURE, sample_rate=Plain.WHOLE, number_of_channels=Plain.WHOLE),
        messages.AUDIO_FIELDS,
    ),
    messages.TASK_OUTCOME: MessageType(
        "outcome", lambda message: message, _fields(_HEADER, **_OUTCOME), messages.OUTCOME_FIELDS
    ),
}


def message_type_of(channel: RawChannel) -> MessageType | None:
    """Return what a channel's type holds; None if nothing that is used."""
    name = type_key(channel.type_name)
    kind = TYPES.get(name)
    if kind and name == messages.JOINT_ANGLES:  # as which Kinova's driver sends torques, too
        topic = channel.topic.rpartition("/")[2].lower()
        for word in ("Torque", "Velocity"):
            if word.lower() in topic:
                return replace(kind, read=_kinova(_KINOVA[word]))
    return kind
