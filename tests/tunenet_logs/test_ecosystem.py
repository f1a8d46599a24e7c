"""Our logs in other people's readers; one experiment in every container that can hold it."""

from __future__ import annotations

import base64
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore

from tests import strangers
from tests.conftest import BIN
from tests.picture_strangers import COMPRESSED, compressed, write_pictures_folder
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.copying import import_log
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.reader import read_episode
from tunenet_logs.writing.writer import EpisodeWriter

NAMES = [f"joint_{number}" for number in range(1, 8)]
EFFORTS = np.arange(7.0)


@pytest.fixture(scope="module")
def ours(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of ours with all that we write."""
    path = tmp_path_factory.mktemp("ours") / "ours.mcap"
    rng = np.random.default_rng(0)
    with EpisodeWriter(path, EpisodeInfo(kind="drop"), live=False) as writer:
        for index in range(20):
            stamp = index * 10_000_000
            pixels = rng.integers(0, 255, (24, 32, 3), np.uint8)
            jpeg = cv2.imencode(".jpg", pixels)[1].tobytes()
            writer.write_frame("/camera/image_raw/compressed", Frame(stamp, "jpeg", jpeg))
            writer.write_frame("/camera/raw", Frame(stamp, "rgb8", pixels.tobytes(), (32, 24)))
            writer.write_joints("/joint_states", stamp, NAMES, rng.normal(size=7), [], EFFORTS)
            writer.write_pose("/ball/pose", stamp, rng.normal(size=3))
    return path


def test_the_libraries_of_ros_2_and_mcap_read_it(ours: Path):
    with ours.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        decoded = list(reader.iter_decoded_messages())
    assert len(decoded) == 80
    efforts = [one[3].effort for one in decoded if one[1].topic == "/joint_states"]
    assert all(list(one) == list(EFFORTS) for one in efforts)
    with AnyReader([ours]) as bag:
        assert sum(1 for one in bag.messages()) == 80


def test_rerun_shows_all_of_it_natively(ours: Path, tmp_path: Path):
    quiet: dict[str, Any] = {"check": True, "capture_output": True, "text": True, "timeout": 60}
    shown = tmp_path / "a.rrd"
    subprocess.run([BIN / "rerun", "mcap", "convert", ours, "-o", shown], **quiet)
    for entity, component in (
        ("/camera/image_raw/compressed", "EncodedImage:blob"),
        ("/camera/raw", "Image:buffer"),
        ("/joint_states/effort", "Scalars:scalars"),
        ("/ball/pose", ":translation"),
    ):
        words = [BIN / "rerun", "rrd", "print", "-v", "--entity", entity, shown]
        assert component in subprocess.run(words, **quiet).stdout


def write_bag(path: Path, frames: list[Frame]) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    of = store.types
    with BagWriter(path) as writer:
        connection = writer.add_connection("/eye", COMPRESSED, typestore=store)
        for count, frame in enumerate(frames):
            stamp = of["builtin_interfaces/msg/Time"](*divmod(frame.stamp_ns, 10**9))
            header = of["std_msgs/msg/Header"](seq=count, stamp=stamp, frame_id="eye")
            data = np.frombuffer(frame.data, np.uint8)
            message = of[COMPRESSED](header=header, format="jpeg", data=data)
            raw = bytes(store.serialize_ros1(message, COMPRESSED))
            writer.write(connection, frame.stamp_ns, raw)


def write_folder(storage: StoragePlugin) -> Callable[[Path, list[Frame]], object]:
    return lambda path, frames: write_pictures_folder(
        path, (compressed(one.stamp_ns, "jpeg", one.data) for one in frames), storage
    )


def write_json(path: Path, frames: list[Frame]) -> None:
    messages = [
        {
            "timestamp": {"sec": one.stamp_ns // 10**9, "nsec": one.stamp_ns % 10**9},
            "frame_id": "eye",
            "format": "jpeg",
            "data": base64.b64encode(one.data).decode(),
        }
        for one in frames
    ]
    stamps = np.array([one.stamp_ns for one in frames])
    strangers.write_texts(path, "foxglove.CompressedImage", messages, "/eye", stamps)


def write_protobuf(path: Path, frames: list[Frame]) -> None:
    from mcap_protobuf.writer import Writer

    kind = strangers.foxglove("CompressedImage")
    with path.open("wb") as file, Writer(file) as writer:
        for one in frames:
            message = kind(frame_id="eye", format="jpeg", data=one.data)
            message.timestamp.FromNanoseconds(one.stamp_ns)
            writer.write_message("/eye", message, one.stamp_ns, one.stamp_ns)


PICTURES: dict[str, Callable[[Path, list[Frame]], object]] = {
    "a.bag": write_bag,
    "db3": write_folder(StoragePlugin.SQLITE3),
    "mcap": write_folder(StoragePlugin.MCAP),
    "json.mcap": write_json,
    "protobuf.mcap": write_protobuf,
}


def test_the_same_frames_come_out_of_every_container(filmed_log: Path, tmp_path: Path):
    """The same bytes at the same stamps, so the tuned value is the same to the last bit."""
    begin, film = 1_700_000_000 * 10**9, read_episode(filmed_log)
    frames = [one for one in film.frames() if one.stamp_ns < 1.6e9]  # two bounces are enough
    with EpisodeWriter(tmp_path / "ours.mcap", film.info, live=False) as writer:
        for one in frames:
            writer.write_frame("/camera/image_raw/compressed", one)
    truth = [Frame(begin + one.stamp_ns, one.encoding, one.data) for one in frames]
    for name, write in PICTURES.items():
        write(tmp_path / name, truth)
        found = [(one.stamp_ns, one.data) for one in read_episode(tmp_path / name).frames()]
        assert found == [(one.stamp_ns, one.data) for one in truth], name
    logs = (tmp_path / "ours.mcap", tmp_path / "a.bag")
    first, last = (tune_log(log, TuneOptions()).estimate for log in logs)
    assert first is not None
    assert last is not None
    assert abs(first[0] - last[0]) < 1e-3


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("a.bag", strangers.write_poses_bag),
        ("db3", strangers.write_poses_folder),
        ("protobuf.mcap", strangers.write_protobuf),
        ("a.csv", strangers.write_table),
    ],
)
def test_an_import_tunes_like_what_it_came_from(tmp_path: Path, name: str, write: Callable):
    samples = strangers.Stranger(0.6).samples()
    log, imported = tmp_path / name, tmp_path / "imported.mcap"
    write(log, *samples)
    assert import_log(log, imported).messages == len(samples[0])
    one, other = (tune_log(path, TuneOptions()) for path in (log, imported))
    assert one.estimate is not None
    assert other.estimate is not None
    assert abs(one.estimate[0] - other.estimate[0]) < 1e-9
    assert not read_episode(imported).warnings


def test_joints_and_videos_can_be_imported(tmp_path: Path, ours: Path):
    import_log(ours, tmp_path / "again.mcap")
    before, after = read_episode(ours), read_episode(tmp_path / "again.mcap")
    assert before.signals.keys() == after.signals.keys()
    for name, signal in before.signals.items():
        assert np.array_equal(signal.values, after.signals[name].values)
        assert np.array_equal(signal.stamps_ns, after.signals[name].stamps_ns)
    for topic in before.picture_topics:
        pairs = zip(before.frames(topic), after.frames(topic), strict=True)
        assert all((one.data, one.size) == (other.data, other.size) for one, other in pairs)
