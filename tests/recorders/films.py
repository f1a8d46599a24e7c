"""Short films in any container, as bytes."""

from __future__ import annotations

import tempfile
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import av
import numpy as np

RATE_HZ = 30


@cache
def film(kind: str, codec: str = "libx264", count: int = 30, **options: str) -> bytes:
    """A film of 64 x 48 px whose pictures differ.

    Args:
        kind: FFmpeg's name of the container.
        codec: what compresses.
        count: of its pictures, 30 a second.
        options: of the container.
    """
    with tempfile.TemporaryDirectory() as folder:  # to write an index first, it is read again
        path = Path(folder) / "film"
        _write(path, kind, codec, count, options)
        return path.read_bytes()


def _write(path: Path, kind: str, codec: str, count: int, options: dict[str, str]) -> None:
    container: Any = av.open(str(path), "w", format=kind, options=options)
    stream = container.add_stream(codec, rate=RATE_HZ)
    stream.width, stream.height, stream.gop_size = 64, 48, 10
    stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
    stream.codec_context.time_base = Fraction(1, RATE_HZ)
    if codec == "libx264":
        stream.options = {"tune": "zerolatency", "preset": "ultrafast"}
    for number in range(count):
        pixels = np.full((48, 64, 3), 60, np.uint8)
        pixels[:, 2 * number % 60 :][:, :4] = 220
        picture = av.VideoFrame.from_ndarray(pixels, format="rgb24")
        picture.pts = number
        container.mux(stream.encode(picture))
    container.mux(stream.encode(None))
    container.close()
