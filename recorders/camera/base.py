"""What every source of frames offers, and the clock of those that are live."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import cache
from typing import Protocol

from tunenet_logs.episode import Frame


class Source(Protocol):
    """A camera or a video, opened.

    Attributes:
        name: what recorded it, in words, without credentials and without a folder.
        live: whether a frame is gone once it is missed.
        ended: why there are no more frames; "" at the end of a file.
        damaged: parts that were no whole picture and were skipped.
    """

    name: str
    live: bool
    ended: str
    damaged: int

    def notes(self) -> dict[str, str]:
        """What the log should say of it: settings asked and accepted, codec, ..."""
        ...

    def frames(self) -> Iterator[Frame]:
        """The frames in order, each with a picture that is compressed. To be asked for once.

        Raises:
            TuneNetError: it failed in a way that a user should hear of.
        """
        ...

    def close(self) -> None:
        """Let go of it. From any thread; running `frames` end by themselves soon after."""
        ...


@cache
def _anchor_ns() -> int:
    return time.time_ns() - time.monotonic_ns()


def wall_ns(monotonic_ns: int) -> int:
    """A monotonic time on the wall clock, as that stood when it was first asked for.

    Anchored once: a wall clock that is set while recording must not bend the stamps.
    """
    return _anchor_ns() + monotonic_ns
