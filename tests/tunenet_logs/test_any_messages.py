"""Messages that are decoded by the definition in their log: of ROS, IDL and DDS, one or many."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from tests.tunenet_logs.any_message_logs import START_NS, STEP_NS, RosLog
from tunenet_logs import messages
from tunenet_logs.episode import Episode
from tunenet_logs.formats.base import (
    MessageError,
    RawChannel,
    RawMessage,
    UnusableError,
    one_by_one,
)
from tunenet_logs.formats.decoders import listed_type
from tunenet_logs.formats.mcap import read_mcap
from tunenet_logs.formats.ros import any_ros_type, known_types, parsed, stacked_decoder
from tunenet_logs.reader import read_episode
from tunenet_logs.terminal import heard_by

KINDS = (
    "geometry_msgs/msg/PoseArray", "visualization_msgs/msg/MarkerArray",
    "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/Odometry", "diagnostic_msgs/msg/DiagnosticArray",
    "sensor_msgs/msg/JointState", "std_msgs/msg/Empty", "trajectory_msgs/msg/JointTrajectory",
)  # fmt: skip
RULE = "=" * 80
IDL = f"""{RULE}
IDL: lab_msgs/msg/Ball
// generated
#include "geometry_msgs/msg/Point.idl"
module lab_msgs {{ module msg {{
  typedef float float__3[3];
  module Ball_Constants {{ const uint8 BIG = 3; }};
  @verbatim (language="comment", text="where it is; (in mm)")
  struct Ball {{
    @unit (value="mm")
    geometry_msgs::msg::Point position;
    float__3 speed;
    sequence<double> more;
    string name;
  }};
}};}};
{RULE}
IDL: geometry_msgs/msg/Point
module geometry_msgs {{ module msg {{ struct Point {{ double x; double y; double z; }}; }}; }};
"""


class Random:
    """Messages of a type with anything in them."""

    def __init__(self, store: Any) -> None:
        self.store, self.rng = store, np.random.default_rng(0)

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
        if "float" in of[0]:
            return float(np.float32(self.rng.normal()))
        return int(self.rng.integers(0, 100))


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
        ("position", "geometry_msgs/msg/Point", -1), ("speed", "f", 3), ("more", "d", 0),
        ("name", "string", -1),
    ]  # fmt: skip


IN_B = "module a {{ module msg {{ struct B {{ {} }}; }}; }};"


@pytest.mark.parametrize(
    "text",
    [
        IN_B.format("sequence<" * 9 + "double" + ">" * 9 + " x;"),
        IN_B.format("double x[" + "(" * 9 + "1" + ")" * 9 + "];"),
        "module a { " * 500,
        "struct",
    ],
)
def test_idl_that_is_made_to_hurt_is_refused_at_once(text: str):
    with pytest.raises(UnusableError):
        parsed(text.encode(), "ros2idl", "a/msg/B")


OWN_POINT = f"""std_msgs/Header header\nlab_msgs/Point32 point\nfloat32 quality
{RULE}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id
{RULE}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec
{RULE}\nMSG: lab_msgs/Point32\nfloat32 x\nfloat32 y\nfloat32 z
"""


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


# As DDS has them: definitions of the OMG, the second version of CDR.
POSE_IDL = b"""
module builtin_interfaces { module msg { struct Time { int32 sec; uint32 nanosec; }; }; };
module std_msgs { module msg {
  struct Header { builtin_interfaces::msg::Time stamp; string frame_id; }; }; };
module geometry_msgs { module msg {
  @final struct Point { double x; double y; double z; };
  struct Quaternion { double x, y, z, w; };
  struct Pose { geometry_msgs::msg::Point position; geometry_msgs::msg::Quaternion orientation; };
  struct PoseStamped { std_msgs::msg::Header header; geometry_msgs::msg::Pose pose; };
}; };
"""
BALL_IDL = b"module lab { struct Place { double x; double y; double z; }; " + (
    b"struct Ball { @key long id; lab::Place position; sequence<float> trail; }; };"
)


def pose(index: int) -> bytes:
    made = messages.pose(START_NS + index * STEP_NS, "lab", (0.1, 0.2, index / 9))
    return messages.encode(made, messages.POSE)


POSES = [pose(index) for index in range(30)]
BALLS = [struct.pack("<4Bi4x3dIf", 0, 1, 0, 0, 7, 0.0, 0.0, n / 9, 1, 0.5) for n in range(30)]


def log(
    path: Path,
    kind: str,
    schema: tuple[str, bytes],
    sent: Sequence[bytes],
    chunk: int = 200_000,
    beside: int = 0,
) -> Episode:
    """Of messages under /a, with one of another topic after every `beside`."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk, use_chunking=chunk > 0)
        writer.start("")
        number = writer.register_schema(kind, *schema)
        channel = writer.register_channel("/a", "cdr", number)
        text = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        other = writer.register_channel("/chat", "cdr", text) if beside else 0
        for index, data in enumerate(sent):
            stamp_ns = START_NS + index * STEP_NS
            writer.add_message(channel, stamp_ns, data, stamp_ns)
            if beside and index % beside == 0:
                writer.add_message(other, stamp_ns, b"\0\1\0\0" + bytes(index % 9), stamp_ns)
        writer.finish()
    return read_episode(path)


