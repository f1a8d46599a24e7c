"""Videos over HTTP, TCP, UDP and pipes, as anybody sends them: every picture, with its times."""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import BIN
from tests.recorders.films import PATIENT, RATE_HZ, film
from tests.recorders.live_wait import LAST_RESORT_S, Terminal, free_port, wait_until
from tests.recorders.mjpeg_camera import picture, times_in
from tests.recorders.programs import nginx_server, running
from tests.recorders.servers import answering, datagrams, http
from tunenet_logs.errors import CameraError
from tunenet_logs.recorders.camera.base import CapturedFrame
from tunenet_logs.recorders.camera.feeds import MAX_FORMAT_BYTES, MULTIPART, format_of
from tunenet_logs.recorders.camera.network import with_scheme
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.camera.sources import open_source

live = pytest.mark.live
slow = pytest.mark.slow
FRAGMENTS = {"movflags": "frag_keyframe+empty_moov"}
FIVE = [picture(number) for number in range(5)]


def shots(text: str, timeout_s: float = LAST_RESORT_S) -> tuple[list[CapturedFrame], str]:
    """All that a source delivers, and why it ended."""
    source = open_source(text, CameraOptions(stall_s=timeout_s))
    return list(source.frames()), source.ended


def check_even(times_ns: list[int]) -> None:
    """Check that they are those of the film, to a container's millisecond."""
    ideal_ns = times_ns[0] + np.arange(len(times_ns)) * 1e9 / RATE_HZ
    assert np.abs(np.array(times_ns) - ideal_ns).max() < 1.1e6


# ---- What people write for an address, and what is a file's name


@pytest.mark.parametrize(
    "text",
    [
        "192.168.1.20:8080/video", "192.168.1.20", "192.168.1.20/video.mp4", "[fe80::1]:8080/video",
        "cam.local/stream", "cam.local:8080", "camera:81/", "user:secret@cam/video",
        "admin@10.0.0.5/live",
    ],
)  # fmt: skip
def test_an_address_needs_no_scheme(text: str):
    assert with_scheme(text) == f"http://{text}"


@pytest.mark.parametrize(
    "text",
    [
        "video.mp4", "my.film.mp4", "clips/video.mp4", "clips.2024/video.mp4", "old.films/drop.mp4",
        "cam.local", "12:30.mp4", "./cam.local/x", "../x", "0", "/dev/video0", "-",
        "rtsp://cam/x", "1.2.3.4.mp4",
    ],
)  # fmt: skip
def test_a_name_stays_one(text: str):
    assert with_scheme(text) == text


def test_a_file_that_is_there_wins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "192.168.1.20").write_bytes(b"")
    (tmp_path / "cam.local").mkdir()
    assert with_scheme("192.168.1.20") == "192.168.1.20"
    assert with_scheme("cam.local/drop") == "cam.local/drop"


# ---- A stream is known by its first bytes, whatever its name and its announced type are


@pytest.mark.parametrize(
    ("start", "kind"),
    [
        (b"--frame\r\nContent-Type: image/jpeg\r\n\r\n", MULTIPART),
        (b"\r\n--x\r\nX-Timestamp: 1.5\r\nContent-Length: 12\r\n\r\n", MULTIPART),
        (b"Content-type: image/jpeg\n\n", MULTIPART),
        (film("mpegts")[100:], "mpegts"),
        (film("mp4", movflags="faststart"), "mov"),
        (film("avi"), "avi"),
        (b"\0\0\1\x40\1\x0c", "hevc"),
        (b"\0\0\0\1\x46\1\x50", "hevc"),
        (b"\0\0\0\1\x41\x9a", "h264"),
        (b"\0\0\1\xba\x44", "mpeg"),
        (b"YUV4MPEG2 W64 H48\n", "yuv4mpegpipe"),
    ],
)
def test_what_begins_so(start: bytes, kind: str):
    assert format_of(start[:MAX_FORMAT_BYTES], is_all=True) == kind


def test_a_few_bytes_wait_for_more_and_never_mislead():
    for kind in ("mpegts", "matroska", "flv", "h264", "avi"):
        whole = film(kind)[:MAX_FORMAT_BYTES]
        seen = [format_of(whole[:count], is_all=False) for count in range(1, 600)]
        assert set(seen) <= {None, kind}
        assert seen[-1] == kind


# ---- Over HTTP and TCP


