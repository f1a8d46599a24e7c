"""JSON messages: ROS and Foxglove types, and whatever else a text can hold."""

from __future__ import annotations

import base64
import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.strangers import write_texts
from tunenet_logs.formats.base import MessageError, RawChannel, UnusableError
from tunenet_logs.formats.decoders import listed_type
from tunenet_logs.formats.message_types import message_type_of
from tunenet_logs.reader import read_episode

POINT = {"x": 1, "y": 2.5, "z": -0.1}
ROS2 = {"stamp": {"sec": 7, "nanosec": 8}, "frame_id": "map"}
ROS1 = {"seq": 3, "stamp": {"secs": 7, "nsecs": 8}, "frame_id": "map"}
TIME = {"sec": 7, "nsec": 8}
POSE = {"timestamp": TIME, "frame_id": "map", "pose": {"position": POINT}}
STAMP = 7_000_000_008


def channel(type_name: str = "foxglove.PoseInFrame", schema_encoding: str = "") -> RawChannel:
    return RawChannel("/any", type_name, "json", schema_encoding)


@pytest.mark.parametrize(
    ("type_name", "message"),
    [
        ("foxglove.PoseInFrame", POSE),
        ("foxglove.Point3InFrame", {"timestamp": TIME, "point": POINT}),
        ("foxglove.Odometry", POSE),
        ("foxglove_msgs/msg/PoseInFrame", {**POSE, "timestamp": ROS2["stamp"]}),
        ("geometry_msgs/msg/PoseStamped", {"header": ROS2, "pose": {"position": POINT}}),
        ("geometry_msgs/PoseStamped", {"header": ROS1, "pose": {"position": POINT}}),
        ("geometry_msgs/PointStamped", {"header": ROS1, "point": POINT}),
        ("nav_msgs/msg/Odometry", {"header": ROS2, "pose": {"pose": {"position": POINT}}}),
    ],
)
def test_positions_of_every_type(tmp_path: Path, type_name: str, message: dict):
    write_texts(tmp_path / "a.mcap", type_name, [message])
    signal = read_episode(tmp_path / "a.mcap").signals["/any"]
    assert signal.values.tolist() == [[1, 2.5, -0.1]]
    assert signal.stamps_ns.tolist() == [STAMP]


@pytest.mark.parametrize(
    ("type_name", "transform"),
    [
        ("tf2_msgs/msg/TFMessage", {"header": ROS2, "transform": {"translation": POINT}}),
        ("tf/tfMessage", {"header": ROS1, "transform": {"translation": POINT}}),
        ("foxglove.FrameTransforms", {"timestamp": TIME, "translation": POINT}),
    ],
)
def test_transforms_of_every_type(tmp_path: Path, type_name: str, transform: dict):
    message = {"transforms": [{**transform, "child_frame_id": "ball"}]}
    write_texts(tmp_path / "a.mcap", type_name, [message])
    assert read_episode(tmp_path / "a.mcap").signals["/any.ball"].values.tolist() == [
        [1, 2.5, -0.1]
    ]


@pytest.mark.parametrize(
    ("type_name", "message"),
    [
        (
            "sensor_msgs/JointState",
            {"header": ROS1, "name": ["a", "b"], "position": [], "velocity": [], "effort": [1, 2]},
        ),
        (
            "foxglove.JointStates",
            {"timestamp": TIME, "joints": [{"name": "a", "effort": 1}, {"name": "b", "effort": 2}]},
        ),
    ],
)
def test_torques_of_every_type(tmp_path: Path, type_name: str, message: dict):
    write_texts(tmp_path / "a.mcap", type_name, [message])
    (signal,) = read_episode(tmp_path / "a.mcap").signals.values()
    assert (signal.name, signal.columns, signal.unit) == ("/any.effort", ("a", "b"), "N·m")
    assert signal.values.tolist() == [[1, 2]]


@pytest.mark.parametrize(
    "data", [base64.b64encode(b"\xff\xd8picture").decode(), list(b"\xff\xd8picture")]
)
def test_pictures_as_base64_and_as_numbers(tmp_path: Path, data: Any):
    message = {"header": ROS2, "format": "jpeg", "data": data}
    write_texts(tmp_path / "a.mcap", "sensor_msgs/msg/CompressedImage", [message])
    (frame,) = read_episode(tmp_path / "a.mcap").frames()
    assert frame.data == b"\xff\xd8picture"


def changed(path: str, value: Any) -> dict:
    message = copy.deepcopy(POSE)
    *places, last = path.split(".")
    part: Any = message
    for place in places:
        part = part[place]
    if value is ...:
        del part[last]
    else:
        part[last] = value
    return message