def usual(kind: str) -> tuple[str, bytes]:
    return "ros2msg", messages.definition(kind).encode()


@pytest.mark.parametrize(
    ("kind", "definition", "sent", "frame"),
    [
        ("geometry_msgs::msg::PoseStamped", POSE_IDL, POSES, "lab"),
        ("lab::Ball", BALL_IDL, BALLS, ""),
    ],
)
def test_definitions_of_the_omg(
    tmp_path: Path, kind: str, definition: bytes, sent: list[bytes], frame: str
):
    (signal,) = log(tmp_path / "a.mcap", kind, ("omgidl", definition), sent).signals.values()
    assert signal.values[:, 2].tolist() == [index / 9 for index in range(30)]
    assert signal.frame == frame


@pytest.mark.parametrize("kind", [-1, 2, 3, 8, 9, 10, 11])
def test_what_is_not_read_of_dds_is_named(tmp_path: Path, kind: int):
    if kind < 0:
        episode = log(tmp_path / "a.mcap", "lab/Ball", ("flatbuffer", b"position"), POSES)
        says = ("definition is in 'flatbuffer'",)
    else:
        sent = [bytes((0, kind)) + one[2:] for one in POSES]
        episode = log(tmp_path / "a.mcap", messages.POSE, usual(messages.POSE), sent)
        says = ("CDR with headers", "; publish it as final")
    assert not episode.losses
    assert all(one in str(episode.channels[0].skipped) for one in says)


