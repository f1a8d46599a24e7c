"""Messages as DDS has them: definitions of the OMG, the second version of CDR; interfaces."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from tests.tunenet_logs.any_message_logs import START_NS, STEP_NS, RosLog
from tunenet_logs import messages
from tunenet_logs.episode import Episode
from tunenet_logs.formats.message_types import JointSample
from tunenet_logs.reader import read_episode
from tunenet_logs.signals import JointRows

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


def log(path: Path, kind: str, schema: tuple[str, bytes], sent: Sequence[bytes]) -> Episode:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("")
        number = writer.register_schema(kind, *schema)
        channel = writer.register_channel("/a", "cdr", number)
        for index, data in enumerate(sent):
            stamp_ns = START_NS + index * STEP_NS
            writer.add_message(channel, stamp_ns, data, stamp_ns)
        writer.finish()
    return read_episode(path)


def pose(index: int) -> bytes:
    made = messages.pose(START_NS + index * STEP_NS, "lab", (0.1, 0.2, index / 9))
    return messages.encode(made, messages.POSE)


def test_a_pose_by_a_definition_of_the_omg(tmp_path: Path):
    kind = "geometry_msgs::msg::PoseStamped"
    sent = [pose(index) for index in range(30)]
    (signal,) = log(tmp_path / "a.mcap", kind, ("omgidl", POSE_IDL), sent).signals.values()
    assert signal.values[:, 2].tolist() == [index / 9 for index in range(30)]
    assert signal.frame == "lab"


def test_a_type_of_a_lab_by_a_definition_of_the_omg(tmp_path: Path):
    sent = [
        struct.pack("<4Bi4x3dIf", 0, 1, 0, 0, 7, 0.0, 0.0, index / 9, 1, 0.5) for index in range(30)
    ]
    episode = log(tmp_path / "a.mcap", "lab::Ball", ("omgidl", BALL_IDL), sent)
    (signal,) = episode.signals.values()
    assert signal.values[:, 2].tolist() == [index / 9 for index in range(30)]


def test_a_definition_that_is_not_read_is_named(tmp_path: Path):
    episode = log(tmp_path / "a.mcap", "lab/Ball", ("flatbuffer", b"position"), [pose(0)])
    assert "definition is in 'flatbuffer'" in str(episode.channels[0].skipped)


def xcdr2_joints(index: int, *, has_sizes: bool, order: str = "<") -> bytes:
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
    schema = ("ros2msg", messages.definition(messages.JOINT_STATE).encode())
    episode = log(tmp_path / "a.mcap", messages.JOINT_STATE, schema, sent)
    position, velocity, effort = episode.signals.values()
    assert position.columns == ("one", "two", "three  ")
    rows = np.arange(30)[:, None]
    assert np.array_equal(position.values, rows + np.arange(3))
    assert np.array_equal(velocity.values, np.arange(3) - rows)
    assert np.array_equal(effort.values, 2 * rows + np.arange(3))
    assert not episode.losses


@pytest.mark.parametrize("kind", [2, 3, 8, 9, 10, 11])
def test_messages_with_headers_are_refused_for_that(tmp_path: Path, kind: int):
    sent = [bytes((0, kind)) + pose(index)[2:] for index in range(30)]
    schema = ("ros2msg", messages.definition(messages.POSE).encode())
    episode = log(tmp_path / "a.mcap", messages.POSE, schema, sent)
    assert not episode.losses
    assert "CDR with headers" in str(episode.channels[0].skipped)
    assert "; publish it as final" in str(episode.channels[0].skipped)


@pytest.mark.parametrize("separator", ["/", "."])
def test_names_of_interfaces_are_taken_apart(separator: str):
    kinds = ("position", "velocity", "effort", "temperature")
    names = tuple(f"j{joint}{separator}{kind}" for joint in (1, 2) for kind in kinds)
    rows = JointRows("/joint_states")
    for index in range(30):
        stamp_ns = START_NS + index * STEP_NS
        rows.add(stamp_ns, JointSample(stamp_ns, names, np.arange(8.0) + index))
    (position, velocity, effort), notes = rows.signals()
    for signal, first in ((position, 0), (velocity, 1), (effort, 2)):
        assert signal.columns == ("j1", "j2")
        assert signal.values[5].tolist() == [first + 5, first + 9]
    assert position.unit == "rad"
    assert len(notes) == 1
    assert "temperature" in notes[0]


def test_dynamic_joint_states(tmp_path: Path):
    value = "control_msgs/msg/InterfaceValue"
    kind = "control_msgs/msg/DynamicJointState"
    ros = RosLog(
        {
            value: "string[] interface_names\nfloat64[] values",
            kind: "std_msgs/Header header\nstring[] joint_names\n"
            "control_msgs/InterfaceValue[] interface_values",
        }
    )
    sent = [
        ros.make(
            kind,
            header=ros.header(index),
            joint_names=["a", "b"],
            interface_values=[
                ros.make(value, interface_names=["effort", "position"], values=[first, index / 7])
                for first in (1.0, 2.0)
            ],
        )
        for index in range(40)
    ]
    ros.write(tmp_path / "a.mcap", {"/dynamic_joint_states": (kind, sent)})
    position, effort = read_episode(tmp_path / "a.mcap").signals.values()
    assert position.values[:, 1].tolist() == [index / 7 for index in range(40)]
    assert effort.values[9].tolist() == [1.0, 2.0]
