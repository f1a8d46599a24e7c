"""What a camera sees, on a page of this machine's own: aim, exposure, where the ball is, record."""

from __future__ import annotations

import json
import math
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any

import numpy as np

from tunenet_logs.episode import Frame
from tunenet_logs.errors import LogError
from tunenet_logs.images import MAX_PIXELS, image_size

_RATE_FRAMES = 60
_BLOWN_OUT = 250
_PAUSE_SECONDS = 0.03
"""Between two pictures of the page: an eye needs no more, and recording comes first."""

_MAX_BODY_BYTES = 1024
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; img-src 'self'; connect-src 'self'; "
    "style-src 'unsafe-inline'; script-src 'unsafe-inline'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
}


@dataclass(frozen=True)
class Click:
    """Where someone says that the ball is.

    Attributes:
        x_px, y_px: in the picture as recorded, from its upper left corner.
        stamp_ns: of the newest frame then.
    """

    x_px: float
    y_px: float
    stamp_ns: int


class Preview:
    """The page and what it knows. It is served on 127.0.0.1 alone, until `close`.

    Attributes:
        url: where it is.
        record: set once someone pressed "record".
        stop: set once someone pressed "stop".
        click: the last one on the ball; None before that.
    """

    def __init__(self) -> None:
        self.record = threading.Event()
        self.stop = threading.Event()
        self.click: Click | None = None
        self._frame: Frame | None = None
        self._shown = 0
        self._dropped = 0
        self._stamps_ns: deque[int] = deque(maxlen=_RATE_FRAMES)
        self._changed = threading.Condition()
        self._is_closed = False
        handler = type("_BoundHandler", (_Handler,), {"preview": self})
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
        self._server.daemon_threads = True
        port = self._server.server_port
        self.url = f"http://127.0.0.1:{port}/"
        self.hosts = (f"127.0.0.1:{port}", f"localhost:{port}")
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def show(self, frame: Frame, dropped: int) -> None:
        """Let the page see the newest frame."""
        with self._changed:
            self._frame = frame
            self._shown += 1
            self._dropped = dropped
            self._stamps_ns.append(frame.stamp_ns)
            self._changed.notify_all()

    def close(self) -> None:
        """Take the page down."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
        self._server.shutdown()
        self._server.server_close()

    def pictures(self) -> Iterator[bytes]:
        """The newest frame, again and again; a slow viewer misses those between."""
        seen = 0
        while True:
            with self._changed:
                while self._shown == seen and not self._is_closed:
                    self._changed.wait()
                if self._is_closed or self._frame is None:
                    return
                seen, data = self._shown, self._frame.data
            yield data

    def state(self) -> dict[str, Any]:
        """What the page shows beside the picture."""
        with self._changed:
            frame, shown, dropped = self._frame, self._shown, self._dropped
            periods_ns = np.diff(np.array(self._stamps_ns, np.int64))
        state: dict[str, Any] = {
            "is_recording": self.record.is_set(),
            "frames": shown,
            "dropped": dropped,
            "rate_hz": round(1e9 / float(np.median(periods_ns)), 1) if len(periods_ns) else 0.0,
            "ball_at_px": [self.click.x_px, self.click.y_px] if self.click else None,
        }
        return state | (_light(frame.data) if frame else {})

    def point(self, x_px: float, y_px: float) -> bool:
        """Take a click on the ball; False where there is no picture to click on."""
        frame = self._frame
        if frame is None:
            return False
        with suppress(LogError):
            width, height = image_size(frame.data)
            if 0 <= x_px < width and 0 <= y_px < height:
                self.click = Click(x_px, y_px, frame.stamp_ns)
                return True
        return False


def _light(data: bytes) -> dict[str, Any]:
    """Size, mean brightness (0 to 1) and share of blown-out pixels of a JPEG."""
    with suppress(LogError):
        width, height = image_size(data)
        if 0 < width * height <= MAX_PIXELS:
            import cv2

            coarse = cv2.IMREAD_REDUCED_GRAYSCALE_4
            grey = cv2.imdecode(np.frombuffer(data, np.uint8), coarse)
            if grey is not None:
                return {
                    "size_px": [width, height],
                    "brightness": round(float(grey.mean()) / 255, 3),
                    "blown_out": round(float(np.mean(np.asarray(grey) >= _BLOWN_OUT)), 4),
                }
    return {}


class _Handler(BaseHTTPRequestHandler):
    preview: Preview
    timeout = 10  # a viewer that takes nothing for so long [s] is gone

    def log_message(self, format: str, *_words: object) -> None:  # noqa: A002
        """Standard error is for the recorder."""

    def do_GET(self) -> None:
        """The page, its picture, its figures."""
        if not self._is_ours():
            return
        if self.path == "/":
            page = files("recorders.camera").joinpath("preview.html").read_bytes()
            self._answer(200, "text/html; charset=utf-8", page)
        elif self.path == "/state":
            self._answer(200, "application/json", json.dumps(self.preview.state()).encode())
        elif self.path == "/live":
            self._play()
        else:
            self._answer(404, "text/plain", b"no such page\n")

    def do_POST(self) -> None:
        """A button, or a click on the ball."""
        if not self._is_ours():
            return
        if self.path in ("/record", "/stop"):
            self._answer(204)  # first: a recorder that stops takes this thread with it
            (self.preview.record if self.path == "/record" else self.preview.stop).set()
        elif self.path == "/ball" and (place := self._place()) and self.preview.point(*place):
            self._answer(204)
        else:
            self._answer(400, "text/plain", b"that is nothing that can be done here\n")

    def _is_ours(self) -> bool:
        """Refuse what another site's page asks for, be it under a host name of its own."""
        origins = [f"http://{host}" for host in self.preview.hosts]
        origin = self.headers.get("Origin")
        if self.headers.get("Host") in self.preview.hosts and origin in (None, *origins):
            return True
        self._answer(403, "text/plain", b"this page is for this machine alone\n")
        return False

    def _place(self) -> tuple[float, float] | None:
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdecimal() and int(length[:9]) <= _MAX_BODY_BYTES):
            return None
        with suppress(ValueError, KeyError, TypeError, RecursionError, OverflowError):
            body = json.loads(self.rfile.read(int(length)))
            x_px, y_px = float(body["x"]), float(body["y"])
            return (x_px, y_px) if math.isfinite(x_px) and math.isfinite(y_px) else None
        return None

    def _answer(self, code: int, kind: str = "", body: bytes = b"") -> None:
        self.send_response(code)
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        if kind:
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def _play(self) -> None:
        self.send_response(200)
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        with suppress(OSError):  # the viewer went away
            for data in self.preview.pictures():
                head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
                self.wfile.write(head.encode() + data + b"\r\n")
                time.sleep(_PAUSE_SECONDS)
