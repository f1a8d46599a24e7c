"""Serve a live preview on this machine: aim, exposure, ball position, record."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np

from recorders.camera.preview_video import PreviewVideo
from recorders.loopback_page import Answer, LoopbackPage, as_json, place_in
from tunenet_logs.episode import Frame
from tunenet_logs.errors import LogError
from tunenet_logs.images import MAX_PIXELS, image_size
from tunenet_logs.measured_rate import MAX_SPEED_CAMERA_HZ, measured_hz
from tunenet_logs.messages import VIDEO_FORMATS

_RATE_FRAMES = 60  # frames over which the shown rate is measured: one or two seconds
# Grey level, of 255, from which a pixel counts as overexposed: JPEG blurs the 255 a little.
_BLOWN_OUT = 250

# Between two pictures of the page: an eye needs no more, and recording comes first.
_PAUSE_SECONDS = 0.03


# After its last question, for which somebody counts as looking: the page asks every second.
_LOOKS_S = 3.0


@dataclass(frozen=True)
class Click:
    """A user's click on the ball.

    Attributes:
        x_px, y_px: in the recorded picture, from its upper left corner.
        stamp_ns: of the newest frame then.
    """

    x_px: float
    y_px: float
    stamp_ns: int


class Preview:
    """The preview page and its state, served on 127.0.0.1 alone, until `close`.

    Attributes:
        record: set once "record" is pressed.
        stop: set once "stop" is pressed.
        click: the last one on the ball; None before that.
    """

    def __init__(self) -> None:
        self.record = threading.Event()
        self.stop = threading.Event()
        self.click: Click | None = None
        self._frame: Frame | None = None
        self._pictured = 0
        self._count = 0
        self._dropped = 0
        self._video: PreviewVideo | None = None
        self._looked_at = -_LOOKS_S
        self._stamps_ns: deque[int] = deque(maxlen=_RATE_FRAMES)
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
        if time.monotonic() - self._looked_at < _LOOKS_S:
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
            page = files("recorders.camera").joinpath("preview.html").read_bytes()
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
            time.sleep(_PAUSE_SECONDS)

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
                    "blown_out": round(float(np.mean(np.asarray(grey) >= _BLOWN_OUT)), 4),
                }
    return {}
