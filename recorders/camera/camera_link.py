"""One connection to a camera, opened and read in its own thread for as long as it is wanted."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from contextlib import closing
from typing import NamedTuple

from recorders.camera.base import Shot, Source

_MAX_WAITING = 4  # shots of one link that wait to be taken: they are taken as they come


class Brought(NamedTuple):
    """What a link delivers: a frame, or None at its end.

    Attributes:
        shot: None where there are no more.
    """

    link: CameraLink
    shot: Shot | None


class CameraLink(threading.Thread):
    """A thread that opens a camera and puts its frames into an inbox.

    A daemon: a camera that never answers must not keep the process.

    Attributes:
        source: None until it is open.
        error: why it failed; None where it did not.
        is_wanted: False once it is given up.
    """

    def __init__(self, inbox: Inbox, open_camera: Callable[[], Source]) -> None:
        super().__init__(name="camera link", daemon=True)
        self.source: Source | None = None
        self.error: Exception | None = None
        self._inbox = inbox
        self._open_camera = open_camera
        self.is_wanted = True

    def run(self) -> None:
        """Open and read the camera until it ends or is given up."""
        try:
            source = self.source = self._open_camera()
            try:
                if self.is_wanted:  # one who gives it up from here on sees the source to close
                    self._read(source)
            finally:
                source.close()
        except Exception as error:  # noqa: BLE001 (whoever takes the end of it raises it)
            self.error = error
        finally:
            self._inbox.put(Brought(self, None))

    def give_up(self) -> None:
        """Abandon the link, from any thread."""
        self.is_wanted = False
        self._inbox.forget(self)
        if self.source is not None:
            self.source.close()

    def _read(self, source: Source) -> None:
        with closing(source.frames()) as shots:  # type: ignore[type-var]
            for shot in shots:
                if not self._inbox.put(Brought(self, shot)):
                    return


class Inbox:
    """Queue of the frames that the running links deliver, in order of arrival."""

    def __init__(self) -> None:
        self._items: deque[Brought] = deque()
        self._changed = threading.Condition()

    def put(self, brought: Brought) -> bool:
        """Add an item once there is room; False if its link was given up."""
        link, shot = brought
        with self._changed:
            while shot and len(self._items) >= _MAX_WAITING and link.is_wanted:
                self._changed.wait()
            if link.is_wanted:
                self._items.append(brought)
                self._changed.notify_all()
            return link.is_wanted

    def take(self, wait_s: float) -> Brought | None:
        """Return the oldest item; None where none comes within `wait_s`."""
        with self._changed:
            if not self._items:
                self._changed.wait(wait_s)
            if not self._items:
                return None
            self._changed.notify_all()
            return self._items.popleft()

    def forget(self, link: CameraLink) -> None:
        """Discard the items of a link."""
        with self._changed:
            self._items = deque(one for one in self._items if one.link is not link)
            self._changed.notify_all()
