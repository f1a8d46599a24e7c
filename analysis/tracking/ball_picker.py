"""Web page of this machine on which a user marks the ball before tuning goes on."""

from __future__ import annotations

import queue
import sys
import threading
import time
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from analysis.tracking.thumbnails import Album, album_of
from recorders.loopback_page import Answer, LoopbackPage, as_json, place_in
from tunenet_logs.episode import Episode
from tunenet_logs.terminal import Progress

# Where the ball is: x, y [px] as `Hints.ball_at` counts them, and seconds since the topic's first
# picture.
Mark = tuple[float, float, float]

# Between two looks at whether the page was closed: nobody notices that it is so late.
_POLL_SECONDS = 0.2

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

    Raises:
        UsageError: there is no picture that can be decoded.
        NotFoundError: the part begins past the last one.
        KeyboardInterrupt: the page was closed, or Ctrl-C.
    """
    marking = Marking(album_of(episode, topic, start_s, end_s, progress))
    try:
        print(f"mark the ball at {marking.url}", file=sys.stderr, flush=True)
        return marking.wait()
    finally:
        marking.close()


class Marking:
    """Page to mark the ball on, served on 127.0.0.1 alone, until `close`.

    Attributes:
        url: where it is.
    """

    def __init__(self, album: Album) -> None:
        self._album = album
        self._decided: queue.SimpleQueue[Mark | None] = queue.SimpleQueue()
        self._left_at: float | None = None
        self._lock = threading.Lock()
        self._page = LoopbackPage(self)
        self.url = self._page.url

    def wait(self) -> Mark | None:
        """Wait for the user; return the mark, or None to go on without one.

        Raises:
            KeyboardInterrupt: the page was closed.
        """
        while True:
            try:
                return self._decided.get(timeout=_POLL_SECONDS)
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
            page = files("analysis.tracking").joinpath("ball_picker.html").read_bytes()
            return Answer(200, "text/html; charset=utf-8", page)
        if path == "/album":
            return as_json(self._contents())
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

    def _contents(self) -> dict[str, Any]:
        album = self._album
        return {
            "topic": album.topic,
            "size_px": album.size_px,
            "seconds": [round(thumbnail.seconds, 6) for thumbnail in album.thumbnails],
        }

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