@live
@pytest.mark.parametrize(
    ("kind", "options"), [("mpegts", {}), ("matroska", {}), ("flv", {}), ("mp4", FRAGMENTS)]
)
@pytest.mark.parametrize("has_length", [False, True])
def test_a_container_over_http(kind: str, options: dict[str, str], has_length: bool):
    with answering(http(film(kind, **options), "text/plain", has_length=has_length)) as server:
        seen, ended = shots(f"{server.place}/x")
    assert len(seen) == 30
    assert {shot.frame.encoding for shot in seen} == {"h264"}
    if has_length:  # a file, though it is far away: its own times, to its end
        assert not ended
        check_even([shot.frame.stamp_ns for shot in seen])
        assert seen[0].source_stamp_ns is None
    else:
        assert ended == "the stream was closed by the camera"
        check_even([shot.source_stamp_ns or 0 for shot in seen])


@live
@pytest.mark.parametrize("kind", ["", "text/html", "application/octet-stream", "image/jpeg"])
@pytest.mark.parametrize("has_parts", [True, False])
def test_jpegs_with_a_missing_or_odd_type_with_parts_or_without(kind: str, has_parts: bool):
    part = b"--x\r\nContent-Type: image/jpeg\r\n\r\n" if has_parts else b""
    body = b"".join(part + one + b"\r\n" * has_parts for one in FIVE)
    with answering(http(body, kind)) as server:
        seen, _ = shots(f"http://{server.place}")
    assert [shot.frame.data for shot in seen] == FIVE
    assert {shot.source_stamp_ns for shot in seen} == {None}


PLAYLIST = r"is a playlist \(HLS or MPEG-DASH\)"


@live
@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (http(picture(1), "image/jpeg", has_length=True), "gives a single picture"),
        (http(picture(1), "image/jpeg"), "gives a single picture"),
        (http(b"\x89PNG\r\n\x1a\n"), "single picture"),
        (http(b"<html>", "text/html"), "answers with a web page"),
        (http(b"<!DOCTYPE html><html>"), "web page"),
        (http(film("mp4"), "video/mp4", has_length=True), "index stands at its end"),
        (http(b"", "video/mp4"), "ends before it sends anything"),
        (http(b"\r\n \r\n"), "ends before it sends anything"),
        (http(b"#EXTM3U\na.ts\n"), rf"{PLAYLIST}.* \| tunenet-record --camera -$"),
        (http((b"#EXTM3U".ljust(93, b"G") + b"\n") * 6), "playlist"),  # as regular as MPEG-TS
        (http(b"\xef\xbb\xbf#EXTM3U\n"), PLAYLIST),
        (http(b"<MPD>"), rf"{PLAYLIST}.* ffmpeg .*-i 'ADDRESS' "),
        (http(b"<?xml version='1.0'?>\n<MPD xmlns='x'>"), PLAYLIST),
        (http(b"v=0\r\no=- 0 0 IN IP4 1.2.3.4\r\n"), "SDP"),
        (http(b"ID3\4\0\0\0\0"), "is no video that is known here"),
    ],
)
def test_what_is_no_stream_is_told_in_one_line(answer: bytes, says: str):
    with answering(answer) as server, pytest.raises(CameraError) as error:
        open_source(f"{server.place}/x", PATIENT)
    assert re.search(rf"^http://{server.place}/x: .*{says}", str(error.value))


@live
@pytest.mark.parametrize("kind", ["mpegts", "matroska", "h264"])
def test_bytes_over_tcp(kind: str):
    with answering(film(kind), asked=False) as server:
        seen, _ = shots(f"tcp://{server.place}")
    assert len(seen) == 30
    assert (seen[0].source_stamp_ns is None) == (kind == "h264")


# ---- In datagrams


@contextmanager
def once_bound(port: int, send: Callable[[], object]) -> Iterator[None]:
    def wait_and_send() -> None:
        wait_until(lambda: f":{port:04X} " in Path("/proc/net/udp").read_text(), "the port")
        send()

    thread = threading.Thread(target=wait_and_send, daemon=True)
    thread.start()
    yield
    thread.join(LAST_RESORT_S)


@live
def test_datagrams_come_from_the_first_sender_alone():
    port, data = free_port(socket.SOCK_DGRAM), film("mpegts", count=120)
    with datagrams() as camera, datagrams("127.0.0.2") as other:

        def send() -> None:
            for at in range(0, len(data), 1316):
                for sender in (camera, other):
                    sender.sendto(data[at : at + 1316], ("127.0.0.1", port))

        with once_bound(port, send):
            source = open_source(f"udp://@:{port}", PATIENT)
            seen = list(islice(source.frames(), 60))
            source.close()
    check_even([shot.source_stamp_ns or 0 for shot in seen])


