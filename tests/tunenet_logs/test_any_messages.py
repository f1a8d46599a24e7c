"""Messages of any type: by the definition in their log, by their shape, or as a user names them."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from tests.message_logs import (
    START_NS,
    STEP_NS,
    Schema,
    definition,
    header,
    in_steps,
    ros2,
    write_cdr,
    write_json,
    write_raw,
)
from tests.message_logs import message as made
from tests.reading import one, read, refusal, skipped
from tunenet_logs import messages, reader
from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats import mcap
from tunenet_logs.formats.base import (
    MessageError,
    RawChannel,
    RawMessage,
    UnusableError,
    one_by_one,
)
from tunenet_logs.formats.decoders import listed_type
from tunenet_logs.formats.mcap import read_mcap
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.formats.ros import any_ros_type, parsed
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


def anything(store: Any, node: Nodetype, of: Any, rng: np.random.Generator) -> Any:
    """Of a type, anything that it can hold."""
    if node == Nodetype.NAME:
        return {name: anything(store, one[0], one[1], rng) for name, one in store.fielddefs[of][1]}
    if node == Nodetype.BASE:
        number = int(rng.integers(8))
        known = {"string": "abcdefgh"[:number], "bool": bool(number % 2)}
        return known.get(of[0], float(np.float32(rng.normal())) if "float" in of[0] else number)
    count = of[1] if node == Nodetype.ARRAY else int(rng.integers(4))
    return [anything(store, of[0][0], of[0][1], rng) for _ in range(count)]


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
    rng = np.random.default_rng(0)
    for _ in range(10):
        message = made(store, kind, anything(store, Nodetype.NAME, kind, rng))
        if is_ros1:
            data = bytes(store.serialize_ros1(message, kind))
        else:
            data = bytes(store.serialize_cdr(message, kind, little_endian=encoding == "cdr"))
        assert same(message, decode(data))
        for end in range(0, len(data) - 8, 7):
            with pytest.raises(MessageError):
                decode(data[:end])


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
NAMED_BALLS = [  # place, speed, two numbers more, and a name
    struct.pack("<4B3d3fI2dI4s", 0, 1, 0, 0, 0.0, 0.0, n / 9, 1, 2, 3, 2, 4, 5, 4, b"red")
    for n in range(30)
]
BALLS = [struct.pack("<4Bi4x3dIf", 0, 1, 0, 0, 7, 0.0, 0.0, n / 9, 1, 0.5) for n in range(30)]


def log(
    path: Path,
    kind: str,
    said: tuple[str, bytes],
    sent: Sequence[bytes],
    chunk: int = 200_000,
    beside: int = 0,
) -> Episode:
    """Of messages under /a, with one of another topic after every `beside`."""
    ours, other = Schema(kind, *said), Schema("std_msgs/msg/String", text=b"string data")
    raw = []
    for index, data in enumerate(sent):
        raw.append(("/a", ours, START_NS + index * STEP_NS, data))
        if beside and index % beside == 0:
            raw.append(("/chat", other, raw[-1][2], b"\0\1\0\0" + bytes(index % 9)))
    return read_episode(write_raw(path, raw, chunk_bytes=chunk))


def usual(kind: str) -> tuple[str, bytes]:
    return "ros2msg", messages.definition(kind).encode()


@pytest.mark.parametrize(
    ("kind", "form", "definition", "sent", "frame"),
    [
        ("geometry_msgs::msg::PoseStamped", "omgidl", POSE_IDL, POSES, "lab"),
        ("lab::Ball", "omgidl", BALL_IDL, BALLS, ""),
        ("lab_msgs/msg/Ball", "ros2idl", IDL.encode(), NAMED_BALLS, ""),
    ],
)
def test_definitions_in_idl(
    tmp_path: Path, kind: str, form: str, definition: bytes, sent: list[bytes], frame: str
):
    (signal,) = log(tmp_path / "a.mcap", kind, (form, definition), sent).signals.values()
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
    types = {value: "string[] interface_names\nfloat64[] values",
             kind: "std_msgs/Header header\nstring[] joint_names\n"
             "control_msgs/InterfaceValue[] interface_values"}  # fmt: skip
    sent = [
        {"header": header(START_NS + index * STEP_NS), "joint_names": ["a", "b"],
         "interface_values": [{"interface_names": ["effort", "position"],
                               "values": [first, index / 7]} for first in (1.0, 2.0)]}
        for index in range(40)
    ]  # fmt: skip
    path = write_cdr(tmp_path / "a.mcap", in_steps("/dynamic_joint_states", kind, sent), types)
    position, effort = read_episode(path).signals.values()
    assert position.values[:, 1].tolist() == [index / 7 for index in range(40)]
    assert effort.values[9].tolist() == [1.0, 2.0]


@pytest.mark.parametrize("fields", [("feedback", "reference"), ("actual", "desired")])
def test_what_a_trajectory_controller_measures_and_asks_for(tmp_path: Path, fields: Sequence[str]):
    point = "trajectory_msgs/msg/JointTrajectoryPoint"
    kind = "control_msgs/msg/JointTrajectoryControllerState"
    lines = [f"trajectory_msgs/JointTrajectoryPoint {one}" for one in (*fields, "error")]
    types = {kind: "\n".join(["std_msgs/Header header", "string[] joint_names", *lines])}
    assert point in messages.typestore().types

    def of(*values: float) -> dict[str, Any]:
        more: dict[str, Any] = {"velocities": [], "accelerations": [], "effort": []}
        return {"positions": values, **more, "time_from_start": {"sec": 0, "nanosec": 0}}

    sent = [
        {"header": header(START_NS + index * STEP_NS), "joint_names": ["a", "b"],
         fields[0]: of(index, 2.0), fields[1]: of(index + 0.5, 3.0), "error": of(0.5, 1.0)}
        for index in range(40)
    ]  # fmt: skip
    path = write_cdr(tmp_path / "a.mcap", in_steps("/arm/controller_state", kind, sent), types)
    signals = read_episode(path).signals
    states, commands = signals.values()
    assert list(signals) == [f"/arm/controller_state{one}.position" for one in ("", ".commands")]
    assert (states.drives, commands.drives) == (False, True)
    assert commands.values[:, 0].tolist() == [index + 0.5 for index in range(40)]
    assert states.columns == commands.columns == ("a", "b")


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


STORE = ros2()


def by_rosbags(index: int, names: tuple[str, ...] = AB, frame: str = "") -> bytes:
    """As another writer serialises it, big-endian."""
    values = (np.arange(len(names)) + index / 7).tolist()
    fields = {"name": names, "position": values, "velocity": values, "effort": values}
    fields["header"] = header(START_NS + index * STEP_NS, frame)
    state = made(STORE, messages.JOINT_STATE, fields)
    return bytes(STORE.serialize_cdr(state, messages.JOINT_STATE, little_endian=False))


def spoiled(at: int, new: bytes, every: int = 97) -> list[bytes]:
    """Messages of which some have other bytes at a place."""
    return [
        one[:at] + new + one[at + len(new) :] if k % every == 50 else one
        for k, one in enumerate(STATES)
    ]


# Every word that may be a size of a frame, of names, of a name, of positions is spoiled in turn.
LAYOUTS = {
    "ours": STATES,
    "another writer's": [by_rosbags(k) for k in range(600)],
    "both": [joints(k) if k % 3 else by_rosbags(k) for k in range(600)],
    "frames": [by_rosbags(k, frame="base"[: k % 5]) for k in range(600)],
    "frames of one length": [by_rosbags(k, frame=f"f{k % 4}") for k in range(600)],
    "each its own frame": [by_rosbags(k, frame=f"{k:04}") for k in range(600)],
    "names of one length": [joints(k, ("a", "b") if k % 5 else ("b", "a")) for k in range(MANY)],
    "names": [joints(k, (AB, ("gripper",), ())[k % 3]) for k in range(MANY)],
    "efforts now and then": [joints(k, effort=k % 4 > 0) for k in range(MANY)],
    "one name twice": [*STATES[:99], by_rosbags(0, ("a", "a"))],
    "cut": [one[: -k % 9] if k % 50 == 7 else one for k, one in enumerate(STATES, 1)],
    "longer": [one + bytes(k % 6) if k % 50 == 7 else one for k, one in enumerate(STATES)],
    "none is whole": [one[:-9] for one in STATES],
    "empty": [b"" if k % 300 == 1 else one for k, one in enumerate(STATES)],
    "no CDR": spoiled(0, b"\x01"),
    "another kind of CDR": spoiled(1, b"\x07"),
    "not numbers": spoiled(len(STATES[1]) - 8, b"\xff" * 8),
    "times": spoiled(4, b"\xff\xff\xff\x7f"),
    "stamps of nanoseconds": spoiled(8, b"\xff\xff\xff\xff"),
    **{
        f"size at byte {at}, {value:#x}": spoiled(at, struct.pack("<I", value))
        for at in range(12, 60, 4)
        for value in (0, 3, 2**32 - 1)
    },
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_columns_are_what_messages_are_one_by_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, layout: str
):
    """In chunks large and small, and without; beside others' messages and alone."""
    data = LAYOUTS[layout][:600]
    monkeypatch.setattr(reader, "_MIN_STACKED", 10**9)
    monkeypatch.setattr(mcap, "_MIN_SHORT", 10**9)
    wanted = states(tmp_path / "a.mcap", data, chunk=20_000, beside=1)
    monkeypatch.undo()
    for chunk, beside in ((20_000, 1), (300, 0), (10**7, 3), (0, 1)):
        found = states(tmp_path / "a.mcap", data, chunk=chunk, beside=beside)
        assert found.warnings[-len(wanted.warnings) :] == wanted.warnings
        assert found.signals.keys() == wanted.signals.keys()
        for own, other in zip(found.signals.values(), wanted.signals.values(), strict=True):
            assert (own.columns, own.left_out) == (other.columns, other.left_out)
            assert np.array_equal(own.stamps_ns, other.stamps_ns)
            assert np.array_equal(own.values, other.values, equal_nan=True)
        assert np.array_equal(found.channels[0].log_ns, wanted.channels[0].log_ns)
        assert found.channels[0].skipped == wanted.channels[0].skipped


