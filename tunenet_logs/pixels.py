"""Decode bare pixels in the encodings of sensor_msgs/Image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.errors import COPY_AGAIN, LogError

_DEPTH = ("32F", "64F", "16S", "32S", "8S")  # how encodings of numbers begin that are no brightness
_RECORD_COLOUR = "record the camera's colour or grey pictures"


@dataclass(frozen=True)
class PixelFormat:
    """Memory layout of an encoding's pixels.

    Attributes:
        channels: samples of a pixel in a row.
        conversion: OpenCV's name of the way to RGB; None where the pixels are RGB.
        sample_bytes: 2 for samples of 16 bits, of which the upper 8 are shown.
        color_block_px: the pixels across and down that share a colour; the picture's size is a
            multiple of it.
        is_planar: whether the colours follow the brightness, in half as many rows again.
    """

    channels: int
    conversion: str | None = None
    sample_bytes: int = 1
    color_block_px: tuple[int, int] = (1, 1)
    is_planar: bool = False

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
    """Return the pixel format of an encoding.

    Raises:
        LogError: it is not read; the message says why.
    """
    found = _FORMATS.get(encoding)
    if found is None:
        name = encoding[:24]
        if name.startswith(_DEPTH):
            raise LogError(
                f"pictures of encoding {name!r} are distances, not what a camera sees",
                _RECORD_COLOUR,
            )
        raise LogError(
            f"pictures of encoding {name!r} are not read (only {', '.join(_FORMATS)})",
            _RECORD_COLOUR,
        )
    return found


def decode_pixels(data: bytes, encoding: str, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Decode bare pixels, without padding and little-endian, to RGB uint8, shape (H, W, 3).

    Samples of 16 bits are shown by their upper 8, as if they filled their range: a camera of 12
    bits that leaves the upper ones empty is dark, but bright and dark keep their order. YUV is
    BT.601 of limited range, as cameras send it.

    Raises:
        LogError: of an encoding that is not read, or of another length than its size needs.
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
