"""Check that a JPEG is whole, and encode bare pixels as JPEG."""

from __future__ import annotations

import numpy as np

from tunenet_logs.episode import Frame
from tunenet_logs.errors import LogError
from tunenet_logs.images import image_size

_QUALITY = 95  # of 100: a ball's edge stays sharp, at a fraction of the bare pixels' size


def is_whole(data: bytes) -> bool:
    """Check whether `data` is one JPEG from first marker to last, of a size that cameras have.

    Zeros and white space after the end are a sender's padding. What lies between is not decoded.
    """
    if not data.startswith(b"\xff\xd8") or not data.rstrip(b"\0 \t\r\n").endswith(b"\xff\xd9"):
        return False
    try:
        image_size(data)
    except LogError:
        return False
    return True


def compressed(frame: Frame) -> Frame:
    """Encode a frame of bare pixels as JPEG; one that is compressed already stays as it is.

    Colour is kept at full resolution (4:4:4): a small ball is found by its colour.
    """
    if frame.size is None:
        return frame
    import cv2

    bgr = cv2.cvtColor(frame.decode(), cv2.COLOR_RGB2BGR)
    return Frame(frame.stamp_ns, "jpeg", from_bgr(bgr))


def from_bgr(pixels: np.ndarray) -> bytes:
    """Encode pixels as JPEG, uint8: BGR of shape (H, W, 3), or grey of shape (H, W).

    Raises:
        LogError: a picture wider or higher than any JPEG.
    """
    import cv2

    settings = [cv2.IMWRITE_JPEG_QUALITY, _QUALITY]
    settings += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    done, data = cv2.imencode(".jpg", pixels, settings)
    if not done:
        height, width = pixels.shape[:2]
        raise LogError(f"a picture of {width} x {height} px fits no JPEG; record a smaller one")
    return data.tobytes()
