"""Read folders of numbered images, as high-speed cameras leave them."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from itertools import islice
from pathlib import Path, PurePosixPath

from tunenet_logs.episode import Episode
from tunenet_logs.errors import CHECK_DISK, LogError
from tunenet_logs.formats.exports.pictures.picture_bytes import MAX_BYTES
from tunenet_logs.formats.exports.pictures.picture_film import (
    MIN_COUNT,
    PictureStore,
    Read,
    film_of,
)
from tunenet_logs.formats.exports.pictures.picture_series import MAX_PICTURES, SUFFIXES
from tunenet_logs.formats.read_options import ReadOptions

# Endings of files that make a folder a ROS 2 bag's.
_LOGS = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd")


def is_picture_folder(path: Path) -> bool:
    """Return whether a folder holds images, and no log.

    Raises:
        OSError: it cannot be read.
    """
    names = _files(path)
    return len(_pictures(names)) >= MIN_COUNT and not any(one.endswith(_LOGS) for one in names)


def read_picture_folder(path: Path, options: ReadOptions) -> Episode:
    """Read a folder's images as an episode; no link is followed.

    Raises:
        LogError: there is no image sequence in it.
        OSError: it cannot be read.
    """
    store = PictureStore(path, "a folder of pictures", partial(_opened, path))
    return film_of(store, _pictures(_files(path)), options)


def _files(path: Path) -> list[str]:
    """Return the names of the folder's regular files, hidden ones aside."""
    with os.scandir(path) as entries:
        some = islice(entries, 2 * MAX_PICTURES)
        return [
            entry.name
            for entry in some
            if entry.is_file(follow_symlinks=False) and not entry.name.startswith(".")
        ]


def _pictures(names: list[str]) -> list[str]:
    return [name for name in names if PurePosixPath(name).suffix.lower() in SUFFIXES]


@contextmanager
def _opened(folder: Path) -> Iterator[Read]:
    yield partial(_bytes_of, folder)


def _bytes_of(folder: Path, name: str) -> bytes:
    try:
        number = os.open(folder / name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        with open(number, "rb") as file:
            if not stat.S_ISREG(os.fstat(number).st_mode):
                raise LogError(f"{name} is no regular file", "copy it to one first")
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise LogError(f"{name} cannot be read ({error.strerror})", CHECK_DISK) from error
    if len(data) > MAX_BYTES:
        raise LogError(f"{name} is over the limit of {MAX_BYTES} bytes", "save smaller pictures")
    return data
