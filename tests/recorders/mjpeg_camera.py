"""A network camera on the loopback: real sockets, in a process of its own, faults on demand.

`python -m tests.recorders.mjpeg_camera` prints its port and serves until its standard input ends.
It plays what was POSTed to /plan at the path that it answers with, and puts down when it sent each
frame. One camera serves all tests of a process; `playing` is what they use.
"""

from __future__ import annotations

import atexit
import base64
import json
import os
import random
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from functools import cache
from http.client import HTTPConnection
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
from mcap.reader import make_reader

from tests.recorders.live_wait import LAST_RESORT_S
from tunenet_logs.reader import read_episode
from tunenet_logs.timing.stamps import wall_ns

ROOT = Path(__file__).resolve().parents[2]
_BLOCK = 16
_BITS = 16


@dataclass(frozen=True)
class Plan:
    """What the camera sends.

    Attributes:
        rate_hz: 0 for all frames in one piece.
        close_after: frames after which it closes the connection; 0 for at the end of `frames`.
        stall_after: frames after which it falls silent and keeps the connection; 0 for never.
        cut_every: every so many frames are cut in half.
        cut_lies: whether a cut frame still states its whole length.
        jitter_s: the largest deviation from its time that a frame is sent with.
        slow_start_s: silence before the first frame.
        with_length: whether it states Content-Length.
        boundary: as it announces it; the delimiter is "--frame".
        status, kind, body: of an answer that is no stream.
        user: "name:password" that it wants.
        distinct: pictures before they come again.
        log: whose pictures they are, where they are not its own.
    """

    frames: int = 60
    rate_hz: float = 60.0
    size: tuple[int, int] = (320, 240)
    close_after: int = 0
    stall_after: int = 0
    cut_every: int = 0
    cut_lies: bool = False
    jitter_s: float = 0.0
    slow_start_s: float = 0.0
    with_length: bool = True
    boundary: str = "frame"
    status: int = 200
    kind: str = ""
    body: str = ""
    user: str = ""
    distinct: int = 1 << _BITS
    log: str = ""


@cache
def picture(number: int, size: tuple[int, int] = (320, 240)) -> bytes:
    """A JPEG of quality 90 that holds its number as blocks of black and white."""
    width, height = size
    pixels = np.tile(np.linspace(60, 200, width).astype(np.uint8), (height, 1))
    pixels = np.repeat(pixels[:, :, None], 3, axis=2)
    noise = np.random.default_rng(number).integers(0, 40, pixels.shape, dtype=np.uint8)
    pixels = cv2.add(pixels, noise)
    for bit in range(_BITS):
        x = bit * _BLOCK
        pixels[:_BLOCK, x : x + _BLOCK] = 255 if number >> bit & 1 else 0
    return cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()


def number_in(pixels: np.ndarray) -> int:
    """The number that a picture holds."""
    half = _BLOCK // 2
    return sum((int(pixels[half, bit * _BLOCK + half, 0]) > 127) << bit for bit in range(_BITS))


@dataclass
class _Show:
    """A plan as it is played.

    Attributes:
        sent_ns: monotonic time just before each whole frame was sent.
        ended: set once nobody wants it any more.
    """

    plan: Plan
    pictures: list[bytes]
    sent_ns: list[int] = field(default_factory=list)
    ended: threading.Event = field(default_factory=threading.Event)


