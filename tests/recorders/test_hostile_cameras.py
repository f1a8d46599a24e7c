"""No camera holds up the recorder, fills its memory, or keeps it from ending at Ctrl-C."""

from __future__ import annotations

import os
import resource
import signal
import socket
import struct
import subprocess
import sys
import threading
from contextlib import closing, suppress
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import ROOT
from tests.hostile_files import FILE_TYPE, mp4_of_many
from tests.recorders.films import PATIENT, MadeSource, film, numbered
from tests.recorders.live_wait import LAST_RESORT_S, ended, recorder, wait_until
from tests.recorders.servers import (
    PART,
    SDP,
    STREAM,
    answering,
    datagrams,
    hostile_rtsp,
    http,
    ok,
    rtsp_camera,
    serving,
)
from tunenet_logs.errors import CameraError
from tunenet_logs.recorders.camera.device import opened_within
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.camera.rtsp import Reply, RtspWire
from tunenet_logs.recorders.camera.sources import open_source
from tunenet_logs.recorders.camera.streams import MultipartParser

pytestmark = pytest.mark.live

STALL_S = 0.5
EMPTY = b"--frame\r\nContent-Length: 0\r\n\r\n\r\n"
CONTINUE = b"HTTP/1.1 100 Continue\r\n\r\n"
CHUNKED = STREAM[:-2].replace(b"1.0", b"1.1") + b"Transfer-Encoding: chunked\r\n\r\n"


def sent_on(place: bytes) -> bytes:
    return b"HTTP/1.1 302 Found\r\nLocation: " + place + b"\r\n\r\n"


def why_it_ended(url: str) -> str:
    try:
        source = open_source(url, CameraOptions(stall_s=STALL_S))
    except CameraError as error:
        return str(error)
    assert not list(source.frames())
    return source.ended


# ---- What drips or has no end: it ends within a limit, with the reason

SLOW, NONE, NO_RTSP = "does not answer within", f"no data for {STALL_S} s", "does not speak RTSP"
ENDED = f" for {STALL_S} s"  # no data, or no whole picture
OPENING_S = ("tunenet_logs.recorders.camera.network.OPENING_S", 1.0)


@pytest.mark.parametrize(
    ("head", "again", "drips", "says"),
    [
        (b"HTTP/1.1 200 OK\r\nX: ", b"a", True, SLOW),
        (b"", CONTINUE, True, SLOW),
        (b"", CONTINUE * 1000, False, SLOW),
        (b"HTTP/1.1 200 OK\r\n", b"X: y\r\n" * 1000, False, "does not answer as a camera"),
        (sent_on(b"/again"), b"", False, "answers 302"),
        (sent_on(b"/again"), b"z" * 65536, False, "answers 302"),
        (sent_on(b"file:///etc/hosts"), b"", False, "to file"),
        (sent_on(b"ftp://127.0.0.1/"), b"", False, "sends on to ftp"),
        (sent_on(b"http://me:pw@10.0.0.9/x?pwd=hidden"), b"", False, "http://10.0.0.9/x; if that"),
        # parts that are no pictures
        (STREAM, b"-", True, ENDED),
        (STREAM + PART + b"\xff\xd8", b"x", True, ENDED),
        (STREAM + b"--frame\r\nX: ", b"x", True, ENDED),
        (STREAM, EMPTY, True, ENDED),
        (STREAM, EMPTY * 1000, False, ENDED),
        (CHUNKED + b"0\r\n", b"T: x\r\n", True, ENDED),
        (CHUNKED, b"1;" + b"e" * 9000 + b"\r\nx\r\n", False, ENDED),
    ],
)
def test_an_http_camera_has_an_end(monkeypatch: pytest.MonkeyPatch, head, again, drips, says):
    if says == SLOW:
        monkeypatch.setattr(*OPENING_S)
    with answering(head, again=again, drips=drips) as server:
        assert says in why_it_ended(server.url)


@pytest.mark.parametrize(
    ("replies", "again", "drips", "says"),
    [
        ({"OPTIONS": b"RTSP/1.0 200 OK\r\nX: "}, b"a", True, SLOW),
        ({"OPTIONS": b""}, b"\r\n", True, SLOW),
        ({"OPTIONS": b""}, b"\r\n" * 9000, False, SLOW),
        ({"OPTIONS": b""}, b"$\x00\x00\x00", True, SLOW),
        ({"OPTIONS": b""}, b"$\x00\xff\xff" + bytes(65535), False, "sends packets and no reply"),
        ({"OPTIONS": b"RTSP/1.0 200 OK\r\n"}, b"X: y\r\n" * 900, False, NO_RTSP),
        ({}, b"\r\n", True, NONE),
        ({}, b"RTSP/1.0 200 OK\r\n\r\n", True, NONE),
        ({}, b"noise without a packet", True, NONE),
    ],
)
def test_an_rtsp_camera_has_an_end(monkeypatch: pytest.MonkeyPatch, replies, again, drips, says):
    monkeypatch.setattr(*OPENING_S)
    with hostile_rtsp(replies, again, drips=drips) as address:
        assert says in why_it_ended(f"rtsp://{address}")


