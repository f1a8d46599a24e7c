"""What every source of live sound offers."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

PIECE_S = 0.02
"""Of sound, that comes in one piece where the source may choose."""


class SoundPiece(NamedTuple):
    """Some samples, as they came.

    Attributes:
        first: number of its first sample since the source was started; those that were lost on
            the way from the device are not counted, since nobody knows how many they were.
        begin_ns: when that was taken, as far as the device tells, on the clock of
            `tunenet_logs.clock`. It jitters; `SampleClock` finds the time behind it.
        pcm: 16-bit samples of all channels together, shape (N,).
        follows_loss: whether the device says that samples before it were lost.
    """

    first: int
    begin_ns: int
    pcm: NDArray[np.int16]
    follows_loss: bool = False


Take = Callable[[SoundPiece], object]
"""What is called with each piece, from a thread of the source; it never waits."""


class SoundSource(Protocol):
    """A microphone, or what is played in its place, opened.

    Attributes:
        name: what is heard, in words.
        rate_hz: samples in a second, as the source says.
    """

    name: str
    rate_hz: float

    @property
    def ended(self) -> str:
        """Why no more sound comes; "" while it does."""
        ...

    def start(self, take: Take) -> None:
        """Begin to deliver pieces. To be called once.

        Raises:
            MicrophoneError: it does not start.
        """
        ...

    def close(self) -> None:
        """Deliver no more, and let go of it. Safe to call twice."""
        ...