@live
def test_rtp_in_datagrams_and_a_port_that_is_taken_are_told():
    port, rtp = free_port(socket.SOCK_DGRAM), b"\x80\x60" + bytes(200)
    with datagrams() as other:
        with (
            once_bound(port, lambda: other.sendto(rtp, ("127.0.0.1", port))),
            pytest.raises(CameraError, match="sends RTP"),
        ):
            open_source(f"udp://127.0.0.1:{port}", PATIENT)
        with pytest.raises(CameraError, match=r"cannot be listened to .*is the port free"):
            open_source(f"udp://127.0.0.1:{other.getsockname()[1]}")


# ---- From pipes


@live
def test_a_fifo_that_nobody_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("tunenet_logs.recorders.camera.network.OPENING_S", 0.3)
    os.mkfifo(tmp_path / "camera")
    with pytest.raises(CameraError, match=r"camera: does not answer within 0\.3 s"):
        open_source(str(tmp_path / "camera"), CameraOptions(stall_s=0.3))


@live
@pytest.mark.parametrize("falls_silent", [False, True])
def test_a_fifo_that_ends_or_falls_silent_gives_all_that_came(tmp_path: Path, falls_silent: bool):
    path, ends = tmp_path / "camera", threading.Event()
    os.mkfifo(path)

    def write() -> None:
        with path.open("wb", buffering=0) as file:
            file.write(film("mpegts"))
            ends.wait(LAST_RESORT_S * falls_silent)

    threading.Thread(target=write, daemon=True).start()
    seen, ended = shots(str(path), 0.5 if falls_silent else LAST_RESORT_S)
    ends.set()
    assert len(seen) == 30  # the last one, too, which nothing follows
    silent = ("no data for 0.5 s", "no whole picture for 0.5 s")
    assert ended in (silent if falls_silent else ("the stream was closed by the camera",))


def piped(folder: Path, **ends: Any) -> subprocess.CompletedProcess[bytes]:
    words = [BIN / "tunenet-record", "--camera", "-", "-o", "a.mcap"]
    return subprocess.run(words, cwd=folder, capture_output=True, timeout=LAST_RESORT_S, **ends)


@live
def test_standard_input(tmp_path: Path):
    done = piped(tmp_path, input=b"")
    said = b"tunenet-record: standard input: ends before it sends anything"
    assert done.stderr.startswith(said)
    assert done.returncode == 1
    assert not list(tmp_path.iterdir())
    done = piped(tmp_path, input=film("matroska"))
    assert b"camera standard input; 30 frames captured, 30 written, 0 dropped" in done.stdout
    assert done.returncode == 0


@live
def test_a_terminal_is_no_camera(tmp_path: Path):
    with closing(Terminal()) as terminal:
        done = piped(tmp_path, stdin=terminal.theirs)
    assert done.returncode == 2
    assert b"which is a terminal; put the program" in done.stderr


# ---- Servers that others wrote, one for each way in which a video comes

COUNT = 45
SOME = 20  # of the pictures of a server that has no end and waits for nobody
GST = "gst-launch-1.0 -q videotestsrc is-live=true num-buffers={} ! "
GST += "video/x-raw,width=160,height=120,framerate=30/1 ! "
GST_264 = "x264enc tune=zerolatency key-int-max=5 ! "
TO_TCP = " ! tcpserversink host=127.0.0.1 port=PORT"
FFMPEG = (
    f"ffmpeg -loglevel error -re -f lavfi -i testsrc2=s=160x120:r=30 -t {COUNT / 30} -threads 1 "
)
FFMPEG_264 = f"{FFMPEG}-c:v libx264 -preset ultrafast -tune zerolatency -g 5 "
LISTEN = "-listen 1 http://127.0.0.1:PORT/"
VLC = "runuser -u nobody -- " * (os.geteuid() == 0)  # it refuses to be root's
VLC += "env HOME=FOLDER cvlc -q -I dummy --no-audio --loop FOLDER/"
TCP, HTTP = "tcp://127.0.0.1:PORT", "http://127.0.0.1:PORT"