def posed(kind: str, k: int) -> bytes:
    """Serialise a pose or transforms, in frames of several names, some without a unit rotation."""
    stamp_ns, frame = START_NS + k * STEP_NS, ("map", "odom", "m")[k % 3]
    place, turn = (k / 7, -k, 1.0), (0.0, 0.0, 0.6, 0.8) if k % 5 else (0.0, 0.0, 0.0, 0.0)
    point, turned = dict(zip("xyz", place, strict=True)), dict(zip("xyzw", turn, strict=True))
    about = header(stamp_ns, frame)
    if kind.endswith("PointStamped"):
        fields: dict = {"header": about, "point": point}
    elif kind.endswith("PoseStamped"):
        fields = {"header": about, "pose": {"position": point, "orientation": turned}}
    else:
        one = {"header": about, "transform": {"translation": point, "rotation": turned}}
        fields = {
            "transforms": [one | {"child_frame_id": name} for name in ("a", "b")[: 1 + k % 2]]
        }
    return bytes(STORE.serialize_cdr(made(STORE, kind, fields), kind))


@pytest.mark.parametrize(
    "kind",
    [
        "geometry_msgs/msg/PoseStamped",
        "geometry_msgs/msg/PointStamped",
        "tf2_msgs/msg/TFMessage",
    ],
)
def test_positions_of_one_layout_are_what_they_are_one_by_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
):
    data = [posed(kind, k) for k in range(300)]
    data[77] = data[77][:-9]
    schema = Schema(kind, "ros2msg", definition(STORE, kind))
    sent = [("/body", schema, START_NS + k * STEP_NS, one) for k, one in enumerate(data)]
    path = write_raw(tmp_path / "a.mcap", sent)
    found = [read_episode(path)]
    monkeypatch.setattr(reader, "_MIN_STACKED", 10**9)
    found.append(read_episode(path))
    together, alone = found
    assert list(together.signals) == list(alone.signals)
    assert together.warnings == alone.warnings
    for own, other in zip(together.signals.values(), alone.signals.values(), strict=True):
        assert (own.columns, own.frame) == (other.columns, other.frame)
        assert np.array_equal(own.stamps_ns, other.stamps_ns)
        assert np.array_equal(own.values, other.values, equal_nan=True)


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


