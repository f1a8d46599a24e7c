"""Sound, recorded by a microphone beside the pictures, or alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Sound:
    """Sound track.

    Attributes:
        name: of its topic.
        start_ns: stamp of the first sample, on the log's clock.
        rate_hz: samples in a second of the log's clock: that of the pictures, so that sound which
            was slowed down with its video has more than its file says.
        samples: of all channels together, full scale 1, shape (N,).
        file_rate_hz: as the file says.
        channels: that there were.
        codec: as the file names it.
        warnings: what a user should know, in words.
    """

    name: str
    start_ns: int
    rate_hz: float
    samples: NDArray[np.float32]
    file_rate_hz: float
    channels: int = 1
    codec: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def lasts_s(self) -> float:
        """Duration on the log's clock [s]."""
        return len(self.samples) / self.rate_hz
