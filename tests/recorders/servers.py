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
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest

from tests.picture_strangers import packets
from tests.recorders.mjpeg_camera import picture

MULTIPART = "multipart/x-mixed-replace; boundary=frame"
PART = b"--frame\r\n\r\n"
PICTURES = 5  # of an `http_camera`
_DRIP_S = 0.05  # between two pieces: far less than any silence that would end the waiting
_LOOKS_EACH_S = 0.01  # whether it is to end; by default half a second, which each test would wait
_FIELD = re.compile(r'(\w+)=(?:"([^"]*)"|([^\s,]+))')
_CLOCK_HZ = 90_000
_MTU_BYTES = 1400

# ---- Servers of bytes


@dataclass
class Server:
    """Where somebody answers, and how often it was called so far."""

    place: str = ""
    calls: int = 0

    @property
    def url(self) -> str:
        return f"http://{self.place}/video"


@contextmanager
def serving(answer: Callable[[socket.socket, threading.Event, int], object]) -> Iterator[Server]:
    """Serve each caller in a thread of its own, by its number from 0 on, until the event."""
    ended, server = threading.Event(), Server()
    listener = socket.create_server(("127.0.0.1", 0))
    server.place = f"127.0.0.1:{listener.getsockname()[1]}"

    def serve_one(caller: socket.socket, number: int) -> None:
        with caller, suppress(OSError):
            answer(caller, ended, number)

    def serve() -> None:
        with suppress(OSError):
            while True:
                caller, _ = listener.accept()
                server.calls += 1
                words = (caller, server.calls - 1)
                threading.Thread(target=serve_one, args=words, daemon=True).start()

    threading.Thread(target=serve, daemon=True).start()
    try:
        yield server
    finally:
        ended.set()
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()


def answering(
    *answers: bytes, again: bytes = b"", drips: bool = False, asked: bool = True
) -> AbstractContextManager[Server]:
    """Give callers one answer after the other, the last one for ever.

    Args:
        answers: whole, as HTTP has them.
        again: what comes again and again behind an answer; if it is empty, it hangs up.
        drips: whether there is a moment before each, or silence without one.
        asked: whether a caller says something first, as over HTTP.
    """

    def answer(caller: socket.socket, ended: threading.Event, number: int) -> None:
        if asked:
            caller.recv(65536)
        caller.sendall(answers[min(number, len(answers) - 1)])
        send_on(caller, again, ended, drips=drips)
        if drips:
            ended.wait()

    return serving(answer)


def datagrams(host: str = "127.0.0.1") -> closing[socket.socket]:
    one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    one.bind((host, 0))
    return closing(one)


def send_on(caller: socket.socket, again: bytes, ended: threading.Event, *, drips: bool) -> None:
    """Send the same without end; nothing if it is empty."""
    while again and not ended.wait(_DRIP_S if drips else 0):
        caller.sendall(again)


def http(body: bytes = b"", kind: str = "", *, has_length: bool = False) -> bytes:
    head = f"Content-Type: {kind}\r\n" * bool(kind)
    head += f"Content-Length: {len(body)}\r\n" * has_length
    return f"HTTP/1.0 200 OK\r\n{head}\r\n".encode() + body


STREAM = http(kind=MULTIPART)


def part(data: bytes, *, stated: int | None = None) -> bytes:
    """A picture of a stream; where a number is stated, with it as its length."""
    length = b"" if stated is None else b"Content-Length: %d\r\n" % stated
    return b"--frame\r\nContent-Type: image/jpeg\r\n" + length + b"\r\n" + data + b"\r\n"


def parts(*pictures: bytes) -> bytes:
    """A stream of pictures that has an end."""
    return b"".join(part(one, stated=len(one)) for one in pictures) + b"--frame--\r\n"


# ---- HTTP servers that ask who is there


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


Header = tuple[str, str]


@dataclass
class HttpServer:
    """Who answers, and what they saw.

    Attributes:
        answer: code, headers and body of a request, by its path and its `Authorization`.
        seen: the `Authorization` of each request, "" for none.
        address: without a scheme.
    """

    answer: Callable[[str, str], tuple[int, list[Header], bytes]]
    seen: list[str] = field(default_factory=list)
    address: str = ""


