"""Messages that are decoded by the definition in their log, against the library that wrote them."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from tunenet_logs.formats.base import MessageError, RawChannel, UnusableError
from tunenet_logs.formats.decoders import listed_type
from tunenet_logs.formats.ros import any_ros_type, parsed

KINDS = (
    "geometry_msgs/msg/PoseArray",
    "visualization_msgs/msg/MarkerArray",
    "sensor_msgs/msg/PointCloud2",
    "nav_msgs/msg/Odometry",
    "diagnostic_msgs/msg/DiagnosticArray",
    "sensor_msgs/msg/JointState",
    "std_msgs/msg/Empty",
    "trajectory_msgs/msg/JointTrajectory",
)
IDL = (
    "=" * 80
    + """
IDL: lab_msgs/msg/Ball
// generated
#include "geometry_msgs/msg/Point.idl"
module lab_msgs { module msg {
  typedef float float__3[3];
  module Ball_Constants { const uint8 BIG = 3; };
  @verbatim (language="comment", text="where it is; (in mm)")
  struct Ball {
    @unit (value="mm")
    geometry_msgs::msg::Point position;
    float__3 speed;
    sequence<double> more;
    string name;
  };
};};
"""
    + "=" * 80
    + """
IDL: geometry_msgs/msg/Point
module geometry_msgs { module msg { struct Point { double x; double y; double z; }; }; };
"""
)


class Random:
    """Messages of a type with anything in them."""

    def __init__(self, store: Any) -> None:
        self.store = store
        self.rng = np.random.default_rng(0)

    def message(self, name: str) -> Any:
        fields = self.store.fielddefs[name][1]
        return self.store.types[name](**{label: self._field(*node) for label, node in fields})

    def _field(self, node: Any, of: Any) -> Any:
        if node in (Nodetype.BASE, Nodetype.NAME):
            return self._one(node, of)
        (inner, kind), count = of
        number = count if node == Nodetype.ARRAY else int(self.rng.integers(0, 4))
        values = [self._one(inner, kind) for _ in range(number)]
        if inner == Nodetype.BASE and kind[0] != "string":
            return np.array(values, np.uint8 if kind[0] in ("byte", "char") else kind[0])
        return values

    def _one(self, node: Any, of: Any) -> Any:
        if node == Nodetype.NAME:
            return self.message(of)
        if of[0] == "string":
            return "abcdefgh"[: self.rng.integers(0, 8)]
        if of[0] == "bool":
            return bool(self.rng.integers(2))
        number = self.rng.normal() if "float" in of[0] else self.rng.integers(0, 100)
        return float(np.float32(number)) if "float" in of[0] else int(number)


def same(theirs: Any, ours: Any) -> bool:
    """Whether two messages hold the same, constants aside."""
    if hasattr(theirs, "__dataclass_fields__"):
        names = [name for name in vars(ours) if not name.startswith("structure_")]
        return all(same(getattr(theirs, name), getattr(ours, name)) for name in names)
    if isinstance(theirs, list | np.ndarray):
        return len(theirs) == len(ours) and all(map(same, theirs, ours))
    return theirs == ours


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("encoding", ["cdr", "big-endian", "ros1"])
def test_what_was_written_is_read(kind: str, encoding: str):
    is_ros1 = encoding == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    text, _ = store.generate_msgdef(kind, ros_version=1 if is_ros1 else 2)
    types = parsed(text.encode(), "ros1msg" if is_ros1 else "ros2msg", kind)
    _, decode = any_ros_type(types, kind, is_ros1=is_ros1)
    maker = Random(store)
    for _ in range(10):
        message = maker.message(kind)
        if is_ros1:
            data = bytes(store.serialize_ros1(message, kind))
        else:
            data = bytes(store.serialize_cdr(message, kind, little_endian=encoding == "cdr"))
        assert same(message, decode(data))
        for end in range(0, len(data) - 8, 7):
            with pytest.raises(MessageError):
                decode(data[:end])


def test_idl_says_what_a_message_is_made_of():
    types = parsed(IDL.encode(), "ros2idl", "lab_msgs/msg/Ball")
    assert [(one.name, one.kind, one.count) for one in types["lab_msgs/msg/Ball"]] == [
        ("position", "geometry_msgs/msg/Point", -1),
        ("speed", "f", 3),
        ("more", "d", 0),
        ("name", "string", -1),
    ]


@pytest.mark.parametrize(
    "text",
    [
        "module a { module msg { struct B { "
        + "sequence<" * 9
        + "double"
        + ">" * 9
        + " x; }; }; };",
        "module a { module msg { struct B { double x[" + "(" * 9 + "1" + ")" * 9 + "]; }; }; };",
        "module a { " * 500,
        "struct",
    ],
)
def test_idl_that_is_made_to_hurt_is_refused_at_once(text: str):
    with pytest.raises(UnusableError):
        parsed(text.encode(), "ros2idl", "a/msg/B")


OWN_POINT = "\n".join(
    [
        "std_msgs/Header header\nlab_msgs/Point32 point\nfloat32 quality",
        "=" * 80,
        "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id",
        "=" * 80,
        "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec",
        "=" * 80,
        "MSG: lab_msgs/Point32\nfloat32 x\nfloat32 y\nfloat32 z\n",
    ]
)


def test_a_listed_type_is_read_as_its_log_defines_it():
    """Single precision and a field more; but not without a field that is read."""
    kind = "geometry_msgs/msg/PointStamped"
    decode = listed_type(RawChannel("/p", kind, "cdr", "ros2msg", OWN_POINT.encode())).decode
    stamp = struct.pack("<iI", 5, 6) + struct.pack("<I", 4) + b"map\0"
    message = decode(b"\0\1\0\0" + stamp + struct.pack("<4f", 1.5, -2.5, 3.5, 0.9))
    assert (message.point.x, message.point.y, message.point.z) == (1.5, -2.5, 3.5)
    assert (message.header.stamp.sec, message.header.frame_id) == (5, "map")
    for change in (("float32 z", "float32 up"), ("float32 z", "string z"), ("lab_msgs/", "no/")):
        text = OWN_POINT.replace(*change, 1)
        with pytest.raises(UnusableError, match=r"schema|definition"):
            listed_type(RawChannel("/p", kind, "cdr", "ros2msg", text.encode()))
