"""Serve a web page that this machine alone can open: the live preview of a camera.

The page shows the picture and its exposure to aim by, takes clicks on the ball, and starts and
stops the recording. A video is decoded for it a few times per second; the log keeps it undecoded.
"""

from __future__ import annotations

import json
import math
import os
import secrets
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from hmac import compare_digest
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any, Protocol

import numpy as np

from tunenet_logs.episode import Frame
from tunenet_logs.errors import LogError
from tunenet_logs.images import MAX_PIXELS, image_size
from tunenet_logs.messages import VIDEO_FORMATS, compressed
from tunenet_logs.recorders.camera.network import Deadline, with_deadline
from tunenet_logs.timing.stamps import MAX_SPEED_CAMERA_HZ, measured_hz
from tunenet_logs.video import Packet, decoded

# ---- Preview video: a few pictures per second, in a thread of its own


class PreviewVideo(threading.Thread):
    """A thread that decodes video and shows some of its frames as JPEGs."""

    def __init__(self, show: Callable[[Frame], None]) -> None:
        super().__init__(name="preview", daemon=True)
        self._show = show
        self._waiting: deque[Frame] = deque()
        self._bytes = 0
        self._skipped = False
        self._closed = False
        self._changed = threading.Condition()

    def offer(self, frame: Frame) -> None:
        """Queue the video's next picture, without blocking."""
        with self._changed:
            # What waits is skipped up to the next key frame.
            if self._bytes > 8 * 1024 * 1024:
                self._forget()
            self._waiting.append(frame)
            self._bytes += len(frame.data)
            self._changed.notify_all()

    def skip(self) -> None:
        """Mark a discontinuity: the next picture does not follow the last."""
        with self._changed:
            self._forget()

    def close(self) -> None:
        """End the thread."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def run(self) -> None:
        """Decode queued pictures until closed."""
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 10)  # recording comes first
        due = 0.0
        while not self._closed:
            try:
                for picture in decoded(self._in_a_row()):
                    if time.monotonic() >= due:
                        self._show(compressed(picture))
                        due = time.monotonic() + 0.2  # [s] between two: enough to aim by
            except LogError:  # nothing here decodes it; the log holds it all the same
                return

    def _forget(self) -> None:
        self._waiting.clear()
        self._bytes = 0
        self._skipped = True

    def _in_a_row(self) -> Iterator[Packet]:
        """Yield queued pictures up to the next discontinuity."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._skipped or self._closed)
                if self._skipped or self._closed:
                    self._skipped = False
                    return
                frame = self._waiting.popleft()
                self._bytes -= len(frame.data)
            yield Packet(frame.stamp_ns, frame.encoding, frame.data)


# ---- Loopback page: a server of any site on 127.0.0.1, its address a secret

_MAX_REQUEST_S = 10.0  # for all of a request, and for a viewer to take what it is sent
# Headers of every answer: nothing is kept, and no other page can show, load or feed this one.
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; img-src 'self'; connect-src 'self'; "
    "style-src 'unsafe-inline'; script-src 'unsafe-inline'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
}


@dataclass(frozen=True)
class Answer:
    """A response to a request."""

    code: int = 204  # HTTP status
    kind: str = ""  # content type; "" for an answer without a body
    body: bytes | Iterator[bytes] = b""  # whole, or part after part for as long as the viewer stays
    then: Callable[[], object] | None = None  # called once it is sent: an end takes the page along


_NO_PAGE = Answer(404, "text/plain", b"no such page\n")


class Site(Protocol):
    """What a page shows and accepts; called from several threads at once."""

    def get(self, path: str) -> Answer | None:
        """Answer a GET; None where there is no such page."""
        ...

    def post(self, path: str, body: Mapping[str, Any]) -> Answer | None:
        """Answer a POST with a JSON object; None for an invalid request."""
        ...


class LoopbackPage:
    """A server of a site on 127.0.0.1 alone, at a free port, until `close`."""

    def __init__(self, site: Site) -> None:
        secret = secrets.token_urlsafe(16)  # other users of this machine can connect, not guess it
        handler = type("_BoundHandler", (_Handler,), {"site": site, "secret": secret})
        self._server = _Server(("127.0.0.1", 0), handler)
        port = self._server.server_port
        self.url = f"http://127.0.0.1:{port}/{secret}/"  # others on this machine cannot guess it
        handler.hosts = (f"127.0.0.1:{port}", f"localhost:{port}")
        serve = self._server.serve_forever
        threading.Thread(target=serve, args=(0.1,), daemon=True).start()  # [s] closing waits for

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()


