"""Decode a few pictures per second of a video for the preview; the log keeps it undecoded."""

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

# Of compressed pictures; where more wait, what waits is skipped up to the next key frame.
_MAX_WAITING_BYTES = 8 * 1024 * 1024

_PERIOD_S = 0.2  # between two pictures that are shown: enough to aim by
_NICENESS = 10  # of the thread that decodes: recording comes first


class PreviewVideo(threading.Thread):
    """A thread that decodes video and shows some of its frames as JPEGs."""

    def __init__(self, show: Callable[[Frame], None]) -> None:
        super().__init__(name="preview", daemon=True)
        self._show = show
        self._waiting: deque[Frame] = deque()
        self._bytes = 0
        self._skipped = False
        self._closed = False
        self._changed = threading.Condition()

    def offer(self, frame: Frame) -> None:
        """Queue the video's next picture, without blocking."""
        with self._changed:
            if self._bytes > _MAX_WAITING_BYTES:
                self._forget()
            self._waiting.append(frame)
            self._bytes += len(frame.data)
            self._changed.notify_all()

    def skip(self) -> None:
        """Mark a discontinuity: the next picture does not follow the last."""
        with self._changed:
            self._forget()

    def close(self) -> None:
        """End the thread."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def run(self) -> None:
        """Decode queued pictures until closed."""
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
        """Yield queued pictures up to the next discontinuity."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._skipped or self._closed)
                if self._skipped or self._closed:
                    self._skipped = False
                    return
                frame = self._waiting.popleft()
                self._bytes -= len(frame.data)
            yield Packet(frame.stamp_ns, frame.encoding, frame.data)