def test_too_many_messages_are_averaged_and_that_is_said(tmp_path: Path):
    path, heard = tmp_path / "a.mcap", []
    states(path, STATES)
    with heard_by(lambda what, fraction: heard.append((what, fraction))):
        episode = read_episode(path, most_numbers=6 * 200)
    assert heard[0] == ("reading", 0.0)
    middle = np.arange(3.5, MANY, 8.0)  # of each eight messages
    for signal, sign in zip(episode.signals.values(), (1, -1), strict=True):
        assert np.abs(signal.stamps_ns - START_NS - middle * STEP_NS).max() < 8
        wanted = sign * (middle[:, None] / 7 + np.arange(2))
        assert np.abs(signal.values - wanted).max() < 1e-9
    assert any(f"of {MANY} messages the means of 8" in warning for warning in episode.warnings)
    assert episode.channels[0].messages == MANY
    states(path, [joints(k if k % 2 else 40_000) for k in range(MANY)])
    warnings = read_episode(path, most_numbers=6 * 200).warnings
    assert any("two publishers" in warning for warning in warnings)


# Positions of messages whose types nobody here knows: by their shape, or as a user names them.
HEIGHTS = [1.5 - 0.01 * index for index in range(20)]
STAMPED, POSE_ARRAY = "geometry_msgs/msg/PointStamped", "geometry_msgs/msg/PoseArray"