def as_json(value: object) -> Answer:
    """Answer with JSON."""
    return Answer(200, "application/json", json.dumps(value).encode())


def place_in(body: Mapping[str, Any]) -> tuple[float, float] | None:
    """Return the finite numbers "x" and "y" of a body; None where one is missing."""
    with suppress(ValueError, KeyError, TypeError, OverflowError):
        x, y = float(body["x"]), float(body["y"])
        return (x, y) if math.isfinite(x) and math.isfinite(y) else None
    return None


class _Server(ThreadingHTTPServer):
    daemon_threads = True  # a viewer does not hold up the end of the command

    def __init__(self, place: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        super().__init__(place, handler)
        self._free = threading.BoundedSemaphore(32)  # a page needs three; more are turned away

    def get_request(self) -> tuple[socket.socket, Any]:
        """Accept a connection, with a deadline for the whole request."""
        caller, place = super().get_request()
        kind = with_deadline(socket.socket, Deadline(_MAX_REQUEST_S, _MAX_REQUEST_S))
        return kind(fileno=caller.detach()), place

    def process_request(self, request: Any, client_address: Any) -> None:
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, then free the thread's place."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print nothing: standard error is the command's, and a broken connection no error."""


class _Handler(BaseHTTPRequestHandler):
    site: Site
    secret: str
    hosts: tuple[str, ...]

    def log_message(self, format: str, *_words: object) -> None:  # noqa: A002
        """Print nothing: standard error is the command's."""

    def do_GET(self) -> None:
        if (path := self._path()) is not None:
            self._send(self.site.get(path) or _NO_PAGE)

    def do_POST(self) -> None:
        if (path := self._path()) is not None:
            nothing = Answer(400, "text/plain", b"that is nothing that can be done here\n")
            body = self._body()
            self._send((None if body is None else self.site.post(path, body)) or nothing)

    def _path(self) -> str | None:
        """Return the path after the secret; None where refused, as another site's requests are."""
        origins = [f"http://{host}" for host in self.hosts]
        origin = self.headers.get("Origin")
        if self.headers.get("Host") in self.hosts and origin in (None, *origins):
            _, secret, rest = (*self.path.split("/", 2), "", "")[:3]
            if compare_digest(secret.encode(errors="replace"), self.secret.encode()):
                return f"/{rest}"
            self._send(_NO_PAGE)
            return None
        self._send(Answer(403, "text/plain", b"this page is for this machine alone\n"))
        return None

    def _body(self) -> dict[str, Any] | None:
        """Parse the JSON object sent, {} for nothing; None if it is anything else or too large."""
        length = self.headers.get("Content-Length", "0")
        if not (length.isascii() and length.isdecimal()):
            return None
        if int(length[:9]) > 1024 or len(length) > 9:  # the page sends a few numbers
            with suppress(OSError):
                # With less read, the sender might not hear the answer.
                self.rfile.read(min(int(length[:9]), 64 * 1024))
            return None
        with suppress(OSError, ValueError, RecursionError):
            data = self.rfile.read(int(length))
            body = json.loads(data) if data else {}
            return body if isinstance(body, dict) else None
        return None

    def _send(self, answer: Answer) -> None:
        with suppress(OSError):  # the viewer went away
            self.send_response(answer.code)
            for name, value in _HEADERS.items():
                self.send_header(name, value)
            if answer.kind:
                self.send_header("Content-Type", answer.kind)
            if isinstance(answer.body, bytes) and answer.kind:
                self.send_header("Content-Length", str(len(answer.body)))
            self.end_headers()
            for part in (answer.body,) if isinstance(answer.body, bytes) else answer.body:
                self.wfile.write(part)
        if answer.then is not None:
            answer.then()


# ---- Preview: aim, exposure, ball position, record

_WATCHED_S = 3.0  # somebody still watches so long after a request: the page asks every second


@dataclass(frozen=True)
class Click:
    """A user's click on the ball."""

    x_px: float  # in the recorded picture, from its upper left corner
    y_px: float
    stamp_ns: int  # of the newest frame then


class Preview:
    """The preview page and its state, served on 127.0.0.1 alone, until `close`."""

    def __init__(self) -> None:
        self.record = threading.Event()  # set once "record" is pressed
        self.stop = threading.Event()  # set once "stop" is pressed
        self.click: Click | None = None  # the last one on the ball; None before that
        self._frame: Frame | None = None
        self._pictured = 0
        self._count = 0
        self._dropped = 0
        self._video: PreviewVideo | None = None
        self._looked_at = -_WATCHED_S
        self._stamps_ns: deque[int] = deque(maxlen=60)  # to measure the rate that is shown
        self._changed = threading.Condition()
        self._is_closed = False
        self._page = LoopbackPage(self)
        self.url = self._page.url

    def show(self, frame: Frame, dropped: int) -> None:
        """Show the newest frame; a video is decoded only while somebody watches."""
        with self._changed:
            self._count += 1
            self._dropped = dropped
            self._stamps_ns.append(frame.stamp_ns)
        if frame.encoding not in VIDEO_FORMATS:
            self._picture(frame)
            return
        if self._video is None:
            self._video = PreviewVideo(self._picture)
            self._video.start()
        if time.monotonic() - self._looked_at < _WATCHED_S:
            self._video.offer(frame)
        else:
            self._video.skip()

    def _picture(self, frame: Frame) -> None:
        with self._changed:
            self._frame = frame
            self._pictured += 1
            self._changed.notify_all()

    def close(self) -> None:
        """Stop serving the page."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
        if self._video is not None:
            self._video.close()
        self._page.close()

    def get(self, path: str) -> Answer | None:
        """Answer a GET request: the page, its picture, its state."""
        if path == "/":
            page = files("tunenet_logs.recorders.camera").joinpath("preview.html").read_bytes()
            return Answer(200, "text/html; charset=utf-8", page)
        if path == "/state":
            return as_json(self.state())
        if path == "/live":
            return Answer(200, "multipart/x-mixed-replace; boundary=frame", self._parts())
        return None

    def post(self, path: str, body: Mapping[str, Any]) -> Answer | None:
        """Answer a POST request: a button, or a click on the ball."""
        if path in ("/record", "/stop"):
            return Answer(then=(self.record if path == "/record" else self.stop).set)
        if path == "/ball" and (place := place_in(body)) and self.point(*place):
            return Answer()
        return None

    def pictures(self) -> Iterator[bytes]:
        """Yield the newest frame, again and again; a slow viewer misses some."""
        seen = 0
        while True:
            with self._changed:
                self._looked_at = time.monotonic()
                while self._pictured == seen and not self._is_closed:
                    self._changed.wait()
                if self._is_closed or self._frame is None:
                    return
                seen, data = self._pictured, self._frame.data
            yield data

    def _parts(self) -> Iterator[bytes]:
        for data in self.pictures():
            head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
            yield head.encode() + data + b"\r\n"
            time.sleep(0.03)  # [s]; an eye needs no more, and recording comes first

    def state(self) -> dict[str, Any]:
        """Return what the page shows beside the picture."""
        with self._changed:
            self._looked_at = time.monotonic()
            frame, shown, dropped = self._frame, self._count, self._dropped
            rate_hz = measured_hz(self._stamps_ns, MAX_SPEED_CAMERA_HZ)
        state: dict[str, Any] = {
            "is_recording": self.record.is_set(),
            "frames": shown,
            "dropped": dropped,
            "rate_hz": round(rate_hz, 1),
            "ball_at_px": [self.click.x_px, self.click.y_px] if self.click else None,
        }
        return state | (_light(frame.data) if frame else {})

    def point(self, x_px: float, y_px: float) -> bool:
        """Take a click on the ball; False where it is not on a picture."""
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
    """Measure a JPEG's size, mean brightness (0 to 1) and fraction of overexposed pixels."""
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
                    # An overexposed pixel has 255, which JPEG blurs a little.
                    "blown_out": round(float(np.mean(np.asarray(grey) >= 250)), 4),
                }
    return {}
