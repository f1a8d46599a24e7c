"""Frames on their way from the thread that reads them to the one that writes them."""

from __future__ import annotations

import threading
from array import array
from collections import deque
from dataclasses import replace

from tunenet_logs.episode import Frame


class FrameQueue:
    """A queue bounded in bytes, which counts what passes.

    Bounded in bytes, not in frames: pictures differ in size by a factor of a hundred. A frame that
    is larger than the bound alone passes through an empty queue.

    Args:
        limit_bytes: of all pictures that wait.
        drops: whether the newest frame is dropped when the queue is full; else `put` waits.
        counts: whether frames count from the beginning; else from `start` on.

    Attributes:
        captured: frames that were put in, those dropped too.
        dropped: frames that found the queue full.
        stamps_ns: of all captured frames, strictly increasing.
    """

    def __init__(self, limit_bytes: int, *, drops: bool, counts: bool = True) -> None:
        self.captured = 0
        self.dropped = 0
        self.stamps_ns = array("q")
        self._limit_bytes = limit_bytes
        self._drops = drops
        self._counts = counts
        self._frames: deque[Frame] = deque()
        self._held_bytes = 0
        self._last_ns: int | None = None
        self._closed = False
        self._changed = threading.Condition()

    def put(self, frame: Frame) -> bool:
        """Add a frame; False once the queue is closed: it was not counted then."""
        with self._changed:
            while not self._drops and self._is_full(frame) and not self._closed:
                self._changed.wait()
            if self._closed:
                return False
            if self._last_ns is not None and frame.stamp_ns <= self._last_ns:  # both in one read
                frame = replace(frame, stamp_ns=self._last_ns + 1)
            self._last_ns = frame.stamp_ns
            is_full = self._is_full(frame)
            if self._counts:
                self.captured += 1
                self.dropped += is_full
                self.stamps_ns.append(frame.stamp_ns)
            if not is_full:
                self._frames.append(frame)
                self._held_bytes += len(frame.data)
                self._changed.notify_all()
            return True

    def get(self, timeout_s: float) -> Frame | None:
        """The oldest frame; None after `timeout_s`, or at once when closed and empty."""
        with self._changed:
            if not self._frames and not self._closed:
                self._changed.wait(timeout_s)
            if not self._frames:
                return None
            frame = self._frames.popleft()
            self._held_bytes -= len(frame.data)
            self._changed.notify_all()
            return frame

    def start(self) -> None:
        """Forget the frames inside, and count from here on."""
        with self._changed:
            self._frames.clear()
            self._held_bytes = 0
            self._counts = True
            self._changed.notify_all()

    def since_first_ns(self, stamp_ns: int) -> int:
        """Time from the first frame that counted [ns]; 0 before that."""
        with self._changed:
            return stamp_ns - self.stamps_ns[0] if self.stamps_ns else 0

    def close(self) -> None:
        """Take no more frames; those inside can still be got."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def is_done(self) -> bool:
        """Whether it is closed and empty."""
        with self._changed:
            return self._closed and not self._frames

    def _is_full(self, frame: Frame) -> bool:
        return bool(self._frames) and self._held_bytes + len(frame.data) > self._limit_bytes