def stamped(index: int, **fields: Any) -> dict[str, Any]:
    """A message whose stamp is 2 ms before it is heard."""
    return {"header": header(START_NS + index * STEP_NS - 2_000_000, "world"), **fields}


def at(z: float) -> dict[str, Any]:
    return {"position": {"z": z}}


def points(axis: str = "z") -> list[Any]:
    """Heights as one coordinate of a type that is known."""
    return [stamped(index, point={axis: z}) for index, z in enumerate(HEIGHTS)]


TYPES = {
    "gazebo_msgs/msg/ModelStates": "string[] name\ngeometry_msgs/Pose[] pose\n"
    "geometry_msgs/Twist[] twist",
    "px4_msgs/msg/VehicleOdometry": "uint64 timestamp\nuint8 pose_frame\nfloat32[3] position\n"
    "float32[4] q\nfloat32[3] velocity",
    "tags_msgs/msg/Tag": "int32[] id\nfloat64[] size\ngeometry_msgs/PoseWithCovarianceStamped pose",
    "tags_msgs/msg/Tags": "std_msgs/Header header\nTag[] detections",
    "rigid_msgs/msg/Body": "int32 id\nbool tracking_valid\ngeometry_msgs/PoseStamped pose_stamped",
    "rigid_msgs/msg/Bodies": "std_msgs/Header header\nBody[] rigid_bodies",
    "vicon_bridge/msg/Marker": "string marker_name\nstring subject_name\nstring segment_name\n"
    "geometry_msgs/Point translation\nbool occluded",
    "vicon_bridge/msg/Markers": "std_msgs/Header header\nuint32 frame_number\nMarker[] markers",
}


def model_states(index: int, z: float) -> Any:
    """A world with a ball, and a plane that is listed in turns before and behind it."""
    turn = slice(None, None, 1 if index % 2 else -1)
    return {"name": ["ball", "plane"][turn], "pose": [at(z), at(0.0)][turn]}


