"""Cameras that start late, are cut off, freeze, or are killed and started again."""

from __future__ import annotations

import re
import signal
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import BIN
from tests.recorders.coming_camera import ComingCamera
from tests.recorders.films import recorded
from tests.recorders.live_wait import LAST_RESORT_S, ending, wait_until
from tests.recorders.mjpeg_camera import picture
from tests.recorders.servers import PART, STREAM, Answering, answering
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.errors import CameraError
from tunenet_logs.messages import CAMERA_TOPIC
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.base import Source
from tunenet_logs.recorders.camera.reconnecting import lasting_camera
from tunenet_logs.recorders.camera.sources import open_source
from tunenet_logs.timing.stamps import Gap, noted_gaps, parts_between
from tunenet_logs.writing.writer import EpisodeWriter

pytestmark = pytest.mark.live

ENOUGH_BYTES = 400_000  # of a log: some twenty pictures


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log whose pictures a camera shows."""
    log = tmp_path_factory.mktemp("shown") / "shown.mcap"
    with EpisodeWriter(log, EpisodeInfo(), live=False) as writer:
        for number in range(30):
            writer.write_frame(CAMERA_TOPIC, Frame(number, "jpeg", picture(number)))
    return log


@pytest.fixture
def camera(shown: Path) -> Iterator[ComingCamera]:
    """One that has not come yet."""
    one = ComingCamera(shown)
    yield one
    one.go()


class Recorder:
    """`tunenet-record` of a camera, to a.mcap of a folder; what it says is in a file there."""

    def __init__(self, address: str, folder: Path, **options: float) -> None:
        self.log = folder / "a.mcap"
        self._said = folder / "said"
        words = [text for name, value in options.items() for text in (f"--{name}", str(value))]
        words = [BIN / "tunenet-record", "--camera", address, *words, "-o", self.log]
        with self._said.open("w") as said:
            self.process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=said, text=True)

    @property
    def said(self) -> str:
        """On standard error so far."""
        return self._said.read_text()

    def wait_for(self, words: str) -> None:
        """Until it says so."""
        wait_until(lambda: words in self.said, words)

    def wait_for_more(self) -> None:
        """Until it has written some pictures more."""
        active = self.log.with_name("a.mcap.active")
        wait_until(active.exists, "a log")
        before = active.stat().st_size
        wait_until(lambda: active.stat().st_size > before + ENOUGH_BYTES, "pictures")

    def end(self, number: int = 0) -> str:
        """Send it a signal, if it is one; its last line."""
        if number:
            self.process.send_signal(number)
        return self.process.communicate(timeout=LAST_RESORT_S)[0]


@pytest.fixture
def recorder(camera: ComingCamera, tmp_path: Path) -> Iterator[Recorder]:
    """One that has recorded some of a camera that is there."""
    camera.come()
    one = Recorder(camera.address, tmp_path, stall=LAST_RESORT_S)
    with ending(one.process):
        one.wait_for_more()
        yield one


def cut(camera: ComingCamera, _recorder: Recorder) -> None:
    camera.send(signal.SIGUSR1)


def freeze(camera: ComingCamera, recorder: Recorder) -> None:
    camera.send(signal.SIGSTOP)
    recorder.wait_for("fell silent")
    camera.send(signal.SIGCONT)


def kill(camera: ComingCamera, recorder: Recorder) -> None:
    camera.go()
    recorder.wait_for("trying again")
    camera.come()


@pytest.mark.parametrize("fault", [cut, kill, pytest.param(freeze, marks=pytest.mark.slow)])
def test_a_camera_that_comes_back_is_recorded_on_and_its_gap_is_marked(camera, recorder, fault):
    fault(camera, recorder)
    recorder.wait_for("camera back after")
    recorder.wait_for_more()
    line = recorder.end(signal.SIGINT)
    assert recorder.process.returncode == 0
    assert re.search(r", 1 gap of \d+\.\d s\b.*\(stopped by a signal\)$", line.strip())
    episode = read_episode(recorder.log)
    assert not episode.warnings
    stamps_ns = np.array([frame.stamp_ns for frame in episode.frames()])
    (gap,) = noted_gaps(episode.info.notes)
    at = int(np.searchsorted(stamps_ns, gap.last_ns))
    assert gap == Gap(*stamps_ns[at : at + 2].tolist())
    assert np.diff(stamps_ns).argmax() == at or fault is cut
    assert set(parts_between(stamps_ns, [gap])) == {0, 1}


def test_a_killed_recorder_has_marked_the_gap(camera: ComingCamera, recorder: Recorder):
    camera.send(signal.SIGUSR1)
    recorder.wait_for("camera back after")
    recorder.wait_for_more()
    recorder.end(signal.SIGKILL)
    active = recorder.log.with_name("a.mcap.active")
    assert len(noted_gaps(read_episode(active).info.notes)) == 1


def test_a_signal_ends_a_recording_whose_camera_is_away(camera: ComingCamera, recorder: Recorder):
    camera.go()
    recorder.wait_for("trying again")
    line = recorder.end(signal.SIGINT)
    assert recorder.process.returncode == 0
    assert "(stopped by a signal)" in line
    assert not read_episode(recorder.log).warnings


def test_one_that_stays_away_ends_it_with_all_that_came(camera: ComingCamera, tmp_path: Path):
    camera.come()
    recorder = Recorder(camera.address, tmp_path, stall=1)
    with ending(recorder.process):
        recorder.wait_for_more()
        camera.go()
        line = recorder.end()
    assert recorder.process.returncode == 0
    assert "no frame for 1.0 s: the" in line
    assert "then cannot be reached (Connection refused))" in line
    assert not noted_gaps(read_episode(recorder.log).info.notes)


def test_one_that_starts_late_is_waited_for(camera: ComingCamera, tmp_path: Path):
    recorder = Recorder(camera.address, tmp_path, wait=LAST_RESORT_S)
    with ending(recorder.process):
        recorder.wait_for("cannot be reached (Connection refused); waiting for it, 120 s at most")
        camera.come()
        recorder.wait_for_more()
        line = recorder.end(signal.SIGINT)
    assert "gap" not in line
    assert recorder.said.count("\n") == 1


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_the_waiting(camera: ComingCamera, tmp_path: Path, number: int, code: int):
    recorder = Recorder(camera.address, tmp_path, wait=LAST_RESORT_S)
    with ending(recorder.process):
        recorder.wait_for("waiting for it")
        recorder.end(number)
    assert recorder.process.returncode == code
    assert not list(tmp_path.glob("a.mcap*"))


# ---- Servers that hang up, in this process

ONE = STREAM + PART + picture(1) + b"\r\n"
BETWEEN_S = "tunenet_logs.recorders.camera.reconnecting._BETWEEN_S"


def lasting(server: Answering, stall_s: float = LAST_RESORT_S) -> Source:
    return lasting_camera(
        lambda: open_source(server.url), wait_s=0, stall_s=stall_s, say=lambda _text: None
    )


def test_a_server_that_hangs_up_at_once_is_not_hurried():
    before = threading.active_count()
    with answering(ONE, STREAM) as server:
        source = lasting(server, 0.7)
        assert len(list(source.frames())) == 1
    why = "no frame for 0.7 s: the stream was closed by the camera, then"
    assert source.ended.startswith(why)
    assert server.calls <= 3  # one each half second
    wait_until(lambda: threading.active_count() <= before, "the threads to end")


def test_one_that_hangs_up_after_a_picture_for_ever_ends_it_with_all_that_came(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.setattr(BETWEEN_S, 0.01)
    with answering(ONE) as server:
        summary, episode = recorded(lasting(server), tmp_path / "a.mcap")
    said = "the stream was closed by the camera, 10 times in a row within 1 s of its first picture"
    assert summary.ended == episode.info.notes["ended"] == said
    assert server.calls == summary.written == 10


def test_one_that_delivers_for_a_while_each_time_is_asked_again(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(BETWEEN_S, 0.01)
    monkeypatch.setattr("tunenet_logs.recorders.camera.reconnecting._BRIEF_S", 0.0)
    with answering(ONE) as server:
        source = lasting(server)
        shots = source.frames()
        assert [next(shots).connection for _ in range(12)] == list(range(1, 13))
        source.close()


def test_what_is_final_ends_it_and_keeps_what_came():
    refusal = b'HTTP/1.0 401 No\r\nWWW-Authenticate: Basic realm="x"\r\n\r\n'
    with answering(ONE, refusal) as server:
        shots = lasting(server).frames()
        assert next(shots).connection == 1
        with pytest.raises(CameraError, match="401"):
            next(shots)
    with answering(ONE + b"--frame--\r\n") as server:  # the camera ended it itself
        assert len(list(lasting(server).frames())) == 1
        assert server.calls == 1


def test_parts_lie_between_gaps_that_nothing_fills():
    stamps_ns = np.array([0, 10, 20, 1000, 1010, 1020], np.int64)
    assert list(parts_between(stamps_ns, [Gap(20, 1000)])) == [0, 0, 0, 1, 1, 1]
    assert list(parts_between(stamps_ns, [Gap(12, 1003)])) == [0, 0, 0, 1, 1, 1]
    assert not parts_between(np.arange(0, 1020, 10), [Gap(20, 1000)]).any()  # what was late came
    assert list(parts_between(stamps_ns, [Gap(1010, 1011)])) == [0, 0, 0, 0, 0, 1]
    assert noted_gaps({"gaps": "5-9,9-5,x,12-99999999999999999999,7-8"}) == (Gap(5, 9), Gap(7, 8))
