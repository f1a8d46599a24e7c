"""Bounded decoding of recorded images: a header's claim is checked before memory is spent on it."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.errors import LogError

MAX_PIXELS = 64_000_000
_FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_PNG_MAGIC = b"\x89PNG\r\n\x1a\n"


def image_size(data: bytes) -> tuple[int, int]:
    """(width, height) [px] that a JPEG's or PNG's header states.

    Raises:
        LogError: neither a JPEG nor a PNG, or cut before its size.
    """
    if data[:8] == _PNG_MAGIC and len(data) >= 24:
        return struct.unpack(">II", data[16:24])
    if data[:2] == b"\xff\xd8":
        at = 2
        while at + 9 <= len(data) and data[at] == 0xFF:
            marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
            if marker in _FRAME_MARKERS:
                height, width = struct.unpack(">HH", data[at + 5 : at + 9])
                return width, height
            at += 1 if marker == 0xFF else 2 + length
    raise LogError("an image is neither a whole JPEG nor PNG; record the camera again as JPEG")


def decode_image(data: bytes, encoding: str) -> NDArray[np.uint8]:
    """Decode to RGB uint8, shape (H, W, 3).

    Raises:
        LogError: damaged, or of a size that no camera has.
    """
    width, height = image_size(data)
    if not 0 < width * height <= MAX_PIXELS:
        raise LogError(f"an image claims {width} x {height} px, over the limit of {MAX_PIXELS} px")
    import cv2

    bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if bgr is None:
        raise LogError(f"an image of encoding {encoding!r} is damaged and cannot be decoded")
    return np.ascontiguousarray(bgr[:, :, ::-1], dtype=np.uint8)