def tags(index: int, z: float) -> Any:
    tag = {"id": [7], "size": [0.1], "pose": stamped(index, pose={"pose": at(z)})}
    return stamped(index, detections=[tag] if index % 3 else [])


def bodies(index: int, z: float) -> Any:
    body = {"id": 4, "tracking_valid": index != 2, "pose_stamped": stamped(index, pose=at(z))}
    return stamped(index, rigid_bodies=[body])


def vicon(index: int, z: float) -> Any:
    markers = [
        {"marker_name": name, "subject_name": "ball", "translation": {"x": 1.0, "y": 2.0, "z": up},
         "occluded": name == "a" and index == 3}
        for name, up in (("a", z), ("b", 0.0))
    ]  # fmt: skip
    return stamped(index, markers=markers)


def markers(index: int, z: float) -> Any:
    other = {"x": 9.0, "y": 9.0, "z": 9.0}
    one = {"ns": "ball", "id": 3, "action": 0 if index else 3, "pose": at(z), "points": [other]}
    return {"markers": [stamped(index, **one)]}


@pytest.mark.parametrize(
    ("kind", "make", "names", "unit", "count"),
    [
        ("gazebo_msgs/msg/ModelStates", model_states, ["/a.ball", "/a.plane"], "m", 20),
        ("px4_msgs/msg/VehicleOdometry", lambda _, z: {"position": [0, 0, z]}, ["/a"], "", 20),
        ("tags_msgs/msg/Tags", tags, ["/a.7"], "", 13),
        ("rigid_msgs/msg/Bodies", bodies, ["/a.4"], "", 19),
        ("visualization_msgs/msg/MarkerArray", markers, ["/a.ball.3"], "m", 19),
        ("vicon_bridge/msg/Markers", vicon, ["/a.a.ball", "/a.b.ball"], "", 19),
        (POSE_ARRAY, lambda index, z: stamped(index, poses=[at(z)] * 2), ["/a.0", "/a.1"], "m", 20),
    ],
)  # fmt: skip
def test_types_of_labs(
    tmp_path: Path, kind: str, make: Callable[..., Any], names: list[str], unit: str, count: int
):
    sent = in_steps("/a", kind, map(make, range(20), HEIGHTS))
    path = write_cdr(tmp_path / "a.mcap", sent, TYPES)
    signals = read_episode(path).signals
    assert sorted(signals) == names
    signal = signals[names[0]]
    assert (signal.unit, len(signal.stamps_ns)) == (unit, count)
    assert signal.values[-1, 2] == pytest.approx(HEIGHTS[-1])
    if make is vicon:  # those that are hidden are left out, and a unit may be said
        assert np.array_equal(signal.values[:, 2], np.delete(HEIGHTS, 3))
        assert signal.stamps_ns[0] == START_NS - 2_000_000
        scaled = read_episode(path, ReadOptions(length_unit="mm")).signals[names[0]]
        assert (scaled.unit, scaled.values[0, 2]) == ("m", pytest.approx(0.0015))


def test_what_says_too_little_is_not_read(tmp_path: Path):
    """Entries by number whose number changes, and two of one name."""
    path = tmp_path / "a.mcap"
    counts = [3 if index == 5 else 2 for index in range(20)]
    sent = [stamped(n, poses=[at(z)] * counts[n]) for n, z in enumerate(HEIGHTS)]
    write_cdr(path, in_steps("/poses", POSE_ARRAY, sent))
    assert not read_episode(path).signals
    assert (
        "choose one with --columns z=/poses.poses[0].position.z"
        in skipped(read_episode(path))["/poses"]
    )
    messages = [
        {"objects": [{"label": name, "position": [0, 0, z]} for name in ("ball", "x", "x")]}
        for z in HEIGHTS
    ]
    episode = read_episode(write_json(path, in_steps("/objects", "", messages)))
    assert list(episode.signals) == ["/objects.ball"]
    assert "40 entries were left out" in " ".join(episode.warnings)


