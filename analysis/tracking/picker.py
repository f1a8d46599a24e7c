"""Web page of this machine on which a user marks the ball in a recording.

Its thumbnails are few and small enough to page through on a screen.
"""

from __future__ import annotations

import queue
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from tunenet_logs.episode import Episode, Frame
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.messages import from_bgr, is_whole
from tunenet_logs.reader import check_start
from tunenet_logs.recorders.local_page import Answer, LoopbackPage, as_json, place_in
from tunenet_logs.terminal import Bar, Progress

# Of all pictures that are kept, as JPEGs: what a browser holds without effort.
MAX_BYTES = 64 * 1024 * 1024
MAX_REDUCED = 300  # pictures that are made smaller: each takes the time to decode and encode it
LONG_SIDE_PX = 960  # of a picture that is made smaller: it fits a screen, with a page around it


@dataclass(frozen=True)
class Thumbnail:
    """Picture as a JPEG."""

    seconds: float  # since the topic's first picture
    data: bytes  # the JPEG
    is_reduced: bool  # whether it was made smaller here; else it is as recorded


@dataclass(frozen=True)
class Album:
    """Pictures in the order of their time, evenly chosen where there are too many."""

    topic: str
    size_px: tuple[int, int]  # (width, height) as recorded, not of the thumbnails
    thumbnails: tuple[Thumbnail, ...]


def album_of(
    episode: Episode,
    topic: str,
    start_s: float | None = None,
    end_s: float | None = None,
    progress: Progress | None = None,
) -> Album:
    """Read a topic's pictures once, forward, in bounded memory.

    `start_s` and `end_s` [s since the first picture] select a part.
    """
    counts = (channel.messages for channel in episode.channels if channel.topic == topic)
    total = next(counts, None)
    with (progress or Progress(quiet=True)).bar(total, "pictures", "frame") as bar:
        thinning = _Thinning()
        for number, (seconds, frame) in enumerate(_selected(episode, topic, start_s, end_s, bar)):
            with suppress(LogError):  # a damaged picture
                thinning.add(number, seconds, frame)
    if thinning.size_px is None or not thinning.thumbnails:
        raise UsageError("holds no picture that can be decoded (in the part selected)")
    return Album(topic, thinning.size_px, tuple(thinning.thumbnails.values()))


def _selected(
    episode: Episode, topic: str, start_s: float | None, end_s: float | None, bar: Bar
) -> Iterator[tuple[float, Frame]]:
    """Yield (seconds since the first, frame), where time goes on."""
    first_ns: int | None = None
    last_ns, length_s = -1, 0.0
    for frame in episode.frames(topic):
        bar.update(1)
        first_ns = frame.stamp_ns if first_ns is None else first_ns
        seconds = (frame.stamp_ns - first_ns) * 1e-9
        length_s = max(length_s, seconds)
        if start_s is not None and seconds < start_s:
            continue
        if (end_s is not None and seconds > end_s) or frame.stamp_ns <= last_ns:
            continue
        last_ns = frame.stamp_ns
        yield seconds, frame
    check_start(start_s, length_s)


class _Thinning:
    """Keeper of every n-th picture; n doubles, and every second is dropped, when too many."""

    def __init__(self) -> None:
        self.size_px: tuple[int, int] | None = None  # of the first that can be decoded
        self.thumbnails: dict[int, Thumbnail] = {}  # by the number of the picture
        self._step, self._held_bytes, self._reduced = 1, 0, 0

    def add(self, number: int, seconds: float, frame: Frame) -> None:
        """Keep a picture if it is its turn."""
        if number % self._step:
            return
        if self.size_px is None:
            height, width = frame.decode().shape[:2]
            self.size_px = (width, height)
        elif frame.size_px() != self.size_px:
            return
        added = self.thumbnails[number] = _thumbnail(seconds, frame)
        self._held_bytes += len(added.data)
        self._reduced += added.is_reduced
        while len(self.thumbnails) > 1 and (
            self._held_bytes > MAX_BYTES or self._reduced > MAX_REDUCED
        ):
            self._step *= 2
            kept = {at: one for at, one in self.thumbnails.items() if at % self._step == 0}
            self.thumbnails = kept
            self._held_bytes = sum(len(one.data) for one in kept.values())
            self._reduced = sum(one.is_reduced for one in kept.values())


