"""Read sequences of one-image files, from a folder or a zip, and animated WebP.

`frame_of` decodes one image within bounds, `series_of` groups file names into sequences, and
`taken` stamps them; `film_of` builds the episode. Files of laboratory cameras hold 10, 12 or 14
bits in 16: the bit depth is inferred from the brightest pixels of a few images, else a ball would
be lost in the dark.
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
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import islice, pairwise
from lzma import LZMAError
from math import gcd
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import FRAME_NS, Channel, Episode, EpisodeInfo, Frame
from tunenet_logs.errors import CHECK_DISK, COPY_AGAIN, LogError
from tunenet_logs.files import open_regular
from tunenet_logs.formats.kinds import UNPACK, Start, foreign_kind
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.images import MAX_PIXELS, image_format, image_size

MAX_BYTES = 120_000_000  # of one file: more than the largest image has, uncompressed
_MAX_PIXELS = MAX_PIXELS // 2  # of an image decoded here: it may have 16 bits a sample
_FORGED_PIXELS_A_BYTE = 2000  # of a file, as in `images`: what claims more is forged
_DEPTHS = (8, 10, 12, 14, 16)  # bits a sample of cameras
_TIFF_WIDTH, _TIFF_HEIGHT, _TIFF_SAMPLES = 256, 257, 277
_TIFF_TILE_WIDTH, _TIFF_TILE_HEIGHT = 322, 323
_MAX_TAGS = 1000  # of a TIFF's picture
# How a PGM or PPM begins, to its width and height.
_PNM = re.compile(rb"P[2356]\s+(?:#[^\n]*\n\s*)*(\d{1,9})\s+(?:#[^\n]*\n\s*)*(\d{1,9})\s")


def frame_of(stamp_ns: int, data: bytes, depth: int = 8) -> Frame:
    """Return one image as a frame: 8-bit JPEG, WebP and PNG as they are, all else as pixels.

    Args:
        stamp_ns: of the frame.
        data: of the file.
        depth: bits per sample of images with more than 8.

    Raises:
        LogError: damaged, of an unsupported format, or of a size that no camera has.
    """
    kind = image_format(data)
    if kind is not None and not _is_deep_png(data):
        return Frame(stamp_ns, kind, data)
    pixels = _pixels(data)
    if pixels.dtype == np.uint16:
        np.right_shift(pixels, max(depth - 8, 0), out=pixels)
        pixels = np.minimum(pixels, 255, out=pixels).astype(np.uint8)
    height, width = pixels.shape[:2]
    return Frame(stamp_ns, "rgb8", pixels.tobytes(), (width, height))


def depth_of(samples: Iterable[bytes]) -> int:
    """Infer the bits per sample from the brightest pixel of a few files; skip damaged ones."""
    brightest = 0
    for data in samples:
        if image_format(data) is not None and not _is_deep_png(data):
            return 8
        try:
            brightest = max(brightest, int(_pixels(data).max()))
        except LogError:
            continue
    return next(depth for depth in _DEPTHS if brightest < 1 << depth)


def _is_deep_png(data: bytes) -> bool:
    return image_format(data) == "png" and data[24:25] == b"\x10"


def _pixels(data: bytes) -> NDArray[Any]:
    """Decode RGB as uint8 or uint16, as stored, shape (H, W, 3); raises as `frame_of` does."""
    width, height = _stated_size(data)
    most = min(_MAX_PIXELS, _FORGED_PIXELS_A_BYTE * len(data))
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
    """Return (width, height) of a header; raise LogError if truncated or unsupported."""
    try:
        if data[:2] == b"BM":
            width, height = struct.unpack_from("<ii", data, 18)
            return width, abs(height)
        if data[:4] in (b"II*\0", b"MM\0*"):
            return _tiff_size(data)
        if match := _PNM.match(data[:4096]):
            return int(match[1]), int(match[2])
        if _is_deep_png(data):
            return image_size(data)
    except struct.error as error:
        raise LogError("a picture is cut", COPY_AGAIN) from error
    raise LogError("a picture is no JPEG, PNG, TIFF, BMP, WebP or PNM", "save it as one of these")


def _tiff_size(data: bytes) -> tuple[int, int]:
    """Return the size of a TIFF's first image; its tiles are checked as well.

    Raises:
        LogError: it claims more tags, samples or pixels in a tile than any camera's.
        struct.error: it is truncated.
    """
    order = "<" if data[:2] == b"II" else ">"
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, at)
    if count > _MAX_TAGS:
        raise LogError("a TIFF has too many tags", "save it again, as PNG")
    tags: dict[int, int] = {}
    for place in range(at + 2, at + 2 + 12 * count, 12):
        tag, kind, _ = struct.unpack_from(f"{order}HHI", data, place)
        form = {3: "H", 4: "I"}.get(kind)
        if form:
            tags[tag] = struct.unpack_from(order + form, data, place + 8)[0]
    tile = tags.get(_TIFF_TILE_WIDTH, 0) * tags.get(_TIFF_TILE_HEIGHT, 0)
    if tile > MAX_PIXELS or tags.get(_TIFF_SAMPLES, 1) > 4:
        raise LogError("a TIFF has tiles or samples beyond any camera's", "save it again, as PNG")
    return tags.get(_TIFF_WIDTH, 0), tags.get(_TIFF_HEIGHT, 0)


# ---- Group image files into sequences by their names, in order, and stamp them.

SUFFIXES = frozenset(
    {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm", ".pnm"}
)

MAX_PICTURES = 200_000  # of one folder or archive
_NUMBER = re.compile(r"\d+")
_MAX_NUMBER = 19  # digits of a counter or a time; a longer number is a digest
_MAX_LEFT_OUT = 0.5  # share of missing numbers: with more, they do not count frames

# A time since 1970 in a name, as data sets of cameras write it.
_SECONDS = re.compile(r"(?<!\d)(\d{10})\.(\d{1,9})(?!\d)")

# Unit of a time of this century [ns], by its number of digits.
_TIME_DIGITS = {19: 1, 16: 1000, 13: 1_000_000}

_TIMES_NS = (10**18, 4 * 10**18)  # from 2001 to 2096


@dataclass(frozen=True)
class Series:
    """One image sequence.

    Attributes:
        name: common part of the file names.
        files: their names, in order.
        numbers: counters in the names, shape (T,), strictly increasing; empty without one counter.
    """

    name: str
    files: tuple[str, ...]
    numbers: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class PictureTimes:
    """Stamps of an image sequence.

    Attributes:
        stamps_ns: int64, shape (T,), strictly increasing.
        rate: in words.
        is_timed: whether the stamps are times; else they count frames, `FRAME_NS` each.
        warnings: what is doubtful, in words.
    """

    stamps_ns: NDArray[np.int64]
    rate: str
    is_timed: bool
    warnings: tuple[str, ...]


def series_of(names: Iterable[str]) -> list[Series]:
    """Group file names into image sequences, the longest first."""
    alike: dict[str, list[str]] = defaultdict(list)
    for name in names:
        alike[_NUMBER.sub("#", name)].append(name)
    found = [one for group in alike.values() for one in _divided(group)]
    shared = Counter(one.name for one in found)
    found = [
        Series(one.name + PurePosixPath(one.files[0]).suffix, one.files, one.numbers)
        if shared[one.name] > 1
        else one
        for one in found
    ]
    return sorted(found, key=lambda one: (-len(one.files), one.name))


def taken(series: Series, options: ReadOptions) -> PictureTimes:
    """Stamp a sequence by `--fps`, else by the times in its names, else by counting frames."""
    times_ns = _times_ns(series.files)
    rate_hz = options.rate_hz
    if rate_hz is None and times_ns is not None:
        return PictureTimes(times_ns, "by the times in the names", is_timed=True, warnings=())
    counts, warnings = _counts(series) if times_ns is None else (np.arange(len(series.files)), [])
    if rate_hz is not None:
        stamps_ns = np.round(counts * (1e9 / rate_hz)).astype(np.int64)
        return PictureTimes(
            stamps_ns, f"{rate_hz:g}, as said", is_timed=True, warnings=tuple(warnings)
        )
    warnings.append(
        f"{series.name}: nothing says how many pictures a second there are; say it with --fps"
    )
    return PictureTimes(counts * FRAME_NS, "unknown", is_timed=False, warnings=tuple(warnings))


def _divided(names: list[str]) -> list[Series]:
    """Split names that differ in numbers alone by all of these but the counter."""
    texts = {name: _NUMBER.findall(name) for name in names}
    columns = list(zip(*texts.values(), strict=True))
    if not columns or max(len(text) for column in columns for text in column) > _MAX_NUMBER:
        return [Series(name, (name,), ()) for name in names]
    kinds = [len(set(column)) for column in columns]
    counter = max(range(len(kinds)), key=lambda at: (kinds[at], at))
    takes: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for name, numbers in texts.items():
        takes[(*numbers[:counter], *numbers[counter + 1 :])].append(name)
    if 2 * len(takes) > len(names):  # dates and times: all of them count together
        ordered = sorted(names, key=lambda name: ([int(text) for text in texts[name]], name))
        return [Series(_label(ordered[0], -1), tuple(ordered), ())]
    return [_counted(take, texts, counter) for take in takes.values()]


def _counted(names: list[str], texts: dict[str, list[str]], counter: int) -> Series:
    """Return the sequence of names that one number counts."""
    ordered = sorted(names, key=lambda name: (int(texts[name][counter]), name))
    numbers = [int(texts[name][counter]) for name in ordered]
    is_strict = all(first < second for first, second in pairwise(numbers))
    return Series(_label(ordered[0], counter), tuple(ordered), tuple(numbers) if is_strict else ())


def _label(name: str, counter: int) -> str:
    """Return a name without its suffix and its counter; -1 is the last number."""
    stem = str(PurePosixPath(name).with_suffix(""))
    found = list(_NUMBER.finditer(stem))
    if not -len(found) <= counter < len(found):
        return stem
    begin, end = found[counter].span()
    return (stem[:begin] + stem[end:]).strip(" ._-/()") or "pictures"


def _counts(series: Series) -> tuple[NDArray[np.int64], list[str]]:
    """Return frame counts that keep the gaps in the numbers, shape (T,), and doubts."""
    ranks = np.arange(len(series.files))
    if len(series.numbers) < 3:
        return ranks, []
    steps = [second - first for first, second in pairwise(series.numbers)]
    unit = gcd(*steps)
    last = sum(steps) // unit
    missing = last - ranks[-1]
    if missing > _MAX_LEFT_OUT * last:
        return ranks, [f"{series.name}: their numbers leap; the pictures are counted instead"]
    counts = np.concatenate([[0], np.cumsum(np.array(steps, np.int64) // unit)])
    said = f"{series.name}: {missing} numbers between the first and the last have no picture"
    return counts, [said] if missing else []


def _times_ns(names: tuple[str, ...]) -> NDArray[np.int64] | None:
    """Return the times since 1970 in the names, shape (T,); None where they state none."""
    found = [_time_ns(PurePosixPath(name).stem) for name in names]
    if len(found) < 2 or None in found:
        return None
    stamps_ns = np.array(found, np.int64)
    return stamps_ns if np.all(np.diff(stamps_ns) > 0) else None


def _time_ns(stem: str) -> int | None:
    if match := _SECONDS.search(stem):
        return int(match[1]) * 10**9 + int(match[2].ljust(9, "0"))
    for text in _NUMBER.findall(stem):
        stamp_ns = int(text) * _TIME_DIGITS.get(len(text), 0)
        if _TIMES_NS[0] <= stamp_ns < _TIMES_NS[1]:
            return stamp_ns
    return None


# ---- Animated WebP: frames, or patches of them, composited one over the other.
# By https://developers.google.com/speed/webp/docs/riff_container.

TOPIC = "video"  # of the frames, as a video's
_ANIMATED = 0x02
# Bits of a part's flags: it replaces what is below; it goes before the next one comes.
_DO_NOT_BLEND, _DISPOSE = 0x02, 0x01

_PART_HEADER = 16  # bytes
# Pixels of all frames of a file: of any, and for each of its bytes.
_FREE_PIXELS, _MAX_PIXELS_A_BYTE = 100_000_000, 50


@dataclass(frozen=True)
class _Chunk:
    """One frame's patch.

    Attributes:
        at: where its chunks begin in the file.
        size: of these [bytes].
        left, top, width, height: in the canvas [px].
        flags: `_DO_NOT_BLEND`, `_DISPOSE`.
    """

    at: int
    size: int
    left: int
    top: int
    width: int
    height: int
    flags: int


def is_animated_webp(start: Start) -> bool:
    """Return whether a file is an animated WebP."""
    data = start.data
    is_webp = data[:4] == b"RIFF" and data[8:16] == b"WEBPVP8X"
    return is_webp and len(data) > 30 and bool(data[20] & _ANIMATED)


def read_animated_webp(path: Path, options: ReadOptions) -> Episode:
    """Read the images as an episode, stamped by their stated durations or by `--fps`.

    Raises:
        LogError: it is cut before the first picture, or claims what no camera makes.
        OSError: it cannot be read.
    """
    canvas, parts, lasts_ms, is_cut = _scanned(path)
    if not parts:
        raise LogError(f"{path}: is an animated WebP without a picture; copy it again")
    limit = _FREE_PIXELS + _MAX_PIXELS_A_BYTE * path.stat().st_size
    if canvas[0] * canvas[1] * len(parts) > limit:
        raise LogError(
            f"{path}: is an animated WebP of {len(parts)} pictures of {canvas[0]} x {canvas[1]} "
            "px, more than its size allows",
            COPY_AGAIN,
        )
    warnings: list[str] = []
    is_timed = True
    counts = np.arange(len(parts))
    if options.rate_hz is not None:
        stamps_ns = np.round(counts * (1e9 / options.rate_hz)).astype(np.int64)
        rate = f"{options.rate_hz:g}, as said"
        warnings.append("the pictures' own times are not used: --fps was said")
    elif min(lasts_ms) > 0:
        stamps_ns = np.concatenate([[0], np.cumsum(lasts_ms[:-1])]).astype(np.int64) * 1_000_000
        rate = f"stored {1000 / float(np.mean(lasts_ms)):.3f}"
    else:
        stamps_ns, is_timed, rate = counts * FRAME_NS, False, "unknown"
        warnings.append("the pictures state no times; say how many there are a second with --fps")
    lost = ("is cut: its last pictures are missing",) if is_cut else ()
    channel = Channel(TOPIC, "webp", "video", stamps_ns, pictures=True)
    notes = {"codec": "webp", "size_px": f"{canvas[0]}x{canvas[1]}", "rate_hz": rate}
    info = EpisodeInfo(source=f"animated WebP {path.name}", notes=notes)
    return Episode(
        info,
        {},
        (channel,),
        (*lost, *warnings),
        lost,
        open_frames=partial(_webp_frames, path, canvas, parts, stamps_ns),
        frames_untimed=not is_timed,
    )


def _scanned(path: Path) -> tuple[tuple[int, int], list[_Chunk], list[int], bool]:
    """Return canvas size (width, height) [px], patches, durations [ms], and whether it is cut."""
    parts: list[_Chunk] = []
    lasts_ms: list[int] = []
    size = path.stat().st_size
    with open_regular(path) as file:
        file.seek(24)
        canvas = (1 + _number(file.read(3)), 1 + _number(file.read(3)))
        if canvas[0] * canvas[1] > MAX_PIXELS:
            raise LogError(f"{path}: claims pictures of {canvas[0]} x {canvas[1]} px", COPY_AGAIN)
        for name, at, length in _chunks(file, 30, size):
            if name != b"ANMF":
                continue
            if len(parts) >= MAX_PICTURES:
                raise LogError(f"{path}: claims more than {MAX_PICTURES} pictures", COPY_AGAIN)
            file.seek(at)
            head = file.read(_PART_HEADER)
            if length <= _PART_HEADER or at + length > size:
                return canvas, parts, lasts_ms, True
            left, top, width, height, lasts = (_number(head[i : i + 3]) for i in range(0, 15, 3))
            part = _Chunk(
                at + _PART_HEADER,
                min(length - _PART_HEADER, MAX_BYTES),
                2 * left,
                2 * top,
                1 + width,
                1 + height,
                head[15],
            )
            if part.left + part.width > canvas[0] or part.top + part.height > canvas[1]:
                raise LogError(f"{path}: claims a picture outside of its own size", COPY_AGAIN)
            parts.append(part)
            lasts_ms.append(lasts)
        file.seek(4)
        is_cut = size < 8 + int.from_bytes(file.read(4), "little")
    return canvas, parts, lasts_ms, is_cut


def _chunks(file: BinaryIO, at: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield name, place and length of each chunk of a RIFF file."""
    while at + 8 <= end:
        file.seek(at)
        head = file.read(8)
        length = int.from_bytes(head[4:], "little")
        yield head[:4], at + 8, length
        at += 8 + length + length % 2


