"""The interface of all frame sources, and what most of them share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import NamedTuple, Protocol

from tunenet_logs.episode import Frame


class CapturedFrame(NamedTuple):
    """One frame as it came."""

    # The compressed picture, stamped when its first byte arrived, on the clock of
    # `tunenet_logs.timing.stamps`; in a video file, stamped with the time that it states.
    frame: Frame
    source_stamp_ns: int | None = None  # by the camera's clock, if it has one, of any origin [ns]
    stands_alone: bool = True  # whether it can be decoded without earlier frames, as every JPEG can
    connection: int = 0  # number of its connection; the camera's clock may restart with each


class Source(Protocol):
    """An open camera or video."""

    name: str  # what recorded it, in words, without credentials and without a folder
    live: bool  # whether a missed frame is lost

    @property
    def returns(self) -> bool:
        """Whether reconnecting may bring more frames; not once a camera ended its stream itself."""
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
        """Yield the frames in order, or raise TuneNetError; call it once."""
        ...

    def close(self) -> None:
        """Close the source, from any thread; a running `frames` ends soon after."""
        ...


class BaseSource(ABC):
    """A `Source` that is read in one thread and closed from any.

    A kind of camera yields its pictures from `_shots`, and frees what it holds in `_release`: once,
    where `frames` ends, or at once where nobody has begun to read.
    """

    live = True
    dropped = 0

    def __init__(self, name: str, *, returns: bool = True) -> None:
        self.name = name
        self.returns = returns
        self.ended = ""
        self.damaged = 0
        self._is_closed = self._is_read = False

    def frames(self) -> Iterator[CapturedFrame]:
        """Yield the pictures as they come, until the stream ends or falls silent."""
        self._is_read = True
        try:
            for shot in self._shots():
                if self._is_closed:
                    return
                yield shot
        finally:
            self._release()

    def close(self) -> None:
        """End a running `frames` with the next picture."""
        self._is_closed = True
        if not self._is_read:
            self._release()

    @abstractmethod
    def _shots(self) -> Iterator[CapturedFrame]: ...

    @abstractmethod
    def _release(self) -> None: ...
