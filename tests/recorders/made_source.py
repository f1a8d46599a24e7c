"""A camera of which a test says what it brings."""

from __future__ import annotations

import threading
from collections.abc import Iterator

from tunenet_logs.recorders.camera.base import CapturedFrame


class MadeSource:
    """Brings the shots that it is given.

    Attributes:
        closed: once it is.
    """

    name, live, returns = "camera made up", True, False
    ended, damaged, dropped = "", 0, 0

    def __init__(self, shots: Iterator[CapturedFrame]) -> None:
        self.closed = threading.Event()
        self._shots = shots

    def notes(self) -> dict[str, str]:
        """Nothing."""
        return {}

    def frames(self) -> Iterator[CapturedFrame]:
        """The shots as they are made."""
        return self._shots

    def close(self) -> None:
        """Remember that."""
        self.closed.set()
