"""Encode a sound as users have it: PCM in WAV, or AAC in M4A."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

AAC_BIT_S = 64_000
_AAC_SAMPLES = 1024  # of one packet


def write_sound(samples: NDArray[np.float32], rate_hz: int, path: Path) -> None:
    """Write .wav (16 bits) or .m4a (AAC, 64 kbit/s), by the path's end."""
    data = wav_bytes(samples, rate_hz) if path.suffix == ".wav" else aac_bytes(samples, rate_hz)
    path.write_bytes(data)


def wav_bytes(samples: NDArray[np.float32], rate_hz: int) -> bytes:
    """Encode a WAV file of 16 bits, one channel."""
    import wave

    whole = np.clip(np.round(samples.astype(np.float64) * 32768), -32768, 32767).astype("<i2")
    held = io.BytesIO()
    with wave.open(held, "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(rate_hz)
        file.writeframes(whole.tobytes())
    return held.getvalue()


def aac_bytes(samples: NDArray[np.float32], rate_hz: int) -> bytes:
    """Encode an M4A file, with the encoder's priming before the first sample, as phones do."""
    import av

    held = io.BytesIO()
    with av.open(held, "w", format="mp4") as container:
        stream: Any = container.add_stream("aac", rate=rate_hz)
        stream.bit_rate = AAC_BIT_S
        stream.layout = "mono"
        add_sound(container, stream, samples, rate_hz)
    return held.getvalue()


def add_sound(
    container: Any, stream: Any, samples: NDArray[np.float32], rate_hz: int, at: int = 0
) -> None:
    """Encode a sound, shape (N,), into an open PyAV container."""
    import av

    for start in range(0, len(samples), _AAC_SAMPLES):
        piece = np.ascontiguousarray(samples[None, start : start + _AAC_SAMPLES], np.float32)
        frame = av.AudioFrame.from_ndarray(piece, format="fltp", layout="mono")
        frame.sample_rate, frame.pts = rate_hz, at + start
        container.mux(stream.encode(frame))
    container.mux(stream.encode(None))


def through_aac(samples: NDArray[np.float32], rate_hz: int) -> NDArray[np.float32]:
    """Pass a sound through AAC: as long as before, at the same times."""
    import av

    heard = np.zeros(len(samples), np.float32)
    with av.open(io.BytesIO(aac_bytes(samples, rate_hz)), "r") as container:
        for frame in container.decode(audio=0):
            assert frame.pts is not None
            assert frame.time_base is not None
            start = round(float(frame.pts * frame.time_base) * rate_hz)
            piece = frame.to_ndarray()[0]
            low, high = max(start, 0), min(start + len(piece), len(heard))
            if low < high:
                heard[low:high] = piece[low - start : high - start]
    return np.clip(heard, -1.0, 1.0)