def _webp_frames(
    path: Path,
    canvas: tuple[int, int],
    parts: list[_Chunk],
    stamps_ns: NDArray[np.int64],
    _topic: str,
) -> Iterator[Frame]:
    """Yield the frames; raise LogError at a damaged one, after those before it."""
    width, height = canvas
    picture = np.zeros((height, width, 3), np.uint8)
    with open_regular(path) as file:
        for stamp_ns, part in zip(stamps_ns.tolist(), parts, strict=True):
            file.seek(part.at)
            place = (
                slice(part.top, part.top + part.height),
                slice(part.left, part.left + part.width),
            )
            _lay(picture[place], _decoded(path, file.read(part.size), part), part.flags)
            yield Frame(stamp_ns, "rgb8", picture.tobytes(), canvas)
            if part.flags & _DISPOSE:
                picture[place] = 0


def _lay(below: NDArray[np.uint8], above: NDArray[np.uint8], flags: int) -> None:
    """Composite RGB or RGBA onto a patch of the picture, in place."""
    if above.shape[2] == 3:
        below[:] = above
    elif flags & _DO_NOT_BLEND:
        below[:] = above[:, :, :3]
    else:
        share = above[:, :, 3:].astype(np.float32) / 255
        below[:] = np.round(share * above[:, :, :3] + (1 - share) * below)


