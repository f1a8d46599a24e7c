"""An import keeps what is different apart, says what it changed, and leaves nothing half done."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.writer import Writer

from tests.conftest import Command, files_no_larger_than
from tunenet_logs import messages
from tunenet_logs.copying import import_log
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.errors import LogError
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
            definition = messages.definition(type_name).encode()
            schema = writer.register_schema(type_name, "ros2msg", definition)
            channel = writer.register_channel(name, "cdr", schema)
            writer.add_message(channel, 1, data, 1)
        writer.finish()
    return path


def heights(path: Path) -> dict[str, float]:
    return {name: float(one.values[0, 2]) for name, one in read_episode(path).signals.items()}


def test_names_that_come_to_the_same_topic_stay_apart(tmp_path: Path):
    names = ["ball", "/ball", "/ball/", "/ball_2", "", "/", "a-b", "a b", "a/b"]
    log = write(tmp_path / "a.mcap", [(name, POSE, pose_at(at)) for at, name in enumerate(names)])
    imported = import_log(log, tmp_path / "b.mcap")
    assert heights(tmp_path / "b.mcap") == {
        "/ball": 1, "/ball_2": 3, "/ball_3": 0, "/ball_4": 2, "/unnamed": 4, "/unnamed_2": 5,
        "/a/b": 6, "/a/b_2": 7, "/a/b_3": 8,
    }  # fmt: skip
    assert imported.renamed == (
        "'ball' is /ball_3", "'/ball/' is /ball_4", "'' is /unnamed", "'/' is /unnamed_2",
        "'a-b' is /a/b", "'a b' is /a/b_2", "'a/b' is /a/b_3",
    )  # fmt: skip


def test_poses_joints_and_pictures_of_one_name_stay_apart(tmp_path: Path):
    joints = messages.encode(messages.joint_state(1, ["a"], [0.5], [], []), JOINT_STATE)
    picture = messages.frame(Frame(1, "jpeg", JPEG))[1]
    bare = messages.frame(Frame(2, "rgb8", bytes(24), (4, 2)))[1]
    topics = [
        ("/arm", POSE, pose_at(1.0)),
        ("arm", JOINT_STATE, joints),
        ("arm/", COMPRESSED_IMAGE, picture),
        ("/eye", COMPRESSED_IMAGE, picture),
        ("/eye", IMAGE, bare),
    ]
    imported = import_log(write(tmp_path / "a.mcap", topics), tmp_path / "b.mcap")
    assert imported.messages == 5
    types = {one.topic: one.type_name for one in read_episode(tmp_path / "b.mcap").channels}
    assert types == {
        "/arm": POSE, "/arm_2": JOINT_STATE, "/arm_3": COMPRESSED_IMAGE,
        "/eye": COMPRESSED_IMAGE, "/eye_2": IMAGE,
    }  # fmt: skip


def test_the_command_says_what_was_renamed(command: Command, tmp_path: Path):
    write(tmp_path / "a.mcap", [("/ball", POSE, pose_at(1.0)), ("ball", POSE, pose_at(2.0))])
    result = command("tunenet-logs", "import", "a.mcap", "-o", "b.mcap", cwd=tmp_path)
    assert result.returncode == 0
    assert "  renamed: 'ball' is /ball_2\n" in result.stdout


@pytest.mark.parametrize(("type_name", "data"), [(POSE, b"\0\1\0\0cut"), (IMAGE, b"\0\1\0\0")])
def test_what_is_all_damaged_is_refused_with_the_reason(
    tmp_path: Path, type_name: str, data: bytes
):
    log = write(tmp_path / "a.mcap", [("/ball/pose", type_name, data)])
    with pytest.raises(LogError, match="/ball/pose: 1 damaged messages were left out") as caught:
        import_log(log, tmp_path / "b.mcap")
    assert f"channels: /ball/pose ({type_name}" in str(caught.value)
    assert [one.name for one in tmp_path.iterdir()] == ["a.mcap"]


def test_what_is_never_used_is_refused_with_the_reason(tmp_path: Path):
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        writer.add_message(writer.register_channel("/chat", "cdr", schema), 1, b"", 1)
        writer.finish()
    with pytest.raises(LogError) as caught:
        import_log(path, tmp_path / "b.mcap")
    reason = "(std_msgs/msg/String: its type is not one that a task uses)"
    assert caught.value.what.endswith(f"joints, pictures or sound; channels: /chat {reason}")
    assert "--columns" in caught.value.remedy


class Breaks(Progress):
    """Breaks off while messages are written."""

    def __init__(self, error: BaseException) -> None:
        super().__init__(quiet=True)
        self.error = error

    @contextmanager
    def stages(self, name: str) -> Iterator[None]:
        with heard_by(self.hear):
            yield

    def hear(self, what: str, fraction: float) -> None:
        if what == "importing" and fraction > 0:  # all messages are written
            raise self.error


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


def test_a_name_that_was_taken_meanwhile_is_not_replaced(drop_log: Path, tmp_path: Path):
    output = tmp_path / "b.mcap"

    class Intruder(Breaks):
        def hear(self, what: str, fraction: float) -> None:
            if what == "importing" and fraction > 0:
                output.write_bytes(b"another's")

    with pytest.raises(LogError, match="nothing is left of the import"):
        import_log(drop_log, output, progress=Intruder(KeyboardInterrupt()))
    assert output.read_bytes() == b"another's"
    assert {one.name for one in tmp_path.iterdir()} == {"drop.mcap", "b.mcap"}


def test_what_a_killed_recording_left_is_not_touched(drop_log: Path, tmp_path: Path):
    (tmp_path / "b.mcap.active").write_bytes(b"the only copy")
    with pytest.raises(LogError, match="did not end"):
        import_log(drop_log, tmp_path / "b.mcap")
    assert (tmp_path / "b.mcap.active").read_bytes() == b"the only copy"


def test_what_the_log_notes_is_kept(tmp_path: Path):
    info = EpisodeInfo(kind="drop", notes={"ball": "gel"})
    with EpisodeWriter(tmp_path / "a.mcap", info, live=False) as writer:
        writer.write_pose("/ball", 1, np.zeros(3))
    import_log(tmp_path / "a.mcap", tmp_path / "b.mcap")
    notes = read_episode(tmp_path / "b.mcap").info.notes
    assert (notes["ball"], notes["imported_from"]) == ("gel", "a.mcap")
