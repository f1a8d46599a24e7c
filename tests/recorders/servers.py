"""Cameras of tests that are served by threads of the test's own process, over real sockets."""

from __future__ import annotations

import base64
import hashlib
import re
import shutil
import socket
import ssl
import struct
import subprocess
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache
from http.server import BaseHTTPRequestHandler, HTTPServer, ThreadingHTTPServer
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import av
import numpy as np
import pytest

from tests.recorders.mjpeg_camera import picture

MULTIPART = "multipart/x-mixed-replace; boundary=frame"
PART = b"--frame\r\n\r\n"
PICTURES = 5  # of an `HttpCamera`
_DRIP_S = 0.05  # between two pieces: far less than any silence that would end the waiting
_LOOKS_EACH_S = 0.01  # whether it is to end; by default half a second, which each test would wait
_FIELD = re.compile(r'(\w+)=(?:"([^"]*)"|([^\s,]+))')
_CLOCK_HZ = 90_000
_MTU_BYTES = 1400

# ---- Servers of bytes


@contextmanager
def beside(server: HTTPServer) -> Iterator[str]:
    """Serve by a server of Python's own; its host and port."""
    threading.Thread(target=server.serve_forever, args=(_LOOKS_EACH_S,), daemon=True).start()
    try:
        yield f"127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()


@contextmanager
def serving_each(answer: Callable[[socket.socket, threading.Event], object]) -> Iterator[str]:
    """Serve each caller in a thread of its own, until the event; host and port."""
    ended = threading.Event()
    listener = socket.create_server(("127.0.0.1", 0))

    def serve_one(caller: socket.socket) -> None:
        with caller, suppress(OSError):
            answer(caller, ended)

    def serve() -> None:
        with suppress(OSError):
            while True:
                caller, _ = listener.accept()
                threading.Thread(target=serve_one, args=(caller,), daemon=True).start()

    threading.Thread(target=serve, daemon=True).start()
    try:
        yield f"127.0.0.1:{listener.getsockname()[1]}"
    finally:
        ended.set()
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()


@dataclass
class Answering:
    """Where somebody answers, how often it was called so far, and who still listens."""

    place: str = ""
    calls: int = 0

    @property
    def url(self) -> str:
        return f"http://{self.place}/video"


@contextmanager
def answering(*answers: bytes, asked: bool = True) -> Iterator[Answering]:
    """Give callers one answer after the other, the last one for ever, and hang up.

    Args:
        answers: whole, as HTTP has them.
        asked: whether a caller says something first, as over HTTP.
    """
    server = Answering()

    def answer(caller: socket.socket, _ended: threading.Event) -> None:
        if asked:
            caller.recv(65536)
        server.calls += 1
        caller.sendall(answers[min(server.calls, len(answers)) - 1])

    with serving_each(answer) as server.place:
        yield server


def http(body: bytes = b"", kind: str = "", *, has_length: bool = False) -> bytes:
    """An answer that HTTP has."""
    head = f"Content-Type: {kind}\r\n" * bool(kind)
    head += f"Content-Length: {len(body)}\r\n" * has_length
    return f"HTTP/1.0 200 OK\r\n{head}\r\n".encode() + body


STREAM = http(kind=MULTIPART)


def send_on(caller: socket.socket, again: bytes, ended: threading.Event, *, drips: bool) -> None:
    """Send the same without end; nothing if it is empty."""
    while again and not ended.wait(_DRIP_S if drips else 0):
        caller.sendall(again)


@contextmanager
def sending(head: bytes, again: bytes = b"", *, drips: bool = False) -> Iterator[str]:
    """Answer all callers with `head`, and then with `again` without end; an address.

    Args:
        head: at once.
        again: what comes again and again; nothing more comes if it is empty.
        drips: whether there is a moment before each, or silence without one; else it hangs up.
    """

    def answer(caller: socket.socket, ended: threading.Event) -> None:
        caller.recv(65536)
        caller.sendall(head)
        send_on(caller, again, ended, drips=drips)
        if drips:
            ended.wait()

    with serving_each(answer) as place:
        yield f"http://{place}/video"


# ---- HTTP cameras that ask who is there