@pytest.mark.parametrize(
    "message",
    [
        b"",
        b"null",
        b"[]",
        b'"text"',
        b"\xff\xfe",
        b"{",
        json.dumps(changed("pose.position.x", float("nan"))).encode(),
        json.dumps(changed("pose.position.x", float("inf"))).encode(),
        json.dumps(POSE).replace("2.5", "1e999").encode(),
        json.dumps(POSE).replace("2.5", "9" * 400).encode(),
        json.dumps(POSE).replace("2.5", "9" * 5000).encode(),
        changed("pose.position.x", "1"),
        changed("pose.position.x", True),
        changed("pose.position.x", None),
        changed("pose.position.x", [1]),
        changed("pose.position.x", ...),
        changed("pose.position", [1, 2, 3]),
        changed("pose", ...),
        changed("timestamp", ...),
        changed("timestamp", 7.5),
        changed("timestamp.sec", "7"),
        changed("timestamp.sec", 7.5),
        changed("timestamp.sec", 10**12),
        changed("timestamp.nsec", 10**9),
        changed("timestamp.nsec", -1),
        b"[" * 200_000,
        b'{"a":' * 40_000,
        b'{"pose":' + b"[[],[" * 40_000,
        b'{"\\"":' * 40_000,
    ],
)
def test_what_is_no_pose_is_counted_and_left_out(tmp_path: Path, message: Any):
    write_texts(tmp_path / "a.mcap", "foxglove.PoseInFrame", [POSE, message, POSE | {"more": 1}])
    episode = read_episode(tmp_path / "a.mcap")
    assert len(episode.signals["/any"].values) == 1  # the third has the stamp of the first
    assert any("1 damaged" in loss for loss in episode.losses)


def test_brackets_in_a_text_are_not_nesting():
    message = changed("frame_id", '[{\\"' * 1000)
    assert listed_type(channel()).decode(json.dumps(message).encode()).pose.position.x == 1
    deep = changed("frame_id", json.loads("[" * 40 + "]" * 40))
    assert listed_type(channel()).decode(json.dumps(deep).encode()).pose.position.x == 1
    wide = changed("frame_id", [[]] * 1000)
    assert listed_type(channel()).decode(json.dumps(wide).encode()).pose.position.x == 1


def test_a_large_message_is_refused_before_it_is_parsed():
    with pytest.raises(MessageError, match="limit"):
        listed_type(channel()).decode(bytes(17 * 2**20))


def test_what_is_no_picture_may_be_no_larger_than_any_such_message():
    large = changed("frame_id", "a" * 300_000)
    with pytest.raises(MessageError, match="limit"):
        listed_type(channel()).decode(json.dumps(large).encode())


def test_a_picture_may_be_large_but_of_few_parts():
    decode = listed_type(channel("foxglove.CompressedImage")).decode
    picture = {"timestamp": TIME, "frame_id": "a", "format": "jpeg"}
    large = base64.b64encode(bytes(12 * 2**20)).decode()
    assert len(decode(json.dumps(picture | {"data": large}).encode()).data) == 12 * 2**20
    assert decode(json.dumps(picture | {"data": [7] * 1000}).encode()).data == b"\7" * 1000
    with pytest.raises(MessageError, match="objects and lists"):
        decode(json.dumps(picture | {"data": large, "more": [{}] * 100}).encode())
    with pytest.raises(MessageError, match="limit"):
        decode(json.dumps(picture | {"data": large * 3}).encode())


def test_other_schemas_and_types_are_refused():
    with pytest.raises(UnusableError, match="ros2msg"):
        listed_type(channel(schema_encoding="ros2msg"))
    with pytest.raises(UnusableError, match="type"):
        listed_type(channel("foxglove.Log"))
    assert message_type_of(channel("foxglove.Log")) is None


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["header", "stamp", "timestamp", "sec", "nsec", "pose", "position"]),
            inner,
            max_size=4,
        )
    ),
    max_leaves=12,
)


@given(st.data())
def test_any_message_gives_only_our_errors(data: st.DataObject):
    for type_name in ("foxglove.PoseInFrame", "sensor_msgs/JointState", "tf2_msgs/msg/TFMessage"):
        one = channel(type_name)
        kind, decode = message_type_of(one), listed_type(one).decode
        assert kind is not None
        text = data.draw(st.one_of(st.binary(max_size=40), JSON.map(json.dumps)))
        try:
            message = decode(text if isinstance(text, bytes) else text.encode())
        except MessageError:
            continue
        assert kind.read(message) is not None


@given(st.sampled_from(["pose", "timestamp", "pose.position", "pose.position.x"]), JSON)
def test_a_pose_with_anything_in_it_is_a_pose_or_damaged(path: str, value: Any):
    try:
        message = listed_type(channel()).decode(json.dumps(changed(path, value)).encode())
    except MessageError:
        return
    position = message.pose.position
    assert np.isfinite([position.x, position.y, position.z]).all()
