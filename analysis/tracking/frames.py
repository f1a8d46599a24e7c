"""Pictures of an episode, as often as they are needed, never all in memory."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterator, Set
from contextlib import contextmanager, suppress
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


class KeptFilm:
    """Pictures of one topic by their numbers in it: all that were looked at, or none.

    Args:
        topic: of the film.
        is_part: whether a part of it is looked at, beside which there are others.

    Attributes:
        pictures: RGB, reduced.
        is_whole: whether there were no more than could be kept.
    """

    def __init__(self, topic: str, *, is_part: bool) -> None:
        self.topic, self.is_part = topic, is_part
        self.pictures: dict[int, Picture] = {}
        self.is_whole = True
        self.is_bare = False
        self._stamps_ns: list[int] = []
        self._bytes = 0

    def keep(self, number: int, frame: Frame, picture: Picture) -> None:
        """Keep one more; drop all of them when there are too many."""
        self._bytes += picture.nbytes
        if self._bytes > _MAX_BYTES:
            self.is_whole = False
            self.pictures.clear()
        if self.is_whole:
            self.is_bare = frame.size is not None
            self.pictures[number] = picture
            self._stamps_ns.append(frame.stamp_ns)

    def frames(self) -> Iterator[Frame]:
        """Yield the pictures as frames of their reduced size."""
        for stamp_ns, picture in zip(self._stamps_ns, self.pictures.values(), strict=True):
            height, width = picture.shape[:2]
            pixels = partial(mean_of_blocks, picture)
            yield Frame(stamp_ns, "rgb8", b"", (width, height), pixels)


_last: WeakKeyDictionary[Episode, KeptFilm] = WeakKeyDictionary()


def begin_film(episode: Episode, topic: str, *, is_part: bool) -> KeptFilm:
    """Start the cache of a film that is about to be looked through; the one before is dropped."""
    _last.clear()
    film = _last[episode] = KeptFilm(topic, is_part=is_part)
    return film


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

    Attributes:
        stamps_ns: when the pictures were taken, shape (T,), strictly increasing.
        arrivals: the same, beside the recording's own stamps, which may have come late.
        start_ns: stamp of the topic's first picture, in the part selected or not.
        length_s: from there to the topic's last picture, in the part selected or not.
        size_px: (width, height) before reduction, as most of the pictures claim it.
        scale: by which they are reduced, a whole number.
        other_size: number of pictures of another size than most, left out.
        not_later: number of those that are stamped no later than the one before, left out.
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

        Most pictures are taken to have the first one's size; where they have another, once more.
        """
        sizes = self._look_for_pictures(None)
        usual = sizes.most_common(1)[0][0] if sizes else self.size_px
        if usual != self.size_px:
            self._look_for_pictures(usual)
        if not len(self.stamps_ns):
            raise NotFoundError(
                "holds no picture that can be decoded (in the part selected)" + self._why,
                "give --start and --end of a part with pictures, or record or copy it again",
            )
        self.arrivals = correct_late_stamps(
            self.stamps_ns,
            are_arrivals=self._episode.info.notes.get(STAMPS_NOTE, "").startswith(ARRIVALS),
        )
        self.stamps_ns = self.arrivals.stamps_ns

    def _look_for_pictures(self, usual: tuple[int, int] | None) -> Counter[tuple[int, int]]:
        """Look through the pictures of this size, of the first one's where it is None."""
        self.size_px, self.scale = usual or (1, 1), _scale_of(usual or (1, 1))
        self.start_ns = 0
        self.length_s = 0.0
        self.damaged = self.opened = self.other_size = self.not_later = 0
        self._film = begin_film(self._episode, self._topic, is_part=self._span_ns is not None)
        self._kept: list[int] = []
        self._why = ""
        stamps: list[int] = []
        samples = _EvenSamples()
        sizes: Counter[tuple[int, int]] = Counter()
        total = sum(one.messages for one in self._episode.channels if one.topic == self._topic)
        for index, frame in told(self._selected(), "decoding the pictures", total):
            try:
                size = frame.size_px()
                if usual is None:
                    usual = self.size_px = size
                    self.scale = _scale_of(size)
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
                samples.add(picture)
                self._film.keep(index, frame, picture)
                stamps.append(frame.stamp_ns)
                self._kept.append(index)
        self.samples, self.sampled = samples.pictures, samples.numbers
        self.stamps_ns = np.array(stamps, np.int64)
        return sizes

    def __iter__(self) -> Iterator[Picture]:
        return self._of(set(self._kept))

    def some(self, numbers: Collection[int]) -> list[Picture]:
        """Return the pictures of these numbers (of `stamps_ns`), in order, decoding no others."""
        return list(self._of({self._kept[number] for number in numbers}))

    def _of(self, wanted: Set[int]) -> Iterator[Picture]:
        """Yield pictures by their numbers in the topic, in order."""
        if self._film.is_whole:
            yield from (self._film.pictures[index] for index in self._kept if index in wanted)
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


class _EvenSamples:
    """At most `_MAX_SAMPLES` pictures of a film of unknown length, evenly over it."""

    def __init__(self) -> None:
        self.pictures: list[Picture] = []
        self._every, self._count = 1, 0

    @property
    def numbers(self) -> NDArray[np.intp]:
        """Numbers of the samples among the pictures."""
        return self._every * np.arange(len(self.pictures))

    def add(self, picture: Picture) -> None:
        """Add the next picture of the film."""
        if self._count % self._every == 0:
            self.pictures.append(picture)
        self._count += 1
        if len(self.pictures) > _MAX_SAMPLES:
            self.pictures, self._every = self.pictures[::2], 2 * self._every


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


def _scale_of(size_px: tuple[int, int]) -> int:
    """Return the factor by which pictures of a size are reduced."""
    # Above that, pictures are reduced: a ball is still found to a small part of a pixel
    return max(1, math.ceil(math.sqrt(math.prod(size_px) / 480_000)))


def readable_frames(episode: Episode, topic: str) -> Iterator[Frame]:
    """Yield the frames of a topic, as far as its file is whole."""
    with suppress(LogError):
        yield from episode.frames(topic)
