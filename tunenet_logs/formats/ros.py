"""ROS messages, ROS 2 CDR and ROS 1: which can be decoded, and how.

A log's own definitions are compared with ours and never compiled: that would run what a stranger
wrote.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, lru_cache
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from rosbags.typesys.store import Typestore

from tunenet_logs import messages
from tunenet_logs.formats.base import DAMAGED, RawChannel
from tunenet_logs.formats.codec import Decode, MessageError, UnusableError

_FRAME = "builtin_interfaces/Time timestamp\nstring frame_id\n"
_TRANSFORM = (
    "builtin_interfaces/Time timestamp\nstring parent_frame_id\nstring child_frame_id\n"
    "geometry_msgs/Vector3 translation\n"
)

_PARSERS = {
    "ros2msg": get_types_from_msg,
    "ros1msg": get_types_from_msg,
    "ros2idl": get_types_from_idl,
}
_FOREIGN = {
    "kinova_msgs": dict.fromkeys(
        ("JointAngles", "JointTorque", "JointVelocity"), messages.SEVEN_JOINTS
    ),
    "tunenet_msgs": {"TaskOutcome": messages.OUTCOME_FIELDS},
    "foxglove_msgs": {
        "PoseInFrame": f"{_FRAME}geometry_msgs/Pose pose",
        "Point3InFrame": f"{_FRAME}geometry_msgs/Point point",
        "FrameTransform": f"{_TRANSFORM}geometry_msgs/Quaternion rotation",
        "FrameTransforms": "foxglove_msgs/FrameTransform[] transforms",
        "CompressedImage": f"{_FRAME}uint8[] data\nstring format",
        "CompressedVideo": f"{_FRAME}uint8[] data\nstring format",
        "RawImage": f"{_FRAME}uint32 width\nuint32 height\nstring encoding\nuint32 step\n"
        "uint8[] data",
    },
}
_MOST_SCHEMA_BYTES = 256 * 1024
"""Of the types that are used, with all that they are made of, none has a tenth of that."""

_SAME_TYPE = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}


def ros_name(type_name: str) -> str:
    """A type as ROS 2 writes it: "sensor_msgs/JointState" is "sensor_msgs/msg/JointState"."""
    package, _, name = type_name.partition("/")
    if name and "/" not in name:
        name = f"msg/{name}"
    full = f"{package}/{name}" if name else package
    return _SAME_TYPE.get(full, full)


def cdr_decoder(channel: RawChannel) -> Decode:
    """For ROS 2 CDR; see `codec.Codec`."""
    name = ros_name(channel.type_name)
    if channel.schema_encoding:  # a .db3 may say no more than the type's name
        _check_same(channel, name, _ros2_typestore, ("ros2msg", "ros2idl"))
    elif name not in _ros2_typestore().types:
        raise UnusableError("its type is not known here")
    return _decoder(_ros2_typestore().deserialize_cdr, name)


def ros1_decoder(channel: RawChannel) -> Decode:
    """For ROS 1; see `codec.Codec`."""
    name = ros_name(channel.type_name)
    _check_same(channel, name, _ros1_typestore, ("ros1msg",))
    return _decoder(_ros1_typestore().deserialize_ros1, name)


def _decoder(deserialize: Callable[[bytes, str], Any], name: str) -> Decode:
    def decode(data: bytes | memoryview) -> Any:
        try:
            return deserialize(data, name)  # type: ignore[arg-type]
        except (SerdeError, *DAMAGED) as error:
            raise MessageError(f"a {name} message is damaged: {error}") from error

    return decode


def _check_same(
    channel: RawChannel,
    name: str,
    store: Callable[[], Typestore],
    encodings: tuple[str, ...],
) -> None:
    """Refuse a log's own definition of a type that lays it out in another way than ours."""
    if channel.schema_encoding not in encodings:
        known = ", ".join(encodings)
        raise UnusableError(
            f"schema encoding {channel.schema_encoding[:20]!r} is not read (only {known})"
        )
    if len(channel.schema) > _MOST_SCHEMA_BYTES:
        raise UnusableError("its schema is too large")
    is_same = _is_same(channel.schema, channel.schema_encoding, name, store)
    if is_same is None:
        raise UnusableError("its schema is damaged")
    if not is_same:
        raise UnusableError(f"its schema is not the usual {channel.type_name}")


@lru_cache(maxsize=64)
def _is_same(
    schema: bytes, encoding: str, name: str, store: Callable[[], Typestore]
) -> bool | None:
    """Whether a definition is ours; None for a damaged one. Parsed once for all of its channels."""
    try:
        theirs = _PARSERS[encoding](schema.decode(), name)
    except (TypesysError, *DAMAGED):
        return None
    ours = store().fielddefs
    return name in theirs and all(
        one in ours and list(ours[one][1]) == list(parsed[1]) for one, parsed in theirs.items()
    )


@cache
def _ros2_typestore() -> Typestore:
    return _with_foreign(messages.typestore())


@cache
def _ros1_typestore() -> Typestore:
    store = get_typestore(Stores.ROS1_NOETIC)
    transforms = "geometry_msgs/TransformStamped[] transforms"
    store.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))
    return _with_foreign(store)


def _with_foreign(store: Typestore) -> Typestore:
    for package, types in _FOREIGN.items():
        for name, text in types.items():
            store.register(get_types_from_msg(text, f"{package}/msg/{name}"))
    return store