# A server's command and address, what it sends, and how many are looked at; 0 for all.
SERVERS = [
    (f"{GST.format(-1)}{GST_264}matroskamux streamable=true{TO_TCP}", TCP, "h264", SOME),
    pytest.param(f"{GST.format(-1)}{GST_264}mpegtsmux{TO_TCP}", TCP, "h264", SOME, marks=slow),
    (f"{GST.format(-1)}jpegenc ! multipartmux{TO_TCP}", TCP, "jpeg", SOME),
    (f"{FFMPEG_264} -f mpegts tcp://127.0.0.1:PORT?listen", TCP, "h264", 0),
    pytest.param(f"{FFMPEG_264} -f h264 tcp://127.0.0.1:PORT?listen", TCP, "h264", 0, marks=slow),
    (f"{FFMPEG_264} -f matroska {LISTEN}", HTTP, "h264", 0),
    pytest.param(f"{FFMPEG_264} -f flv {LISTEN}", HTTP, "h264", 0, marks=slow),
    (f"{FFMPEG} -c:v mjpeg -f mpjpeg {LISTEN}", HTTP, "jpeg", 0),
    pytest.param(f"{FFMPEG} -c:v mjpeg -f mjpeg {LISTEN}", HTTP, "jpeg", 0, marks=slow),
    (f"{VLC}libx264.mkv --sout #http{{mux=ts,dst=127.0.0.1:PORT/x}}", f"{HTTP}/x", "h264", SOME),
    (f"{VLC}mjpeg.mkv --sout #http{{mux=mpjpeg,dst=127.0.0.1:PORT/x}}", f"{HTTP}/x", "jpeg", SOME),
]


@pytest.fixture(scope="module")
def films() -> Iterator[str]:
    """A folder that is open to all, with a film by each encoder."""
    with tempfile.TemporaryDirectory(dir="/tmp") as name:
        Path(name).chmod(0o777)
        for codec in ("libx264", "mjpeg"):
            (Path(name) / f"{codec}.mkv").write_bytes(film("matroska", codec, count=120))
        yield name


def skip_without(words: list[str]) -> None:
    """Where a program, or a part of GStreamer that is needed here, is not installed."""
    for name in {"gst-launch-1.0", "ffmpeg", "cvlc", "runuser"} & set(words):
        if shutil.which(name) is None:
            pytest.skip(f"{name} is not installed")
    for name in ("x264enc", "matroskamux", "mpegtsmux", "jpegenc", "tcpserversink"):
        if name in words and subprocess.run(["gst-inspect-1.0", "--exists", name]).returncode:
            pytest.skip(f"GStreamer's {name} is not installed")


def frames_of(text: str, most: int = 0) -> tuple[int, str]:
    """How many pictures a server that may have to start sends, and as what; 0 for all."""
    until = time.monotonic() + LAST_RESORT_S
    while True:
        try:
            source = open_source(text, PATIENT)
            break
        except CameraError as error:
            if "cannot be reached" not in str(error) or time.monotonic() > until:
                raise
            time.sleep(0.05)
    seen = list(islice(source.frames(), most or None))
    source.close()
    return len(seen), seen[0].frame.encoding


@live
@pytest.mark.parametrize(("command", "address", "encoding", "most"), SERVERS)
def test_what_others_serve(films: str, command: str, address: str, encoding: str, most: int):
    port = str(free_port())
    words = command.replace("PORT", port).replace("FOLDER", films).split()
    skip_without(words)
    with running(words):
        assert frames_of(address.replace("PORT", port), most) == (most or COUNT, encoding)


@live
@pytest.mark.parametrize(
    ("coded", "is_told"),
    [
        (f"{GST_264}matroskamux", True),
        (f"{GST_264}mpegtsmux", True),
        pytest.param(f"{GST_264}mp4mux fragment-duration=200 streamable=true", True, marks=slow),
        pytest.param("jpegenc ! matroskamux", True, marks=slow),
        pytest.param("jpegenc ! multipartmux", False, marks=slow),
        pytest.param("jpegenc", False, marks=slow),
    ],
)
def test_a_pipeline_of_gstreamer_is_a_camera(tmp_path: Path, coded: str, is_told: bool):
    words = f"{GST.format(COUNT)}{coded} ! fdsink".split()
    skip_without(words)
    with subprocess.Popen(words, stdout=subprocess.PIPE) as sender:
        done = piped(tmp_path, stdin=sender.stdout)
    assert f" {COUNT} frames captured, {COUNT} written, 0 dropped".encode() in done.stdout
    if is_told:  # to a container's millisecond
        stamps_ns = np.sort([stamp_ns for stamp_ns, _ in times_in(tmp_path / "a.mcap")])
        assert np.allclose(np.diff(stamps_ns), 1e9 / 30, atol=1.1e6)


@live
@pytest.mark.parametrize("kind", ["mpegts", "matroska", "flv"])
def test_a_film_from_nginx(tmp_path: Path, kind: str):
    (tmp_path / "film").write_bytes(film(kind))
    with nginx_server(tmp_path, f"root {tmp_path};") as place:
        assert frames_of(f"http://{place}/film") == (30, "h264")