class _Handler(BaseHTTPRequestHandler):
    shows: list[_Show]

    def log_message(self, format: str, *_words: object) -> None:  # noqa: A002
        pass

    def do_POST(self) -> None:
        words = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        plan = Plan(**{**words, "size": tuple(words["size"])})
        if plan.log:
            pictures = [frame.data for frame in read_episode(Path(plan.log)).frames()]
        else:
            count = min(plan.frames, plan.distinct)
            pictures = [picture(number, plan.size) for number in range(count)]
        self.shows.append(_Show(plan, pictures))
        self._answer(200, "text/plain", f"/video/{len(self.shows) - 1}")

    def do_GET(self) -> None:
        show = self._show()
        if self.path.startswith("/sent/"):
            self._answer(200, "application/json", json.dumps(show.sent_ns))
        else:
            self._send(show)

    def do_DELETE(self) -> None:
        self._show().ended.set()
        self._answer(200, "text/plain", "")

    def _show(self) -> _Show:
        return self.shows[int(self.path.partition("?")[0].rpartition("/")[2])]

    def _answer(self, code: int, kind: str, body: str) -> None:
        self.send_response(code)
        self.send_header("Content-Type", kind)
        self.end_headers()
        self.wfile.write(body.encode())

    def _send(self, show: _Show) -> None:
        plan = show.plan
        if plan.user:
            wanted = "Basic " + base64.b64encode(plan.user.encode()).decode()
            if self.headers.get("Authorization") != wanted:
                self.send_response(401)
                self.send_header("WWW-Authenticate", 'Basic realm="camera"')
                self.end_headers()
                return
        if plan.status != 200 or plan.kind:
            self._answer(plan.status, plan.kind or "text/html", plan.body)
            return
        self.send_response(200)
        announced = f"; boundary={plan.boundary}" if plan.boundary else ""
        self.send_header("Content-Type", "multipart/x-mixed-replace" + announced)
        self.end_headers()
        with suppress(BrokenPipeError, ConnectionResetError):
            self._play(show)

    def _play(self, show: _Show) -> None:
        plan = show.plan
        rng = random.Random(0)
        start = time.monotonic() + plan.slow_start_s
        held = b""
        for number in range(plan.frames):
            if plan.rate_hz:
                due = start + number / plan.rate_hz + rng.uniform(-1, 1) * plan.jitter_s
                if show.ended.wait(max(0.0, due - time.monotonic())):
                    return
            if plan.close_after and number == plan.close_after:
                return
            if plan.stall_after and number == plan.stall_after:
                self.wfile.write(held)
                show.ended.wait()
                return
            part = self._part(show, number)
            if plan.rate_hz:
                self.wfile.write(part)
            else:
                held += part
        self.wfile.write(held + b"--frame--\r\n")

    def _part(self, show: _Show, number: int) -> bytes:
        plan = show.plan
        whole = show.pictures[number % len(show.pictures)]
        is_cut = plan.cut_every and number % plan.cut_every == plan.cut_every - 1
        data = whole[: len(whole) // 2] if is_cut else whole
        head = "--frame\r\nContent-Type: image/jpeg\r\n"
        if plan.with_length:
            head += f"Content-Length: {len(whole if plan.cut_lies else data)}\r\n"
        if not is_cut:
            show.sent_ns.append(time.monotonic_ns())
        return head.encode() + b"\r\n" + data + b"\r\n"


class _Server(ThreadingHTTPServer):
    daemon_threads = True


def main() -> None:
    _Handler.shows = []
    server = _Server(("127.0.0.1", 0), _Handler)
    print(server.server_port, flush=True)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    sys.stdin.read()  # which ends with whoever started it
    os._exit(0)


@cache
def _port() -> int:
    """The port of this process's camera, which is started when it is first wanted."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.recorders.mjpeg_camera"],
        cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip

    def end() -> None:
        process.kill()
        process.communicate()

    atexit.register(end)
    assert process.stdout is not None
    return int(process.stdout.readline())


def _ask(method: str, path: str, body: str = "") -> str:
    connection = HTTPConnection("127.0.0.1", _port(), timeout=LAST_RESORT_S)
    try:
        connection.request(method, path, body)
        response = connection.getresponse()
        assert response.status == 200
        return response.read().decode()
    finally:
        connection.close()


@contextmanager
def playing(**plan: object) -> Iterator[str]:
    """A camera that plays a plan to whoever asks; its address, without "http://"."""
    words = json.dumps(asdict(Plan(**plan)))  # type: ignore[arg-type]
    path = _ask("POST", "/plan", words)
    try:
        yield f"127.0.0.1:{_port()}{path}"
    finally:
        _ask("DELETE", path)


def sent_by(address: str) -> list[int]:
    """When the camera sent each whole frame so far, just before it did [monotonic ns]."""
    return json.loads(_ask("GET", "/sent/" + address.rpartition("/")[2]))


def times_in(log: Path) -> list[tuple[int, int]]:
    """Each message's stamp and receipt [ns]."""
    with log.open("rb") as file:
        return [(one.publish_time, one.log_time) for _, _, one in make_reader(file).iter_messages()]


def check_times(log: Path, address: str) -> None:
    """Check the times of what this process recorded, by arrival, of all that the camera sent.

    Each frame's stamp lies between the moment of its sending and that of its receipt.
    """
    for sent_ns, (stamp_ns, received_ns) in zip(sent_by(address), times_in(log), strict=True):
        assert wall_ns(sent_ns) <= stamp_ns <= received_ns


if __name__ == "__main__":
    main()
