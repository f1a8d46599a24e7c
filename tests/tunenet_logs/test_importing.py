"""An import keeps what is apart and leaves nothing half done; our logs in others' readers."""

from __future__ import annotations

import base64
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin

from tests import strangers
from tests.conftest import BIN, Command
from tests.export_writers_video import FilmedTrack, mtrack2, phyphox_xlsx
from tests.library_writers import drop
from tests.message_logs import (
    Schema,
    Sent,
    foxglove,
    header,
    write_bag,
    write_folder,
    write_json,
    write_protobuf,
    write_raw,
)
from tests.reading import one, tuned
from tunenet_logs import messages
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.copying import import_log
from tunenet_logs.episode import FRAME_NS, EpisodeInfo, Frame
from tunenet_logs.errors import LogError
from tunenet_logs.formats.options import AS_IT_SAYS, ReadOptions
from tunenet_logs.messages import COMPRESSED_IMAGE, IMAGE, JOINT_STATE, POSE
from tunenet_logs.reader import read_episode
from tunenet_logs.terminal import Progress, heard_by
from tunenet_logs.writing.writer import EpisodeWriter

Topic = tuple[str, str, bytes]
JPEG = cv2.imencode(".jpg", np.zeros((24, 32, 3), np.uint8))[1].tobytes()


def pose_at(height_m: float) -> bytes:
    return messages.encode(messages.pose(1, "world", np.array([0, 0, height_m])), POSE)


def write(path: Path, topics: list[Topic]) -> Path:
    """A log with one message a topic, one of others: no data checksum, any name."""
    sent = []
    for name, kind, data in topics:
        said = "string data" if "String" in kind else messages.definition(kind)
        sent.append((name, Schema(kind, text=said.encode()), 1, data))
    return write_raw(path, sent)


def imported(log: Path) -> Path:
    target = log.with_name("imported.mcap")
    import_log(log, target)
    return target


def test_names_that_come_to_the_same_topic_stay_apart(command: Command, tmp_path: Path):
    names = ["ball", "/ball", "/ball/", "/ball_2", "", "/", "a-b", "a b", "a/b"]
    write(tmp_path / "a.mcap", [(name, POSE, pose_at(at)) for at, name in enumerate(names)])
    result = command("tunenet-logs", "import", "a.mcap", "-o", "b.mcap", cwd=tmp_path)
    assert result.returncode == 0
    signals = read_episode(tmp_path / "b.mcap").signals
    assert {name: float(one.values[0, 2]) for name, one in signals.items()} == {
        "/ball": 1, "/ball_2": 3, "/ball_3": 0, "/ball_4": 2, "/unnamed": 4, "/unnamed_2": 5,
        "/a/b": 6, "/a/b_2": 7, "/a/b_3": 8,
    }  # fmt: skip
    renamed = (
        "'ball' is /ball_3", "'/ball/' is /ball_4", "'' is /unnamed", "'/' is /unnamed_2",
        "'a-b' is /a/b", "'a b' is /a/b_2", "'a/b' is /a/b_3",
    )  # fmt: skip
    assert import_log(tmp_path / "a.mcap", tmp_path / "c.mcap").renamed == renamed
    assert all(f"  renamed: {one}\n" in result.stdout for one in renamed)


def test_poses_joints_and_pictures_of_one_name_stay_apart(tmp_path: Path):
    joints = messages.encode(messages.joint_state(1, ["a"], [0.5], [], []), JOINT_STATE)
    picture = messages.frame(Frame(1, "jpeg", JPEG))[1]
    bare = messages.frame(Frame(2, "rgb8", bytes(24), (4, 2)))[1]
    topics = [
        ("/arm", POSE, pose_at(1.0)), ("arm", JOINT_STATE, joints),
        ("arm/", COMPRESSED_IMAGE, picture), ("/eye", COMPRESSED_IMAGE, picture),
        ("/eye", IMAGE, bare),
    ]  # fmt: skip
    assert import_log(write(tmp_path / "a.mcap", topics), tmp_path / "b.mcap").messages == 5
    types = {one.topic: one.type_name for one in read_episode(tmp_path / "b.mcap").channels}
    assert types == {
        "/arm": POSE, "/arm_2": JOINT_STATE, "/arm_3": COMPRESSED_IMAGE,
        "/eye": COMPRESSED_IMAGE, "/eye_2": IMAGE,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("topic", "type_name", "data", "says"),
    [
        *(("/ball/pose", kind, data, "/ball/pose: 1 damaged messages were left out")
          for kind, data in ((POSE, b"\0\1\0\0cut"), (IMAGE, b"\0\1\0\0"))),
        ("/chat", "std_msgs/msg/String", b"", "joints, pictures or sound; channels: "),
    ],
)  # fmt: skip
def test_what_holds_nothing_is_refused_with_the_reason(
    tmp_path: Path, topic: str, type_name: str, data: bytes, says: str
):
    log = write(tmp_path / "a.mcap", [(topic, type_name, data)])
    with pytest.raises(LogError, match=says) as caught:
        import_log(log, tmp_path / "b.mcap")
    assert f"channels: {topic} ({type_name}" in str(caught.value)
    assert [one.name for one in tmp_path.iterdir()] == ["a.mcap"]
    if topic == "/chat":
        assert caught.value.what.endswith(f"({type_name}: its type is not one that a task uses)")
        assert "--columns" in caught.value.remedy