def test_what_is_known_by_type_comes_first(tmp_path: Path):
    kind = "a_msgs/msg/Where"
    shaped = [{"position": [0.0, 0.0, z]} for z in HEIGHTS]
    sent = [*in_steps("/a", kind, shaped), *in_steps("/z", STAMPED, points())]
    path = write_cdr(tmp_path / "a.mcap", sent, {kind: "float64[3] position"})
    signals = read_episode(path).signals
    assert [(one.name, one.unit) for one in signals.values()] == [("/z", "m"), ("/a", "")]
    assert np.array_equal(signals["/a"].values[:, 2], HEIGHTS)
    assert np.array_equal(signals["/a"].stamps_ns, START_NS + STEP_NS * np.arange(20))


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ("geometry_msgs/Point position\ngeometry_msgs/Pose pose", "several positions"),
        ("geometry_msgs/Quaternion pose", "not one that a task uses"),
        ("geometry_msgs/Vector3 speed", "not one that a task uses"),
    ],
)
def test_what_does_not_say_one_position_is_not_read(tmp_path: Path, fields: str, said: str):
    kind = "a_msgs/msg/What"
    text = definition(ros2({kind: fields}), kind)
    path = write_raw(tmp_path / "a.mcap", [("/a", Schema(kind, text=text), 1, bytes(200))])
    assert said in skipped(read_episode(path))["/a"]


def test_json_that_only_later_says_something_and_json_of_other_things(tmp_path: Path):
    messages = [{"markers": []}] * 3 + [
        {"markers": [{"name": "m", "position": {"x": 0, "y": 0, "z": z}}]} for z in HEIGHTS
    ]
    episode = read_episode(write_json(tmp_path / "a.mcap", in_steps("/tracker", "t", messages)))
    assert np.array_equal(episode.signals["/tracker.m"].values[:, 2], HEIGHTS)
    messages = [{"note": float("nan")}, {"note": 1}, [1, 2]] * 100
    episode = read_episode(write_json(tmp_path / "b.mcap", in_steps("/notes", "t", messages)))
    assert not episode.losses  # is no damage
    assert episode.channels[0].skipped == "its type is not one that a task uses"


OF_TYPE = b"\n" + b"=" * 80 + b"\nMSG: "


@pytest.mark.parametrize(
    "text",
    [
        b"a_msgs/Inner position" + OF_TYPE + b"a_msgs/Inner\na_msgs/Inner position",
        b"a_msgs/Inner[1000000000] markers" + OF_TYPE + b"a_msgs/Inner\n",
        b"float64[3] position\n\x00\xff",
        b"float64[99999999999] position\nfloat64 z",
        b"a_msgs/Missing position\nfloat64 z",
        b"".join(OF_TYPE[1:] + b"a_msgs/T%d\nT%d position0\nT%d position1\n" % (at, at + 1, at + 1)
                 for at in range(40)),
    ],
)  # fmt: skip
def test_a_definition_that_is_made_to_hurt_is_passed_over(tmp_path: Path, text: bytes):
    sent = [("/a", Schema("a_msgs/msg/T0", text=text), 1, bytes(100))]
    episode = read_episode(write_raw(tmp_path / "a.mcap", sent))
    assert not episode.signals
    assert episode.channels[0].skipped