def xcdr2_joints(index: int, *, has_sizes: bool, order: str) -> bytes:
    """A JointState of three joints in plain XCDR2: numbers of 8 bytes at multiples of 4."""
    names = b"".join(
        struct.pack(f"{order}I", len(name) + 1) + name + bytes(-len(name) % 4 or 4)
        for name in (b"one", b"two", b"three  ")
    )
    listed = struct.pack(f"{order}I", 3) + names
    if has_sizes:
        listed = struct.pack(f"{order}I", len(listed)) + listed
    stamp_ns = START_NS + index * STEP_NS
    head = struct.pack(f"{order}iII", stamp_ns // 10**9, stamp_ns % 10**9, 1) + bytes(4)
    numbers = b"".join(
        struct.pack(f"{order}I3d", 3, *(sign * index + k for k in range(3))) for sign in (1, -1, 2)
    )
    return bytes((0, 7 if order == "<" else 6, 0, 0)) + head + listed + numbers


@pytest.mark.parametrize("has_sizes", [False, True])
@pytest.mark.parametrize("order", ["<", ">"])
def test_joints_in_plain_xcdr2(tmp_path: Path, has_sizes: bool, order: str):
    sent = [xcdr2_joints(index, has_sizes=has_sizes, order=order) for index in range(30)]
    kind = messages.JOINT_STATE
    episode = log(tmp_path / "a.mcap", kind, usual(kind), sent)
    position, velocity, effort = episode.signals.values()
    assert position.columns == ("one", "two", "three  ")
    rows = np.arange(30)[:, None]
    for signal, sign in ((position, 1), (velocity, -1), (effort, 2)):
        assert np.array_equal(signal.values, sign * rows + np.arange(3))
    assert not episode.losses


def test_dynamic_joint_states(tmp_path: Path):
    value, kind = "control_msgs/msg/InterfaceValue", "control_msgs/msg/DynamicJointState"
    ros = RosLog({value: "string[] interface_names\nfloat64[] values",
                  kind: "std_msgs/Header header\nstring[] joint_names\n"
                  "control_msgs/InterfaceValue[] interface_values"})  # fmt: skip
    names = ["effort", "position"]
    sent = []
    for index in range(40):
        values = [
            ros.make(value, interface_names=names, values=[first, index / 7])
            for first in (1.0, 2.0)
        ]
        header = ros.header(index)
        sent.append(ros.make(kind, header=header, joint_names=["a", "b"], interface_values=values))
    ros.write(tmp_path / "a.mcap", {"/dynamic_joint_states": (kind, sent)})
    position, effort = read_episode(tmp_path / "a.mcap").signals.values()
    assert position.values[:, 1].tolist() == [index / 7 for index in range(40)]
    assert effort.values[9].tolist() == [1.0, 2.0]


# Very many messages, of one layout or of several: read together, and as they are one by one.
MANY = 1200
STAMPS = START_NS + np.arange(MANY) * STEP_NS
AB = ("a", "b")


def joints(index: int, names: tuple[str, ...] = AB, effort: bool = True) -> bytes:
    values = np.arange(len(names)) + index / 7
    efforts = -values if effort else values[:0]
    stamp_ns = START_NS + index * STEP_NS
    state = messages.joint_state(stamp_ns, names, values, values[:0], efforts)
    return messages.encode(state, messages.JOINT_STATE)


def states(path: Path, data: list[bytes], **how: int) -> Episode:
    return log(path, messages.JOINT_STATE, usual(messages.JOINT_STATE), data, **how)


STATES = [joints(index) for index in range(MANY)]


@pytest.mark.parametrize("beside", [0, 1, 5, 40])
@pytest.mark.parametrize("chunk", [0, 500, 20_000, 10_000_000])
def test_all_that_was_written_is_read(tmp_path: Path, beside: int, chunk: int):
    episode = states(tmp_path / "a.mcap", STATES, chunk=chunk, beside=beside)
    position, effort = episode.signals.values()
    wanted = np.arange(MANY)[:, None] / 7 + np.arange(2)
    assert np.array_equal(position.values, wanted)
    assert np.array_equal(effort.values, -wanted)
    assert np.array_equal(position.stamps_ns, STAMPS)
    assert episode.channels[0].messages == MANY
    if beside == 5:  # what comes together is what comes one by one
        records = one_by_one(read_mcap(tmp_path / "a.mcap", []))
        found = [one for one in records if isinstance(one, RawMessage)]
        assert [bytes(one.data) for one in found if one.channel.topic == "/a"] == STATES
        assert [one.log_ns for one in found] == sorted(one.log_ns for one in found)


def test_layouts_by_turns_keep_their_order_and_damage_is_left_out(tmp_path: Path):
    """An arm and a gripper on one topic, whose messages have several lengths and names."""
    names = (AB, ("gripper",), AB)
    data = [joints(k, names[k % 3], k % 3 < 2) for k in range(MANY)]
    position, effort = states(tmp_path / "a.mcap", data).signals.values()
    assert position.columns == ("a", "b", "gripper")
    times = np.arange(MANY)
    arm = times % 3 != 1
    assert np.array_equal(position.values[arm, 1], times[arm] / 7 + 1)
    assert np.isnan(position.values[~arm, 0]).all()
    assert np.array_equal(np.isfinite(effort.values[:, 0]), times % 3 == 0)
    episode = states(tmp_path / "a.mcap", [*STATES[:700], STATES[700][:40], *STATES[701:]])
    assert len(next(iter(episode.signals.values())).stamps_ns) == MANY - 1
    assert any("1 damaged messages" in loss for loss in episode.losses)


def test_of_too_many_messages_some_are_kept_evenly_and_that_is_said(tmp_path: Path):
    path, heard = tmp_path / "a.mcap", []
    states(path, STATES)
    with heard_by(lambda what, fraction: heard.append((what, fraction))):
        episode = read_episode(path, most_numbers=6 * 200)
    assert heard[0] == ("reading", 0.0)
    position, _ = episode.signals.values()
    assert np.array_equal(position.stamps_ns, STAMPS[::8])
    assert any(f"of {MANY} messages every 8th" in warning for warning in episode.warnings)
    assert episode.channels[0].messages == MANY
    states(path, [joints(k if k % 2 else 40_000) for k in range(MANY)])
    warnings = read_episode(path, most_numbers=6 * 200).warnings
    assert any("two publishers" in warning for warning in warnings)


@pytest.mark.parametrize("is_ros1", [False, True])
def test_stacked_messages_are_those_that_rosbags_decodes(is_ros1: bool):
    ros, kind = RosLog({}, is_ros1=is_ros1), "nav_msgs/msg/Odometry"
    of = ros.store.types
    rows: list[bytes] = []
    for index in range(9):
        time = of["builtin_interfaces/msg/Time"](index, 5)
        header = {"stamp": time, "frame_id": "odom"} | ({"seq": index} if is_ros1 else {})
        pose = of["geometry_msgs/msg/PoseWithCovariance"](
            ros.pose(index, 2.0, -index), np.arange(36.0)
        )
        turn = of["geometry_msgs/msg/Vector3"](0.0, 0.0, index / 3)
        twist = of["geometry_msgs/msg/TwistWithCovariance"](
            of["geometry_msgs/msg/Twist"](turn, turn), np.zeros(36)
        )
        child = "ball" if index < 6 else "cube"
        message = of[kind](of["std_msgs/msg/Header"](**header), child, pose, twist)
        serialize = ros.store.serialize_ros1 if is_ros1 else ros.store.serialize_cdr
        rows.append(bytes(serialize(message, kind)))
    decode = stacked_decoder(known_types(is_ros1=is_ros1), kind, is_ros1=is_ros1)
    message, same = decode(np.array([list(row) for row in rows], np.uint8))
    assert same.tolist() == [True] * 6 + [False] * 3
    assert message.child_frame_id == "ball"
    assert message.header.stamp.sec.tolist() == list(range(6))
    assert message.pose.pose.position.z.tolist() == [-float(k) for k in range(6)]
    assert np.array_equal(message.pose.covariance, np.tile(np.arange(36.0), (6, 1)))
    assert message.twist.twist.angular.z.tolist() == [k / 3 for k in range(6)]
