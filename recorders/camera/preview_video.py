"""A few pictures a second of a video that goes into the log undecoded, for whoever looks."""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator

from tunenet_logs.episode import Frame
from tunenet_logs.errors import LogError
from tunenet_logs.formats.video_messages import Packet, decoded
from tunenet_logs.jpeg import compressed

_MOST_WAITING_BYTES = 8 * 1024 * 1024
"""Of compressed pictures; where more wait, what waits is skipped up to the next key frame."""

_PERIOD_S = 0.2
"""Between two pictures that are shown: enough to aim by."""

_NICENESS = 10
"""Of the thread that decodes: recording comes first."""


class PreviewVideo(threading.Thread):
    """Decodes what it is offered and gives some of it on as JPEGs, in a thread of its own.

    Args:
        show: takes a picture.
    """

    def __init__(self, show: Callable[[Frame], None]) -> None:
        super().__init__(name="preview", daemon=True)
        self._show = show
        self._waiting: deque[Frame] = deque()
        self._bytes = 0
        self._skipped = False
        self._closed = False
        self._changed = threading.Condition()

    def offer(self, frame: Frame) -> None:
        """Add the next of the video's pictures. Never waits."""
        with self._changed:
            if self._bytes > _MOST_WAITING_BYTES:
                self._forget()
            self._waiting.append(frame)
            self._bytes += len(frame.data)
            self._changed.notify_all()

    def skip(self) -> None:
        """What is offered next does not follow upon what was offered last."""
        with self._changed:
            self._forget()

    def close(self) -> None:
        """End the thread."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def run(self) -> None:
        """Decode what is offered until closed."""
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICENESS)
        due = 0.0
        while not self._closed:
            try:
                for picture in decoded(self._in_a_row()):
                    if time.monotonic() >= due:
                        self._show(compressed(picture))
                        due = time.monotonic() + _PERIOD_S
            except LogError:  # nothing here decodes it; the log holds it all the same
                return

    def _forget(self) -> None:
        self._waiting.clear()
        self._bytes = 0
        self._skipped = True

    def _in_a_row(self) -> Iterator[Packet]:
        """What is offered, up to where something is skipped."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._skipped or self._closed)
                if self._skipped or self._closed:
                    self._skipped = False
                    return
                frame = self._waiting.popleft()
                self._bytes -= len(frame.data)
            yield Packet(frame.stamp_ns, frame.encoding, frame.data)
