"""Open a source in its own thread, so that Ctrl-C and a deadline work even if it blocks."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from tunenet_logs.errors import CameraAwayError


class _Opened(Protocol):
    def close(self) -> None: ...


Opened = TypeVar("Opened", bound=_Opened)


def opened_within(
    seconds: float, shown: str, open_source: Callable[[], Opened], *, what: str = "camera"
) -> Opened:
    """Open a source within `seconds`, raising the errors of `open_source` here.

    Name servers, drivers and libraries in C block the thread that calls them, and no signal is
    handled there until they return. What opens too late is closed.

    Raises:
        CameraAwayError: it takes longer.
    """
    opening = _Opening(open_source)
    opening.start()
    try:
        if not opening.is_done.wait(seconds):
            raise CameraAwayError(
                f"{shown}: cannot be opened within {seconds:g} s; is the {what} on?"
            )
        return opening.take()
    finally:
        opening.abandon()


class _Opening(threading.Thread, Generic[Opened]):
    """A daemon: a camera that never opens must not keep the process."""

    def __init__(self, open_source: Callable[[], Opened]) -> None:
        super().__init__(name="opening", daemon=True)
        self.is_done = threading.Event()
        self._open_source = open_source
        self._lock = threading.Lock()
        self._is_wanted = True
        self._source: Opened | None = None
        self._error: BaseException | None = None

    def run(self) -> None:
        try:
            source = self._open_source()
            with self._lock:
                if self._is_wanted:
                    self._source = source
                else:
                    source.close()
        except BaseException as error:  # noqa: BLE001 (it is raised again where it is waited for)
            self._error = error
        self.is_done.set()

    def take(self) -> Opened:
        """Return the opened source, or raise its error."""
        with self._lock:
            source, self._source = self._source, None
        if source is None:
            assert self._error is not None
            raise self._error
        return source

    def abandon(self) -> None:
        """Close the source unless it was taken, now or once it opens."""
        with self._lock:
            self._is_wanted = False
            if self._source is not None:
                self._source.close()
