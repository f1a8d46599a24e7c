"""Protobuf: what Foxglove's own writer wrote, and descriptors that lie."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.strangers import WRITERS, Stranger
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.formats.base import MessageError, RawChannel, UnusableError
from tunenet_logs.formats.decoders import listed_type
from tunenet_logs.reader import read_episode

POSE = "foxglove.PoseInFrame"


def foxglove(name: str) -> Any:
    module = __import__(f"foxglove_schemas_protobuf.{name}_pb2", fromlist=[name])
    return getattr(module, name)


def schema_of(name: str = "PoseInFrame") -> Any:
    from mcap_protobuf.schema import build_file_descriptor_set

    return build_file_descriptor_set(foxglove(name))


def channel(schema: bytes, type_name: str = POSE) -> RawChannel:
    return RawChannel("/any", type_name, "protobuf", "protobuf", schema)


def write(path: Path, *messages: Any) -> Path:
    from mcap_protobuf.writer import Writer

    with path.open("wb") as file, Writer(file) as writer:
        for count, message in enumerate(messages):
            writer.write_message(f"/{type(message).__name__}", message, 5 + count, 5 + count)
    return path


@pytest.mark.parametrize("name", list(WRITERS)[1:])
def test_every_encoding_reads_as_the_same_numbers(tmp_path: Path, name: str):
    stamps, positions = Stranger(0.6).samples()
    for one in ("cdr.mcap", name):
        WRITERS[one](tmp_path / one, stamps, positions)
    usual = read_episode(tmp_path / "cdr.mcap").signals["/vrpn/thing/pose"]
    episode = read_episode(tmp_path / name)
    (signal,) = episode.signals.values()
    assert np.array_equal(signal.stamps_ns, usual.stamps_ns)
    assert np.array_equal(signal.values, usual.values)
    unit = "" if name == "table.csv" else usual.unit  # its columns are called x, y, z
    assert (signal.columns, signal.unit) == (usual.columns, unit)
    assert not episode.losses


@pytest.mark.parametrize("restitution", [0.35, 0.8])
def test_every_encoding_tunes_to_the_same_value(tmp_path: Path, restitution: float):
    stamps, positions = Stranger(restitution).samples()
    found = []
    for name, write_one in WRITERS.items():
        write_one(tmp_path / name, stamps, positions)
        tuning = tune_log(tmp_path / name, TuneOptions())
        assert tuning.estimate is not None, (name, tuning.reason)
        found.append(float(tuning.estimate[0]))
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
    transforms = foxglove("FrameTransforms")(transforms=[transform])
    path = write(
        tmp_path / "a.mcap", transform, point, odometry, joints, picture, pixels, video, transforms
    )
    episode = read_episode(path)
    assert {one.topic: one.skipped for one in episode.channels if one.skipped} == {}
    assert not episode.losses
    assert episode.signals["/FrameTransform.ball"].values.tolist() == [[0, 0, 2]]
    assert episode.signals["/FrameTransforms.ball"].values.tolist() == [[0, 0, 2]]
    assert episode.signals["/Point3InFrame"].values.tolist() == [[1, 0, 0]]
    assert episode.signals["/Odometry"].values.tolist() == [[0, 3, 0]]
    position = episode.signals["/JointStates.position"]
    assert np.array_equal(position.values, [[0, np.nan]], equal_nan=True)
    assert episode.signals["/JointStates.effort"].values.tolist() == [[1.5, -2.5]]
    assert "/JointStates.velocity" not in episode.signals
    assert set(episode.picture_topics) == {"/CompressedImage", "/RawImage", "/CompressedVideo"}


def test_a_pose_that_says_no_position_is_damaged(tmp_path: Path):
    whole = foxglove("PoseInFrame")()
    whole.pose.position.SetInParent()
    turned = foxglove("PoseInFrame")()
    turned.pose.orientation.w = 1.0
    path = write(tmp_path / "a.mcap", foxglove("PoseInFrame")(), whole, turned)
    episode = read_episode(path)
    assert episode.signals["/PoseInFrame"].values.tolist() == [[0, 0, 0]]
    assert any("2 damaged" in loss for loss in episode.losses)


def test_files_of_a_schema_come_in_any_order_and_googles_may_be_missing():
    files = schema_of()
    for order in (slice(None), slice(None, None, -1)):
        some = type(files)()
        some.file.extend([one for one in files.file if "google" not in one.name][order])
        decode = listed_type(channel(some.SerializeToString())).decode
        message = foxglove("PoseInFrame")()
        message.pose.position.x = 0.1
        assert decode(memoryview(message.SerializeToString())).pose.position.x == 0.1


def forged(change: str) -> Any:
    files = schema_of()
    by_name = {one.name.split("/")[-1]: one for one in files.file}
    pose, point = by_name["PoseInFrame.proto"], by_name["Vector3.proto"].message_type[0]
    if change == "a text for a number":
        point.field[0].type = point.field[0].TYPE_STRING
    elif change == "a list of numbers":
        point.field[0].label = point.field[0].LABEL_REPEATED
    elif change == "another name":
        pose.message_type[0].field[2].name = "attitude"
    elif change == "no such type":
        pose.message_type[0].name = "Other"
    elif change == "a missing file":
        files.file.remove(by_name["Pose.proto"])
    elif change == "a circle":
        by_name["Pose.proto"].dependency.append(pose.name)
    elif change == "a time of its own":
        time = next(one for one in files.file if one.name.endswith("timestamp.proto"))
        time.message_type[0].field[0].type = point.field[0].TYPE_DOUBLE
    elif change == "a number used twice":
        point.field[1].number = 1
    return files


@pytest.mark.parametrize(
    "change",
    [
        "a text for a number",
        "a list of numbers",
        "another name",
        "no such type",
        "a missing file",
        "a circle",
        "a time of its own",
        "a number used twice",
    ],
)
def test_a_forged_schema_is_refused(change: str):
    with pytest.raises(UnusableError, match="schema"):
        listed_type(channel(forged(change).SerializeToString()))


def test_sizes_are_bounded():
    with pytest.raises(UnusableError, match="larger"):
        listed_type(channel(bytes(5 * 2**20)))
    many = schema_of("FrameTransforms").SerializeToString()
    decode = listed_type(channel(many, "foxglove.FrameTransforms")).decode
    with pytest.raises(MessageError, match="limit"):
        decode(b"\x0a\x00" * (3 * 2**20))
    picture = schema_of("CompressedImage").SerializeToString()
    data = foxglove("CompressedImage")(data=bytes(8 * 2**20), format="jpeg").SerializeToString()
    assert (
        len(listed_type(channel(picture, "foxglove.CompressedImage")).decode(data).data)
        == 8 * 2**20
    )


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
        listed_type(channel(schema_of().SerializeToString())).decode(data)


@given(st.data())
def test_any_message_gives_only_our_errors(data: st.DataObject):
    decode = listed_type(channel(schema_of().SerializeToString())).decode
    whole = foxglove("PoseInFrame")(frame_id="map")
    whole.pose.position.x = 0.1
    raw = bytearray(whole.SerializeToString())
    for _ in range(data.draw(st.integers(0, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    for one in (bytes(raw), data.draw(st.binary(max_size=60))):
        try:
            decode(one)
        except MessageError:
            continue


@given(st.data())
def test_any_schema_gives_only_our_errors(data: st.DataObject):
    raw = bytearray(schema_of().SerializeToString())
    for _ in range(data.draw(st.integers(1, 6))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    for one in (bytes(raw), data.draw(st.binary(max_size=100))):
        try:
            listed_type(channel(one)).decode(b"\x1a\x02\x0a\x00")
        except (UnusableError, MessageError):
            continue