@cache
def self_signed() -> Path:
    """A PEM file with a key and a certificate that nobody vouches for, of a host of another name.

    The test is skipped without openssl.
    """
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    file = Path(mkdtemp(prefix="tunenet-certificate-")) / "camera.pem"
    words = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-subj", "/CN=camera.lan"]
    words += ["-days", "1", "-keyout", str(file), "-out", str(file.with_suffix(".crt"))]
    subprocess.run(words, check=True, capture_output=True)
    file.write_text(file.read_text() + file.with_suffix(".crt").read_text())
    return file


def fingerprint_of(file: Path) -> str:
    """As `openssl x509 -fingerprint -sha256` prints it: capital digits with colons."""
    text = file.with_suffix(".crt").read_text()
    return hashlib.sha256(ssl.PEM_cert_to_DER_cert(text)).digest().hex(":").upper()


@dataclass
class HttpCamera:
    """What it wants before it shows five pictures, and what it saw.

    Attributes:
        challenges: its `WWW-Authenticate` to who has not proved anything.
        proves: whether a request's `Authorization` does; the nonce is "n0".
        moved: where it sends on to from /moved.
        seen: the `Authorization` of each request, "" for none.
        address: without a scheme.
    """

    challenges: tuple[str, ...] = ()
    proves: Callable[[str], bool] = field(default=bool)
    moved: str = ""
    seen: list[str] = field(default_factory=list)
    address: str = ""


@contextmanager
def http_camera(camera: HttpCamera, certificate: Path | None = None) -> Iterator[HttpCamera]:
    """Serve a camera, and set its address."""

    class Handler(BaseHTTPRequestHandler):
        def log_message(self, format: str, *_words: object) -> None:  # noqa: A002
            pass

        def answer(self, code: int, *headers: tuple[str, str]) -> None:
            self.send_response(code)
            for header in headers:
                self.send_header(*header)
            self.end_headers()

        def do_GET(self) -> None:
            given = self.headers.get("Authorization", "")
            camera.seen.append(given)
            if camera.moved and self.path.startswith("/moved"):
                self.answer(302, ("Location", camera.moved))
            elif camera.challenges and not camera.proves(given):
                self.answer(401, *(("WWW-Authenticate", one) for one in camera.challenges))
            else:
                self.answer(200, ("Content-Type", MULTIPART))
                shown = b"".join(PART + picture(number) + b"\r\n" for number in range(PICTURES))
                self.wfile.write(shown + b"--frame--\r\n")  # else it is asked for again

    class Server(ThreadingHTTPServer):
        def handle_error(self, request: object, client_address: object) -> None:
            pass  # who does not believe a certificate hangs up

    server = Server(("127.0.0.1", 0), Handler)
    if certificate is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(certificate)
        server.socket = context.wrap_socket(
            server.socket, server_side=True, do_handshake_on_connect=False
        )
    with beside(server) as camera.address:
        yield camera


def digest_of(given: str, kind: str, user: str, password: str) -> str:
    """What a digest has to be, by RFC 7616, from the words that were given with it."""
    words = {name: quoted or plain for name, quoted, plain in _FIELD.findall(given)}

    def hashed(*parts: str) -> str:
        return hashlib.new(kind, ":".join(parts).encode()).hexdigest()

    secret = hashed(user, words["realm"], password)
    if words.get("algorithm", "").lower().endswith("-sess"):
        secret = hashed(secret, words["nonce"], words["cnonce"])
    names = ("nonce", "nc", "cnonce", "qop") if "qop" in words else ("nonce",)
    return hashed(secret, *(words[name] for name in names), hashed("GET", words["uri"]))


# ---- RTSP cameras

SDP = (
    "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=camera\r\nt=0 0\r\nm=video 0 RTP/AVP 96\r\n"
    "a=rtpmap:96 H264/90000\r\na=control:track\r\n"
)


def ok(method: str, sdp: str = SDP) -> bytes:
    """What an honest camera replies."""
    body = sdp if method == "DESCRIBE" else ""
    head = {
        "OPTIONS": "Public: OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN\r\n",
        "DESCRIBE": f"Content-Type: application/sdp\r\nContent-Length: {len(sdp)}\r\n",
        "SETUP": "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\nSession: 1\r\n",
        "PLAY": "Session: 1\r\nRTP-Info: url=track;seq=0;rtptime=123456\r\n",
    }.get(method, "")
    return f"RTSP/1.0 200 OK\r\nCSeq: 1\r\n{head}\r\n{body}".encode()


