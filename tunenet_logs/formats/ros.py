"""Decode messages of known ROS types, in ROS 2 CDR and in ROS 1 serialization.

A log's own definitions are compared with ours and never compiled: that would run untrusted code.
"""

from __future__ import annotations

import re
from contextlib import suppress
from functools import cache, lru_cache
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_msg,
    get_typestore,
)
from rosbags.typesys.store import Typestore

from tunenet_logs import messages
from tunenet_logs.formats.base import DAMAGED, Decode, MessageError, RawChannel, UnusableError
from tunenet_logs.formats.ros_any import any_ros_type
from tunenet_logs.formats.ros_definitions import MAX_SCHEMA_BYTES, RosTypes, idl_types, types_of

# Foxglove's types as ROS messages; they begin alike.
_FRAME = "builtin_interfaces/Time timestamp\nstring frame_id\n"
_TRANSFORM = (
    "builtin_interfaces/Time timestamp\nstring parent_frame_id\nstring child_frame_id\n"
    "geometry_msgs/Vector3 translation\n"
)

# Definitions that are read, by the encoding of the messages.
SCHEMA_ENCODINGS = {"cdr": ("ros2msg", "ros2idl", "omgidl"), "ros1": ("ros1msg",)}

# Parsers of definitions, by schema encoding; they build field lists and run nothing.
_PARSERS = {
    "ros2msg": get_types_from_msg,
    "ros1msg": get_types_from_msg,
    "ros2idl": lambda text, _name: idl_types(text),
    "omgidl": lambda text, _name: idl_types(text),
}

# Types that no distribution of ROS defines: of Kinova's driver, ros2_control, ours, Foxglove's.
_FOREIGN = {
    "kinova_msgs": dict.fromkeys(
        ("JointAngles", "JointTorque", "JointVelocity"), messages.SEVEN_JOINTS
    ),
    "control_msgs": {
        "InterfaceValue": "string[] interface_names\nfloat64[] values",
        "DynamicJointState": "std_msgs/Header header\nstring[] joint_names\n"
        "control_msgs/InterfaceValue[] interface_values",
    },
    "tunenet_msgs": {"TaskOutcome": messages.OUTCOME_FIELDS},
    "foxglove_msgs": {
        "PoseInFrame": f"{_FRAME}geometry_msgs/Pose pose",
        "Point3InFrame": f"{_FRAME}geometry_msgs/Point point",
        "FrameTransform": f"{_TRANSFORM}geometry_msgs/Quaternion rotation",
        "FrameTransforms": "foxglove_msgs/FrameTransform[] transforms",
        "CompressedImage": f"{_FRAME}uint8[] data\nstring format",
        "CompressedVideo": f"{_FRAME}uint8[] data\nstring format",
        "RawAudio": messages.AUDIO_FIELDS,
        "RawImage": f"{_FRAME}uint32 width\nuint32 height\nstring encoding\nuint32 step\n"
        "uint8[] data",
    },
}

# Old names of types: ROS 1 moved this one to another package.
_SAME_TYPE = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}


def ros_name(type_name: str) -> str:
    """Return a type name as ROS 2 writes it: "sensor_msgs/msg/JointState".

    So becomes "sensor_msgs/JointState", and "sensor_msgs::msg::JointState" of the OMG's IDL.
    """
    package, _, name = type_name.replace("::", "/").partition("/")
    if name and "/" not in name:
        name = f"msg/{name}"
    full = f"{package}/{name}" if name else package
    return _SAME_TYPE.get(full, full)


def plain_type(type_name: str) -> str:
    """Return a type name without its package: "JointState"."""
    return re.split(r"[/.:]", type_name)[-1]


def ros_decoder(channel: RawChannel) -> Decode:
    """Return a decoder of ROS 2 CDR, or of ROS 1 serialization, by the channel's encoding.

    Raises:
        UnusableError: the channel's own definition of its type is damaged, or its layout differs
            from ours.
    """
    name = ros_name(channel.type_name)
    is_ros1 = channel.encoding == "ros1"
    stores = Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE
    store = _typestore(stores)
    if not channel.schema_encoding and not is_ros1:  # a .db3 may give no more than the type's name
        if name not in store.types:
            raise UnusableError("its type is not known here")
    else:
        encodings = SCHEMA_ENCODINGS[channel.encoding]
        if channel.schema_encoding not in encodings:
            raise UnusableError(
                f"schema encoding {channel.schema_encoding[:20]!r} is not read "
                f"(only {', '.join(encodings)})"
            )
        if len(channel.schema) > MAX_SCHEMA_BYTES:
            raise UnusableError("its schema is too large")
        is_same = _is_same(channel.schema, channel.schema_encoding, name, stores)
        if is_same is None:
            raise UnusableError("its schema is damaged")
        if not is_same:
            raise UnusableError(f"its schema is not the usual {channel.type_name}")
    deserialize = store.deserialize_ros1 if is_ros1 else store.deserialize_cdr

    def decode(data: bytes | memoryview) -> Any:
        if not is_ros1 and len(data) > 1 and not data[0] and data[1] > 1:
            return _other_cdr(name)(data)
        try:
            return deserialize(data, name)  # type: ignore[arg-type]
        except (SerdeError, *DAMAGED) as error:
            raise MessageError(f"a {name} message is damaged: {error}") from error

    return decode


@cache
def _other_cdr(name: str) -> Decode:
    """Return a decoder of a known type in CDR of another version than that of ROS 2."""
    return any_ros_type(known_types(is_ros1=False), name, is_ros1=False)[1]


@lru_cache(maxsize=64)
def _is_same(schema: bytes, encoding: str, name: str, stores: Stores) -> bool | None:
    """Return whether a definition is ours; None for a damaged one. Cached over channels."""
    try:
        theirs = _PARSERS[encoding](schema.decode(), name)
    except (TypesysError, *DAMAGED):
        return None
    ours = _typestore(stores).fielddefs
    return name in theirs and all(
        inner in ours and list(ours[inner][1]) == list(parsed[1])
        for inner, parsed in theirs.items()
    )


@cache
def known_types(*, is_ros1: bool) -> RosTypes:
    """Return the fields of all known types."""
    stores = Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE
    found: RosTypes = {}
    for name, fields in _typestore(stores).fielddefs.items():
        with suppress(LookupError):  # one with wide texts, which are not read
            found |= types_of({name: fields})
    return found


@cache
def _typestore(stores: Stores) -> Typestore:
    """Return the known types: those of a ROS distribution, and `_FOREIGN`."""
    store = get_typestore(stores)
    if stores is Stores.ROS1_NOETIC:
        transforms = "geometry_msgs/TransformStamped[] transforms"
        store.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))
    for package, types in _FOREIGN.items():
        for name, text in types.items():
            store.register(get_types_from_msg(text, f"{package}/msg/{name}"))
    return store
