"""Decode images: compressed ones, and the bare pixels of sensor_msgs/Image.

What a header claims is checked before memory is spent: a few forged bytes may claim seconds of a
decoder's time and hundreds of megabytes.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.errors import COPY_AGAIN, LogError

MAX_PIXELS = 36_000_000  # of any picture: a little more than 8K video has
# A JPEG of more pixels than stills of 12 megapixels have is decoded to a quarter of its sides.
LARGE_PIXELS, LARGE_REDUCED = 12_600_000, 4
# Of all pictures of a video: so many whatever its size is, and so many for each of its bytes. A
# rendered film of 4K without noise has 16,000 a byte, a camera's 100.
FREE_VIDEO_PIXELS, VIDEO_PIXELS_A_BYTE = 100_000_000, 20_000
# JPEG markers with the picture's size, of all ways of coding (SOF0 to SOF15), and those that may
# precede it: tables, comments, what applications add.
_FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_BEFORE_FRAME = frozenset({0xC4, 0xCC, 0xDB, 0xDD, 0xFE, *range(0xE0, 0xF0)})
# PNG's signature and the head of its first chunk, which must be that with the size.
_PNG_START = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"
_SCAN = b"\xff\xda"  # JPEG's marker of a scan, which coded pixels never hold
Format = Literal["jpeg", "png", "webp"]  # compressed pictures that are read


def image_format(data: bytes) -> Format | None:
    """Identify a compressed image by its first bytes; None for a format that is not read."""
    if data[:2] == b"\xff\xd8":
        return "jpeg"
    if data[:8] == _PNG_START[:8]:
        return "png"
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return "webp"
    return None


def image_size(data: bytes) -> tuple[int, int]:
    """Return (width, height) [px] from the header of a JPEG, PNG or WebP; else LogError."""
    kind = image_format(data)
    size = _SIZES[kind](data) if kind else None
    if size is None:
        raise LogError("an image is no whole JPEG, PNG or WebP; record the camera again as JPEG")
    width, height = size
    if not 0 < width * height <= MAX_PIXELS:
        raise LogError(
            f"an image claims {width} x {height} px, over the limit of {MAX_PIXELS} px",
            "record smaller pictures",
        )
    # A blank JPEG has some 300 pixels for each of its bytes, a blank PNG 1000. What claims more is
    # cut, or forged.
    if width * height > 2000 * len(data):
        raise LogError(
            f"an image claims {width} x {height} px in {len(data)} bytes: damaged", COPY_AGAIN
        )
    # JPEG encoders write ten scans, the most thorough some twenty; each goes over the picture.
    if kind == "jpeg" and data.count(_SCAN) > 50:
        raise LogError("an image has over 50 scans: forged", COPY_AGAIN)
    # PNG chunks beside the picture that a decoder unpacks, to megabytes each; programs write a few.
    if kind == "png" and sum(map(data.count, (b"zTXt", b"iTXt", b"iCCP"))) > 16:
        raise LogError("an image has over 16 packed words: forged", COPY_AGAIN)
    return size


def image_work_px(data: bytes) -> int:
    """Return the pixels that decoding passes over: of a JPEG of many scans, more than it shows."""
    width, height = image_size(data)
    if image_format(data) != "jpeg":
        return width * height
    return width * height * max(data.count(_SCAN), 10) // 10  # which encoders write


def decode_image(data: bytes, encoding: str, least_px: int | None = None) -> NDArray[np.uint8]:
    """Decode to RGB uint8, shape (H, W, 3); of 16 bits a sample, the upper 8.

    A JPEG may be decoded at 1/2, 1/4 or 1/8, not below `least_px` in length. A note in the file
    that it should be shown turned is not obeyed: every picture then has the size that its header
    states. LogError for one that is damaged, or of a size that cannot be true.
    """
    import cv2

    width, height = image_size(data)
    part, flag = 1, cv2.IMREAD_COLOR_RGB  # without a second copy
    if least_px is not None and image_format(data) == "jpeg":
        fitting = (part for part in (8, 4, 2) if max(width, height) >= part * least_px)
        part = next(fitting, 1)
    if part > 1:
        flag = getattr(cv2, f"IMREAD_REDUCED_COLOR_{part}")
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flag | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        pixels = None
    is_sized = part > 1 or (pixels is not None and pixels.shape == (height, width, 3))
    if pixels is None or pixels.ndim != 3 or not is_sized:
        raise LogError(
            f"an image of encoding {encoding[:24]!r} is damaged and cannot be decoded", COPY_AGAIN
        )
    pixels = pixels if part == 1 else cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)
    return np.asarray(pixels, np.uint8)


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Parse strictly: markers that a decoder skips in another way could show us another size."""
    at = 2
    for _ in range(1000):  # cameras write a few tens
        if data[at : at + 1] != b"\xff" or at + 9 > len(data):
            return None
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        if marker in _FRAME_MARKERS:
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            return width, height
        if marker == 0xFF:
            at += 1
        elif marker in _BEFORE_FRAME and length >= 2:
            at += 2 + length
        else:
            return None
    return None


