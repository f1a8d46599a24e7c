"""JSON and protobuf: types of ROS and Foxglove, anything else in a text, schemas that lie."""

from __future__ import annotations

import base64
import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.message_logs import foxglove, in_steps, write_json, write_protobuf
from tests.reading import tuned
from tests.strangers import WRITERS, Stranger
from tunenet_logs.formats.base import MessageError, RawChannel, UnusableError
from tunenet_logs.formats.decoders import listed_type
from tunenet_logs.formats.message_types import message_type_of
from tunenet_logs.reader import read_episode

POINT = {"x": 1, "y": 2.5, "z": -0.1}
PLACE = [[1, 2.5, -0.1]]
ROS2 = {"stamp": {"sec": 7, "nanosec": 8}, "frame_id": "map"}
ROS1 = {"seq": 3, "stamp": {"secs": 7, "nsecs": 8}, "frame_id": "map"}
TIME = {"sec": 7, "nsec": 8}
POSE = {"timestamp": TIME, "frame_id": "map", "pose": {"position": POINT}}
KIND = "foxglove.PoseInFrame"
MIB = 2**20


def moved(**fields: Any) -> dict[str, Any]:
    return {"transforms": [{**fields, "child_frame_id": "ball"}]}


JOINTS = {"name": ["a", "b"], "position": [], "velocity": [], "effort": [1, 2]}
EACH = [{"name": "a", "effort": 1}, {"name": "b", "effort": 2}]


@pytest.mark.parametrize(
    ("type_name", "message", "topic", "values"),
    [
        (KIND, POSE, "/any", PLACE),
        ("foxglove.Point3InFrame", {"timestamp": TIME, "point": POINT}, "/any", PLACE),
        ("foxglove.Odometry", POSE, "/any", PLACE),
        ("foxglove_msgs/msg/PoseInFrame", {**POSE, "timestamp": ROS2["stamp"]}, "/any", PLACE),
        ("geometry_msgs/msg/PoseStamped", {"header": ROS2, "pose": {"position": POINT}}, "/any",
         PLACE),
        ("geometry_msgs/PoseStamped", {"header": ROS1, "pose": {"position": POINT}}, "/any", PLACE),
        ("geometry_msgs/PointStamped", {"header": ROS1, "point": POINT}, "/any", PLACE),
        ("nav_msgs/msg/Odometry", {"header": ROS2, "pose": {"pose": {"position": POINT}}}, "/any",
         PLACE),
        ("tf2_msgs/msg/TFMessage", moved(header=ROS2, transform={"translation": POINT}),
         "/any.ball", PLACE),
        ("tf/tfMessage", moved(header=ROS1, transform={"translation": POINT}), "/any.ball", PLACE),
        ("foxglove.FrameTransforms", moved(timestamp=TIME, translation=POINT), "/any.ball", PLACE),
        ("sensor_msgs/JointState", {"header": ROS1, **JOINTS}, "/any.effort", [[1, 2]]),
        ("foxglove.JointStates", {"timestamp": TIME, "joints": EACH}, "/any.effort", [[1, 2]]),
    ],
)  # fmt: skip
def test_json_of_every_type(tmp_path: Path, type_name: str, message: dict, topic: str, values):
    write_json(tmp_path / "a.mcap", in_steps("/any", type_name, [message]))
    (signal,) = read_episode(tmp_path / "a.mcap").signals.values()
    assert (signal.name, signal.values.tolist()) == (topic, values)
    assert signal.stamps_ns.tolist() == [7_000_000_008]
    if "effort" in topic:
        assert (signal.columns, signal.unit) == (("a", "b"), "N·m")


@pytest.mark.parametrize(
    "data", [base64.b64encode(b"\xff\xd8picture").decode(), list(b"\xff\xd8picture")]
)
def test_pictures_as_base64_and_as_numbers(tmp_path: Path, data: Any):
    message = {"header": ROS2, "format": "jpeg", "data": data}
    write_json(tmp_path / "a.mcap", in_steps("/any", "sensor_msgs/msg/CompressedImage", [message]))
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


def text(message: Any) -> bytes:
    return json.dumps(message).encode()


