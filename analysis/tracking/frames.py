"""Pictures of an episode, as often as they are needed, never all in memory."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Set
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Episode, Frame, Picture
from tunenet_logs.errors import LogError, NotFoundError, UsageError
from tunenet_logs.images import mean_of_blocks
from tunenet_logs.reader import check_start
from tunenet_logs.terminal import told
from tunenet_logs.timing.arrivals import ARRIVALS, STAMPS_NOTE, correct_late_stamps
from tunenet_logs.timing.stamps import filmed_part

# ---- Cache of the last film's reduced pictures: to decode a film costs more than most else
# They are kept as long as the film's episode is, and until another film is looked through.

# Of one film: 12 s of 640 x 480 at 60 Hz. A longer one is decoded whenever it is looked at.
_MAX_BYTES = 640 * 2**20


@dataclass(eq=False)
class KeptFilm:
    """Pictures of one topic by their numbers in it: all that were looked at, or none."""

    topic: str
    is_part: bool  # whether a part of it is looked at, beside which there are others
    pictures: dict[int, Frame] = field(default_factory=dict)  # of their reduced size
    is_whole: bool = True  # whether there were no more than could be kept
    is_bare: bool = False  # whether they were recorded as pixels
    bytes: int = 0

    def keep(self, index: int, frame: Frame, picture: Picture) -> None:
        """Keep a picture that was decoded from a frame, or none of them if they are too many."""
        self.is_bare = frame.size is not None
        self.bytes += picture.nbytes
        if self.bytes > _MAX_BYTES:
            self.is_whole = False
            self.pictures.clear()
        if self.is_whole:
            height, width = picture.shape[:2]
            pixels = partial(mean_of_blocks, picture)
            self.pictures[index] = Frame(frame.stamp_ns, "rgb8", b"", (width, height), pixels)


# The film that is looked through, by its episode; the one before is dropped.
_last: WeakKeyDictionary[Episode, KeptFilm] = WeakKeyDictionary()


def kept_film(episode: Episode, topic: str) -> KeptFilm | None:
    """Return the pictures of a film, if it was the last one looked through, and not too long."""
    film = _last.get(episode)
    return film if film is not None and film.topic == topic and film.is_whole else None


# ---- Pictures of a topic, reduced, and some of them as samples

# Pictures for the background, in memory at once: enough that a ball, a hand or a person covers no
# pixel in most of them.
_MAX_SAMPLES = 64
_ROUNDED_S = 0.1  # by as much a time that somebody read off a player may lie outside the pictures


class Pictures:
    """Decoded pictures of an episode, reduced to a size at which tracking is quick.

    `start_s` and `end_s` select a part [s since the first frame], `span_ns` one by the stamps of
    its first and its last picture.

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
        self._episode, self._topic = episode, topic
        self._start_s, self._end_s, self._span_ns = start_s, end_s, span_ns
        self._one_clock: Set[int] | None = None
        self._recorded_ns: list[int] = []
        reason: NotFoundError | None = None
        try:
            self._look_through()
        except NotFoundError as why:  # a jump may hide the part that is selected
            reason = why
        part = filmed_part(np.array(self._recorded_ns, np.int64))
        self.jumps = part.words  # where the clock jumps: what lies beyond is left out
        if part.words:
            self._one_clock = frozenset(part.keep.tolist())
            self._look_through()
        elif reason is not None:
            raise reason

    def _look_through(self) -> None:
        """Decode every picture once, for the stamps, the size and some samples."""
        sizes = self._look_for_pictures(None)
        usual = sizes.most_common(1)[0][0] if sizes else self.size_px
        if usual != self.size_px:  # not the first one's, as was assumed: once more
            self._look_for_pictures(usual)
        if not len(self.stamps_ns):
            raise NotFoundError(
                "holds no picture that can be decoded (in the part selected)" + self._why,
                "give --start and --end of a part with pictures, or record or copy it again",
            )
        # The stamps beside the recording's own ones, which may have come late.
        self.arrivals = correct_late_stamps(
            self.stamps_ns,
            are_arrivals=self._episode.info.notes.get(STAMPS_NOTE, "").startswith(ARRIVALS),
        )
        self.stamps_ns = self.arrivals.stamps_ns

    def _look_for_pictures(self, usual: tuple[int, int] | None) -> Counter[tuple[int, int]]:
        """Look through the pictures of this size, of the first one's where it is None."""
        # (width, height) before reduction, and the whole number by which pictures are reduced.
        self.size_px, self.scale = usual or (1, 1), 1
        # Stamp of the topic's first picture, and from there to its last, in the part or not.
        self.start_ns, self.length_s = 0, 0.0
        # Pictures that can be read, in the part or not; those left out as they cannot be decoded,
        # have another size than most, or are stamped no later than the one before.
        self.opened = self.damaged = self.other_size = self.not_later = 0
        _last.clear()
        film = self._film = _last[self._episode] = KeptFilm(self._topic, self._span_ns is not None)
        self._kept: list[int] = []
        self._why = ""
        stamps: list[int] = []
        # 32 to 64 pictures, reduced, evenly over a film of unknown length; all of a short one.
        self.samples: list[Picture] = []
        every = 1
        sizes: Counter[tuple[int, int]] = Counter()
        total = sum(one.messages for one in self._episode.channels if one.topic == self._topic)
        for index, frame in told(self._selected(), "decoding the pictures", total):
            try:
                size = frame.size_px()
                if usual is None:
                    usual = self.size_px = size
                # A ball is still found to a small part of a pixel.
                self.scale = max(1, math.ceil(math.sqrt(math.prod(self.size_px) / 480_000)))
                self.scale = frame.coarse * math.ceil(self.scale / frame.coarse)
                sizes[size] += 1
                picture = frame.decode(self.scale) if size == self.size_px else None
            except LogError as error:
                self.damaged += 1
                self._why = f": {error.what}"
                continue
            if picture is None:
                self.other_size += 1
            elif stamps and frame.stamp_ns <= stamps[-1]:
                self.not_later += 1
            else:
                if len(stamps) % every == 0:
                    self.samples.append(picture)
                if len(self.samples) > _MAX_SAMPLES:
                    self.samples, every = self.samples[::2], 2 * every
                film.keep(index, frame, picture)
                stamps.append(frame.stamp_ns)
                self._kept.append(index)
        self.sampled = every * np.arange(len(self.samples))
        self.stamps_ns = np.array(stamps, np.int64)  # shape (T,), strictly increasing
        return sizes

    def leave(self, numbers: NDArray[np.intp]) -> None:
        """Leave only the pictures of these numbers, increasing: the others come twice."""
        at = np.minimum(np.searchsorted(numbers, self.sampled), len(numbers) - 1)
        # A sample shows the last picture that is left, where it is left out itself.
        self.sampled = at - (numbers[at] > self.sampled)
        self._kept = [self._kept[number] for number in numbers]
        self.stamps_ns = self.stamps_ns[numbers]

    def __iter__(self) -> Iterator[Picture]:
        return self.some(range(len(self._kept)))

    def some(self, numbers: Iterable[int]) -> Iterator[Picture]:
        """Yield the pictures of these numbers (of `stamps_ns`), in order, decoding no others."""
        wanted = {self._kept[number] for number in numbers}
        if self._film.is_whole:
            pictures = self._film.pictures
            yield from (pictures[index].decode() for index in self._kept if index in wanted)
            return
        left = len(wanted)
        for index, frame in self._selected():
            if index in wanted:
                yield frame.decode(self.scale)
                left -= 1
            if not left:
                break

    def allowed(self, roi: tuple[int, int, int, int] | None) -> Picture | None:
        """Build a mask of where the ball may be: 1 in the box, 0 outside; None for everywhere."""
        if roi is None:
            return None
        left, top, width, height = roi
        wide, tall = self.size_px
        inside = 0 <= left < left + width <= wide and 0 <= top < top + height <= tall
        if not inside:
            raise UsageError(f"--roi {roi} is not inside the picture of {wide} x {tall} px")
        mask = np.zeros((tall, wide), np.uint8)
        mask[top : top + height, left : left + width] = 1
        return mean_of_blocks(mask, self.scale)

    def scaled(self, ball_at: tuple[float, float, float]) -> tuple[float, float, float]:
        """Convert x, y [px] and seconds since the first picture to reduced pictures of the part."""
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
        """Yield the frames of the part selected, each with its number in the topic."""
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


@contextmanager
def one_thread() -> Iterator[None]:
    """Run OpenCV in one thread: on pictures of this size more of them mostly wait, and spin."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def readable_frames(episode: Episode, topic: str) -> Iterator[Frame]:
    """Yield the frames of a topic, as far as its file is whole."""
    with suppress(LogError):
        yield from episode.frames(topic)