def _decoded(path: Path, chunks: bytes, part: _Chunk) -> NDArray[np.uint8]:
    """Decode a patch as RGB or RGBA, shape (H, W, 3 or 4)."""
    import cv2

    flags = b"\x10" if chunks[:4] == b"ALPH" else b""
    sides = b"".join((side - 1).to_bytes(3, "little") for side in (part.width, part.height))
    extra = b"VP8X\x0a\0\0\0" + flags + b"\0\0\0" + sides if flags else b""
    data = b"WEBP" + extra + chunks
    data = b"RIFF" + len(data).to_bytes(4, "little") + data
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        pixels = None
    wanted = (part.height, part.width)
    if pixels is None or pixels.ndim != 3 or pixels.shape[:2] != wanted:
        raise LogError(f"{path}: a picture is damaged", COPY_AGAIN)
    turned = cv2.COLOR_BGRA2RGBA if pixels.shape[2] == 4 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(pixels, turned), np.uint8)


def _number(data: bytes) -> int:
    return int.from_bytes(data, "little")


# ---- Build an episode of image files, wherever they are.

MIN_COUNT = 3  # images of a sequence
_MAX_FILMS = 16  # sequences of one folder or archive that are read
# Pixels of a sequence: of any, and for each byte of its files; a camera's have 20.
_FREE_FRAME_PIXELS, _FRAME_PIXELS_A_BYTE = 150_000_000, 50

