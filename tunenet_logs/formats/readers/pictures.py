"""Read sequences of one-image files, from a folder or a zip, and animated WebP.

Files of laboratory cameras hold 10, 12 or 14 bits in 16: the bit depth is inferred from the
brightest pixels of a few images, else a ball would be lost in the dark.
"""

from __future__ import annotations

import os
import re
import stat
import struct
import zipfile
import zlib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import partial
from itertools import islice, pairwise
from lzma import LZMAError
from math import gcd
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import FRAME_NS, Channel, Episode, EpisodeInfo, Frame
from tunenet_logs.errors import CHECK_DISK, COPY_AGAIN, LogError
from tunenet_logs.files import open_regular
from tunenet_logs.formats.kinds import UNPACK, Start, foreign_kind
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.formats.readers.arrays import directory_bytes
from tunenet_logs.images import MAX_PIXELS, image_format, image_size

MAX_BYTES = 120_000_000  # of one file: more than the largest image has, uncompressed
# How a PGM or PPM begins, to its width and height.
_PNM = re.compile(rb"P[2356]\s+(?:#[^\n]*\n\s*)*(\d{1,9})\s+(?:#[^\n]*\n\s*)*(\d{1,9})\s")


def _frame_of(stamp_ns: int, data: bytes, depth: int) -> Frame:
    """Return one image as a frame: 8-bit JPEG, WebP and PNG as they are, all else as pixels."""
    kind = image_format(data)
    if kind is not None and not _is_deep_png(data):
        return Frame(stamp_ns, kind, data)
    pixels = _pixels(data)
    if pixels.dtype == np.uint16:
        np.right_shift(pixels, max(depth - 8, 0), out=pixels)
        pixels = np.minimum(pixels, 255, out=pixels).astype(np.uint8)
    return Frame(stamp_ns, "rgb8", pixels.tobytes(), (pixels.shape[1], pixels.shape[0]))


def _depth_of(samples: Iterable[bytes]) -> int:
    """Infer the bits per sample from the brightest pixel of a few files; skip damaged ones."""
    brightest = 0
    for data in samples:
        if image_format(data) is not None and not _is_deep_png(data):
            return 8
        with suppress(LogError):
            brightest = max(brightest, int(_pixels(data).max()))
    return next(depth for depth in (8, 10, 12, 14, 16) if brightest < 1 << depth)


def _is_deep_png(data: bytes) -> bool:
    return image_format(data) == "png" and data[24:25] == b"\x10"


