"""Videos over HTTP, TCP, UDP and pipes: every picture comes, with the times that it was given."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import BIN, Command
from tests.recorders.byte_servers import Answer, sending_bytes, serving
from tests.recorders.films import RATE_HZ, film
from tests.recorders.free_port import free_port
from tests.recorders.hostile_cameras import sending
from tests.recorders.live_wait import LAST_RESORT_S, ending, wait_until
from tests.recorders.mjpeg_camera import picture
from tunenet_logs.errors import CameraError, UsageError
from tunenet_logs.recorders.camera.base import CapturedFrame
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.camera.sources import open_source

pytestmark = pytest.mark.live

FRAGMENTS = {"movflags": "frag_keyframe+empty_moov"}


def shots(text: str, timeout_s: float = LAST_RESORT_S) -> tuple[list[CapturedFrame], str]:
    """All that a source delivers, and why it ended."""
    source = open_source(text, CameraOptions(stall_s=timeout_s))
    return list(source.frames()), source.ended


def check_even(times_ns: list[int]) -> None:
    """Check that they are those of the film, to a container's millisecond."""
    ideal_ns = times_ns[0] + np.arange(len(times_ns)) * 1e9 / RATE_HZ
    assert np.abs(np.array(times_ns) - ideal_ns).max() < 1.1e6


@pytest.mark.parametrize(
    ("kind", "options"),
    [("mpegts", {}), ("matroska", {}), ("flv", {}), ("mp4", FRAGMENTS)],
)
@pytest.mark.parametrize("has_length", [False, True])
def test_a_container_over_http(kind: str, options: dict[str, str], has_length: bool):
    answer = Answer(film(kind, **options), "text/plain", has_length)
    with serving({"/x": answer}) as place:
        seen, ended = shots(f"{place}/x")
    assert len(seen) == 30
    assert {shot.frame.encoding for shot in seen} == {"h264"}
    if has_length:  # a file, though it is far away: its own times, to its end
        assert not ended
        check_even([shot.frame.stamp_ns for shot in seen])
        assert seen[0].source_stamp_ns is None
    else:
        assert ended == "the stream was closed by the camera"
        check_even([shot.source_stamp_ns or 0 for shot in seen])


@pytest.mark.parametrize("kind", ["", "text/html", "application/octet-stream", "image/jpeg"])
def test_parts_with_a_missing_or_odd_type(kind: str):
    part = b"--x\r\nContent-Type: image/jpeg\r\n\r\n"
    body = b"".join(part + picture(number) + b"\r\n" for number in range(5))
    with serving({"/": Answer(body, kind)}) as place:
        seen, _ = shots(f"http://{place}")
    assert [shot.frame.data for shot in seen] == [picture(number) for number in range(5)]


def test_jpegs_without_anything_between_them():
    with serving({"/": Answer(b"".join(map(picture, range(5))), "image/jpeg")}) as place:
        seen, _ = shots(f"http://{place}")
    assert [shot.frame.data for shot in seen] == [picture(number) for number in range(5)]
    assert {shot.source_stamp_ns for shot in seen} == {None}


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (Answer(picture(1), "image/jpeg", has_length=True), "gives a single picture"),
        (Answer(picture(1), "image/jpeg"), "gives a single picture"),
        (Answer(b"<html>", "text/html"), "answers with a web page"),
        (Answer(film("mp4"), "video/mp4", has_length=True), "index stands at its end"),
        (Answer(b"", "video/mp4"), "ends before it sends anything"),
        (Answer(b"#EXTM3U\na.ts\n"), r"is a playlist .* \| tunenet-record --camera -$"),
        (Answer(b"<MPD>"), r"is a playlist .* ffmpeg .*-i 'ADDRESS' "),
    ],
)
def test_what_is_no_stream_is_told_in_one_line(answer: Answer, says: str):
    with (
        serving({"/x": answer}) as place,
        pytest.raises(CameraError, match=rf"^http://{place}/x: .*{says}"),
    ):
        open_source(f"{place}/x", CameraOptions(stall_s=LAST_RESORT_S))


@pytest.mark.parametrize("kind", ["mpegts", "matroska", "h264"])
def test_bytes_over_tcp(kind: str):
    with sending_bytes(film(kind)) as place:
        seen, _ = shots(f"tcp://{place}")
    assert len(seen) == 30
    assert (seen[0].source_stamp_ns is None) == (kind == "h264")


def test_datagrams_come_from_the_first_sender_alone():
    port = free_port(socket.SOCK_DGRAM)
    data = film("mpegts", count=120)

    def send() -> None:
        wait_until(lambda: _is_bound(port), "the port")
        other.bind(("127.0.0.2", 0))
        for at in range(0, len(data), 1316):
            for sender in (camera, other):
                sender.sendto(data[at : at + 1316], ("127.0.0.1", port))

    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as camera,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        sending = threading.Thread(target=send, daemon=True)
        sending.start()
        source = open_source(f"udp://@:{port}", CameraOptions(stall_s=LAST_RESORT_S))
        seen = list(islice(source.frames(), 60))
        source.close()
        sending.join(LAST_RESORT_S)  # before its sockets are closed
    check_even([shot.source_stamp_ns or 0 for shot in seen])