class Breaks(Progress):
    """Does something once all messages are written."""

    def __init__(self, act: Any) -> None:
        super().__init__(quiet=True)
        self.act = act

    @contextmanager
    def stages(self, name: str) -> Iterator[None]:
        with heard_by(self.hear):
            yield

    def hear(self, what: str, fraction: float) -> None:
        if what == "importing" and fraction > 0:
            if isinstance(self.act, BaseException):
                raise self.act
            self.act()


@pytest.mark.parametrize("error", [KeyboardInterrupt(), LogError("a.bag: broken"), MemoryError()])
@pytest.mark.parametrize("overwrite", [False, True])
def test_an_import_that_is_broken_off_leaves_nothing(
    drop_log: Path, tmp_path: Path, error: BaseException, overwrite: bool
):
    output = tmp_path / "b.mcap"
    if overwrite:
        output.write_bytes(drop_log.read_bytes())
    before = {one: one.read_bytes() for one in tmp_path.iterdir()}
    with pytest.raises(type(error)):
        import_log(drop_log, output, overwrite=overwrite, progress=Breaks(error))
    assert {one: one.read_bytes() for one in tmp_path.iterdir()} == before


def test_what_is_anothers_is_not_touched(drop_log: Path, tmp_path: Path):
    output = tmp_path / "b.mcap"
    with pytest.raises(LogError, match="nothing is left of the import"):  # it came meanwhile
        import_log(drop_log, output, progress=Breaks(lambda: output.write_bytes(b"another's")))
    assert output.read_bytes() == b"another's"
    assert {one.name for one in tmp_path.iterdir()} == {"drop.mcap", "b.mcap"}
    output.rename(tmp_path / "b.mcap.active")  # what a killed recording left
    with pytest.raises(LogError, match="did not end"):
        import_log(drop_log, output)
    assert (tmp_path / "b.mcap.active").read_bytes() == b"another's"


def test_what_the_log_notes_is_kept(tmp_path: Path):
    info = EpisodeInfo(kind="drop", notes={"ball": "gel"})
    with EpisodeWriter(tmp_path / "a.mcap", info, live=False) as writer:
        writer.write_pose("/ball", 1, np.zeros(3))
    notes = read_episode(imported(tmp_path / "a.mcap")).info.notes
    assert (notes["ball"], notes["imported_from"]) == ("gel", "a.mcap")


# What messages cannot say goes through an import all the same: units, frames, impacts.
def test_pixels_and_frames_without_a_rate_stay_what_they_are(tmp_path: Path):
    seconds, places = drop()
    track = FilmedTrack(seconds, {"ball": places}, 400.0, True, (300, 500), 240.0)
    mtrack2(tmp_path / "a.txt", track)
    log = imported(tmp_path / "a.txt")
    before, after = one(tmp_path / "a.txt"), one(log)
    assert before.unit != "m"
    assert before.counts_frames
    assert (after.unit, after.counts_frames) == (before.unit, True)
    assert np.array_equal(after.stamps_ns, before.stamps_ns)
    assert np.array_equal(after.values, before.values)
    signal = one(log, fps=240, length_unit="mm")  # a user goes before the notes
    assert (signal.unit, signal.counts_frames) == ("m", False)
    assert signal.rate_hz == pytest.approx(240, rel=1e-5)
    first, second = (tune_log(one, options=TuneOptions()) for one in (tmp_path / "a.txt", log))
    assert first.estimate is not None
    assert second.estimate == pytest.approx(first.estimate, abs=1e-6)
    assert second.detection.units == first.detection.units
    assert second.detection.extent == first.detection.extent


def test_impacts_are_times_and_no_places(tmp_path: Path):
    phyphox_xlsx(tmp_path / "a.xlsx", [0.0, 0.9, 1.6, 2.1, 2.5])
    log = imported(tmp_path / "a.xlsx")
    after = one(log)
    assert after.columns == ("impact",)
    assert np.array_equal(after.stamps_ns, one(tmp_path / "a.xlsx").stamps_ns)
    channels = [(one.type_name, one.skipped) for one in read_episode(log).channels]
    assert channels == [("std_msgs/msg/Header", None)]


def test_pictures_without_a_rate_stay_without_one(tmp_path: Path):
    folder = tmp_path / "film"
    folder.mkdir()
    for number in range(5):
        data = cv2.imencode(".jpg", np.full((24, 32), 9 * number, np.uint8))[1].tobytes()
        (folder / f"{number}.jpg").write_bytes(data)
    log = imported(folder)
    for options, untimed, step_ns in (
        (AS_IT_SAYS, True, FRAME_NS),
        (ReadOptions(fps=500), False, 2_000_000),
    ):
        episode = read_episode(log, options)
        assert bool(episode.frames_untimed) == untimed
        assert np.diff([one.stamp_ns for one in episode.frames()]).tolist() == [step_ns] * 4


