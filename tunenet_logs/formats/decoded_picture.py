"""Decoded video pictures as frames: converted to RGB on demand, at the size asked for."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Frame
from tunenet_logs.errors import COPY_AGAIN, LogError
from tunenet_logs.pixels import mean_of_blocks

if TYPE_CHECKING:
    from av import VideoFrame

_TURNS = {90: "ROTATE_90_COUNTERCLOCKWISE", 180: "ROTATE_180", 270: "ROTATE_90_CLOCKWISE"}


def decoded_frame(
    stamp_ns: int, picture: VideoFrame, rotation_deg: int = 0, *, dithered: bool = False
) -> Frame:
    """Wrap a decoded picture as a frame, kept as its decoder gave it: half of RGB's size.

    Args:
        stamp_ns: acquisition stamp.
        picture: not changed by its decoder any more.
        rotation_deg: counterclockwise turn that brings it upright; a multiple of 90.
        dithered: whether it has few colours that alternate, which stand for their mean.
    """
    width, height = picture.width, picture.height
    upright = (height, width) if rotation_deg % 180 else (width, height)
    pixels = partial(_rgb, picture, rotation_deg % 360, dithered)
    return Frame(stamp_ns, "rgb8", b"", upright, pixels)


def _rgb(picture: VideoFrame, rotation_deg: int, dithered: bool, scale: int) -> NDArray[np.uint8]:
    """Convert to RGB, reduced by the integer factor `scale`, shape (H, W, 3).

    Raises:
        LogError: it cannot be converted.
    """
    import cv2
    from av.error import FFmpegError

    try:
        pixels = np.asarray(picture.to_ndarray(format="rgb24"), np.uint8)
    except (FFmpegError, ValueError, OverflowError, MemoryError) as error:
        raise LogError(f"a picture of a video cannot be shown ({error})", COPY_AGAIN) from error
    if not dithered and picture.width % scale == picture.height % scale == 0:
        pixels, scale = mean_of_blocks(pixels, scale), 1  # the same, and less to turn
    if rotation_deg:
        pixels = np.asarray(cv2.rotate(pixels, getattr(cv2, _TURNS[rotation_deg])), np.uint8)
    if dithered:
        pixels = np.asarray(cv2.GaussianBlur(pixels, (0, 0), 1.0), np.uint8)
    return mean_of_blocks(pixels, scale)
