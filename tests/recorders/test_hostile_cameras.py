"""No camera holds up the recorder, and none keeps it from ending at Ctrl-C."""

from __future__ import annotations

import resource
import signal
import socket
import subprocess
import threading
from contextlib import suppress
from pathlib import Path

import pytest

from tests.conftest import BIN, Command
from tests.recorders.hostile_cameras import CONTINUE, MOVED, OK, sending, serving_each
from tests.recorders.live_wait import LAST_RESORT_S, ending, wait_until
from tests.recorders.made_source import MadeSource
from tests.recorders.mjpeg_camera import picture
from tunenet_logs.errors import CameraError
from tunenet_logs.recorders.camera.device import opened_within
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.camera.sources import open_source
from tunenet_logs.recorders.camera.streams import MultipartParser
from tunenet_logs.timing.stamps import MAX_SPEED_CAMERA_HZ, MAX_SPEED_HZ, measured_hz

pytestmark = pytest.mark.live

PART = b"--frame\r\n\r\n"
EMPTY = b"--frame\r\nContent-Length: 0\r\n\r\n\r\n"


@pytest.mark.parametrize(
    ("head", "again", "drips", "says"),
    [
        (b"HTTP/1.1 200 OK\r\nX: ", b"a", True, "does not answer within"),
        (b"", CONTINUE, True, "does not answer within"),
        (b"", CONTINUE * 1000, False, "does not answer within"),
        (b"HTTP/1.1 200 OK\r\n", b"X: y\r\n" * 1000, False, "does not answer as a camera"),
        (MOVED, b"", False, "answers 302"),
        (MOVED, b"z" * 65536, False, "answers 302"),
        (b"HTTP/1.1 302 F\r\nLocation: file:///etc/hosts\r\n\r\n", b"", False, "to file"),
        (b"HTTP/1.1 302 F\r\nLocation: ftp://127.0.0.1/\r\n\r\n", b"", False, "sends on to ftp"),
        (b"HTTP/1.1 302 F\r\nLocation: http://10.0.0.9/\r\n\r\n", b"", False, "sends on to http"),
    ],
)
def test_an_opening_has_an_end(
    monkeypatch: pytest.MonkeyPatch, head: bytes, again: bytes, drips: bool, says: str
):
    monkeypatch.setattr("tunenet_logs.recorders.camera.network.OPENING_S", 2.0)
    with sending(head, again, drips=drips) as url, pytest.raises(CameraError, match=says):
        open_source(url, CameraOptions(stall_s=2.0))


@pytest.mark.parametrize(
    ("head", "again", "drips"),
    [
        (OK + b"\r\n", b"-", True),
        (OK + b"\r\n" + PART + b"\xff\xd8", b"x", True),
        (OK + b"\r\n" + b"--frame\r\nX: ", b"x", True),
        (OK + b"\r\n", EMPTY, True),
        (OK + b"Transfer-Encoding: chunked\r\n\r\n0\r\n", b"T: x\r\n", True),
        (OK + b"Transfer-Encoding: chunked\r\n\r\n", b"1;" + b"e" * 9000 + b"\r\nx\r\n", False),
        (OK + b"\r\n", EMPTY * 1000, False),
    ],
)
def test_parts_that_are_no_pictures_end_it_whatever_drips(head: bytes, again: bytes, drips: bool):
    with sending(head, again, drips=drips) as url:
        source = open_source(url, CameraOptions(stall_s=1.0))
        assert not list(source.frames())
        assert source.ended in ("no whole picture for 1.0 s", "no data for 1.0 s")


def test_closing_ends_a_read_that_waits():
    with sending(OK + b"\r\n" + PART, b"") as url:
        source = open_source(url, CameraOptions(stall_s=LAST_RESORT_S))
        reading = threading.Thread(target=lambda: list(source.frames()), daemon=True)
        reading.start()
        while not source._is_read:  # type: ignore[attr-defined]
            pass
        source.close()
        reading.join(LAST_RESORT_S / 2)
        assert not reading.is_alive()