@pytest.mark.parametrize(
    "message",
    [
        b"", b"null", b"[]", b'"text"', b"\xff\xfe", b"{",
        *(text(changed("pose.position.x", float(one))) for one in ("nan", "inf")),
        *(text(POSE).replace(b"2.5", one) for one in (b"1e999", b"9" * 400, b"9" * 5000)),
        *(changed("pose.position.x", one) for one in ("1", True, None, [1], ...)),
        changed("pose.position", [1, 2, 3]), changed("pose", ...),
        *(changed("timestamp", one) for one in (..., 7.5)),
        *(changed("timestamp.sec", one) for one in ("7", 7.5, 10**12)),
        *(changed("timestamp.nsec", one) for one in (10**9, -1)),
        b"[" * 200_000, b'{"a":' * 40_000, b'{"pose":' + b"[[],[" * 40_000, b'{"\\"":' * 40_000,
    ],
)  # fmt: skip
def test_what_is_no_pose_is_counted_and_left_out(tmp_path: Path, message: Any):
    write_json(tmp_path / "a.mcap", in_steps("/any", KIND, [POSE, message, POSE | {"more": 1}]))
    episode = read_episode(tmp_path / "a.mcap")
    assert len(episode.signals["/any"].values) == 1  # the third has the stamp of the first
    assert any("1 damaged" in loss for loss in episode.losses)


def json_decoder(type_name: str = KIND, schema_encoding: str = "") -> Any:
    return listed_type(RawChannel("/any", type_name, "json", schema_encoding)).decode


def test_json_is_bounded_before_it_is_parsed():
    decode = json_decoder()
    for frame in ('[{\\"' * 1000, json.loads("[" * 40 + "]" * 40), [[]] * 1000):
        assert decode(text(changed("frame_id", frame))).pose.position.x == 1  # is no nesting
    for large in (bytes(17 * MIB), text(changed("frame_id", "a" * 300_000))):
        with pytest.raises(MessageError, match="limit"):
            decode(large)
    decode = json_decoder("foxglove.CompressedImage")  # may be large, but of few parts
    picture = {"timestamp": TIME, "frame_id": "a", "format": "jpeg"}
    data = base64.b64encode(bytes(12 * MIB)).decode()
    assert len(decode(text(picture | {"data": data})).data) == 12 * MIB
    assert decode(text(picture | {"data": [7] * 1000})).data == b"\7" * 1000
    with pytest.raises(MessageError, match="objects and lists"):
        decode(text(picture | {"data": data, "more": [{}] * 100}))
    with pytest.raises(MessageError, match="limit"):
        decode(text(picture | {"data": data * 3}))
    with pytest.raises(UnusableError, match="ros2msg"):
        json_decoder(schema_encoding="ros2msg")
    with pytest.raises(UnusableError, match="type"):
        json_decoder("foxglove.Log")
    assert message_type_of(RawChannel("/any", "foxglove.Log", "json", "")) is None


# Protobuf.
def schema_of(name: str = "PoseInFrame") -> Any:
    from mcap_protobuf.schema import build_file_descriptor_set

    return build_file_descriptor_set(foxglove(name))


def protobuf_decoder(schema: Any, type_name: str = KIND) -> Any:
    data = schema if isinstance(schema, bytes) else schema.SerializeToString()
    return listed_type(RawChannel("/any", type_name, "protobuf", "protobuf", data)).decode


def write(path: Path, *messages: Any) -> Path:
    sent = ((f"/{type(one).__name__}", 5 + n, one) for n, one in enumerate(messages))
    return write_protobuf(path, sent)


@pytest.mark.parametrize("restitution", [0.35, 0.8])
def test_every_encoding_has_the_same_numbers_and_tunes_to_the_same_value(
    tmp_path: Path, restitution: float
):
    stamps, positions = Stranger(restitution).samples()
    found = []
    for name, write_one in WRITERS.items():
        write_one(tmp_path / name, stamps, positions)
        episode = read_episode(tmp_path / name)
        (signal,) = episode.signals.values()
        assert np.array_equal(signal.stamps_ns, stamps)
        assert np.array_equal(signal.values, positions)
        unit = "" if name == "table.csv" else "m"  # its columns are called x, y, z
        assert (signal.columns, signal.unit) == (("x", "y", "z"), unit)
        assert not episode.losses
        found.append(tuned(tmp_path / name))
    assert np.ptp(found) < 1e-9
    assert abs(found[0] - restitution) < 0.01


