"""An episode's pictures, as often as they are needed, never all in memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Set
from contextlib import suppress

import numpy as np

from analysis.selection import check_start
from tunenet_logs.arrays import Picture
from tunenet_logs.clock_jumps import filmed_part
from tunenet_logs.episode import Episode, Frame
from tunenet_logs.errors import LogError, NotFoundError, UsageError
from tunenet_logs.late_stamps import ARRIVALS, STAMPS_NOTE, correct_late_stamps

_MOST_SAMPLES = 64
"""Pictures for the background, in memory at once: enough that a ball, a hand or a person covers no
pixel in most of them."""

_MOST_PIXELS = 480_000
"""Above that, pictures are reduced: a ball is still found to a small part of a pixel."""

_ROUNDED_S = 0.1
"""By as much a time that somebody read off a player may lie outside the pictures."""


class Pictures:
    """The decoded pictures of an episode, reduced to a size at which tracking is quick.

    Attributes:
        stamps_ns: when the pictures were taken, shape (T,), strictly increasing.
        arrivals: the same, beside the recording's own stamps, which may have come late.
        start_ns: stamp of the topic's first picture, in the part selected or not.
        length_s: from there to the topic's last picture, in the part selected or not.
        size_px: (width, height) before reduction, as most of the pictures claim it.
        scale: by which they are reduced, a whole number.
        other_size: number of pictures of another size than most, left out.
        opened: number of pictures of the topic that can be read, in the part selected or not.
        jumps: where the clock jumps, in words; what lies beyond is left out. Empty if nowhere.
        damaged: number of pictures that could not be decoded and are left out.
        samples: 32 to 64 of the pictures, evenly over the recording (all of a short one), reduced.
        sampled: their numbers, increasing, shape (N,).

    Args:
        episode: with frames.
        topic: which of its picture topics.
        start_s: leave out what comes before, in seconds since the first frame.
        end_s: leave out what comes after.
        span_ns: stamps of the first picture and of the last one to look at; None for all.

    Raises:
        NotFoundError: there is none, or the part begins past the last one.
    """

    def __init__(
        self,
        episode: Episode,
        topic: str,
        start_s: float | None = None,
        end_s: float | None = None,
        span_ns: tuple[int, int] | None = None,
    ) -> None:
        self._episode = episode
        self._topic = topic
        self._start_s = start_s
        self._end_s = end_s
        self._span_ns = span_ns
        self._one_clock: Set[int] | None = None
        self._recorded_ns: list[int] = []
        reason: NotFoundError | None = None
        try:
            self._look_through()
        except NotFoundError as why:  # a jump may hide the part that is selected
            reason = why
        part = filmed_part(np.array(self._recorded_ns, np.int64))
        self.jumps = part.words
        if part.words:
            self._one_clock = frozenset(part.keep.tolist())
            self._look_through()
        elif reason is not None:
            raise reason

    def _look_through(self) -> None:
        """Decode every picture once, for the stamps, the size and some samples.

        Raises:
            NotFoundError: there is none, or the part begins past the last one.
        """
        self.start_ns = 0
        self.length_s = 0.0
        self.damaged = 0
        self.opened = 0
        self.other_size = 0
        self.samples: list[Picture] = []
        stamps: list[int] = []
        every, reason = 1, ""
        self._kept: set[int] = set()
        sizes: Counter[tuple[int, int]] = Counter()
        for _, frame in self._selected():
            with suppress(LogError):
                sizes[frame.size_px()] += 1
            if frame.size is not None and sizes.total() >= _MOST_SAMPLES:
                break  # they may be a video's, and each of them decoded for this
        self.size_px = sizes.most_common(1)[0][0] if sizes else (1, 1)
        self.scale = max(1, int(np.ceil(np.sqrt(np.prod(self.size_px) / _MOST_PIXELS))))
        for index, frame in self._selected():
            try:
                picture = frame.decode()
            except LogError as error:
                self.damaged += 1
                reason = str(error)
                continue
            height, width = picture.shape[:2]
            self.other_size += (width, height) != self.size_px
            if (width, height) == self.size_px and (not stamps or frame.stamp_ns > stamps[-1]):
                if len(stamps) % every == 0:
                    self.samples.append(self._reduced(picture))
                if len(self.samples) > _MOST_SAMPLES:  # how many there will be is not known yet
                    self.samples, every = self.samples[::2], 2 * every
                stamps.append(frame.stamp_ns)
                self._kept.add(index)
            del picture  # a large one would else be kept while the next is decoded
        self.sampled = every * np.arange(len(self.samples))
        if not stamps:
            why = f": {reason}" if reason else ""
            raise NotFoundError(f"holds no picture that can be decoded (in the part selected){why}")
        self.arrivals = correct_late_stamps(
            np.array(stamps, np.int64),
            are_arrivals=self._episode.info.notes.get(STAMPS_NOTE, "").startswith(ARRIVALS),
        )
        self.stamps_ns = self.arrivals.stamps_ns

    def __iter__(self) -> Iterator[Picture]:
        for index, frame in self._selected():
            if index in self._kept:
                yield self._reduced(frame.decode())

    def some(self, numbers: Collection[int]) -> list[Picture]:
        """Those of these numbers (of `stamps_ns`), in order; the others are not decoded."""
        wanted = set(numbers)
        found: list[Picture] = []
        number = -1
        for index, frame in self._selected():
            if index not in self._kept:
                continue
            number += 1
            if number in wanted:
                found.append(self._reduced(frame.decode()))
            if len(found) == len(wanted):
                break
        return found

    def allowed(self, roi: tuple[int, int, int, int] | None) -> Picture | None:
        """Where the ball may be: 1 inside the box, 0 outside; None for everywhere.

        Args:
            roi: left, top, width, height [px] of the box, before reduction.

        Returns:
            Shape (H, W) of the reduced pictures.

        Raises:
            UsageError: the box is not in the picture.
        """
        if roi is None:
            return None
        left, top, width, height = roi
        wide, tall = self.size_px
        inside = 0 <= left < left + width <= wide and 0 <= top < top + height <= tall
        if not inside:
            raise UsageError(f"--roi {roi} is not inside the picture of {wide} x {tall} px")
        mask = np.zeros((tall, wide), np.uint8)
        mask[top : top + height, left : left + width] = 1
        return self._reduced(mask)

    def scaled(self, ball_at: tuple[float, float, float]) -> tuple[float, float, float]:
        """Convert a position [px] and a time [s] to reduced pictures that begin at `stamps_ns[0]`.

        Args:
            ball_at: x, y in the picture as recorded, and seconds since the topic's first one.

        Raises:
            UsageError: the position is not in the picture, or the time not in the part selected.
        """
        x, y, at_s = ball_at
        wide, tall = self.size_px
        if not (0 <= x < wide and 0 <= y < tall):
            raise UsageError(f"--ball-at {x:g},{y:g} is not in the picture of {wide} x {tall} px")
        before_s, last_s = ((int(end) - self.start_ns) * 1e-9 for end in self.stamps_ns[[0, -1]])
        if not before_s - _ROUNDED_S <= at_s <= last_s + _ROUNDED_S:
            raise UsageError(
                f"--ball-at: {at_s:g} s is not in the pictures, {before_s:.2f} to {last_s:.2f} s "
                f"(the recording is {self.length_s:.2f} s long)"
            )
        return x / self.scale, y / self.scale, at_s - before_s

    def _selected(self) -> Iterator[tuple[int, Frame]]:
        """Frames of the part selected, each with its number in the topic."""
        self._recorded_ns = []
        start_ns: int | None = None
        for index, frame in enumerate(readable_frames(self._episode, self._topic)):
            self.opened = index + 1
            self._recorded_ns.append(frame.stamp_ns)
            if self._one_clock is not None and index not in self._one_clock:
                continue
            if start_ns is None:
                start_ns = self.start_ns = frame.stamp_ns
            since_s = (frame.stamp_ns - self.start_ns) * 1e-9
            self.length_s = max(self.length_s, since_s)
            if self._span_ns and not self._span_ns[0] <= frame.stamp_ns <= self._span_ns[1]:
                continue
            if self._start_s is not None and since_s < self._start_s:
                continue
            if self._end_s is not None and since_s > self._end_s:
                continue
            yield index, frame
        check_start(self._start_s, self.length_s)

    def _reduced(self, picture: Picture) -> Picture:
        """The mean of each `scale` by `scale` pixels; what is left over at two edges is cut."""
        if self.scale == 1:
            return picture
        import cv2

        height, width = picture.shape[:2]
        size = (width // self.scale, height // self.scale)
        cut = picture[: size[1] * self.scale, : size[0] * self.scale]
        return np.asarray(cv2.resize(cut, size, interpolation=cv2.INTER_AREA), np.uint8)


def readable_frames(episode: Episode, topic: str) -> Iterator[Frame]:
    """The frames of a topic, as far as its file is whole."""
    with suppress(LogError):
        yield from episode.frames(topic)
