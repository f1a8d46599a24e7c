"""What every source of frames offers."""

from __future__ import annotations

from collections.abc import Iterator
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