@pytest.mark.parametrize(
    ("boundary", "head", "again"),
    [
        ("", b"", b"-"),
        ("", b"--x\r\n\r\n", b"\xff\xd9" + b"-" * 139),
        ("", b"--x\r\n\r\n\xff\xd9", b" "),
        ("", b"", b"x\n"),
        ("frame", b"", b"-"),
        ("frame", PART, b"\n" + b"-" * 65 + b"frame="),
    ],
)
def test_work_grows_with_the_bytes_alone(boundary: str, head: bytes, again: bytes):
    def seconds(size: int) -> float:
        data = head + again * (size // len(again))
        pieces = iter([data[at : at + 4096] for at in range(0, len(data), 4096)])
        parser = MultipartParser(lambda _most: next(pieces, b""), boundary, lambda: 0)
        before = resource.getrusage(resource.RUSAGE_THREAD).ru_utime
        with suppress(CameraError):
            list(parser.parts())
        return resource.getrusage(resource.RUSAGE_THREAD).ru_utime - before

    assert seconds(4_000_000) < 16 * seconds(1_000_000) + 0.2  # a square would be 16 times


@pytest.mark.parametrize("scheme", ["http", "rtsp", "https", "rtsps"])
def test_ctrl_c_while_a_camera_is_opened(tmp_path: Path, scheme: str):
    with serving_each(silent) as place:
        words = [BIN / "tunenet-record", "--camera", f"{scheme}://{place}/video"]
        process = subprocess.Popen(
            [*words, "--stall", "600"],
            cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        with ending(process):
            wait_for_thread(process)
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=LAST_RESORT_S)
    assert process.returncode == 130
    assert err == "tunenet-record: interrupted\n"
    assert not list(tmp_path.iterdir())


def silent(_caller: socket.socket, ended: threading.Event) -> None:
    """Takes the call, and says nothing."""
    ended.wait(LAST_RESORT_S)


def wait_for_thread(process: subprocess.Popen[str]) -> None:
    """Until a process has two threads: one waits, the other opens."""
    tasks = Path(f"/proc/{process.pid}/task")

    def opens() -> bool:
        assert process.poll() is None, process.communicate()
        return len(list(tasks.iterdir())) > 1

    wait_until(opens, "the thread that opens the camera")


def test_what_opens_too_late_is_closed():
    late, may_open = MadeSource(iter(())), threading.Event()

    def opening() -> MadeSource:
        may_open.wait(LAST_RESORT_S)
        return late

    with pytest.raises(CameraError, match=r"late: cannot be opened within 0\.01 s"):
        opened_within(0.01, "late", opening)
    may_open.set()
    assert late.closed.wait(LAST_RESORT_S)


def test_a_burst_has_a_true_rate_or_none():
    second = 1_000_000_000
    assert measured_hz([5, 6, 7, 8], MAX_SPEED_CAMERA_HZ) == 0
    assert measured_hz([0, 60_000, 130_000], MAX_SPEED_CAMERA_HZ) == 0
    assert measured_hz([], MAX_SPEED_CAMERA_HZ) == measured_hz([3], MAX_SPEED_CAMERA_HZ) == 0
    bursts = [at * second // 20 + extra for at in range(40) for extra in (0, 1, 2)]
    assert measured_hz(bursts, MAX_SPEED_CAMERA_HZ) == pytest.approx(60, rel=0.05)
    paused = [at * second // 60 + (at > 50) * 9 * second for at in range(120)]
    assert measured_hz(paused, MAX_SPEED_CAMERA_HZ) == pytest.approx(60, rel=0.001)
    assert measured_hz([at * 100_000 for at in range(50)], MAX_SPEED_HZ) == pytest.approx(10_000)


def test_a_whole_picture_after_much_else_counts(tmp_path: Path, command: Command):
    stream = OK + b"\r\n" + EMPTY * 3 + PART + picture(1) + b"\r\n--frame--\r\n"
    with sending(stream, b"") as url:
        result = command("tunenet-record", "--camera", url, "-o", "a.mcap", cwd=tmp_path)
    assert result.returncode == 0
    assert "1 frames captured, 1 written, 0 dropped, 3 damaged" in result.stdout
