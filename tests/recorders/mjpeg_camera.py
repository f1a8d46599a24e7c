"""A network camera on the loopback: real sockets, in a process of its own, faults on demand.

`python -m tests.recorders.mjpeg_camera '{"frames": 100, "rate_hz": 60}'` prints its port, serves
until it is told to end, and puts down when it sent each frame.
"""

from __future__ import annotations

import base64
import json
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np

from tunenet_logs.reader import read_episode

ROOT = Path(__file__).resolve().parents[2]
_BLOCK = 16
_BITS = 16


@dataclass(frozen=True)
class Plan:
    """What the camera sends.

    Attributes:
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
        sent: file to which it writes the monotonic time [ns] of each frame it sent.
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
    sent: str = ""
    distinct: int = 1 << _BITS
    log: str = ""


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


class _Handler(BaseHTTPRequestHandler):
    plan: Plan
    pictures: list[bytes]

    def log_message(self, format: str, *_words: object) -> None:  # noqa: A002
        pass

    def do_GET(self) -> None:
        plan = self.plan
        if plan.user:
            wanted = "Basic " + base64.b64encode(plan.user.encode()).decode()
            if self.headers.get("Authorization") != wanted:
                self.send_response(401)
                self.send_header("WWW-Authenticate", 'Basic realm="camera"')
                self.end_headers()
                return
        if plan.status != 200 or plan.kind:
            self.send_response(plan.status)
            self.send_header("Content-Type", plan.kind or "text/html")
            self.end_headers()
            self.wfile.write(plan.body.encode())
            return
        self.send_response(200)
        announced = f"; boundary={plan.boundary}" if plan.boundary else ""
        self.send_header("Content-Type", "multipart/x-mixed-replace" + announced)
        self.end_headers()
        sent: list[int] = []
        with suppress(BrokenPipeError, ConnectionResetError):
            self._play(sent)
        if plan.sent:
            Path(plan.sent).write_text(json.dumps(sent))

    def _play(self, sent: list[int]) -> None:
        plan = self.plan
        rng = random.Random(0)
        start = time.monotonic() + plan.slow_start_s
        for number in range(plan.frames):
            due = start + number / plan.rate_hz + rng.uniform(-1, 1) * plan.jitter_s
            time.sleep(max(0.0, due - time.monotonic()))
            if plan.stall_after and number == plan.stall_after:
                time.sleep(600)
            if plan.close_after and number == plan.close_after:
                return
            self.wfile.write(self._part(number, sent))
        self.wfile.write(b"--frame--\r\n")

    def _part(self, number: int, sent: list[int]) -> bytes:
        plan = self.plan
        whole = self.pictures[number % len(self.pictures)]
        is_cut = plan.cut_every and number % plan.cut_every == plan.cut_every - 1
        data = whole[: len(whole) // 2] if is_cut else whole
        head = "--frame\r\nContent-Type: image/jpeg\r\n"
        if plan.with_length:
            head += f"Content-Length: {len(whole if plan.cut_lies else data)}\r\n"
        if not is_cut:
            sent.append(time.monotonic_ns())
        return head.encode() + b"\r\n" + data + b"\r\n"


class _Server(ThreadingHTTPServer):
    daemon_threads = True


def main() -> None:
    words = json.loads(sys.argv[1])
    plan = Plan(**{**words, "size": tuple(words["size"])})
    _Handler.plan = plan
    count = min(plan.frames, plan.distinct)
    if plan.log:
        _Handler.pictures = [frame.data for frame in read_episode(Path(plan.log)).frames()]
    else:
        _Handler.pictures = [picture(number, plan.size) for number in range(count)]
    server = _Server(("127.0.0.1", 0), _Handler)
    print(server.server_port, flush=True)
    server.serve_forever()


@contextmanager
def playing(**plan: object) -> Iterator[str]:
    """A camera that runs in a process of its own; its address, without "http://"."""
    words = json.dumps(asdict(Plan(**plan)))  # type: ignore[arg-type]
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.recorders.mjpeg_camera", words],
        cwd=ROOT, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert process.stdout is not None
        yield f"127.0.0.1:{int(process.stdout.readline())}/video"
    finally:
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


if __name__ == "__main__":
    main()
