"""Very many messages, of one layout or of several: read together, and as they are one by one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from tests.tunenet_logs.any_message_logs import START_NS, STEP_NS, RosLog
from tunenet_logs import messages
from tunenet_logs.formats.base import RawMessage, one_by_one
from tunenet_logs.formats.mcap import read_mcap
from tunenet_logs.formats.ros import known_types, stacked_decoder
from tunenet_logs.reader import read_episode
from tunenet_logs.terminal import heard_by

COUNT = 1200


def joints(index: int, names: tuple[str, ...], effort: bool = True) -> bytes:
    values = np.arange(len(names)) + index / 7
    state = messages.joint_state(
        START_NS + index * STEP_NS, names, values, values[:0], -values if effort else values[:0]
    )
    return messages.encode(state, messages.JOINT_STATE)


def log(path: Path, data: list[bytes], chunk: int = 200_000, beside: int = 0) -> Path:
    """A log of /joint_states, with a message of another topic after every `beside`."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk, use_chunking=chunk > 0)
        writer.start("ros2")
        text = messages.definition(messages.JOINT_STATE).encode()
        schema = writer.register_schema(messages.JOINT_STATE, "ros2msg", text)
        channel = writer.register_channel("/joint_states", "cdr", schema)
        text_schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        other = writer.register_channel("/chat", "cdr", text_schema)
        for index, one in enumerate(data):
            stamp_ns = START_NS + index * STEP_NS
            writer.add_message(channel, stamp_ns, one, stamp_ns)
            if beside and index % beside == 0:
                writer.add_message(other, stamp_ns, b"\0\1\0\0" + bytes(index % 9), stamp_ns)
        writer.finish()
    return path


@pytest.mark.parametrize("beside", [0, 1, 5, 40])
@pytest.mark.parametrize("chunk", [0, 500, 20_000, 10_000_000])
def test_all_that_was_written_is_read(tmp_path: Path, beside: int, chunk: int):
    path = log(tmp_path / "a.mcap", [joints(k, ("a", "b")) for k in range(COUNT)], chunk, beside)
    episode = read_episode(path)
    position, effort = episode.signals.values()
    wanted = np.arange(COUNT)[:, None] / 7 + np.arange(2)
    assert np.array_equal(position.values, wanted)
    assert np.array_equal(effort.values, -wanted)
    assert np.array_equal(position.stamps_ns, START_NS + np.arange(COUNT) * STEP_NS)
    assert episode.channels[0].messages == COUNT


def test_layouts_by_turns_keep_their_order(tmp_path: Path):
    """An arm and a gripper on one topic, whose messages have several lengths and names."""
    names = (("a", "b"), ("gripper",), ("a", "b"))
    data = [joints(k, names[k % 3], k % 3 < 2) for k in range(COUNT)]
    position, effort = read_episode(log(tmp_path / "a.mcap", data)).signals.values()
    assert position.columns == ("a", "b", "gripper")
    times = np.arange(COUNT)
    arm = times % 3 != 1
    assert np.array_equal(position.values[arm, 1], times[arm] / 7 + 1)
    assert np.isnan(position.values[~arm, 0]).all()
    assert np.array_equal(np.isfinite(effort.values[:, 0]), times % 3 == 0)


def test_a_damaged_message_among_many_is_left_out_and_said(tmp_path: Path):
    data = [joints(k, ("a", "b")) for k in range(COUNT)]
    data[700] = data[700][:40]
    episode = read_episode(log(tmp_path / "a.mcap", data))
    assert len(next(iter(episode.signals.values())).stamps_ns) == COUNT - 1
    assert any("1 damaged messages" in loss for loss in episode.losses)


def test_of_too_many_messages_some_are_kept_evenly_and_that_is_said(tmp_path: Path):
    path = log(tmp_path / "a.mcap", [joints(k, ("a", "b")) for k in range(COUNT)])
    episode = read_episode(path, most_numbers=6 * 200)
    position, _ = episode.signals.values()
    assert np.array_equal(position.stamps_ns, START_NS + np.arange(0, COUNT, 8) * STEP_NS)
    assert any(f"of {COUNT} messages every 8th" in warning for warning in episode.warnings)
    assert episode.channels[0].messages == COUNT


def test_two_publishers_among_too_many_messages_are_said(tmp_path: Path):
    data = [joints(k if k % 2 else 40_000, ("a", "b")) for k in range(COUNT)]
    episode = read_episode(log(tmp_path / "a.mcap", data), most_numbers=6 * 200)
    assert any("two publishers" in warning for warning in episode.warnings)


def test_reading_tells_how_far_it_is(tmp_path: Path):
    path = log(tmp_path / "a.mcap", [joints(k, ("a", "b")) for k in range(COUNT)])
    heard: list[tuple[str, float]] = []
    with heard_by(lambda what, fraction: heard.append((what, fraction))):
        read_episode(path)
    assert heard[0] == ("reading", 0.0)


@pytest.mark.parametrize("is_ros1", [False, True])
def test_stacked_messages_are_those_that_rosbags_decodes(is_ros1: bool):
    ros = RosLog({}, is_ros1=is_ros1)
    kind = "nav_msgs/msg/Odometry"
    store = ros.store
    rows: list[bytes] = []
    for index in range(9):
        header = {"stamp": store.types["builtin_interfaces/msg/Time"](index, 5), "frame_id": "odom"}
        if is_ros1:
            header["seq"] = index
        pose = store.types["geometry_msgs/msg/PoseWithCovariance"](
            ros.pose(index, 2.0, -index), np.arange(36.0)
        )
        zero = store.types["geometry_msgs/msg/Vector3"](0.0, 0.0, index / 3)
        twist = store.types["geometry_msgs/msg/TwistWithCovariance"](
            store.types["geometry_msgs/msg/Twist"](zero, zero), np.zeros(36)
        )
        message = store.types[kind](
            store.types["std_msgs/msg/Header"](**header),
            "ball" if index < 6 else "cube",
            pose,
            twist,
        )
        data = (
            store.serialize_ros1(message, kind) if is_ros1 else store.serialize_cdr(message, kind)
        )
        rows.append(bytes(data))
    decode = stacked_decoder(known_types(is_ros1=is_ros1), kind, is_ros1=is_ros1)
    message, same = decode(np.array([list(row) for row in rows], np.uint8))
    assert same.tolist() == [True] * 6 + [False] * 3
    assert message.child_frame_id == "ball"
    assert message.header.stamp.sec.tolist() == list(range(6))
    assert message.pose.pose.position.z.tolist() == [-float(k) for k in range(6)]
    assert np.array_equal(message.pose.covariance, np.tile(np.arange(36.0), (6, 1)))
    assert message.twist.twist.angular.z.tolist() == [k / 3 for k in range(6)]


def test_what_comes_together_is_what_comes_one_by_one(tmp_path: Path):
    data = [joints(k, ("a", "b")) for k in range(200)]
    path = log(tmp_path / "a.mcap", data, beside=3)
    found = [one for one in one_by_one(read_mcap(path, [])) if isinstance(one, RawMessage)]
    own = [bytes(one.data) for one in found if one.channel.topic == "/joint_states"]
    assert own == data
    assert [one.log_ns for one in found] == sorted(one.log_ns for one in found)