def _is_bound(port: int) -> bool:
    return f":{port:04X} " in Path("/proc/net/udp").read_text()


def test_rtp_in_datagrams_is_told():
    port = free_port(socket.SOCK_DGRAM)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as camera:

        def send() -> None:
            wait_until(lambda: _is_bound(port), "the port")
            camera.sendto(b"\x80\x60" + bytes(200), ("127.0.0.1", port))

        sending = threading.Thread(target=send, daemon=True)
        sending.start()
        with pytest.raises(CameraError, match="sends RTP"):
            open_source(f"udp://127.0.0.1:{port}", CameraOptions(stall_s=LAST_RESORT_S))
        sending.join(LAST_RESORT_S)


def test_a_port_that_is_taken():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        with pytest.raises(CameraError, match=r"cannot be listened to .*is the port free"):
            open_source(f"udp://127.0.0.1:{port}")


def test_a_fifo(tmp_path: Path):
    path = tmp_path / "camera"
    os.mkfifo(path)
    threading.Thread(target=lambda: path.write_bytes(film("matroska")), daemon=True).start()
    seen, ended = shots(str(path))
    assert len(seen) == 30
    assert ended == "the stream was closed by the camera"


def test_a_fifo_that_nobody_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("tunenet_logs.recorders.camera.network.OPENING_S", 0.3)
    path = tmp_path / "camera"
    os.mkfifo(path)
    with pytest.raises(CameraError, match=r"camera: does not answer within 0\.3 s"):
        open_source(str(path), CameraOptions(stall_s=0.3))


def test_what_came_before_a_silence_is_kept(tmp_path: Path):
    path = tmp_path / "camera"
    os.mkfifo(path)
    writer = None

    def write() -> None:
        nonlocal writer
        writer = path.open("wb")
        writer.write(film("mpegts"))
        writer.flush()

    threading.Thread(target=write, daemon=True).start()
    seen, ended = shots(str(path), timeout_s=1.0)
    assert len(seen) == 30  # the last one, too, which nothing follows
    assert ended in ("no data for 1.0 s", "no whole picture for 1.0 s")


def test_standard_input(tmp_path: Path):
    def recorded(data: bytes) -> subprocess.CompletedProcess[bytes]:
        words = [BIN / "tunenet-record", "--camera", "-", "-o", "a.mcap"]
        return subprocess.run(
            words, input=data, cwd=tmp_path, capture_output=True, timeout=LAST_RESORT_S, check=False
        )

    done = recorded(film("matroska"))
    assert b"camera standard input; 30 frames captured, 30 written, 0 dropped" in done.stdout
    assert done.returncode == 0
    (tmp_path / "a.mcap").unlink()
    done = recorded(b"")
    assert done.stderr.startswith(b"tunenet-record: standard input: ends before it sends anything")
    assert done.returncode == 1
    assert not list(tmp_path.iterdir())


def test_a_terminal_is_no_camera():
    ours, theirs = os.openpty()
    words = "from tunenet_logs.recorders.camera.sources import open_source; open_source('-')"
    done = subprocess.run(
        [sys.executable, "-c", words], stdin=theirs, capture_output=True, text=True, check=False
    )
    os.close(ours)
    os.close(theirs)
    assert UsageError.__name__ in done.stderr
    assert "which is a terminal; put the program" in done.stderr


def test_ctrl_c_ends_the_waiting_for_standard_input(tmp_path: Path):
    words = [BIN / "tunenet-record", "--camera", "-", "--stall", "600"]
    process = subprocess.Popen(
        words, cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True,
    )  # fmt: skip
    with ending(process):
        tasks = Path(f"/proc/{process.pid}/task")
        wait_until(lambda: len(list(tasks.iterdir())) > 1, "the thread that opens the camera")
        process.send_signal(signal.SIGINT)
        process.wait(LAST_RESORT_S)
    assert process.returncode == 130


def test_closing_ends_a_read_that_waits():
    with sending(b"HTTP/1.0 200 OK\r\n\r\n" + film("mpegts"), b"") as url:
        source = open_source(url, CameraOptions(stall_s=LAST_RESORT_S))
        frames = source.frames()
        next(frames)
        reading = threading.Thread(target=lambda: list(frames), daemon=True)
        reading.start()
        source.close()
        reading.join(LAST_RESORT_S / 2)
        assert not reading.is_alive()


def test_a_film_on_another_machine_is_recorded_to_its_end(tmp_path: Path, command: Command):
    with serving({"/film": Answer(film("matroska"), has_length=True)}) as place:
        told = command("tunenet-record", "--camera", f"{place}/film", "-o", "a.mcap", cwd=tmp_path)
    assert told.returncode == 0
    assert "30 frames captured, 30 written, 0 dropped, 30.0 Hz\n" in told.stdout
