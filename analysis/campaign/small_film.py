"""Downsample a drop's images to 160 px and 30 Hz, and build a strobe image of them."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tunenet_logs.arrays import Picture
from tunenet_logs.episode import Frame
from tunenet_logs.errors import LogError, TuneNetError
from tunenet_logs.images import decode_small
from tunenet_logs.reader import read_episode

WIDTH_PX = 160  # of the longer side: what a view in a corner of a review shows
RATE_HZ = 30.0  # pictures a second, at most: they play smoothly
_MAX_PICTURES = 300  # ten seconds at that rate: a drop is over by then
_QUALITY = 75  # of JPEG, 0 to 100: small files, in which the ball is still clear
# Stamps jitter: a picture that comes so little before it is due must not be passed over.
_SLACK_S = 0.25 / RATE_HZ

_STROBES = 24  # pictures in a strobe picture: with more, a ball would overlap itself along its way


@dataclass(frozen=True)
class SmallFilm:
    """Downsampled images as JPEG.

    Attributes:
        start_ns: Origin of `seconds`.
        seconds: Stamp of each image [s], increasing.
        pictures: In their order.
        strobe: The ball at many of those times, in one image.
        size_px: (width, height) of each.
    """

    start_ns: int
    seconds: tuple[float, ...]
    pictures: tuple[bytes, ...]
    strobe: bytes
    size_px: tuple[int, int]


def small_film(
    log: Path, start_ns: int | None, window_s: tuple[float, float] | None
) -> SmallFilm | None:
    """Downsample the images of a log; None if it has none that can be read.

    Args:
        log: Of any kind.
        start_ns: Origin of time; None for the first image.
        window_s: First and last time since `start_ns`; None for all, up to the maximum count.
    """
    try:
        episode = read_episode(log)
    except TuneNetError:
        return None
    if not episode.picture_topics:
        return None
    first_s, last_s = window_s or (float("-inf"), float("inf"))
    pace = _Pace()
    seconds: list[float] = []
    small: list[Picture] = []
    with suppress(LogError):  # what was read before the damage is shown
        for frame in episode.frames(episode.picture_topics[0]):
            start_ns = frame.stamp_ns if start_ns is None else start_ns
            at_s = (frame.stamp_ns - start_ns) * 1e-9
            if not pace.is_due(at_s) or not first_s <= at_s <= last_s:
                continue
            with suppress(LogError):  # a damaged picture
                picture = _reduced(frame)
                if not small or picture.shape == small[0].shape:
                    pace.took(at_s)
                    seconds.append(at_s)
                    small.append(picture)
            if len(small) >= _MAX_PICTURES:
                break
    if not small or start_ns is None:
        return None
    height, width = small[0].shape[:2]
    pictures = tuple(_jpeg(one) for one in small)
    return SmallFilm(start_ns, tuple(seconds), pictures, _jpeg(strobe(small)), (width, height))


class _Pace:
    """Decimator that keeps images at most at `RATE_HZ`."""

    def __init__(self) -> None:
        self._due_s = float("-inf")
        self._before_s = float("-inf")

    def is_due(self, at_s: float) -> bool:
        """Return whether the image of a time is the nearest to the one that is due."""
        slack_s = min(_SLACK_S, (at_s - self._before_s) / 2)
        self._before_s = at_s
        return at_s >= self._due_s - slack_s

    def took(self, at_s: float) -> None:
        """Record that an image was kept."""
        self._due_s = max(self._due_s, at_s) + 1 / RATE_HZ


def _reduced(frame: Frame) -> Picture:
    """Downsample an image; shape (H, W, 3), BGR."""
    import cv2

    is_bare = frame.size is not None
    picture = frame.decode() if is_bare else decode_small(frame.data, frame.encoding, WIDTH_PX)
    height, width = picture.shape[:2]
    scale = min(1.0, WIDTH_PX / max(width, height))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.cvtColor(small, cv2.COLOR_RGB2BGR), np.uint8)


def strobe(pictures: list[Picture]) -> Picture:
    """Compose a strobe image of moving objects over the static background, shape (H, W, 3).

    Each pixel is taken from the image in which it is furthest from its median.
    """
    chosen = np.linspace(0, len(pictures) - 1, min(len(pictures), _STROBES)).round().astype(int)
    stack = np.stack([pictures[index] for index in np.unique(chosen)])
    usual = np.median(stack, axis=0).astype(np.int16)
    off = np.abs(stack.astype(np.int16) - usual).sum(axis=3)
    rows, columns = np.indices(usual.shape[:2])
    return stack[off.argmax(axis=0), rows, columns]


def _jpeg(picture: Picture) -> bytes:
    import cv2

    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
