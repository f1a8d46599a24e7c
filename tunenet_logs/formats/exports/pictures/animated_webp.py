"""Read animated WebP: frames, or patches of them, composited one over the other.

By the container's description: https://developers.google.com/speed/webp/docs/riff_container
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import FRAME_NS, Channel, Episode, EpisodeInfo, Frame
from tunenet_logs.errors import COPY_AGAIN, LogError
from tunenet_logs.formats.exports.pictures.picture_bytes import MAX_BYTES
from tunenet_logs.formats.exports.pictures.picture_series import MAX_PICTURES
from tunenet_logs.formats.exports.start import Start
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.images import MAX_PIXELS
from tunenet_logs.regular_file import open_regular

TOPIC = "video"  # what the pictures go by, as a video's
_ANIMATED = 0x02
# Bits of a part's flags: it replaces what is below; it goes before the next one comes.
_DO_NOT_BLEND, _DISPOSE = 0x02, 0x01

_PART_HEADER = 16
# Of all pictures, whatever the size of the file is, and for each of its bytes.
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
        open_frames=partial(_frames, path, canvas, parts, stamps_ns),
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


def _frames(
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
