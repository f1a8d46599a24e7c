"""The interface of all live sound sources."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

PIECE_S = 0.02  # of sound, that comes in one piece where the source may choose


class SoundPiece(NamedTuple):
    """A block of samples as it came.

    Attributes:
        first: number of its first sample since the start; samples lost on the way from the device
            are not counted, since nobody knows how many they were.
        begin_ns: capture time of that sample as reported by the device, on the clock of
            `tunenet_logs.clock`. It jitters; `SampleClock` finds the uniform clock behind it.
        pcm: 16-bit samples of all channels together, shape (N,).
        follows_loss: whether the device reports samples lost before it.
    """

    first: int
    begin_ns: int
    pcm: NDArray[np.int16]
    follows_loss: bool = False


# What is called with each piece, from a thread of the source; it never waits.
Take = Callable[[SoundPiece], object]


class SoundSource(Protocol):
    """An open microphone, or a file played in its place.

    Attributes:
        name: what is recorded, in words.
        rate_hz: nominal sample rate.
    """

    name: str
    rate_hz: float

    @property
    def ended(self) -> str:
        """Why no more sound comes; "" while it does."""
        ...

    def start(self, take: Take) -> None:
        """Begin to deliver blocks; call it once.

        Raises:
            MicrophoneError: it does not start.
        """
        ...

    def close(self) -> None:
        """Stop and close the source. Safe to call twice."""
        ...
