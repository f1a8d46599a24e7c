"""Thumbnails of a recording, few and small enough to page through on a screen."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

from analysis.selection import check_start
from tunenet_logs.episode import Episode, Frame
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.jpeg import from_bgr, is_whole
from tunenet_logs.terminal import Bar, Progress

# Of all pictures that are kept, as JPEGs: what a browser holds without effort.
MAX_BYTES = 64 * 1024 * 1024

MAX_REDUCED = 300  # pictures that are made smaller: each takes the time to decode and encode it
LONG_SIDE_PX = 960  # of a picture that is made smaller: it fits a screen, with a page around it
# A JPEG of no more is kept as it was recorded: to make it smaller takes time and gains little.
_SMALL_BYTES = 200_000


@dataclass(frozen=True)
class Thumbnail:
    """Picture as a JPEG.

    Attributes:
        seconds: since the topic's first picture.
        data: the JPEG.
        is_reduced: whether it was made smaller here; else it is as recorded.
    """

    seconds: float
    data: bytes
    is_reduced: bool


@dataclass(frozen=True)
class Album:
    """Pictures in the order of their time, evenly chosen where there are too many.

    Attributes:
        size_px: (width, height) as recorded, not of the thumbnails.
    """

    topic: str
    size_px: tuple[int, int]
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

    Raises:
        UsageError: there is no picture that can be decoded.
        NotFoundError: the part begins past the last one.
        LogError: the log is damaged.
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
    """Keeper of every n-th picture; n doubles, and every second is dropped, when too many.

    Attributes:
        size_px: of the first picture that can be decoded; None before it.
        thumbnails: by the number of the picture.
    """

    def __init__(self) -> None:
        self.size_px: tuple[int, int] | None = None
        self.thumbnails: dict[int, Thumbnail] = {}
        self._step = 1
        self._held_bytes = 0
        self._reduced = 0

    def add(self, number: int, seconds: float, frame: Frame) -> None:
        """Keep a picture if it is its turn.

        Raises:
            LogError: it is damaged.
        """
        if number % self._step:
            return
        if self.size_px is None:
            height, width = frame.decode().shape[:2]
            self.size_px = (width, height)
        elif frame.size_px() != self.size_px:
            return
        self._put(number, _thumbnail(seconds, frame))
        while len(self.thumbnails) > 1 and (
            self._held_bytes > MAX_BYTES or self._reduced > MAX_REDUCED
        ):
            self._step *= 2
            thumbnails, self.thumbnails = self.thumbnails, {}
            self._held_bytes = self._reduced = 0
            for at, thumbnail in thumbnails.items():
                if at % self._step == 0:
                    self._put(at, thumbnail)

    def _put(self, number: int, thumbnail: Thumbnail) -> None:
        self.thumbnails[number] = thumbnail
        self._held_bytes += len(thumbnail.data)
        self._reduced += thumbnail.is_reduced


def _thumbnail(seconds: float, frame: Frame) -> Thumbnail:
    """Return the frame as recorded where that is a small JPEG, else made smaller."""
    if frame.size is None and len(frame.data) <= _SMALL_BYTES and is_whole(frame.data):
        return Thumbnail(seconds, frame.data, is_reduced=False)
    import cv2

    pixels = frame.decode()
    height, width = pixels.shape[:2]
    scale = min(1.0, LONG_SIDE_PX / max(width, height))
    small_px = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = cv2.resize(pixels, small_px, interpolation=cv2.INTER_AREA)
    data = from_bgr(cv2.cvtColor(small, cv2.COLOR_RGB2BGR))
    return Thumbnail(seconds, data, is_reduced=True)
