"""What every source of frames offers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple, Protocol

from tunenet_logs.episode import Frame


class Shot(NamedTuple):
    """One picture as it came.

    Attributes:
        frame: the picture, compressed; its stamp is when its first byte arrived, on the clock of
            `tunenet_logs.clock`; of a file, the time that the file states.
        told_ns: when the camera says that it was taken, on the camera's own clock, which begins
            anywhere; None where it says nothing.
        stands_alone: whether it can be decoded without those before it, as every JPEG can.
        connection: by which it came: with each the camera's clock may begin anew.
    """

    frame: Frame
    told_ns: int | None = None
    stands_alone: bool = True
    connection: int = 0


class Source(Protocol):
    """A camera or a video, opened.

    Attributes:
        name: what recorded it, in words, without credentials and without a folder.
        live: whether a frame is gone once it is missed.
    """

    name: str
    live: bool

    @property
    def returns(self) -> bool:
        """Whether a new connection may bring more where this one is silent or has ended.

        Not of files and plugged-in cameras, and not once a camera ended its stream itself.
        """
        ...

    @property
    def ended(self) -> str:
        """Why there are no more frames; "" at the end of a file."""
        ...

    @property
    def damaged(self) -> int:
        """Parts that were no whole picture and were skipped."""
        ...

    @property
    def dropped(self) -> int:
        """Pictures that came, and were let go because this machine could not keep up."""
        ...

    def notes(self) -> dict[str, str]:
        """What the log should say of it: settings asked and accepted, codec, ..."""
        ...

    def frames(self) -> Iterator[Shot]:
        """The shots in order. To be asked for once.

        Raises:
            TuneNetError: it failed in a way that a user should hear of.
        """
        ...

    def close(self) -> None:
        """Let go of it. From any thread; running `frames` end by themselves soon after."""
        ...
