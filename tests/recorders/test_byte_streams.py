"""Videos over HTTP, TCP, UDP and pipes, as anybody sends them: every picture, with its times."""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import BIN
from tests.recorders.conftest import Record
from tests.recorders.films import PATIENT, RATE_HZ, film
from tests.recorders.live_wait import LAST_RESORT_S, ending, free_port, wait_until
from tests.recorders.mjpeg_camera import picture, times_in
from tests.recorders.programs import nginx_server
from tests.recorders.servers import answering, http
from tunenet_logs.errors import CameraError, UsageError
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


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("video.mp4", "no such file"),
        ("srt://1.2.3.4:5000", r"srtsrc uri=srt://\.\.\. ! fdsink \| tunenet-record --camera -"),
        ("rtp://@:5004", "rtpjitterbuffer ! rtph264depay"),
        ("rtmp://cam/live", r"ffmpeg .* -i rtmp://\.\.\."),
        ("file:///etc/passwd", "file:// is not recorded; there is http, https, rtsp"),
        ("tcp://127.0.0.1", "a host and a port alone"),
        ("tcp://a:b@127.0.0.1:5000", "a host and a port alone"),
        ("tcp://127.0.0.1:5000/x", "a host and a port alone"),
        ("udp://127.0.0.1", "no udp address"),
        ("udp://@:99999", "no udp address"),
        ("cam:99999/video", "no http address"),
    ],
)
def test_what_cannot_be_opened_is_told_with_its_remedy(text: str, says: str):
    with pytest.raises((UsageError, CameraError), match=says):
        open_source(text)


# ---- A stream is known by its first bytes, whatever its name and its announced type are