def test_all_foxglove_types_with_something_to_use(tmp_path: Path):
    transform = foxglove("FrameTransform")(child_frame_id="ball")
    transform.translation.z = 2
    point = foxglove("Point3InFrame")()
    point.point.x = 1
    odometry = foxglove("Odometry")()
    odometry.pose.position.y = 3
    joints = foxglove("JointStates")()
    joints.joints.add(name="a", position=0.0, effort=1.5)
    joints.joints.add(name="b", effort=-2.5)
    picture = foxglove("CompressedImage")(data=b"\xff\xd8", format="jpeg")
    pixels = foxglove("RawImage")(width=1, height=1, encoding="rgb8", step=3, data=b"abc")
    video = foxglove("CompressedVideo")(data=b"x", format="h264")
    both = foxglove("FrameTransforms")(transforms=[transform])
    sent = (transform, point, odometry, joints, picture, pixels, video, both)
    episode = read_episode(write(tmp_path / "a.mcap", *sent))
    assert {one.topic: one.skipped for one in episode.channels if one.skipped} == {}
    assert not episode.losses
    assert {name: str(one.values.tolist()) for name, one in episode.signals.items()} == {
        "/FrameTransform.ball": "[[0.0, 0.0, 2.0]]", "/FrameTransforms.ball": "[[0.0, 0.0, 2.0]]",
        "/Point3InFrame": "[[1.0, 0.0, 0.0]]", "/Odometry": "[[0.0, 3.0, 0.0]]",
        "/JointStates.position": "[[0.0, nan]]", "/JointStates.effort": "[[1.5, -2.5]]",
    }  # fmt: skip
    assert set(episode.picture_topics) == {"/CompressedImage", "/RawImage", "/CompressedVideo"}


def test_a_pose_that_says_no_position_is_damaged(tmp_path: Path):
    whole, turned = foxglove("PoseInFrame")(), foxglove("PoseInFrame")()
    whole.pose.position.SetInParent()
    turned.pose.orientation.w = 1.0
    episode = read_episode(write(tmp_path / "a.mcap", foxglove("PoseInFrame")(), whole, turned))
    assert episode.signals["/PoseInFrame"].values.tolist() == [[0, 0, 0]]
    assert any("2 damaged" in loss for loss in episode.losses)


def test_files_of_a_schema_come_in_any_order_and_googles_may_be_missing():
    files, message = schema_of(), foxglove("PoseInFrame")()
    message.pose.position.x = 0.1
    for order in (slice(None), slice(None, None, -1)):
        some = type(files)()
        some.file.extend([one for one in files.file if "google" not in one.name][order])
        decode = protobuf_decoder(some)
        assert decode(memoryview(message.SerializeToString())).pose.position.x == 0.1


# By name, a change of the files of a schema: the one of the pose and its places, and a field of it.
FORGED: dict[str, Callable[[Any, dict[str, Any], Any], object]] = {
    "a text for a number": lambda _, of, axis: setattr(axis, "type", axis.TYPE_STRING),
    "a list of numbers": lambda _, of, axis: setattr(axis, "label", axis.LABEL_REPEATED),
    "another name": lambda _, of, axis: setattr(
        of["PoseInFrame"].message_type[0].field[2], "name", "attitude"),
    "no such type": lambda _, of, axis: setattr(of["PoseInFrame"].message_type[0], "name", "Other"),
    "a missing file": lambda files, of, axis: files.file.remove(of["Pose"]),
    "a circle": lambda _, of, axis: of["Pose"].dependency.append(of["PoseInFrame"].name),
    "a time of its own": lambda _, of, axis: setattr(
        of["timestamp"].message_type[0].field[0], "type", axis.TYPE_DOUBLE),
    "a number used twice": lambda _, of, axis: setattr(axis, "number", 2),
}  # fmt: skip


@pytest.mark.parametrize("change", FORGED)
def test_a_forged_schema_is_refused(change: str):
    files = schema_of()
    by_name = {Path(one.name).stem: one for one in files.file}
    FORGED[change](files, by_name, by_name["Vector3"].message_type[0].field[0])
    with pytest.raises(UnusableError, match="schema"):
        protobuf_decoder(files)


def test_sizes_are_bounded():
    with pytest.raises(UnusableError, match="larger"):
        protobuf_decoder(bytes(5 * MIB))
    decode = protobuf_decoder(schema_of("FrameTransforms"), "foxglove.FrameTransforms")
    with pytest.raises(MessageError, match="limit"):
        decode(b"\x0a\x00" * (3 * MIB))
    decode = protobuf_decoder(schema_of("CompressedImage"), "foxglove.CompressedImage")
    data = foxglove("CompressedImage")(data=bytes(8 * MIB), format="jpeg").SerializeToString()
    assert len(decode(data).data) == 8 * MIB


@pytest.mark.parametrize(
    "data",
    [
        b"\x1a\xff\xff\xff\xff\xff\xff\xff\xff\xff\x01",  # a length of 2**64 - 1
        b"\xff" * 20,  # a tag that does not end
        b"\x1b" * 100_000,  # groups within groups
        b"\x12\x02\xff\xff\x1a\x02\x0a\x00",  # a text that is none
    ],
)
def test_hostile_messages_are_one_clean_error(data: bytes):
    with pytest.raises(MessageError):
        protobuf_decoder(schema_of())(data)
