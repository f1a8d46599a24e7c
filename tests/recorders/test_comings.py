"""Cameras that start late, are cut off, freeze, or are killed and started again."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import BIN, Command
from tests.recorders.coming_camera import ComingCamera
from tests.recorders.live_wait import LAST_RESORT_S, ending, wait_until
from tests.recorders.mjpeg_camera import picture
from tests.recorders.test_camera_faults import STREAM
from tests.recorders.test_mjpeg_stream import QUIET
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.errors import CameraError
from tunenet_logs.messages import CAMERA_TOPIC
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.reconnecting import lasting_camera
from tunenet_logs.recorders.camera.recording import Limits, record_camera
from tunenet_logs.recorders.camera.sources import open_source
from tunenet_logs.timing.stamps import Gap, noted_gaps, parts_between
from tunenet_logs.writing.writer import EpisodeWriter

pytestmark = pytest.mark.live

ENOUGH_BYTES = 400_000  # of a log: some twenty pictures


@pytest.fixture
def camera(tmp_path: Path) -> Iterator[ComingCamera]:
    """One that has not come yet."""
    log = tmp_path / "shown.mcap"
    with EpisodeWriter(log, EpisodeInfo(), live=False) as writer:
        for number in range(30):
            writer.write_frame(CAMERA_TOPIC, Frame(number, "jpeg", picture(number)))
    one = ComingCamera(log)
    yield one
    one.go()


class Recorder:
    """`tunenet-record` of a camera, to a.mcap of a folder; what it says is in a file there."""

    def __init__(self, address: str, folder: Path, **options: float) -> None:
        self.log = folder / "a.mcap"
        self._said = folder / "said"
        words = [text for name, value in options.items() for text in (f"--{name}", str(value))]
        with self._said.open("w") as said:
            self.process = subprocess.Popen(
                [BIN / "tunenet-record", "--camera", address, *words, "-o", self.log],
                stdout=subprocess.PIPE, stderr=said, text=True,
            )  # fmt: skip

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

    def end(self, number: int = signal.SIGINT) -> str:
        """Send it a signal; its last line."""
        self.process.send_signal(number)
        return self.process.communicate(timeout=LAST_RESORT_S)[0]


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
def test_a_camera_that_comes_back_is_recorded_on_and_its_gap_is_marked(
    camera: ComingCamera, tmp_path: Path, fault: Callable[[ComingCamera, Recorder], None]
):
    camera.come()
    recorder = Recorder(camera.address, tmp_path, stall=LAST_RESORT_S)
    with ending(recorder.process):
        recorder.wait_for_more()
        fault(camera, recorder)
        recorder.wait_for("camera back after")
        recorder.wait_for_more()
        line = recorder.end()
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


def test_a_killed_recorder_has_marked_the_gap(camera: ComingCamera, tmp_path: Path):
    camera.come()
    recorder = Recorder(camera.address, tmp_path, stall=LAST_RESORT_S)
    with ending(recorder.process):
        recorder.wait_for_more()
        camera.send(signal.SIGUSR1)
        recorder.wait_for("camera back after")
        recorder.wait_for_more()
        recorder.end(signal.SIGKILL)
    assert len(noted_gaps(read_episode(tmp_path / "a.mcap.active").info.notes)) == 1


def test_one_that_stays_away_ends_it_with_all_that_came(camera: ComingCamera, tmp_path: Path):
    camera.come()
    recorder = Recorder(camera.address, tmp_path, stall=1)
    with ending(recorder.process):
        recorder.wait_for_more()
        camera.go()
        line = recorder.process.communicate(timeout=LAST_RESORT_S)[0]
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
        line = recorder.end()
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


def test_a_signal_ends_a_recording_whose_camera_is_away(camera: ComingCamera, tmp_path: Path):
    camera.come()
    recorder = Recorder(camera.address, tmp_path, stall=LAST_RESORT_S)
    with ending(recorder.process):
        recorder.wait_for_more()
        camera.go()
        recorder.wait_for("trying again")
        line = recorder.end()
    assert recorder.process.returncode == 0
    assert "(stopped by a signal)" in line
    assert not read_episode(recorder.log).warnings


def test_waiting_is_for_cameras_in_a_network(command: Command, tmp_path: Path):
    result = command("tunenet-record", "--camera", "drop.mp4", "--wait", 1, cwd=tmp_path)
    assert result.returncode == 2
    assert "--wait is for a camera in a network" in result.stderr


class Answering:
    """A server that gives its callers one answer after the other, the last one for ever."""

    def __init__(self, *answers: bytes) -> None:
        self.calls = 0
        self._answers = answers
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"http://127.0.0.1:{self._listener.getsockname()[1]}/video"
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        with suppress(OSError):
            while True:
                caller, _ = self._listener.accept()
                with caller:
                    caller.recv(65536)
                    caller.sendall(self._answers[min(self.calls, len(self._answers) - 1)])
                    self.calls += 1

    def close(self) -> None:
        """Answer nobody any more."""
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()


PART = STREAM + b"--frame\r\n\r\n" + picture(1) + b"\r\n"


def test_a_server_that_hangs_up_at_once_is_not_hurried():
    server = Answering(PART, STREAM)
    before = threading.active_count()
    source = lasting_camera(
        lambda: open_source(server.address), wait_s=0, stall_s=1.2, say=lambda _text: None
    )
    assert len(list(source.frames())) == 1
    assert source.ended.startswith("no frame for 1.2 s: the stream was closed by the camera, then")
    assert server.calls <= 4  # one each half second
    server.close()
    wait_until(lambda: threading.active_count() <= before, "the threads to end")


def test_one_that_hangs_up_after_a_picture_for_ever_ends_it_with_all_that_came(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.setattr("tunenet_logs.recorders.camera.reconnecting._BETWEEN_S", 0.01)
    server = Answering(PART)
    source = lasting_camera(
        lambda: open_source(server.address), wait_s=0, stall_s=LAST_RESORT_S, say=lambda _text: None
    )
    summary = record_camera(
        source,
        EpisodeInfo(),
        tmp_path / "a.mcap",
        limits=Limits(stall_s=LAST_RESORT_S),
        overwrite=False,
        progress=QUIET,
    )
    said = "the stream was closed by the camera, 10 times in a row within 1 s of its first picture"
    assert summary.ended == said
    assert server.calls == 10
    episode = read_episode(tmp_path / "a.mcap")
    assert not episode.warnings
    assert len(list(episode.frames())) == 10
    assert episode.info.notes["ended"] == said
    server.close()


def test_one_that_delivers_for_a_while_each_time_is_asked_again(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("tunenet_logs.recorders.camera.reconnecting._BETWEEN_S", 0.01)
    monkeypatch.setattr("tunenet_logs.recorders.camera.reconnecting._BRIEF_S", 0.0)
    server = Answering(PART)
    source = lasting_camera(
        lambda: open_source(server.address), wait_s=0, stall_s=LAST_RESORT_S, say=lambda _text: None
    )
    shots = source.frames()
    assert [next(shots).connection for _ in range(12)] == list(range(1, 13))
    source.close()
    server.close()


def test_what_is_final_ends_it_and_keeps_what_came():
    refusal = b'HTTP/1.0 401 No\r\nWWW-Authenticate: Basic realm="x"\r\n\r\n'
    server = Answering(PART, refusal)
    source = lasting_camera(
        lambda: open_source(server.address), wait_s=0, stall_s=LAST_RESORT_S, say=lambda _text: None
    )
    shots = source.frames()
    assert next(shots).connection == 1
    with pytest.raises(CameraError, match="401"):
        next(shots)
    server.close()


def test_a_stream_that_its_camera_ended_is_not_asked_for_again():
    server = Answering(PART + b"--frame--\r\n")
    source = lasting_camera(
        lambda: open_source(server.address), wait_s=0, stall_s=LAST_RESORT_S, say=lambda _text: None
    )
    assert len(list(source.frames())) == 1
    assert server.calls == 1
    server.close()


def test_parts_lie_between_gaps_that_nothing_fills():
    stamps_ns = np.array([0, 10, 20, 1000, 1010, 1020], np.int64)
    assert list(parts_between(stamps_ns, [Gap(20, 1000)])) == [0, 0, 0, 1, 1, 1]
    assert list(parts_between(stamps_ns, [Gap(12, 1003)])) == [0, 0, 0, 1, 1, 1]
    assert not parts_between(np.arange(0, 1020, 10), [Gap(20, 1000)]).any()  # what was late came
    assert list(parts_between(stamps_ns, [Gap(1010, 1011)])) == [0, 0, 0, 0, 0, 1]
    assert noted_gaps({"gaps": "5-9,9-5,x,12-99999999999999999999,7-8"}) == (Gap(5, 9), Gap(7, 8))
