"""An import keeps what is different apart, says what it changed, and leaves nothing half done."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.writer import Writer

from tests.conftest import Command, files_no_larger_than
from tests.export_writers_video import FilmedTrack, mtrack2, phyphox_xlsx
from tests.library_writers import drop
from tunenet_logs import messages
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.copying import import_log
from tunenet_logs.episode import FRAME_NS, EpisodeInfo, Frame, Signal
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
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        for name, type_name, data in topics:
            said = "string data" if "String" in type_name else messages.definition(type_name)
            schema = writer.register_schema(type_name, "ros2msg", said.encode())
            writer.add_message(writer.register_channel(name, "cdr", schema), 1, data, 1)
        writer.finish()
    return path


def imported(log: Path) -> Path:
    target = log.with_name("imported.mcap")
    import_log(log, target)
    return target


def only(path: Path, options: ReadOptions = AS_IT_SAYS) -> Signal:
    (signal,) = read_episode(path, options).signals.values()
    return signal


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


@pytest.mark.parametrize("limit", [10, 4000])
def test_a_full_disk_leaves_nothing_and_says_what_to_do(drop_log: Path, tmp_path: Path, limit: int):
    log = drop_log.rename(tmp_path / "a.mcap")
    with files_no_larger_than(limit), pytest.raises(LogError) as caught:
        import_log(log, tmp_path / "b.mcap")
    assert [one.name for one in tmp_path.iterdir()] == ["a.mcap"]
    assert str(caught.value).startswith(f"{tmp_path / 'b.mcap'}: ")
    assert "record" not in str(caught.value).removeprefix(str(tmp_path))
    if limit > 1000:
        assert "nothing is left of the import; import to another disk" in str(caught.value)


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
    before, after = only(tmp_path / "a.txt"), only(log)
    assert before.unit != "m"
    assert before.counts_frames
    assert (after.unit, after.counts_frames) == (before.unit, True)
    assert np.array_equal(after.stamps_ns, before.stamps_ns)
    assert np.array_equal(after.values, before.values)
    signal = only(log, ReadOptions(fps=240, length_unit="mm"))  # a user goes before the notes
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
    after = only(log)
    assert after.columns == ("impact",)
    assert np.array_equal(after.stamps_ns, only(tmp_path / "a.xlsx").stamps_ns)
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