@contextmanager
def http_server(served: HttpServer, certificate: Path | None = None) -> Iterator[HttpServer]:
    class Handler(BaseHTTPRequestHandler):
        def log_message(self, format: str, *_words: object) -> None:  # noqa: A002
            pass

        def do_GET(self) -> None:
            given = self.headers.get("Authorization", "")
            served.seen.append(given)
            code, headers, body = served.answer(self.path, given)
            self.send_response(code)
            for header in headers:
                self.send_header(*header)
            self.end_headers()
            if self.command == "GET":
                self.wfile.write(body)

        def do_HEAD(self) -> None:
            self.do_GET()

    class Listener(ThreadingHTTPServer):
        def handle_error(self, request: object, client_address: object) -> None:
            pass  # who does not believe a certificate hangs up

    server = Listener(("127.0.0.1", 0), Handler)
    if certificate is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(certificate)
        server.socket = context.wrap_socket(
            server.socket, server_side=True, do_handshake_on_connect=False
        )
    threading.Thread(target=server.serve_forever, args=(_LOOKS_EACH_S,), daemon=True).start()
    served.address = f"127.0.0.1:{server.server_port}"
    try:
        yield served
    finally:
        server.shutdown()
        server.server_close()


def http_camera(
    *challenges: str,
    proves: Callable[[str], object] = bool,
    moved: str = "",
    certificate: Path | None = None,
) -> AbstractContextManager[HttpServer]:
    """A camera that shows five pictures.

    Args:
        challenges: its `WWW-Authenticate` to who has not proved anything.
        proves: whether a request's `Authorization` does.
        moved: where it sends on to from /moved.
        certificate: a PEM file with key and certificate, for HTTPS.
    """

    def answer(path: str, given: str) -> tuple[int, list[Header], bytes]:
        if moved and path.startswith("/moved"):
            return 302, [("Location", moved)], b""
        if challenges and not proves(given):
            return 401, [("WWW-Authenticate", one) for one in challenges], b""
        return 200, [("Content-Type", MULTIPART)], parts(*map(picture, range(PICTURES)))

    return http_server(HttpServer(answer), certificate)


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

    def answer(caller: socket.socket, ended: threading.Event, _number: int) -> None:
        for method, _ in _requests(caller):
            caller.sendall(replies[method] if method in replies else ok(method))
            if method == last:
                send_on(caller, again, ended, drips=drips)

    with serving(answer) as server:
        yield f"{server.place}/stream"


def _requests(caller: socket.socket) -> Iterator[tuple[str, bytes]]:
    file = caller.makefile("rb")
    while method := file.readline().decode().partition(" ")[0]:
        number = b"1"
        while line := file.readline().strip():
            name, _, value = line.partition(b":")
            number = value.strip() if name.lower() == b"cseq" else number
        yield method, number


@contextmanager
def rtsp_camera(pictures: list[np.ndarray], rate_hz: int, *, stall: bool = False) -> Iterator[str]:
    """Play H.264, interleaved on the one connection, and hang up or fall silent; its address.

    They are sent in one piece, so that no delay between them looks like silence; their times are
    those of the rate.
    """
    frames = _encoded(pictures)
    sets = [base64.b64encode(one).decode() for one in frames[0] if one[0] & 0x1F in (7, 8)]
    sdp = f"{SDP}a=fmtp:96 packetization-mode=1;sprop-parameter-sets={','.join(sets)}\r\n"
    sent: list[bytes] = []
    for number, units in enumerate(frames):
        sent += _rtp(units, number, len(sent), rate_hz)
    stream = b"".join(struct.pack(">cBH", b"$", 0, len(one)) + one for one in sent)

    def answer(caller: socket.socket, ended: threading.Event, _number: int) -> None:
        for method, number in _requests(caller):
            caller.sendall(ok(method, sdp).replace(b"CSeq: 1", b"CSeq: " + number))
            if method == "PLAY":
                break
        caller.sendall(stream)
        if stall:
            ended.wait()

    with serving(answer) as server:
        yield f"{server.place}/stream"


def _encoded(pictures: list[np.ndarray]) -> list[list[bytes]]:
    """The NAL units of each picture, RGB (H, W, 3)."""
    units = [
        data.replace(b"\0\0\0\1", b"\0\0\1").split(b"\0\0\1")
        for _, data in packets(pictures, "h264", keyframe_every=10)
    ]
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
