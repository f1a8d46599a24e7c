"""Required fields of each type, for encodings that do not prove a message's type.

A ROS message decodes only by the definition that we know. A protobuf schema can call anything a
`foxglove.PoseInFrame`, and JSON can hold anything: there the fields are checked against these.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from tunenet_logs.formats.base import RawChannel, UnusableError
from tunenet_logs.formats.message_types import type_key


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
_NUMBER = _fields(data=Leaf.NUMBER)
_NUMBERS = _fields(data=Many(Leaf.NUMBER))
_KINOVA = Fields({f"joint{number}": Leaf.NUMBER for number in range(1, 8)})

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
    "kinova_msgs/msg/JointAngles": _KINOVA,
    "kinova_msgs/msg/JointTorque": _KINOVA,
    "kinova_msgs/msg/JointVelocity": _KINOVA,
    "trajectory_msgs/msg/JointTrajectory": _fields(
        header=_HEADER, joint_names=Many(Leaf.TEXT), points=Many(_TRAJECTORY_POINT)
    ),
    "std_msgs/msg/Float64MultiArray": _NUMBERS,
    "std_msgs/msg/Float32MultiArray": _NUMBERS,
    "std_msgs/msg/Float64": _NUMBER,
    "std_msgs/msg/Float32": _NUMBER,
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
