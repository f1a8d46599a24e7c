"""A network camera on the loopback: real sockets, in a process of its own, whose times are known.

`python -m tests.recorders.mjpeg_camera PORT` prints its port and serves until its standard input
ends. It plays what was POSTed to /plan at the path that it answers with, and puts down when it sent
each frame. SIGUSR1 cuts every connection. One camera serves all tests of a process, by `playing`.
"""

from __future__ import annotations

import atexit
import json
import os
import random
import signal
import socket
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

from tests.recorders.live_wait import LAST_RESORT_S, free_port
from tunenet_logs.reader import read_episode
from tunenet_logs.timing.stamps import wall_ns

ROOT = Path(__file__).resolve().parents[2]
_BLOCK = 16
_BITS = 16
_SERVES = [sys.executable, "-m", "tests.recorders.mjpeg_camera"]


@dataclass(frozen=True)
class Plan:
    """What the camera sends.

    Attributes:
        jitter_s: the largest deviation from its time that a frame is sent with.
        distinct: pictures before they come again.
        log: whose pictures they are, where they are not its own.
        since_ns: of the monotonic clock, when frame 0 was due to whoever looked; 0 for the call.
    """

    frames: int = 60
    rate_hz: float = 60.0
    size: tuple[int, int] = (320, 240)
    jitter_s: float = 0.0
    distinct: int = 1 << _BITS
    log: str = ""
    since_ns: int = 0


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
    half = _BLOCK // 2
    return sum((int(pixels[half, bit * _BLOCK + half, 0]) > 127) << bit for bit in range(_BITS))


@dataclass
class _Show:
    """A plan as it is played.

    Attributes:
        sent_ns: monotonic time just before each frame was sent.
        ended: set once nobody wants it any more.
    """

    plan: Plan
    pictures: list[bytes]
    sent_ns: list[int] = field(default_factory=list)
    ended: threading.Event = field(default_factory=threading.Event)


class _Handler(BaseHTTPRequestHandler):
    shows: list[_Show]
    callers: list[socket.socket]

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
        self._answer(f"/video/{len(self.shows) - 1}")

    def do_GET(self) -> None:
        show = self._show()
        if self.path.startswith("/sent/"):
            self._answer(json.dumps(show.sent_ns))
            return
        self.callers.append(self.connection)
        self._begin("multipart/x-mixed-replace; boundary=frame")
        with suppress(OSError):
            self._play(show)

    def do_DELETE(self) -> None:
        self._show().ended.set()
        self._answer("")

    def _show(self) -> _Show:
        return self.shows[int(self.path.rpartition("/")[2])]

    def _begin(self, kind: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.end_headers()

    def _answer(self, text: str) -> None:
        self._begin("text/plain")
        self.wfile.write(text.encode())

    def _play(self, show: _Show) -> None:
        plan, rng, now_s = show.plan, random.Random(0), time.monotonic()
        start_s, number = now_s, 0
        if plan.since_ns:
            start_s = plan.since_ns * 1e-9
            number = int((now_s - start_s) * plan.rate_hz) + 1
        while number < plan.frames:
            due_s = start_s + number / plan.rate_hz + rng.uniform(-1, 1) * plan.jitter_s
            late_s = time.monotonic() - due_s
            if plan.since_ns and late_s > 1 / plan.rate_hz:  # what was not filmed is not shown
                number += int(late_s * plan.rate_hz)
            if show.ended.wait(max(0.0, -late_s)):
                return
            data = show.pictures[number % len(show.pictures)]
            head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
            show.sent_ns.append(time.monotonic_ns())
            self.wfile.write(head.encode() + data + b"\r\n")
            number += 1
        self.wfile.write(b"--frame--\r\n")


class _Server(ThreadingHTTPServer):
    daemon_threads = True


def main() -> None:
    _Handler.shows, _Handler.callers = [], []
    server = _Server(("127.0.0.1", int(sys.argv[1])), _Handler)

    def cut(*_words: object) -> None:
        while _Handler.callers:
            with suppress(OSError):
                _Handler.callers.pop().shutdown(socket.SHUT_RDWR)

    signal.signal(signal.SIGUSR1, cut)
    print(server.server_port, flush=True)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    sys.stdin.read()  # which ends with whoever started it
    os._exit(0)


def _ask(port: int, method: str, path: str, body: str = "") -> str:
    connection = HTTPConnection("127.0.0.1", port, timeout=LAST_RESORT_S)
    try:
        connection.request(method, path, body)
        response = connection.getresponse()
        assert response.status == 200
        return response.read().decode()
    finally:
        connection.close()


def _started(words: list[str]) -> tuple[subprocess.Popen[str], str]:
    """A server in a process of its own, which is ended with this one, and the line it says."""
    pipe = subprocess.PIPE
    process = subprocess.Popen(words, cwd=ROOT, stdin=pipe, stdout=pipe, text=True)
    atexit.register(process.kill)
    assert process.stdout is not None
    return process, process.stdout.readline()


@cache
def _port() -> int:
    """The port of this process's camera, which is started when it is first wanted."""
    return int(_started([*_SERVES, "0"])[1])


@contextmanager
def playing(**plan: object) -> Iterator[str]:
    """A camera that plays a plan to whoever asks; its address, without "http://"."""
    path = _ask(_port(), "POST", "/plan", json.dumps(asdict(Plan(**plan))))  # type: ignore[arg-type]
    try:
        yield f"127.0.0.1:{_port()}{path}"
    finally:
        _ask(_port(), "DELETE", path)


class ComingCamera:
    """A camera that may come and go; what it shows, over and over, goes on meanwhile.

    Attributes:
        address: where it is, or will be.
        words: the command that serves; it says so in a line.
    """

    def __init__(self, log: Path | str = "", rate_hz: float = 60.0) -> None:
        self._port, since_ns = free_port(), time.monotonic_ns()
        self._plan = Plan(1 << 62, rate_hz, distinct=30, log=str(log), since_ns=since_ns)
        self._process: subprocess.Popen[str] | None = None
        self.address = f"http://127.0.0.1:{self._port}/video/0"
        self.words = [*_SERVES, str(self._port)]

    def come(self) -> None:
        self._process, _ = _started(self.words)
        if self.words[:-1] == _SERVES:
            _ask(self._port, "POST", "/plan", json.dumps(asdict(self._plan)))

    def send(self, number: int) -> None:
        assert self._process is not None
        self._process.send_signal(number)

    def go(self) -> None:
        """Kill it; nothing is left of it afterwards, not even on its port."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


def times_in(log: Path) -> list[tuple[int, int]]:
    """Each message's stamp and receipt [ns]."""
    with log.open("rb") as file:
        return [(one.publish_time, one.log_time) for _, _, one in make_reader(file).iter_messages()]


def check_times(log: Path, address: str) -> None:
    """Check the times of what this process recorded, by arrival, of all that the camera sent.

    Each frame's stamp lies between the moment of its sending and that of its receipt.
    """
    path = "/sent/" + address.rpartition("/")[2]
    sent_ns = json.loads(_ask(_port(), "GET", path))  # just before each was
    for before_ns, (stamp_ns, received_ns) in zip(sent_ns, times_in(log), strict=True):
        assert wall_ns(before_ns) <= stamp_ns <= received_ns


if __name__ == "__main__":
    main()
