"""Cache of the last film's reduced pictures: to decode a film costs more than most else.

They are kept as long as the film's episode is, and until another film is looked through.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from weakref import WeakKeyDictionary

from tunenet_logs.arrays import Picture
from tunenet_logs.episode import Episode, Frame
from tunenet_logs.pixels import mean_of_blocks

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