def _png_size(data: bytes) -> tuple[int, int] | None:
    if not data.startswith(_PNG_START) or len(data) < 24:
        return None
    return struct.unpack(">II", data[16:24])


def _webp_size(data: bytes) -> tuple[int, int] | None:
    """Parse the three kinds: VP8 (lossy), VP8L (lossless), VP8X (either, with extras)."""
    kind, body = data[12:16], data[20:30]
    if len(body) < 10:
        return None
    if kind == b"VP8 " and body[3:6] == b"\x9d\x01\x2a":
        width, height = struct.unpack("<HH", body[6:10])
        return width & 0x3FFF, height & 0x3FFF
    if kind == b"VP8L" and body[0] == 0x2F:
        bits = int.from_bytes(body[1:5], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    if kind == b"VP8X" and not body[0] & 0x02:  # several pictures, which no camera writes
        return tuple(1 + int.from_bytes(body[at : at + 3], "little") for at in (4, 7))  # type: ignore[return-value]
    return None


# (width, height) [px] of a picture's header, by format; None where it makes no sense.
_SIZES = {"jpeg": _jpeg_size, "png": _png_size, "webp": _webp_size}


# ---- Bare pixels, in the encodings of sensor_msgs/Image


@dataclass(frozen=True)
class PixelFormat:
    """Memory layout of an encoding's pixels."""

    channels: int  # samples of a pixel in a row
    conversion: str | None = None  # OpenCV's name of the way to RGB; None where the pixels are RGB
    sample_bytes: int = 1  # 2 for samples of 16 bits, of which the upper 8 are shown
    # the pixels across and down that share a colour; the picture's size is a multiple of it
    color_block_px: tuple[int, int] = (1, 1)
    is_planar: bool = False  # whether the colours follow the brightness, in half as many rows again

    def row_bytes(self, width: int) -> int:
        """Return the bytes of one row without padding."""
        return width * self.channels * self.sample_bytes

    def rows(self, height: int) -> int:
        """Return the rows of bytes of a picture, chroma included."""
        return height * 3 // 2 if self.is_planar else height


# By the names of sensor_msgs/Image.
_FORMATS = {
    "rgb8": PixelFormat(3),
    "bgr8": PixelFormat(3, "COLOR_BGR2RGB"),
    "8UC3": PixelFormat(3, "COLOR_BGR2RGB"),  # unnamed channels are OpenCV's
    "rgba8": PixelFormat(4, "COLOR_RGBA2RGB"),
    "bgra8": PixelFormat(4, "COLOR_BGRA2RGB"),
    "8UC4": PixelFormat(4, "COLOR_BGRA2RGB"),
    "mono8": PixelFormat(1, "COLOR_GRAY2RGB"),
    "8UC1": PixelFormat(1, "COLOR_GRAY2RGB"),
    "mono16": PixelFormat(1, "COLOR_GRAY2RGB", sample_bytes=2),
    "16UC1": PixelFormat(1, "COLOR_GRAY2RGB", sample_bytes=2),
    "yuv422": PixelFormat(2, "COLOR_YUV2RGB_UYVY", color_block_px=(2, 1)),
    "uyvy": PixelFormat(2, "COLOR_YUV2RGB_UYVY", color_block_px=(2, 1)),
    "yuv422_yuy2": PixelFormat(2, "COLOR_YUV2RGB_YUY2", color_block_px=(2, 1)),
    "yuyv": PixelFormat(2, "COLOR_YUV2RGB_YUY2", color_block_px=(2, 1)),
    "nv12": PixelFormat(1, "COLOR_YUV2RGB_NV12", color_block_px=(2, 2), is_planar=True),
    "nv21": PixelFormat(1, "COLOR_YUV2RGB_NV21", color_block_px=(2, 2), is_planar=True),
}

# ROS names a Bayer pattern by its first row and then its second. OpenCV's old names of two letters
# begin in the second row; those of four letters mean what ROS means.
for _pattern in ("RGGB", "BGGR", "GBRG", "GRBG"):
    for _bits in (8, 16):
        _FORMATS[f"bayer_{_pattern.lower()}{_bits}"] = PixelFormat(
            1, f"COLOR_Bayer{_pattern}2RGB", sample_bytes=_bits // 8
        )


def pixel_format_of(encoding: str) -> PixelFormat:
    """Return the pixel format of an encoding; raise LogError for one that is not read."""
    found = _FORMATS.get(encoding)
    if found is None:
        why = f"not read (only {', '.join(_FORMATS)})"
        if encoding.startswith(("32F", "64F", "16S", "32S", "8S")):  # numbers, no brightness
            why = "distances, not what a camera sees"
        raise LogError(
            f"pictures of encoding {encoding[:24]!r} are {why}",
            "record the camera's colour or grey pictures",
        )
    return found


def decode_pixels(data: bytes, encoding: str, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Decode bare pixels, without padding and little-endian, to RGB uint8, shape (H, W, 3).

    Samples of 16 bits are shown by their upper 8, as if they filled their range: a camera of 12
    bits that leaves the upper ones empty is dark, but bright and dark keep their order. YUV is
    BT.601 of limited range, as cameras send it. LogError for an encoding that is not read, or
    another length than its size needs.
    """
    form = pixel_format_of(encoding)
    width, height = size
    rows, across = form.rows(height), width * form.channels
    if len(data) != rows * across * form.sample_bytes or any(
        length <= 0 or length % share
        for length, share in zip(size, form.color_block_px, strict=True)
    ):
        raise LogError(
            f"{len(data)} bytes are no {encoding} picture of {width} x {height} px", COPY_AGAIN
        )
    if form.sample_bytes == 2:
        samples = (np.frombuffer(data, "<u2") >> 8).astype(np.uint8)
    else:
        samples = np.frombuffer(data, np.uint8)
    shape = (rows, width) if form.channels == 1 else (rows, width, form.channels)
    if form.conversion is None:
        return samples.reshape(shape)
    import cv2

    conversion = getattr(cv2, form.conversion)
    return np.asarray(cv2.cvtColor(samples.reshape(shape), conversion), np.uint8)


def mean_of_blocks(picture: NDArray[np.uint8], scale: int) -> NDArray[np.uint8]:
    """Downsample by area averaging, shape (H, W) or (H, W, 3); left-over edges are cut."""
    if scale == 1:
        return picture
    import cv2

    height, width = picture.shape[:2]
    size = (width // scale, height // scale)
    cut = picture[: size[1] * scale, : size[0] * scale]
    return np.asarray(cv2.resize(cut, size, interpolation=cv2.INTER_AREA), np.uint8)