_SAMPLES = 5  # images by which their bit depth is inferred
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
            bytes, but for `_FREE_FRAME_PIXELS`.
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
        open_frames=partial(_series_frames, store, by_name, times, depths),
        frames_untimed=not all(one.is_timed for one in times.values()),
    )


def _samples(series: Series, read: Read) -> Iterator[bytes]:
    """Yield the bytes of a few readable images, evenly spaced."""
    for at in np.linspace(0, len(series.files) - 1, _SAMPLES).round().astype(int).tolist():
        try:
            yield read(series.files[at])
        except LogError:
            continue


def _series_frames(
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
                paid += min(_FRAME_PIXELS_A_BYTE * len(data), work)
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
_MAX_DIRECTORY_BYTES = 8_000_000  # of a zip: its list of files, with 100 bytes for each of 80,000
_END, _END_BYTES, _END64 = b"PK\x05\x06", 22, b"PK\x06\x06"
_MAX_COMMENT = 65_535

# Unpacked bytes of a whole zip: of any, and for each of its bytes.
_FREE_BYTES, _MAX_RATIO = 256_000_000, 100

_KIND_BYTES = 65_536  # that hold the names which tell what else a zip is
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
    names = _pictures_in_zip(path, size)
    store = PictureStore(
        path,
        "a zip of pictures",
        partial(_opened_zip, path),
        most_pixels=_FREE_PIXELS + _MAX_PIXELS_A_BYTE * size,
    )
    return film_of(store, names, options)


def _pictures_in_zip(path: Path, size: int) -> list[str]:
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
    """Return whether a folder holds images, and no log.

    Raises:
        OSError: it cannot be read.
    """
    names = _files(path)
    return len(_pictures_among(names)) >= MIN_COUNT and not any(
        one.endswith(_LOGS) for one in names
    )


def read_picture_folder(path: Path, options: ReadOptions) -> Episode:
    """Read a folder's images as an episode; no link is followed.

    Raises:
        LogError: there is no image sequence in it.
        OSError: it cannot be read.
    """
    store = PictureStore(path, "a folder of pictures", partial(_opened_folder, path))
    return film_of(store, _pictures_among(_files(path)), options)


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


@contextmanager
def _opened_folder(folder: Path) -> Iterator[Read]:
    yield partial(_bytes_in_folder, folder)


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
