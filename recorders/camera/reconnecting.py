"""Reconnect to a network camera that may start late, fall silent, or go and come back.

Each connection is a `CameraLink`, a thread of its own that puts its frames into one inbox.
`ReconnectingCamera` takes them, and opens another link where the running one is silent or gone.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from queue import Empty, Full, Queue

from tunenet_logs.errors import CameraAwayError
from tunenet_logs.recorders.camera.base import CapturedFrame, Source

_LOOK_S = 0.1  # how often to look at the clock while nothing comes
_BETWEEN_S = 0.5  # from the start of one link to the next: more do not hurry a camera that is away
_BRIEF_S = 1.0  # a brief connection is ended by the camera sooner than that after its first frame


class CameraLink(threading.Thread):
    """A thread that opens a camera and puts its frames into an inbox, None at its end.

    A daemon: a camera that never answers must not keep the process. What a link that was given up
    had put in is left to whoever takes it.
    """

    def __init__(self, inbox: Inbox, open_camera: Callable[[], Source]) -> None:
        super().__init__(name="camera link", daemon=True)
        self.source: Source | None = None  # None until it is open
        self.error: Exception | None = None  # why it failed; None where it did not
        self.is_wanted = True  # False once it is given up
        self._inbox = inbox
        self._open_camera = open_camera

    def run(self) -> None:
        """Open and read the camera until it ends or is given up."""
        try:
            source = self.source = self._open_camera()
            try:
                if self.is_wanted:  # one who gives it up from here on sees the source to close
                    with closing(source.frames()) as shots:  # type: ignore[type-var]
                        for shot in shots:
                            if not self._put(shot):
                                return
            finally:
                source.close()
        except Exception as error:  # noqa: BLE001 (whoever takes the end of it raises it)
            self.error = error
        finally:
            self._put(None)

    def give_up(self) -> None:
        """Abandon the link, from any thread."""
        self.is_wanted = False
        if self.source is not None:
            self.source.close()

    def _put(self, shot: CapturedFrame | None) -> bool:
        """Wait for room; return False once the link was given up."""
        while self.is_wanted:
            with suppress(Full):
                self._inbox.put((self, shot), timeout=_LOOK_S)
                return True
        return False


Inbox = Queue[tuple[CameraLink, CapturedFrame | None]]


def lasting_camera(
    open_camera: Callable[[], Source], *, wait_s: float, stall_s: float, say: Callable[[str], None]
) -> Source:
    """Open a camera that reconnects where that can help."""
    until = time.monotonic() + wait_s
    is_said = False
    while True:
        next_at = time.monotonic() + _BETWEEN_S
        try:
            source = open_camera()
            break
        except CameraAwayError as error:
            now = time.monotonic()
            if now >= until:
                raise
            if not is_said:
                say(f"{_without_remedy(error)}; waiting for it, {wait_s:g} s at most")
                is_said = True
            time.sleep(max(0.0, min(until, next_at) - now))
    if not source.returns:
        return source
    return ReconnectingCamera(source, open_camera, until=until, stall_s=stall_s, say=say)


class ReconnectingCamera:
    """Delivers the frames of successive connections as a single source.

    Where the connection breaks, a new one is tried, and again until `stall_s` have passed since the
    last frame. Where it falls silent, a new one is tried beside it; the one that delivers first is
    kept. A camera that ends its stream itself is not asked again, nor one that hangs up again and
    again after a few pictures.
    """

    live = True
    returns = False

    def __init__(
        self,
        first: Source,
        open_camera: Callable[[], Source],
        *,
        until: float,
        stall_s: float,
        say: Callable[[str], None],
    ) -> None:
        self.name = first.name
        self.ended = ""
        self._source = first
        self._open_camera = open_camera
        self._say = say
        self._inbox: Inbox = Queue(maxsize=4)  # frames are taken as they come
        self._links = [CameraLink(self._inbox, lambda: first)]
        self._delivering: CameraLink | None = self._links[0]
        self._hanging: list[CameraLink] = []
        self._connection = self._brief = 0
        self._damaged = self._dropped = 0
        self._stall_s = stall_s
        self._heard = self._tried = self._began = time.monotonic()
        self._tries_until = until
        self._patience_s = max(stall_s, until - self._heard)
        self._lost = self._not_back = ""
        self._failure: Exception | None = None
        self._closed = False

    @property
    def damaged(self) -> int:
        """Number of damaged pictures of all connections."""
        return self._damaged + sum(link.source.damaged for link in self._links if link.source)

    @property
    def dropped(self) -> int:
        """Number of dropped pictures of all connections."""
        return self._dropped + sum(link.source.dropped for link in self._links if link.source)

    def notes(self) -> dict[str, str]:
        """Return the notes of the latest connection that delivered."""
        return self._source.notes()

    def frames(self) -> Iterator[CapturedFrame]:
        """Yield the frames as they come, each with the number of its connection."""
        self._links[0].start()
        try:
            while not self._closed and not self.ended:
                self._try_when_due()
                try:
                    link, shot = self._inbox.get(timeout=_LOOK_S)
                except Empty:  # end where no more frames can come
                    if self._failure is not None and not self._links:
                        raise self._failure from None
                    now = time.monotonic()
                    if now - self._heard >= self._patience_s:
                        whys = ": " + ", then ".join(filter(None, (self._lost, self._not_back)))
                        ended = f"no frame for {self._patience_s:.1f} s{whys}"
                        self.ended = ended.removesuffix(": ")
                    elif now >= self._tries_until and not self._links:
                        self.ended = self._lost
                    continue
                if link.is_wanted and shot is None:
                    self._has_ended(link)
                elif link.is_wanted and shot is not None:
                    self._has_come(link)
                    yield shot._replace(connection=self._connection)
        finally:
            self.close()

    def close(self) -> None:
        """End a running `frames`, and close every connection."""
        self._closed = True
        for link in list(self._links):
            link.give_up()

    def _try_when_due(self) -> None:
        """Open a link where the camera is away or silent, and none is being opened."""
        now = time.monotonic()
        if self._failure or now >= self._tries_until or now < self._tried + _BETWEEN_S:
            return
        if self._delivering is not None:
            # After 3 s of silence a link is tried beside the silent one: where the camera's end of
            # a connection is gone, ours may never hear of it.
            if now - self._heard < min(3.0, self._stall_s / 2):
                return
            self._lose("fell silent")
        for link in [one for one in self._links if one is not self._delivering][:1]:
            # A link has 10 s for its first frame, before another takes its place: as long as
            # opening may take, and as key frames may be apart.
            if now < self._tried + 10.0:
                return
            self._give_up(link)
        self._hanging = [link for link in self._hanging if link.is_alive()]
        # No more are opened while four that were given up still hang in a library.
        if len(self._hanging) < 4:
            self._tried = now
            self._links.append(CameraLink(self._inbox, self._open_camera))
            self._links[-1].start()

    def _has_come(self, link: CameraLink) -> None:
        """Take a link that delivers; abandon the others."""
        for other in [one for one in self._links if one is not link]:
            self._give_up(other)
        now = time.monotonic()
        if self._lost and self._connection:
            self._say(f"camera back after {now - self._heard:.1f} s")
        if link is not self._delivering or not self._connection:
            assert link.source is not None
            self._delivering, self._source = link, link.source
            self._connection += 1
            self._began = now
        self._lost = self._not_back = ""
        self._patience_s = self._stall_s
        self._heard, self._tries_until = now, now + self._stall_s

    def _has_ended(self, link: CameraLink) -> None:
        """Handle the end of a link, however it ended."""
        self._forget(link)
        source, error = link.source, link.error
        if error is not None and not isinstance(error, CameraAwayError):
            self._failure = error
        if source is None or error:  # without the camera's name, which every line has
            why = _without_remedy(error).removeprefix(f"{self.name.removeprefix('camera ')}: ")
        else:
            why = source.ended
        if link is not self._delivering:
            self._not_back = why
            return
        self._delivering = None
        if source is not None and not source.returns and not error:
            self.ended = why
            return
        is_brief = self._connection > 0 and self._heard - self._began < _BRIEF_S
        self._brief = self._brief + 1 if is_brief else 0
        # A drop takes longer, and the camera would be asked again for ever.
        if self._brief == 10 and self._failure is None:
            so = f"within {_BRIEF_S:g} s of its first picture"
            self.ended = f"{why}, {self._brief} times in a row {so}"
        else:
            self._lose(why)

    def _lose(self, why: str) -> None:
        """Report that the camera is away."""
        if self._lost or self._failure:
            return
        self._lost = why
        left_s = self._tries_until - time.monotonic()
        if left_s > 0:
            self._say(f"{self.name}: {why}; trying again, {left_s:.1f} s at most")

    def _give_up(self, link: CameraLink) -> None:
        self._forget(link)
        self._hanging.append(link)
        link.give_up()

    def _forget(self, link: CameraLink) -> None:
        self._links.remove(link)
        if link.source is not None:
            self._damaged += link.source.damaged
            self._dropped += link.source.dropped


def _without_remedy(error: Exception | None) -> str:
    return str(error).partition(";")[0]
