"""Clips with sound, as cameras and recorders of voices write them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

RATE_HZ = 48_000  # samples a second
PICTURES_HZ = 30  # pictures a second


def clicks(
    at_s: Sequence[float], lasts_s: float = 3.0, rate_hz: int = RATE_HZ
) -> NDArray[np.float32]:
    """Damped tones that begin at the given times, shape (N,)."""
    times_s = np.arange(round(lasts_s * rate_hz)) / rate_hz
    samples = np.zeros(len(times_s))
    for begin_s in at_s:
        after_s = times_s - begin_s
        tone = np.exp(-after_s / 0.004) * np.sin(2 * np.pi * 3000 * after_s)
        samples += np.where(after_s >= 0, 0.5 * tone, 0.0)
    return samples.astype(np.float32)


def write_clip(
    path: Path,
    samples: NDArray[np.float32],
    codec: str,
    *,
    rate_hz: int = RATE_HZ,
    channels: int = 1,
    late_s: float = 0.0,
    film: str = "",
    pictures: int = 90,
    tags: Mapping[str, str] | None = None,
    form: str | None = None,
) -> None:
    """Write sound, of `channels` that are the same, beside a film where a codec for it is named.

    Args:
        samples: full scale 1, shape (N,).
        late_s: from the first picture to the first sample [s].
        film: codec of the pictures; "" for none.
        form: the container, where the file's name does not tell it.
    """
    with av.open(str(path), "w", format=form) as file:
        file.metadata.update(tags or {})
        video: Any = file.add_stream(film, rate=PICTURES_HZ) if film else None
        audio: Any = file.add_stream(codec, rate=rate_hz)
        layout = "mono" if channels == 1 else "stereo"
        audio.layout = layout
        if video is not None:
            video.width, video.height, video.pix_fmt = 64, 48, "yuv420p"
            for number in range(pictures):
                pixels = np.full((48, 64, 3), number * 7 % 255, np.uint8)
                picture = av.VideoFrame.from_ndarray(pixels, format="rgb24")
                picture.pts, picture.time_base = number, Fraction(1, PICTURES_HZ)
                file.mux(video.encode(picture))
            file.mux(video.encode(None))
        late = round(late_s * rate_hz)
        for begin in range(0, len(samples), 1024):
            piece = np.tile(samples[begin : begin + 1024], (channels, 1))
            frame = av.AudioFrame.from_ndarray(piece, format="fltp", layout=layout)
            frame.sample_rate, frame.pts = rate_hz, begin + late
            frame.time_base = Fraction(1, rate_hz)
            file.mux(audio.encode(frame))
        file.mux(audio.encode(None))


def found_late_s(
    samples: NDArray[np.float32], expected: NDArray[np.float32], rate_hz: float
) -> float:
    from scipy.signal import correlate

    both = correlate(samples.astype(float), expected.astype(float), method="fft")
    return (int(np.argmax(both)) - (len(expected) - 1)) / rate_hz