def _thumbnail(seconds: float, frame: Frame) -> Thumbnail:
    """Return the frame as recorded where that is a small JPEG, else made smaller."""
    # To make a JPEG of so few bytes smaller takes time and gains little.
    if frame.size is None and len(frame.data) <= 200_000 and is_whole(frame.data):
        return Thumbnail(seconds, frame.data, is_reduced=False)
    import cv2

    pixels = frame.decode()
    height, width = pixels.shape[:2]
    scale = min(1.0, LONG_SIDE_PX / max(width, height))
    small_px = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = cv2.resize(pixels, small_px, interpolation=cv2.INTER_AREA)
    data = from_bgr(cv2.cvtColor(small, cv2.COLOR_RGB2BGR))
    return Thumbnail(seconds, data, is_reduced=True)


# ---- Page that serves the thumbnails, until the ball is marked or the page closed

# Where the ball is: x, y [px] as `Hints.ball_at` counts them, and seconds since the topic's first
# picture.
Mark = tuple[float, float, float]
# A page that was left and is not back so soon is closed; one that is loaded again is back.
_AWAY_SECONDS = 3.0


def mark_ball(
    episode: Episode,
    topic: str,
    *,
    start_s: float | None = None,
    end_s: float | None = None,
    progress: Progress | None = None,
) -> Mark | None:
    """Serve a topic's pictures on a page, and wait for its user; return None without a mark.

    `start_s` and `end_s` [s since the first picture] select a part.
    """
    marking = Marking(album_of(episode, topic, start_s, end_s, progress))
    try:
        print(f"mark the ball at {marking.url}", file=sys.stderr, flush=True)
        return marking.wait()
    finally:
        marking.close()


class Marking:
    """Page to mark the ball on, served on 127.0.0.1 alone, until `close`."""

    def __init__(self, album: Album) -> None:
        self._album = album
        self._decided: queue.SimpleQueue[Mark | None] = queue.SimpleQueue()
        self._left_at: float | None = None
        self._lock = threading.Lock()
        self._page = LoopbackPage(self)
        self.url = self._page.url

    def wait(self) -> Mark | None:
        """Wait for the user; return the mark, or None to go on without one."""
        while True:
            try:
                return self._decided.get(timeout=0.2)
            except queue.Empty:
                if self._is_closed():
                    raise KeyboardInterrupt from None

    def close(self) -> None:
        """Take the page down."""
        self._page.close()

    def get(self, path: str) -> Answer | None:
        """Answer a request for the page, for what it shows, or for one of its pictures."""
        self._note_leaving(None)
        if path == "/":
            page = files("tunenet_logs.analysis.tracking").joinpath("ball_picker.html").read_bytes()
            return Answer(200, "text/html; charset=utf-8", page)
        if path == "/album":
            album = self._album
            seconds = [round(thumbnail.seconds, 6) for thumbnail in album.thumbnails]
            return as_json({"topic": album.topic, "size_px": album.size_px, "seconds": seconds})
        if path == "/here":
            return Answer()
        number = self._number(path.removeprefix("/picture/"))
        if path.startswith("/picture/") and number is not None:
            return Answer(200, "image/jpeg", self._album.thumbnails[number].data)
        return None

    def post(self, path: str, body: Mapping[str, Any]) -> Answer | None:
        """Answer a button, or the page's farewell."""
        if path == "/leave":
            self._note_leaving(time.monotonic())
            return Answer()
        if path == "/without":
            return Answer(then=lambda: self._decided.put(None))
        if path == "/tune" and (mark := self._mark(body)) is not None:
            return Answer(then=lambda: self._decided.put(mark))
        return None

    def _number(self, text: object) -> int | None:
        """Return which picture a text names; None for none."""
        if isinstance(text, str) and text.isascii() and text.isdecimal() and len(text) < 10:
            return int(text) if int(text) < len(self._album.thumbnails) else None
        return None

    def _mark(self, body: Mapping[str, Any]) -> Mark | None:
        """Return what was clicked on, if it is a position in one of the pictures."""
        place, number = place_in(body), self._number(str(body.get("picture")))
        width, height = self._album.size_px
        if place is None or number is None:
            return None
        if not (0 <= place[0] < width and 0 <= place[1] < height):
            return None
        return (*place, self._album.thumbnails[number].seconds)

    def _note_leaving(self, at: float | None) -> None:
        with self._lock:
            self._left_at = at

    def _is_closed(self) -> bool:
        with self._lock:
            return self._left_at is not None and time.monotonic() - self._left_at > _AWAY_SECONDS
