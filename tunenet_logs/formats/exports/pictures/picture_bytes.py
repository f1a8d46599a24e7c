"""Decode one image file as a frame, within bounds: TIFF, BMP and PNM beside what logs hold.

Files of laboratory cameras hold 10, 12 or 14 bits in 16. The bit depth is inferred from the
brightest pixels of a few images; else a ball would be lost in the dark.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Frame
from tunenet_logs.errors import COPY_AGAIN, LogError
from tunenet_logs.images import MAX_PIXELS, image_format, image_size

MAX_BYTES = 120_000_000  # of one file: more than the largest picture has, uncompressed
_MAX_PIXELS = MAX_PIXELS // 2  # of what is decoded here: it may have 16 bits a sample
_MAX_PIXELS_A_BYTE = 2000  # as in `images`: what claims more is forged
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
    most = min(_MAX_PIXELS, _MAX_PIXELS_A_BYTE * len(data))
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