# Our logs in other people's readers; one experiment in every container that can hold it.
NAMES = [f"joint_{number}" for number in range(1, 8)]
EFFORTS = np.arange(7.0)


POSITIONS, PIXELS = np.random.default_rng(0).normal(size=(20, 3)), bytes(range(24))


@pytest.fixture(scope="module")
def ours(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of ours with all that we write."""
    path = tmp_path_factory.mktemp("ours") / "ours.mcap"
    info = EpisodeInfo(kind="drop", source="a test", truth={"restitution": 0.5})
    with EpisodeWriter(path, info, live=False) as writer:
        for index, place in enumerate(POSITIONS):
            stamp = index * 10_000_000 + 7
            writer.write_frame("/camera/image_raw/compressed", Frame(stamp, "jpeg", JPEG))
            writer.write_frame("/camera/raw", Frame(stamp, "rgb8", PIXELS, (4, 2)))
            writer.write_joints("/joint_states", stamp, NAMES, EFFORTS / 2, [], EFFORTS)
            writer.write_pose("/ball/pose", stamp, place)
        with pytest.raises(ValueError, match="cannot hold sensor_msgs/msg/JointState"):
            writer.write_joints("/camera/raw", 6, [], [])  # a topic holds one type
    return path


def test_it_comes_back_bit_for_bit(ours: Path):
    episode, ball = read_episode(ours), read_episode(ours).signals["/ball/pose"]
    assert np.array_equal(ball.values, POSITIONS)
    assert np.array_equal(ball.stamps_ns, np.arange(20) * 10_000_000 + 7)
    assert (episode.info.truth["restitution"], episode.info.counts["written"]) == (0.5, 80)
    assert not episode.warnings
    frames = list(episode.frames("/camera/image_raw/compressed"))
    assert [frame.stamp_ns for frame in frames] == ball.stamps_ns.tolist()
    assert all((one.data, one.encoding) == (JPEG, "jpeg") for one in frames)
    assert list(ours.parent.iterdir()) == [ours]


def test_the_libraries_of_ros_2_and_mcap_read_it(ours: Path):
    with ours.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        assert len(list(reader.iter_decoded_messages())) == 80
        assert reader.get_header().profile == "ros2"
        records = {record.name: record.metadata for record in reader.iter_metadata()}
        assert records["tunenet/episode"]["truth.restitution"] == "0.5"
    with AnyReader([ours]) as bag:
        seen: list[tuple[str, Any]] = [
            (one.topic, bag.deserialize(raw, one.msgtype)) for one, _, raw in bag.messages()
        ]
    last = dict(seen)
    heights = [one.pose.position.z for topic, one in seen if topic == "/ball/pose"]
    assert heights == list(POSITIONS[:, 2])
    image, state = last["/camera/raw"], last["/joint_states"]
    assert (image.width, image.height, image.step, image.encoding) == (4, 2, 12, "rgb8")
    assert image.data.tobytes() == PIXELS
    assert (image.header.stamp.sec, image.header.stamp.nanosec) == (0, 190_000_007)
    parts = [list(one) for one in (state.position, state.velocity, state.effort)]
    assert (state.name, parts) == (NAMES, [list(EFFORTS / 2), [], list(EFFORTS)])


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


KIND, FOXGLOVE = "sensor_msgs/msg/CompressedImage", "foxglove.CompressedImage"


def sent(frames: list[Frame]) -> list[Sent]:
    return [
        ("/eye", KIND, one.stamp_ns,
         {"header": header(one.stamp_ns, "eye"), "format": "jpeg", "data": one.data})
        for one in frames
    ]  # fmt: skip


def in_json(path: Path, frames: list[Frame]) -> None:
    messages = []
    for frame in frames:
        at = {"sec": frame.stamp_ns // 10**9, "nsec": frame.stamp_ns % 10**9}
        data = base64.b64encode(frame.data).decode()
        fields = {"timestamp": at, "frame_id": "eye", "format": "jpeg", "data": data}
        messages.append(("/eye", FOXGLOVE, frame.stamp_ns, fields))
    write_json(path, messages, start_ns=0)


def in_protobuf(path: Path, frames: list[Frame]) -> None:
    messages = []
    for frame in frames:
        message = foxglove("CompressedImage")(frame_id="eye", format="jpeg", data=frame.data)
        message.timestamp.FromNanoseconds(frame.stamp_ns)
        messages.append(("/eye", frame.stamp_ns, message))
    write_protobuf(path, messages)


PICTURES: dict[str, Callable[[Path, list[Frame]], object]] = {
    "a.bag": lambda path, frames: write_bag(path, sent(frames), start_ns=0),
    "db3": lambda path, frames: write_folder(path, sent(frames), start_ns=0),
    "mcap": lambda path, frames: write_folder(path, sent(frames), StoragePlugin.MCAP, start_ns=0),
    "json.mcap": in_json,
    "protobuf.mcap": in_protobuf,
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
    assert tuned(logs[0]) == pytest.approx(tuned(logs[1]), abs=1e-3)


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
    assert tuned(log) == pytest.approx(tuned(imported), abs=1e-9)
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
