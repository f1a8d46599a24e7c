"""The interface of all frame sources."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple, Protocol

from tunenet_logs.episode import Frame


class CapturedFrame(NamedTuple):
    """One frame as it came.

    Attributes:
        frame: the compressed picture, stamped when its first byte arrived, on the clock of
            `tunenet_logs.timing.stamps`; in a video file, stamped with the time that it states.
        source_stamp_ns: capture time reported by the camera [ns], on a clock of arbitrary origin;
            None where it reports none.
        stands_alone: whether it can be decoded without earlier frames, as every JPEG can.
        connection: number of its connection; the camera's clock may restart with each.
    """

    frame: Frame
    source_stamp_ns: int | None = None
    stands_alone: bool = True
    connection: int = 0


class Source(Protocol):
    """An open camera or video.

    Attributes:
        name: what recorded it, in words, without credentials and without a folder.
        live: whether a missed frame is lost.
    """

    name: str
    live: bool

    @property
    def returns(self) -> bool:
        """Whether reconnecting may bring more frames once this one is silent or has ended.

        False for files and plugged-in cameras, and once a camera has ended its stream itself.
        """
        ...

    @property
    def ended(self) -> str:
        """Why there are no more frames; "" at the end of a file."""
        ...

    @property
    def damaged(self) -> int:
        """Number of incomplete pictures that were skipped."""
        ...

    @property
    def dropped(self) -> int:
        """Number of pictures dropped because this machine could not keep up."""
        ...

    def notes(self) -> dict[str, str]:
        """Return notes for the log: settings asked and accepted, codec, ..."""
        ...

    def frames(self) -> Iterator[CapturedFrame]:
        """Yield the frames in order; call it once.

        Raises:
            TuneNetError: the source failed.
        """
        ...

    def close(self) -> None:
        """Close the source, from any thread; a running `frames` ends soon after."""
        ...