def _pixels(data: bytes) -> NDArray[Any]:
    """Decode RGB as uint8 or uint16, as stored, shape (H, W, 3); raises as `_frame_of` does."""
    width, height = _stated_size(data)
    # An image may have 16 bits a sample; what claims more pixels for its bytes is forged.
    most = min(MAX_PIXELS // 2, 2000 * len(data))
    if not 0 < width * height <= most:
        raise LogError(f"a picture claims {width} x {height} px in {len(data)} bytes", COPY_AGAIN)
    import cv2

    flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        pixels = None
    finally:
        cv2.utils.logging.setLogLevel(level)
    if pixels is None or pixels.shape != (height, width, 3):
        raise LogError("a picture is damaged and cannot be decoded", COPY_AGAIN)
    if pixels.dtype not in (np.uint8, np.uint16):
        raise LogError(f"a picture holds {pixels.dtype} numbers; save it with 8 or 16 bits")
    return np.asarray(pixels)


def _stated_size(data: bytes) -> tuple[int, int]:
    """Return (width, height) of a header; a TIFF's tiles and samples are checked as well."""
    try:
        if data[:2] == b"BM":
            width, height = struct.unpack_from("<ii", data, 18)
            return width, abs(height)
        if match := _PNM.match(data[:4096]):
            return int(match[1]), int(match[2])
        if _is_deep_png(data):
            return image_size(data)
        if data[:4] not in (b"II*\0", b"MM\0*"):
            raise LogError(
                "a picture is no JPEG, PNG, TIFF, BMP, WebP or PNM", "save it as one of these"
            )
        order = "<" if data[:2] == b"II" else ">"
        (at,) = struct.unpack_from(f"{order}I", data, 4)
        (count,) = struct.unpack_from(f"{order}H", data, at)
        if count > 1000:
            raise LogError("a TIFF has too many tags", "save it again, as PNG")
        tags: dict[int, int] = {}
        for place in range(at + 2, at + 2 + 12 * count, 12):
            tag, kind, _ = struct.unpack_from(f"{order}HHI", data, place)
            if kind in (3, 4):  # whole numbers of 16 and 32 bits
                (tags[tag],) = struct.unpack_from(order + "HI"[kind - 3], data, place + 8)
    except struct.error as error:
        raise LogError("a picture is cut", COPY_AGAIN) from error
    width, height, samples, tile_width, tile_height = (
        tags.get(tag, 0) for tag in (256, 257, 277, 322, 323)
    )
    if tile_width * tile_height > MAX_PIXELS or samples > 4:
        raise LogError("a TIFF has tiles or samples beyond any camera's", "save it again, as PNG")
    return width, height


# ---- Group image files into sequences by their names, in order, and stamp them.

SUFFIXES = frozenset(
    {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm", ".pnm"}
)

MAX_PICTURES = 200_000  # of one folder or archive
_NUMBER = re.compile(r"\d+")
# A time since 1970 in a name, as data sets of cameras write it.
_SECONDS = re.compile(r"(?<!\d)(\d{10})\.(\d{1,9})(?!\d)")
# Unit of a time of this century [ns], by its number of digits.
_TIME_DIGITS = {19: 1, 16: 1000, 13: 1_000_000}


class _Series(NamedTuple):
    """One image sequence."""

    name: str  # common part of the file names
    files: tuple[str, ...]  # their names, in order
    # counters in the names, shape (T,), strictly increasing; empty without one counter
    numbers: tuple[int, ...] = ()


class _PictureTimes(NamedTuple):
    """Stamps of an image sequence, strictly increasing, the rate in words, and doubts."""

    stamps_ns: NDArray[np.int64]
    rate: str
    is_timed: bool = True  # else they count frames, `FRAME_NS` each
    warnings: Sequence[str] = ()


def _counted(
    counts: NDArray[np.int64], options: ReadOptions, warnings: Sequence[str], remedy: str
) -> _PictureTimes:
    """Stamp counted frames by `--fps`, if it was said; `remedy` warns where it was not."""
    if options.fps is None:
        return _PictureTimes(counts * FRAME_NS, "unknown", False, [*warnings, remedy])
    stamps_ns = np.round(counts * (1e9 / options.fps)).astype(np.int64)
    return _PictureTimes(stamps_ns, f"{options.fps:g}, as said", True, warnings)


def _series_of(names: Iterable[str]) -> list[_Series]:
    """Group file names into image sequences, the longest first."""
    alike: dict[str, list[str]] = defaultdict(list)
    for name in names:
        alike[_NUMBER.sub("#", name)].append(name)
    found = [one for group in alike.values() for one in _divided(group)]
    shared = Counter(one.name for one in found)
    for at, one in enumerate(found):
        if shared[one.name] > 1:
            found[at] = one._replace(name=one.name + PurePosixPath(one.files[0]).suffix)
    return sorted(found, key=lambda one: (-len(one.files), one.name))


def _divided(names: list[str]) -> list[_Series]:
    """Split names that differ in numbers alone by all of these but the counter."""
    texts = {name: _NUMBER.findall(name) for name in names}
    columns = list(zip(*texts.values(), strict=True))
    # A number that is longer than a counter or a time is a digest.
    if not columns or max(len(text) for column in columns for text in column) > 19:
        return [_Series(name, (name,)) for name in names]
    kinds = [len(set(column)) for column in columns]
    counter = max(range(len(kinds)), key=lambda at: (kinds[at], at))
    takes: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for name, numbers in texts.items():
        takes[(*numbers[:counter], *numbers[counter + 1 :])].append(name)
    if 2 * len(takes) > len(names):  # dates and times: all of them count together
        ordered = sorted(names, key=lambda name: ([int(text) for text in texts[name]], name))
        return [_Series(_label(ordered[0], -1), tuple(ordered))]
    found: list[_Series] = []
    for take in takes.values():
        ordered = sorted(take, key=lambda name: (int(texts[name][counter]), name))
        counts = tuple(int(texts[name][counter]) for name in ordered)
        is_strict = all(first < second for first, second in pairwise(counts))
        label = _label(ordered[0], counter)
        found.append(_Series(label, tuple(ordered), counts if is_strict else ()))
    return found


def _label(name: str, counter: int) -> str:
    """Return a name without its suffix and its counter; -1 is the last number."""
    stem = str(PurePosixPath(name).with_suffix(""))
    found = list(_NUMBER.finditer(stem))
    if not -len(found) <= counter < len(found):
        return stem
    begin, end = found[counter].span()
    return (stem[:begin] + stem[end:]).strip(" ._-/()") or "pictures"


def _taken(series: _Series, options: ReadOptions) -> _PictureTimes:
    """Stamp a sequence by `--fps`, else by the times in its names, else by counting frames."""
    said_ns = [_time_ns(PurePosixPath(name).stem) for name in series.files]
    times_ns = np.array([0 if one is None else one for one in said_ns], np.int64)
    has_times = len(said_ns) > 1 and None not in said_ns and bool(np.all(np.diff(times_ns) > 0))
    if options.fps is None and has_times:
        return _PictureTimes(times_ns, "by the times in the names")
    counts, warnings = (np.arange(len(series.files)), []) if has_times else _counts(series)
    remedy = f"{series.name}: nothing says how many pictures a second there are; say it with --fps"
    return _counted(counts, options, warnings, remedy)


def _counts(series: _Series) -> tuple[NDArray[np.int64], list[str]]:
    """Return frame counts that keep the gaps in the numbers, shape (T,), and doubts."""
    ranks = np.arange(len(series.files))
    if len(series.numbers) < 3:
        return ranks, []
    steps = [second - first for first, second in pairwise(series.numbers)]
    unit = gcd(*steps)
    last = sum(steps) // unit
    missing = last - ranks[-1]
    if missing > 0.5 * last:
        return ranks, [f"{series.name}: their numbers leap; the pictures are counted instead"]
    counts = np.concatenate([[0], np.cumsum(np.array(steps, np.int64) // unit)])
    said = f"{series.name}: {missing} numbers between the first and the last have no picture"
    return counts, [said] if missing else []


def _time_ns(stem: str) -> int | None:
    """Return the time since 1970 in a name; None where it states none."""
    if match := _SECONDS.search(stem):
        return int(match[1]) * 10**9 + int(match[2].ljust(9, "0"))
    texts = [text for text in _NUMBER.findall(stem) if len(text) in _TIME_DIGITS]
    stamps_ns = [int(text) * _TIME_DIGITS[len(text)] for text in texts]
    return next((one for one in stamps_ns if 10**18 <= one < 4 * 10**18), None)  # 2001 to 2096


# ---- Animated WebP: frames, or patches of them, composited one over the other.
# By https://developers.google.com/speed/webp/docs/riff_container. OpenCV reads them too, but holds
# all pictures of a film at once, and none of one that is cut.

_PATCH_HEADER = 16  # bytes
# Pixels of all frames of a file: of any, and for each of its bytes.
_FREE_PIXELS, _MAX_PIXELS_A_BYTE = 100_000_000, 50


class _Patch(NamedTuple):
    """Where a frame's chunks are in the file, its place in the canvas [px], and for how long."""

    at: int
    size: int  # bytes
    left: int
    top: int
    width: int
    height: int
    lasts_ms: int
    flags: int


def is_animated_webp(start: Start) -> bool:
    """Return whether a file is an animated WebP."""
    data = start.data
    is_webp = data[:4] == b"RIFF" and data[8:16] == b"WEBPVP8X"
    return is_webp and len(data) > 30 and bool(data[20] & 0x02)


def read_animated_webp(path: Path, options: ReadOptions) -> Episode:
    """Read the images as an episode, stamped by their stated durations or by `--fps`."""
    canvas, patches, is_cut = _patches(path)
    if not patches:
        raise LogError(f"{path}: is an animated WebP without a picture; copy it again")
    limit = _FREE_PIXELS + _MAX_PIXELS_A_BYTE * path.stat().st_size
    if canvas[0] * canvas[1] * len(patches) > limit:
        raise LogError(
            f"{path}: is an animated WebP of {len(patches)} pictures of {canvas[0]} x {canvas[1]} "
            "px, more than its size allows",
            COPY_AGAIN,
        )
    losses = ["is cut: its last pictures are missing"] if is_cut else []
    lasts_ms = [patch.lasts_ms for patch in patches]
    if options.fps is None and min(lasts_ms) > 0:
        stamps_ns = np.concatenate([[0], np.cumsum(lasts_ms[:-1])]).astype(np.int64) * 1_000_000
        rate = f"stored {1000 / float(np.mean(lasts_ms)):.3f}"
        times = _PictureTimes(stamps_ns, rate, True, losses)
    else:
        said = ["the pictures' own times are not used: --fps was said"] if options.fps else []
        remedy = "the pictures state no times; say how many there are a second with --fps"
        times = _counted(np.arange(len(patches)), options, [*losses, *said], remedy)
    notes = {"codec": "webp", "size_px": f"{canvas[0]}x{canvas[1]}", "rate_hz": times.rate}
    return Episode(
        EpisodeInfo(source=f"animated WebP {path.name}", notes=notes),
        {},
        (Channel("video", "webp", "video", times.stamps_ns, pictures=True),),
        tuple(times.warnings),
        tuple(losses),
        open_frames=partial(_webp_frames, path, canvas, patches, times.stamps_ns),
        frames_untimed=not times.is_timed,
    )


def _patches(path: Path) -> tuple[tuple[int, int], list[_Patch], bool]:
    """Return canvas size (width, height) [px], patches, and whether the file is cut."""
    found: list[_Patch] = []
    size = path.stat().st_size
    with open_regular(path) as file:
        head = file.read(30)
        stated = 8 + int.from_bytes(head[4:8], "little")
        width, height = (1 + int.from_bytes(head[at : at + 3], "little") for at in (24, 27))
        if width * height > MAX_PIXELS:
            raise LogError(f"{path}: claims pictures of {width} x {height} px", COPY_AGAIN)
        at = 30
        while at + 8 <= size:
            file.seek(at)
            head = file.read(8 + _PATCH_HEADER)
            at, length = at + 8, int.from_bytes(head[4:8], "little")
            if head[:4] == b"ANMF":
                if len(found) >= MAX_PICTURES:
                    raise LogError(f"{path}: claims more than {MAX_PICTURES} pictures", COPY_AGAIN)
                if length <= _PATCH_HEADER or at + length > size:
                    return (width, height), found, True
                place = [int.from_bytes(head[one : one + 3], "little") for one in range(8, 23, 3)]
                left, top = 2 * place[0], 2 * place[1]
                wide, high = 1 + place[2], 1 + place[3]
                if left + wide > width or top + high > height:
                    raise LogError(f"{path}: claims a picture outside of its own size", COPY_AGAIN)
                begin, data_bytes = at + _PATCH_HEADER, min(length - _PATCH_HEADER, MAX_BYTES)
                found.append(_Patch(begin, data_bytes, left, top, wide, high, place[4], head[23]))
            at += length + length % 2
    return (width, height), found, size < stated


def _webp_frames(
    path: Path,
    canvas: tuple[int, int],
    patches: list[_Patch],
    stamps_ns: NDArray[np.int64],
    _topic: str,
) -> Iterator[Frame]:
    """Yield the frames; raise LogError at a damaged one, after those before it."""
    picture = np.zeros((canvas[1], canvas[0], 3), np.uint8)
    with open_regular(path) as file:
        for stamp_ns, patch in zip(stamps_ns.tolist(), patches, strict=True):
            file.seek(patch.at)
            above = _decoded(path, file.read(patch.size), patch)
            rows = slice(patch.top, patch.top + patch.height)
            below = picture[rows, patch.left : patch.left + patch.width]
            if above.shape[2] == 3 or patch.flags & 0x02:  # it replaces what is below
                below[:] = above[:, :, :3]
            else:
                share = above[:, :, 3:].astype(np.float32) / 255
                below[:] = np.round(share * above[:, :, :3] + (1 - share) * below)
            yield Frame(stamp_ns, "rgb8", picture.tobytes(), canvas)
            if patch.flags & 0x01:  # it goes before the next one comes
                below[:] = 0


def _decoded(path: Path, chunks: bytes, patch: _Patch) -> NDArray[np.uint8]:
    """Decode a patch, as a file of its own, as RGB or RGBA, shape (H, W, 3 or 4)."""
    import cv2

    data = b"WEBP" + chunks
    if chunks[:4] == b"ALPH":
        sides = b"".join((side - 1).to_bytes(3, "little") for side in (patch.width, patch.height))
        data = b"WEBPVP8X\x0a\0\0\0\x10\0\0\0" + sides + chunks
    data = b"RIFF" + len(data).to_bytes(4, "little") + data
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        pixels = None
    if pixels is None or pixels.ndim != 3 or pixels.shape[:2] != (patch.height, patch.width):
        raise LogError(f"{path}: a picture is damaged", COPY_AGAIN)
    turned = cv2.COLOR_BGRA2RGBA if pixels.shape[2] == 4 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(pixels, turned), np.uint8)


# ---- Build an episode of image files, wherever they are.

MIN_COUNT = 3  # images of a sequence
_MAX_FILMS = 16  # sequences of one folder or archive that are read
_FREE_FRAME_PIXELS = 150_000_000  # of any sequence, beside those that its bytes pay for

# The bytes of a file of that name, bounded; LogError where it cannot be read.
Read = Callable[[str], bytes]


class _Store(NamedTuple):
    """Source of image files."""

    path: Path  # of the folder or archive
    what: str  # kind of source, in words
    # opens it; it is closed when the images have been read
    opened: Callable[[], AbstractContextManager[Read]]
    # of all images of one sequence together; None where each is paid for by its bytes, but for
    # `_FREE_FRAME_PIXELS`
    most_pixels: int | None = None


def _film_of(store: _Store, names: Sequence[str], options: ReadOptions) -> Episode:
    """Group named images into sequences, each a topic of one episode."""
    if len(names) > MAX_PICTURES:
        raise LogError(
            f"{store.path}: holds {len(names)} pictures, over the limit of {MAX_PICTURES}; leave "
            "there only those of one drop"
        )
    found = _series_of(names)
    films = {one.name: one for one in found if len(one.files) >= MIN_COUNT}
    films = dict(islice(films.items(), _MAX_FILMS))
    if not films:
        raise LogError(
            f"{store.path}: is {store.what} without a film: no {MIN_COUNT} pictures in it whose "
            "names differ in a number alone; number them, or name a video of the drop"
        )
    times = {name: _taken(one, options) for name, one in films.items()}
    with store.opened() as read:
        depths = {name: _depth_of(_samples(one, read)) for name, one in films.items()}
    channels: list[Channel] = []
    for name, one in films.items():
        kind = f"{store.what}, {one.files[0]} to {one.files[-1]}"[:200]
        stamps_ns = times[name].stamps_ns
        channels.append(Channel(name, kind, "pictures", stamps_ns, pictures=True))
    why, none = "too few pictures for a film", np.empty(0, np.int64)
    rest = dict.fromkeys(one.name[:200] for one in found[len(films) :])
    channels += [Channel(name, "", "file", none, skipped=why) for name in islice(rest, _MAX_FILMS)]
    rates = ", ".join(dict.fromkeys(one.rate for one in times.values()))
    return Episode(
        EpisodeInfo(source=f"{store.what} {store.path.name}", notes={"rate_hz": rates}),
        {},
        tuple(channels),
        tuple(said for one in times.values() for said in one.warnings),
        open_frames=partial(_series_frames, store, films, times, depths),
        frames_untimed=not all(one.is_timed for one in times.values()),
    )


def _samples(series: _Series, read: Read) -> Iterator[bytes]:
    """Yield the bytes of five readable images, evenly spaced."""
    for at in np.linspace(0, len(series.files) - 1, 5).round().astype(int).tolist():
        with suppress(LogError):
            yield read(series.files[at])


def _series_frames(
    store: _Store,
    films: Mapping[str, _Series],
    times: Mapping[str, _PictureTimes],
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
                frame = _frame_of(stamp_ns, data, depths[topic])
                work = frame.work_px()
                pixels += work
                paid += min(50 * len(data), work)  # a camera's have 20 a byte
            except LogError:
                frame = Frame(stamp_ns, "damaged", b"")
            most = _FREE_FRAME_PIXELS + paid if store.most_pixels is None else store.most_pixels
            if pixels > most:
                raise LogError(
                    f"{store.path}: its pictures claim far more pixels than their size holds",
                    COPY_AGAIN,
                )
            yield frame


# ---- Zips of images.

_STARTS = (b"PK\x03\x04", b"PK\x05\x06")  # of a zip with files, and of one without
_MAX_RATIO = 100  # unpacked bytes of a zip for each of its own, beyond 256 MB
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
    """Read the images of an archive as an episode. Nothing is unpacked to disk."""
    with open_regular(path) as file:
        if not file.read(4).startswith(_STARTS):
            return read_animated_webp(path, options)
    size = path.stat().st_size
    names = _pictures_in_zip(path, size)
    most_pixels = _FREE_PIXELS + _MAX_PIXELS_A_BYTE * size
    store = _Store(path, "a zip of pictures", partial(_opened_zip, path), most_pixels)
    return _film_of(store, names, options)


def _pictures_in_zip(path: Path, size: int) -> list[str]:
    """Return the names of the images in a zip; raises as `read_picture_archive` does."""
    with open_regular(path) as file:
        stated = directory_bytes(file, size)
    if stated is None:
        raise LogError(f"{path}: is a zip without an end; copy it again")
    if stated > 8_000_000:  # 100 bytes for each of 80,000 files would fill the memory
        raise LogError(
            f"{path}: is a zip of too many files ({stated} bytes of names); unpack it, and name a "
            "folder with the pictures of one drop"
        )
    try:
        with open_regular(path) as file, zipfile.ZipFile(file) as archive:
            named = [one for one in archive.infolist() if one.filename]
            entries = [one for one in named if not one.is_dir()]
    except _UNREADABLE as error:
        raise LogError(f"{path}: is a damaged zip ({error}); copy it again") from error
    found = [one for one in entries if _is_picture(one.filename)]
    if len(found) < MIN_COUNT:
        with open_regular(path) as file:
            what, remedy = foreign_kind(file.read(65_536), path) or ("", "")
        if remedy != UNPACK:
            raise LogError(f"{path}: is {what}, which is not read as it is", remedy)
        shown = ", ".join(one.filename[:60] for one in entries[:2]) or "nothing"
        raise LogError(
            f"{path}: is a zip without pictures (it holds {shown}); unpack it, and name the log or "
            "video of the drop"
        )
    if any(one.flag_bits & 0x1 for one in found):
        raise LogError(f"{path}: is a zip with a password; unpack it, and name the folder")
    total = sum(one.file_size for one in found)
    if total > 256_000_000 + _MAX_RATIO * size:
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


@contextmanager
def _opened_zip(path: Path) -> Iterator[Read]:
    try:
        with open_regular(path) as file, zipfile.ZipFile(file) as archive:
            yield partial(_bytes_in_zip, archive)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})", CHECK_DISK) from error


def _bytes_in_zip(archive: zipfile.ZipFile, name: str) -> bytes:
    try:
        if archive.getinfo(name).file_size > MAX_BYTES:
            raise LogError(
                f"{name} is over the limit of {MAX_BYTES} bytes", "save smaller pictures"
            )
        with archive.open(name) as file:
            return file.read(MAX_BYTES)
    except _UNREADABLE as error:
        raise LogError(f"{name} is damaged ({error})", COPY_AGAIN) from error


# ---- Folders of numbered images, as high-speed cameras leave them.

# Endings of files that make a folder a ROS 2 bag's.
_LOGS = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd")


def is_picture_folder(path: Path) -> bool:
    """Return whether a folder holds images, and no log."""
    names = _files(path)
    has_log = any(one.endswith(_LOGS) for one in names)
    return len(_pictures_among(names)) >= MIN_COUNT and not has_log


def read_picture_folder(path: Path, options: ReadOptions) -> Episode:
    """Read a folder's images as an episode; no link is followed."""
    read = partial(_bytes_in_folder, path)
    store = _Store(path, "a folder of pictures", lambda: nullcontext(read))
    return _film_of(store, _pictures_among(_files(path)), options)


def _files(path: Path) -> list[str]:
    """Return the names of the folder's regular files, hidden ones aside."""
    with os.scandir(path) as entries:
        some = islice(entries, 2 * MAX_PICTURES)
        return [
            entry.name
            for entry in some
            if entry.is_file(follow_symlinks=False) and not entry.name.startswith(".")
        ]


def _pictures_among(names: list[str]) -> list[str]:
    return [name for name in names if PurePosixPath(name).suffix.lower() in SUFFIXES]


def _bytes_in_folder(folder: Path, name: str) -> bytes:
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