# Fields that a user names.
BALL = "lab_msgs/msg/Ball"
FIELDS = (
    "std_msgs/Header header\nuint64 timestamp\nfloat32[] values\n"
    "geometry_msgs/Point[] points\nfloat64 height\nfloat64 hit\nstring name"
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    sent = [
        stamped(index, timestamp=5_000_000 + 10_000 * index, values=[z, 2 * z, 3 * z],
                points=[{}, {"y": 7.0, "z": z}], height=z, hit=0.01 * index, name="ball")
        for index, z in enumerate(HEIGHTS)
    ]  # fmt: skip
    both = [*in_steps("/ball", BALL, sent), *in_steps("/lab/point", STAMPED, points("y"))]
    return write_cdr(tmp_path / "a.mcap", both, {BALL: FIELDS})


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ("z=/ball.height", [0, 0, 1]),
        ("z=ball.height", [0, 0, 1]),
        ("x=/ball.values[2],z=/ball.height", [3, 0, 1]),
        ("z=/ball.points[1].z", [0, 0, 1]),
        ("z=/lab/point.point.y", [0, 0, 1]),
    ],
)
def test_a_position_is_named_by_its_topic(path: Path, columns: str, expected: list[float]):
    signal = one(path, None, columns)
    topic, unit = ("/lab/point", "m") if "lab" in columns else ("/ball", "")
    assert (signal.name, signal.columns, signal.unit) == (topic, ("x", "y", "z"), unit)
    assert signal.values == pytest.approx(np.outer(HEIGHTS, expected), rel=1e-6)
    assert signal.stamps_ns[0] == START_NS - 2_000_000


def test_units_clocks_impacts_joints_and_currents_that_are_named(path: Path):
    signal = one(path, None, "z=/lab/point.point.y", length_unit="mm")  # goes before a type's
    assert (signal.unit, signal.values[0, 2]) == ("m", pytest.approx(0.0015))
    signal = one(
        path, None, "t=/ball.timestamp,z=/ball.height"
    )  # its unit is told by the log's clock
    assert np.array_equal(signal.stamps_ns, 5_000_000_000 + STEP_NS * np.arange(20))
    signal = one(path, None, "times=/ball.hit")
    assert (signal.name, signal.columns, signal.unit) == ("impacts", ("impact",), "1")
    assert signal.seconds == pytest.approx(0.01 * np.arange(20))
    signal = one(path, None, "times=/ball")  # of the messages
    assert signal.stamps_ns[0] == START_NS - 2_000_000
    assert np.all(signal.values == 1)
    columns = "position_1=/ball.values[0],position_2=/ball.values[1],current_1=/ball.height"
    signals = read(path, None, columns).signals
    assert {name: (one.unit, one.columns) for name, one in signals.items()} == {
        "/ball.position": ("rad", ("joint1", "joint2")),
        "/ball.current": ("A", ("joint1",)),
    }
    asked = "position_1=/ball.values[0],command_1=/ball.values[1],command_2=/ball.values[2]"
    commands = read(path, None, asked).signals["/ball.commands"]
    assert (commands.columns, commands.drives) == (("joint1", "joint2"), True)
    signals = read(path, None, columns, torque_constants=(2.0,)).signals
    assert signals["/ball.effort"].values[:, 0] == pytest.approx(2 * np.array(HEIGHTS))


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ("z=/bal.height", "no topic of --columns z=/bal.height (there are: /ball, /lab/point"),
        ("z=/ball.heigth", "has no heigth; of /ball there are: header.stamp"),
        ("z=/ball.name", "is no number"),
        ("z=/ball", "is a whole message"),
        ("x=/ball.height,z=/lab/point.point.z", "name fields of one topic"),
        ("z=/ball.values[7]", "hold no value"),
    ],
)
def test_what_is_not_there_is_said_in_one_line(path: Path, columns: str, said: str):
    assert said in refusal(path, None, columns)


def test_json_is_read_by_hand_too(tmp_path: Path):
    messages = [{"a": {"b c": [0, z]}, "t": 0.01 * at} for at, z in enumerate(HEIGHTS)]
    path = write_json(tmp_path / "a.mcap", in_steps("/j", "", messages))
    signal = one(path, None, "t=/j.t,z=/j.a.b c[1]")
    assert np.array_equal(signal.values[:, 2], HEIGHTS)
    assert signal.seconds == pytest.approx(0.01 * np.arange(20))
    with pytest.raises(LogError, match="has no q"):
        one(path, None, "z=/j.q")
