"""Read an image sequence in one file that is no video: a zip of images, or an animated WebP."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from lzma import LZMAError
from pathlib import Path, PurePosixPath

from tunenet_logs.episode import Episode
from tunenet_logs.errors import CHECK_DISK, COPY_AGAIN, LogError
from tunenet_logs.formats.exports.pictures.animated_webp import is_animated_webp, read_animated_webp
from tunenet_logs.formats.exports.pictures.picture_bytes import MAX_BYTES
from tunenet_logs.formats.exports.pictures.picture_film import (
    MIN_COUNT,
    PictureStore,
    Read,
    film_of,
)
from tunenet_logs.formats.exports.pictures.picture_series import SUFFIXES
from tunenet_logs.formats.exports.start import Start
from tunenet_logs.formats.foreign_kinds import UNPACK, foreign_kind
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.regular_file import open_regular

_STARTS = (b"PK\x03\x04", b"PK\x05\x06")  # of a zip with files, and of one without
_MAX_DIRECTORY_BYTES = 8_000_000  # of a zip: its list of files, with 100 bytes for each of 80,000
_END, _END_BYTES, _END64 = b"PK\x05\x06", 22, b"PK\x06\x06"
_MAX_COMMENT = 65_535

# Unpacked, of a whole zip: bytes whatever its size is, and for each of its bytes.
_FREE_BYTES, _MAX_RATIO = 256_000_000, 100

# Of all its pictures, whatever its size is, and for each of its bytes: a camera's have 20.
_FREE_PIXELS, _MAX_PIXELS_A_BYTE = 100_000_000, 50

_KIND_BYTES = 65_536  # in which the names stand that tell what else a zip is
_ENCRYPTED = 0x1  # the bit of a zip's flags
# What `zipfile` raises of damaged and forged files.
_UNREADABLE = (
    zipfile.BadZipFile,
    zlib.error,
    LZMAError,
    NotImplementedError,
    RuntimeError,
    ValueError,
    KeyError,
    OverflowError,
    EOFError,
)


def is_picture_archive(start: Start) -> bool:
    """Return whether a file is a zip that no other reader knows, or an animated WebP."""
    return start.data.startswith(_STARTS) or is_animated_webp(start)


def read_picture_archive(path: Path, options: ReadOptions) -> Episode:
    """Read the images of an archive as an episode. Nothing is unpacked to disk.

    Raises:
        LogError: no image sequence in it, damage, or a decompressed size over the limit.
        OSError: it cannot be read.
    """
    with open_regular(path) as file:
        if not file.read(4).startswith(_STARTS):
            return read_animated_webp(path, options)
    size = path.stat().st_size
    names = _pictures(path, size)
    store = PictureStore(
        path,
        "a zip of pictures",
        partial(_opened, path),
        most_pixels=_FREE_PIXELS + _MAX_PIXELS_A_BYTE * size,
    )
    return film_of(store, names, options)


def _pictures(path: Path, size: int) -> list[str]:
    """Return the names of the images in a zip; raises as `read_picture_archive` does."""
    _check_directory(path, size)
    try:
        with open_regular(path) as file, zipfile.ZipFile(file) as archive:
            named = [one for one in archive.infolist() if one.filename]
            entries = [one for one in named if not one.is_dir()]
    except _UNREADABLE as error:
        raise LogError(f"{path}: is a damaged zip ({error}); copy it again") from error
    found = [one for one in entries if _is_picture(one.filename)]
    if len(found) < MIN_COUNT:
        with open_regular(path) as file:
            what, remedy = foreign_kind(file.read(_KIND_BYTES), path) or ("", "")
        if remedy != UNPACK:
            raise LogError(f"{path}: is {what}, which is not read as it is", remedy)
        shown = ", ".join(one.filename[:60] for one in entries[:2]) or "nothing"
        raise LogError(
            f"{path}: is a zip without pictures (it holds {shown}); unpack it, and name the log or "
            "video of the drop"
        )
    if any(one.flag_bits & _ENCRYPTED for one in found):
        raise LogError(f"{path}: is a zip with a password; unpack it, and name the folder")
    total = sum(one.file_size for one in found)
    if total > _FREE_BYTES + _MAX_RATIO * size:
        raise LogError(
            f"{path}: is a zip of {size} bytes that unpacks to {total}, over {_MAX_RATIO} times "
            "that; if its pictures are whole, unpack it, and name the folder"
        )
    return list(dict.fromkeys(one.filename for one in found))


def _is_picture(name: str) -> bool:
    """Return whether a name is an image's, and not one that macOS adds."""
    parts = PurePosixPath(name)
    hidden = parts.name.startswith(".") or "__MACOSX" in parts.parts
    return parts.suffix.lower() in SUFFIXES and not hidden


def _check_directory(path: Path, size: int) -> None:
    """Refuse, with a LogError, a zip whose directory is missing or would fill the memory."""
    with open_regular(path) as file:
        file.seek(max(0, size - _MAX_COMMENT - 200))
        tail = file.read(_MAX_COMMENT + 200)
    at, at64 = tail.rfind(_END), tail.rfind(_END64)
    if at < 0 or at + _END_BYTES > len(tail):
        raise LogError(f"{path}: is a zip without an end; copy it again")
    stated = int.from_bytes(tail[at + 12 : at + 16], "little")
    if at64 >= 0:
        stated = max(int.from_bytes(tail[at64 + 40 : at64 + 48], "little"), stated % 0xFFFFFFFF)
    if stated > _MAX_DIRECTORY_BYTES:
        raise LogError(
            f"{path}: is a zip of too many files ({stated} bytes of names); unpack it, and name a "
            "folder with the pictures of one drop"
        )


@contextmanager
def _opened(path: Path) -> Iterator[Read]:
    try:
        with open_regular(path) as file, zipfile.ZipFile(file) as archive:
            yield partial(_bytes_of, archive)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})", CHECK_DISK) from error


def _bytes_of(archive: zipfile.ZipFile, name: str) -> bytes:
    try:
        if archive.getinfo(name).file_size > MAX_BYTES:
            raise LogError(
                f"{name} is over the limit of {MAX_BYTES} bytes", "save smaller pictures"
            )
        with archive.open(name) as file:
            return file.read(MAX_BYTES)
    except _UNREADABLE as error:
        raise LogError(f"{name} is damaged ({error})", COPY_AGAIN) from error