def moved(place: str) -> bytes:
    return f"RTSP/1.0 302 Moved\r\nCSeq: 1\r\nLocation: {place}\r\n\r\n".encode()


def transport(said: str) -> bytes:
    return f"RTSP/1.0 200 OK\r\nCSeq: 1\r\nSession: 1\r\nTransport: {said}\r\n\r\n".encode()


@pytest.mark.parametrize(
    ("replies", "says"),
    [
        ({"DESCRIBE": moved("rtsp://u:p@10.0.0.9/x?q")}, "sends on to rtsp://10.0.0.9/x; if that"),
        ({"DESCRIBE": moved("file:///etc/passwd")}, "sends on to file:///etc/passwd, which is no"),
        ({"DESCRIBE": moved("http://[")}, "sends on to what is no address"),
        ({"OPTIONS": b"RTSP/1.0 302 M\r\n\r\n"}, "sends on to"),
        ({"OPTIONS": b"HTTP/1.1 400 Bad Request\r\n\r\n"}, NO_RTSP),
        ({"OPTIONS": b"RTSP/1.0 200 OK\r\nContent-Length: 99999999\r\n\r\n"}, NO_RTSP),
        ({"OPTIONS": b"RTSP/1.0 200 OK\r\nContent-Length: -5\r\n\r\n"}, NO_RTSP),
        ({"OPTIONS": b"RTSP/1.0 200 OK\r\n" + b"X: y\r\n" * 9000}, NO_RTSP),
        ({"OPTIONS": b"RTSP/1.0 abc\r\n\r\n"}, NO_RTSP),
        ({"DESCRIBE": b"RTSP/1.0 503 Full\r\n\r\n"}, "answers 503 Full to DESCRIBE"),
        ({"DESCRIBE": ok("DESCRIBE", "v=0\r\nm=audio 0 RTP/AVP 0\r\n")}, "holds no video"),
        ({"DESCRIBE": ok("DESCRIBE", SDP.replace("RTP/AVP", "RTP/SAVP"))}, "by RTP/SAVP"),
        ({"DESCRIBE": b'RTSP/1.0 401 No\r\nWWW-Authenticate: Basic realm="x"\r\n\r\n'}, "password"),
        ({"SETUP": transport("RTP/AVP;multicast;destination=239.0.0.1")}, "asked for TCP and"),
        ({"SETUP": transport("RTP/AVP/TCP;multicast")}, "asked for TCP and"),
        ({"SETUP": b"garbage"}, NO_RTSP),
        ({"SETUP": b"RTSP/1.0 461 No\r\n\r\n"}, "refuses TCP and UDP"),
    ],
)
def test_each_refusal_of_rtsp_is_one_true_line(replies: dict[str, bytes], says: str):
    with hostile_rtsp(replies) as address, pytest.raises(CameraError) as error:
        open_source(f"rtsp://{address}", PATIENT)
    assert says in str(error.value)
    assert "\n" not in str(error.value)


# ---- Memory and work


MATROSKA = bytes.fromhex("1a45dfa39f4286810142f7810142f2810442f381084282886d6174726f736b61")
MATROSKA += bytes.fromhex("42878104428581021853806701ffffffffffffff1654ae6b080fffffff")
FLV = (b"FLV\1\1\0\0\0\x09\0\0\0\0", b"\x09\xff\xff\xff" + bytes(7))
TOO_MUCH = "sends 64 MiB without a picture"
slow = pytest.mark.slow
# In a process of at most so many bytes of address space; FFmpeg with its threads needs a third.
_READS_STDIN = """
import resource
resource.setrlimit(resource.RLIMIT_AS, (1_500_000_000,) * 2)
from tunenet_logs.recorders.camera.sources import open_source
print(list(open_source('-').frames()))
"""


