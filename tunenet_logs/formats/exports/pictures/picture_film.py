"""Build an episode of one-image files, from a folder or an archive."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Frame
from tunenet_logs.errors import COPY_AGAIN, LogError
from tunenet_logs.formats.exports.pictures.picture_bytes import depth_of, frame_of
from tunenet_logs.formats.exports.pictures.picture_series import (
    MAX_PICTURES,
    PictureTimes,
    Series,
    series_of,
    taken,
)
from tunenet_logs.formats.read_options import ReadOptions

MIN_COUNT = 3  # pictures of a film
_MAX_FILMS = 16  # of one place; it is no film's where there are more
# Of a film's pictures together, and for each of their bytes: a camera's have 20.
_FREE_PIXELS, _PIXELS_A_BYTE = 150_000_000, 50

_SAMPLES = 5  # pictures by which their depth is told
# The bytes of a file of that name, bounded; LogError where it cannot be read.
Read = Callable[[str], bytes]


@dataclass(frozen=True, eq=False)
class PictureStore:
    """Source of image files.

    Attributes:
        path: of the folder or archive.
        what: kind of source, in words.
        opened: opens it; it is closed when the images have been read.
        most_pixels: of all images of one sequence together; None where each is paid for by its
            bytes, but for `_FREE_PIXELS`.
        others: files that are no image, by name: why they are not used.
    """

    path: Path
    what: str
    opened: Callable[[], AbstractContextManager[Read]]
    most_pixels: int | None = None
    others: Mapping[str, str] = field(default_factory=dict)


def film_of(store: PictureStore, names: Sequence[str], options: ReadOptions) -> Episode:
    """Group named images into sequences, each a topic of one episode.

    Args:
        store: where they are.
        names: of the image files.
        options: the user's.

    Raises:
        LogError: there are too many images, or too few.
    """
    if len(names) > MAX_PICTURES:
        raise LogError(
            f"{store.path}: holds {len(names)} pictures, over the limit of {MAX_PICTURES}; leave "
            "there only those of one drop"
        )
    found = series_of(names)
    films = [one for one in found if len(one.files) >= MIN_COUNT][:_MAX_FILMS]
    if not films:
        raise LogError(
            f"{store.path}: is {store.what} without a film: no {MIN_COUNT} pictures in it whose "
            "names differ in a number alone; number them, or name a video of the drop"
        )
    times = {one.name: taken(one, options) for one in films}
    with store.opened() as read:
        depths = {one.name: depth_of(_samples(one, read)) for one in films}
    channels = [
        Channel(
            topic=one.name,
            type_name=f"{store.what}, {one.files[0]} to {one.files[-1]}"[:200],
            encoding="pictures",
            log_ns=times[one.name].stamps_ns,
            pictures=True,
        )
        for one in films
    ]
    unused = {one.name: "too few pictures for a film" for one in found[len(films) :]}
    none = np.empty(0, np.int64)
    for name, why in list({**unused, **store.others}.items())[:_MAX_FILMS]:
        channels.append(Channel(name[:200], "", "file", none, skipped=why))
    rates = ", ".join(dict.fromkeys(one.rate for one in times.values()))
    info = EpisodeInfo(source=f"{store.what} {store.path.name}", notes={"rate_hz": rates})
    by_name = {one.name: one for one in films}
    return Episode(
        info,
        {},
        tuple(channels),
        tuple(said for one in times.values() for said in one.warnings),
        open_frames=partial(_frames, store, by_name, times, depths),
        frames_untimed=not all(one.is_timed for one in times.values()),
    )


def _samples(series: Series, read: Read) -> Iterator[bytes]:
    """Yield the bytes of a few readable images, evenly spaced."""
    for at in np.linspace(0, len(series.files) - 1, _SAMPLES).round().astype(int).tolist():
        try:
            yield read(series.files[at])
        except LogError:
            continue


def _frames(
    store: PictureStore,
    films: Mapping[str, Series],
    times: Mapping[str, PictureTimes],
    depths: Mapping[str, int],
    topic: str,
) -> Iterator[Frame]:
    """Yield the frames of a sequence; an unreadable one comes as damaged, to be counted."""
    pixels = paid = 0
    with store.opened() as read:
        stamps = times[topic].stamps_ns.tolist()
        for stamp_ns, name in zip(stamps, films[topic].files, strict=True):
            try:
                data = read(name)
                frame = frame_of(stamp_ns, data, depths[topic])
                work = frame.work_px()
                pixels += work
                paid += min(_PIXELS_A_BYTE * len(data), work)
            except LogError:
                frame = Frame(stamp_ns, "damaged", b"")
            most = _FREE_PIXELS + paid if store.most_pixels is None else store.most_pixels
            if pixels > most:
                raise LogError(
                    f"{store.path}: its pictures claim far more pixels than their size holds",
                    COPY_AGAIN,
                )
            yield frame