@pytest.mark.parametrize(
    ("start", "kind"),
    [
        (picture(1), "mjpeg"),
        (b"--frame\r\nContent-Type: image/jpeg\r\n\r\n", MULTIPART),
        (b"\r\n--x\r\nX-Timestamp: 1.5\r\nContent-Length: 12\r\n\r\n", MULTIPART),
        (b"Content-type: image/jpeg\n\n", MULTIPART),
        (film("mpegts"), "mpegts"),
        (film("mpegts")[100:], "mpegts"),
        (film("matroska"), "matroska"),
        (film("flv"), "flv"),
        (film("mp4", movflags="faststart"), "mov"),
        (film("mp4", **FRAGMENTS), "mov"),
        (film("avi"), "avi"),
        (film("h264"), "h264"),
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


@pytest.mark.parametrize(
    ("start", "says"),
    [
        (b"", "ends before it sends anything"),
        (b"\r\n \r\n", "ends before it sends anything"),
        (b"<!DOCTYPE html><html>", "web page"),
        (b"<?xml version='1.0'?>\n<MPD xmlns='x'>", r"playlist \(HLS or MPEG-DASH\)"),
        (b"\xef\xbb\xbf#EXTM3U\n", r"playlist \(HLS or MPEG-DASH\)"),
        ((b"#EXTM3U".ljust(93, b"G") + b"\n") * 6, "playlist"),  # as regular as MPEG-TS
        (b"v=0\r\no=- 0 0 IN IP4 1.2.3.4\r\n", "SDP"),
        (b"\x89PNG\r\n\x1a\n", "single picture"),
        (b"ID3\4\0\0\0\0", "is no video that is known here"),
        (film("mp4"), "index stands at its end"),
    ],
)
def test_what_is_no_video_is_named(start: bytes, says: str):
    with pytest.raises(CameraError, match=says):
        format_of(start[:MAX_FORMAT_BYTES], is_all=True)


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
def test_a_film_on_another_machine_is_recorded_to_its_end(record: Record):
    with answering(http(film("matroska"), has_length=True)) as server:
        told = record("--camera", f"{server.place}/film", "-o", "a.mcap")
    assert told.returncode == 0
    assert "30 frames captured, 30 written, 0 dropped, 30.0 Hz\n" in told.stdout


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


@live
@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (http(picture(1), "image/jpeg", has_length=True), "gives a single picture"),
        (http(picture(1), "image/jpeg"), "gives a single picture"),
        (http(b"<html>", "text/html"), "answers with a web page"),
        (http(film("mp4"), "video/mp4", has_length=True), "index stands at its end"),
        (http(b"", "video/mp4"), "ends before it sends anything"),
        (http(b"#EXTM3U\na.ts\n"), r"is a playlist .* \| tunenet-record --camera -$"),
        (http(b"<MPD>"), r"is a playlist .* ffmpeg .*-i 'ADDRESS' "),
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
    """Send, in a thread, as soon as somebody listens on a port."""

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
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as camera,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        other.bind(("127.0.0.2", 0))

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
    port = free_port(socket.SOCK_DGRAM)
    rtp = b"\x80\x60" + bytes(200)
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
        once_bound(port, lambda: other.sendto(rtp, ("127.0.0.1", port))),
        pytest.raises(CameraError, match="sends RTP"),
    ):
        open_source(f"udp://127.0.0.1:{port}", PATIENT)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        with pytest.raises(CameraError, match=r"cannot be listened to .*is the port free"):
            open_source(f"udp://127.0.0.1:{other.getsockname()[1]}")


# ---- From pipes


@live
def test_a_fifo(tmp_path: Path):
    path = tmp_path / "camera"
    os.mkfifo(path)
    threading.Thread(target=lambda: path.write_bytes(film("matroska")), daemon=True).start()
    seen, ended = shots(str(path))
    assert len(seen) == 30
    assert ended == "the stream was closed by the camera"


@live
def test_a_fifo_that_nobody_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("tunenet_logs.recorders.camera.network.OPENING_S", 0.3)
    path = tmp_path / "camera"
    os.mkfifo(path)
    with pytest.raises(CameraError, match=r"camera: does not answer within 0\.3 s"):
        open_source(str(path), CameraOptions(stall_s=0.3))


@live
def test_what_came_before_a_silence_is_kept(tmp_path: Path):
    path = tmp_path / "camera"
    os.mkfifo(path)
    held = []

    def write() -> None:
        held.append(path.open("wb", buffering=0))
        held[0].write(film("mpegts"))

    threading.Thread(target=write, daemon=True).start()
    seen, ended = shots(str(path), timeout_s=0.5)
    assert len(seen) == 30  # the last one, too, which nothing follows
    assert ended in ("no data for 0.5 s", "no whole picture for 0.5 s")


@live
@pytest.mark.parametrize("data", [film("matroska"), b""], ids=["a film", "nothing"])
def test_standard_input(tmp_path: Path, data: bytes):
    words = [BIN / "tunenet-record", "--camera", "-", "-o", "a.mcap"]
    done = subprocess.run(
        words, input=data, cwd=tmp_path, capture_output=True, timeout=LAST_RESORT_S
    )
    if data:
        assert b"camera standard input; 30 frames captured, 30 written, 0 dropped" in done.stdout
        assert done.returncode == 0
    else:
        said = b"tunenet-record: standard input: ends before it sends anything"
        assert done.stderr.startswith(said)
        assert done.returncode == 1
        assert not list(tmp_path.iterdir())


@live
def test_a_terminal_is_no_camera():
    ours, theirs = os.openpty()
    words = "from tunenet_logs.recorders.camera.sources import open_source; open_source('-')"
    done = subprocess.run(
        [sys.executable, "-c", words], stdin=theirs, capture_output=True, text=True
    )
    os.close(ours)
    os.close(theirs)
    assert UsageError.__name__ in done.stderr
    assert "which is a terminal; put the program" in done.stderr


# ---- Servers that others wrote, one for each way in which a video comes

COUNT = 45
SOME = 20  # of the pictures of a server that has no end and waits for nobody
# Before a program that refuses to be root's.
AS_NOBODY = ["runuser", "-u", "nobody", "--"] if os.geteuid() == 0 else []

GST = "gst-launch-1.0 -q videotestsrc is-live=true num-buffers={count} ! "
GST += "video/x-raw,width=160,height=120,framerate=30/1 ! "
GST_264 = "x264enc tune=zerolatency key-int-max=5 ! "
FFMPEG = "ffmpeg -loglevel error -re -f lavfi -i testsrc2=s=160x120:r=30 "
FFMPEG += f"-t {COUNT / 30} -threads 1 "
FFMPEG_264 = "-c:v libx264 -preset ultrafast -tune zerolatency -g 5 "
LISTEN = "-listen 1 http://127.0.0.1:{port}/"


@pytest.fixture(scope="module")
def gst() -> str:
    """The beginning of a pipeline, where GStreamer has all that those here need."""
    inspect = shutil.which("gst-inspect-1.0")
    for name in ("x264enc", "matroskamux", "mpegtsmux", "jpegenc", "tcpserversink"):
        if inspect is None or subprocess.run([inspect, "--exists", name]).returncode:
            pytest.skip(f"GStreamer's {name} is not installed")
    return GST


def needs(*names: str) -> pytest.MarkDecorator:
    missing = [name for name in names if shutil.which(name) is None]
    return pytest.mark.skipif(bool(missing), reason=f"{', '.join(missing)} is not installed")


@contextmanager
def running(words: list[str]) -> Iterator[None]:
    """A server, until it is no longer needed."""
    none = subprocess.DEVNULL
    with ending(subprocess.Popen(words, stdin=none, stdout=none, stderr=none, text=True)):
        yield


def frames_of(text: str, most: int | None = None) -> tuple[int, str]:
    """How many pictures a server that may have to start sends, and as what.

    Args:
        text: its address.
        most: after which it is left alone; None for one that ends.
    """
    until = time.monotonic() + LAST_RESORT_S
    while True:
        try:
            source = open_source(text, PATIENT)
            break
        except CameraError as error:
            if "cannot be reached" not in str(error) or time.monotonic() > until:
                raise
            time.sleep(0.05)
    seen = list(islice(source.frames(), most))
    source.close()
    return len(seen), seen[0].frame.encoding


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
def test_a_pipeline_of_gstreamer_is_a_camera(gst: str, tmp_path: Path, coded: str, is_told: bool):
    pipeline = f"{gst.format(count=COUNT)}{coded} ! fdsink"
    with subprocess.Popen(pipeline.split(), stdout=subprocess.PIPE) as sender:
        words = [BIN / "tunenet-record", "--camera", "-", "-o", "a.mcap"]
        done = subprocess.run(
            words, stdin=sender.stdout, cwd=tmp_path, capture_output=True, timeout=LAST_RESORT_S
        )
    assert f" {COUNT} frames captured, {COUNT} written, 0 dropped".encode() in done.stdout
    if is_told:  # to a container's millisecond
        stamps_ns = np.sort([stamp_ns for stamp_ns, _ in times_in(tmp_path / "a.mcap")])
        assert np.allclose(np.diff(stamps_ns), 1e9 / 30, atol=1.1e6)


@live
@pytest.mark.parametrize(
    ("coded", "encoding"),
    [
        (f"{GST_264}matroskamux streamable=true", "h264"),
        pytest.param(f"{GST_264}mpegtsmux", "h264", marks=slow),
        ("jpegenc ! multipartmux", "jpeg"),
    ],
)
def test_gstreamer_over_tcp(gst: str, coded: str, encoding: str):
    port = free_port()
    pipeline = f"{gst.format(count=-1)}{coded} ! tcpserversink host=127.0.0.1 port={port}"
    with running(pipeline.split()):
        assert frames_of(f"tcp://127.0.0.1:{port}", SOME) == (SOME, encoding)


@live
@needs("ffmpeg")
@pytest.mark.parametrize(
    ("words", "encoding"),
    [
        (f"{FFMPEG_264} -f mpegts tcp://127.0.0.1:{{port}}?listen", "h264"),
        pytest.param(f"{FFMPEG_264} -f h264 tcp://127.0.0.1:{{port}}?listen", "h264", marks=slow),
        (f"{FFMPEG_264} -f matroska {LISTEN}", "h264"),
        pytest.param(f"{FFMPEG_264} -f flv {LISTEN}", "h264", marks=slow),
        (f"-c:v mjpeg -f mpjpeg {LISTEN}", "jpeg"),
        pytest.param(f"-c:v mjpeg -f mjpeg {LISTEN}", "jpeg", marks=slow),
    ],
)
def test_ffmpeg_as_a_server(words: str, encoding: str):
    port = free_port()
    with running((FFMPEG + words).format(port=port).split()):
        scheme = "tcp" if "tcp:" in words else "http"
        assert frames_of(f"{scheme}://127.0.0.1:{port}") == (COUNT, encoding)


@live
@pytest.mark.parametrize("kind", ["mpegts", "matroska", "flv"])
def test_a_film_from_nginx(tmp_path: Path, kind: str):
    (tmp_path / "film").write_bytes(film(kind))
    with nginx_server(tmp_path, f"root {tmp_path};") as place:
        assert frames_of(f"http://{place}/film") == (30, "h264")


@live
@needs("cvlc", *AS_NOBODY[:1])
@pytest.mark.parametrize("mux", ["ts", "mpjpeg"])
def test_vlc(mux: str):
    port = free_port()
    codec, encoding = ("mjpeg", "jpeg") if mux == "mpjpeg" else ("libx264", "h264")
    with tempfile.TemporaryDirectory(dir="/tmp") as name:  # which is open to all
        home = Path(name)
        home.chmod(0o777)
        (home / "film.mkv").write_bytes(film("matroska", codec, count=120))
        words = [*AS_NOBODY, "env", f"HOME={home}", "cvlc", "-q", "-I", "dummy", "--no-audio"]
        sout = f"#http{{mux={mux},dst=127.0.0.1:{port}/x}}"
        with running([*words, "--loop", str(home / "film.mkv"), "--sout", sout]):
            assert frames_of(f"http://127.0.0.1:{port}/x", SOME) == (SOME, encoding)