@pytest.mark.parametrize(
    ("start", "again", "says"),
    [
        (mp4_of_many(80_000_000), b"", "claims 80000000 samples in"),
        (FILE_TYPE + b"\xff\xff\xff\xffmoov", b"\0", "holds no video"),
        (MATROSKA, b"a", TOO_MUCH),
        pytest.param(*FLV, TOO_MUCH, marks=slow),
        (b"", b"G" + bytes(187), TOO_MUCH),
        (b"\0\0\0\1\x67\x42", b"\x11", TOO_MUCH),
        pytest.param(b"\xff\xd8\xff\xe0", b"\x11", TOO_MUCH, marks=slow),
        (b"--x\r\nContent-Type: image/jpeg\r\n\r\n", b"\xff", "sends a part of more than"),
    ],
)
def test_nothing_is_kept_without_a_bound(start: bytes, again: bytes, says: str):
    ours, theirs = os.pipe()
    out: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    recorder = subprocess.Popen([sys.executable, "-c", _READS_STDIN], cwd=ROOT, stdin=ours, **out)
    os.close(ours)
    with suppress(BrokenPipeError), os.fdopen(theirs, "wb", buffering=0) as camera:
        camera.write(start)
        for _ in range(200 if again else 0):
            camera.write(again * (1_000_000 // len(again)))
    said, _ = recorder.communicate(timeout=LAST_RESORT_S)
    assert says in said.splitlines()[-1]
    assert "PyAV library exception" not in said


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


# ---- Ends that a user brings about


def silent(_caller: socket.socket, ended: threading.Event, _number: int) -> None:
    ended.wait(LAST_RESORT_S)


@pytest.mark.parametrize("scheme", ["http", "rtsp", "https", "rtsps"])
def test_a_camera_that_does_not_answer_is_not_waited_for_as_long_as_one_may_be_silent(
    monkeypatch: pytest.MonkeyPatch, scheme: str
):
    monkeypatch.setattr(OPENING_S[0], 0.5)
    with serving(silent) as server, pytest.raises(CameraError, match=r"answer within 0\.5 s"):
        open_source(f"{scheme}://{server.place}/video", CameraOptions(stall_s=LAST_RESORT_S))


@pytest.mark.parametrize("scheme", ["http", "rtsp", "https", "rtsps", "-"])
def test_ctrl_c_while_a_camera_is_opened(tmp_path: Path, scheme: str):
    with serving(silent) as server:
        address = "-" if scheme == "-" else f"{scheme}://{server.place}/video"
        with recorder(tmp_path, "--camera", address, "--stall", 600) as process:
            tasks = Path(f"/proc/{process.pid}/task")
            wait_until(lambda: len(list(tasks.iterdir())) > 1, "the thread that opens the camera")
            _, err = ended(process, signal.SIGINT, 130)
    assert err == "tunenet-record: interrupted\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("scheme", "serve", "shots"),
    [
        ("", lambda: answering(STREAM + PART, drips=True), 0),
        ("", lambda: answering(http(film("mpegts")), drips=True), 1),
        ("rtsp://", lambda: rtsp_camera([*map(numbered, range(20))], 50, stall=True), 0),
    ],
    ids=["parts", "a film", "rtsp"],
)
def test_closing_ends_a_read_that_waits(scheme: str, serve, shots: int):
    with serve() as served:
        source = open_source(scheme + served if scheme else served.url, PATIENT)
        frames = source.frames()
        assert len(list(islice(frames, shots))) == shots
        reading = threading.Thread(target=lambda: list(frames), daemon=True)
        reading.start()
        while not getattr(source, "_is_read", True):
            pass
        source.close()
        reading.join(LAST_RESORT_S / 2)
        assert not reading.is_alive()


def test_what_opens_too_late_is_closed():
    late, may_open = MadeSource(iter(())), threading.Event()

    def opening() -> MadeSource:
        may_open.wait(LAST_RESORT_S)
        return late

    with pytest.raises(CameraError, match=r"late: cannot be opened within 0\.01 s"):
        opened_within(0.01, "late", opening)
    may_open.set()
    assert late.closed.wait(LAST_RESORT_S)


# ---- True figures, and packets of the camera alone


def test_nothing_is_sent_to_the_source_that_a_camera_names():
    with datagrams() as named, closing(socket.socket(type=socket.SOCK_DGRAM)) as elsewhere:
        port = named.getsockname()[1]
        elsewhere.bind(("127.0.0.2", port))
        said = f"RTP/AVP;unicast;source=127.0.0.2;destination=127.0.0.2;server_port={port}-{port}"
        setups = iter([b"RTSP/1.0 461 No\r\n\r\n", transport(said)])

        class Replies(dict[str, bytes]):
            def __getitem__(self, method: str) -> bytes:
                return next(setups) if method == "SETUP" else ok(method)

        with hostile_rtsp(Replies(SETUP=b"")) as address:
            assert f"no data for {STALL_S} s over UDP" in why_it_ended(f"rtsp://{address}")
        assert named.recv(100)
        elsewhere.setblocking(False)
        with pytest.raises(BlockingIOError):
            elsewhere.recv(100)


def packet(number: int) -> bytes:
    return struct.pack(">BBHII", 0x80, 96, number, 0, 1)


@pytest.mark.parametrize("noise", [b"$\x00\xff\xff" + b"x" * 9, b"\r\nRTSP/1.0 x\r\n\r\n"])
@pytest.mark.parametrize("size", [1, 100_000])
def test_noise_between_packets_costs_no_more_than_it_covers(noise: bytes, size: int):
    one = b"$\x00\x00\x0c" + packet(1)
    sent = one * 10 + noise + one * 20_000
    ours, theirs = socket.socketpair()

    def send_in_pieces() -> None:
        for at in range(0, 400, size):
            theirs.sendall(sent[at : min(at + size, 400)])
        theirs.sendall(sent[400:])
        theirs.shutdown(socket.SHUT_WR)

    with closing(ours), closing(theirs):
        threading.Thread(target=send_in_pieces, daemon=True).start()
        wire, came = RtspWire(ours), bytearray()
        while wire.fill():
            while (some := wire.take(is_playing=True)) is not None:
                assert not isinstance(some, Reply)
                came += some
    assert came.startswith(one * 10)
    assert came.endswith(one * 10_000)