@contextmanager
def hostile_rtsp(
    replies: Mapping[str, bytes], again: bytes = b"", *, drips: bool = False
) -> Iterator[str]:
    """Reply as told; an address without a scheme.

    Args:
        replies: by method, instead of an honest reply; b"" for none.
        again: what comes without end after the first of those replies, or else after PLAY.
        drips: whether there is a moment before each.
    """
    last = next(iter(replies), "PLAY")

    def answer(caller: socket.socket, ended: threading.Event) -> None:
        file = caller.makefile("rb")
        while line := file.readline():
            method = line.decode().partition(" ")[0]
            while file.readline().strip():
                pass
            caller.sendall(replies[method] if method in replies else ok(method))
            if method == last:
                send_on(caller, again, ended, drips=drips)

    with serving_each(answer) as place:
        yield f"{place}/stream"


@contextmanager
def rtsp_camera(pictures: list[np.ndarray], rate_hz: int, *, stall: bool = False) -> Iterator[str]:
    """Play H.264, interleaved on the one connection, and hang up or fall silent; its address.

    They are sent in one piece, so that no delay between them looks like silence; their times are
    those of the rate.
    """
    frames = _encoded(pictures, rate_hz)
    sets = [base64.b64encode(one).decode() for one in frames[0] if one[0] & 0x1F in (7, 8)]
    sdp = f"{SDP}a=fmtp:96 packetization-mode=1;sprop-parameter-sets={','.join(sets)}\r\n"
    packets: list[bytes] = []
    for number, units in enumerate(frames):
        packets += _rtp(units, number, len(packets), rate_hz)

    def answer(caller: socket.socket, ended: threading.Event) -> None:
        file = caller.makefile("rb")
        method = ""
        while method != "PLAY":
            method = file.readline().decode().partition(" ")[0]
            number = b"1"
            while line := file.readline().strip():
                name, _, value = line.partition(b":")
                number = value.strip() if name.lower() == b"cseq" else number
            caller.sendall(ok(method, sdp).replace(b"CSeq: 1", b"CSeq: " + number))
        heads = (struct.pack(">cBH", b"$", 0, len(packet)) for packet in packets)
        caller.sendall(b"".join(head + one for head, one in zip(heads, packets, strict=True)))
        if stall:
            ended.wait()

    with serving_each(answer) as place:
        yield f"{place}/stream"


def _encoded(pictures: list[np.ndarray], rate_hz: int) -> list[list[bytes]]:
    """The NAL units of each picture, RGB (H, W, 3)."""
    height, width = pictures[0].shape[:2]
    coder: Any = av.CodecContext.create("libx264", "w")
    coder.width, coder.height, coder.pix_fmt = width, height, "yuv420p"
    coder.time_base, coder.gop_size = Fraction(1, rate_hz), 10
    coder.options = {"tune": "zerolatency", "preset": "ultrafast"}
    packets = []
    for index, pixels in enumerate(pictures):
        frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")
        frame.pts = index
        packets += coder.encode(frame)
    packets += coder.encode(None)
    units = [bytes(one).replace(b"\0\0\0\1", b"\0\0\1").split(b"\0\0\1") for one in packets]
    return [[unit for unit in one if unit] for one in units]


def _rtp(units: list[bytes], number: int, sequence: int, rate_hz: int) -> list[bytes]:
    """One picture's NAL units as RTP packets (RFC 6184: whole units, or fragments FU-A)."""
    payloads = []
    for unit in units:
        if len(unit) <= _MTU_BYTES:
            payloads.append(unit)
            continue
        pieces = [unit[at : at + _MTU_BYTES] for at in range(1, len(unit), _MTU_BYTES)]
        for index, piece in enumerate(pieces):
            edges = 0x80 * (index == 0) | 0x40 * (index == len(pieces) - 1)
            payloads.append(bytes([unit[0] & 0xE0 | 28, edges | unit[0] & 0x1F]) + piece)
    ticks = 123_456 + number * _CLOCK_HZ // rate_hz
    return [
        struct.pack(
            ">BBHII", 0x80, 96 | 0x80 * (index == len(payloads) - 1), sequence + index & 0xFFFF,
            ticks, 1,
        ) + payload
        for index, payload in enumerate(payloads)
    ]  # fmt: skip
