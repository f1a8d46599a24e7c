"""Queue messages from the receiving threads to the writing one."""

from __future__ import annotations

import threading
from array import array
from collections import deque
from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

from tunenet_logs.clock import now_ns

Payload = TypeVar("Payload")

# How long messages gather before they are written in one go: a small part of the 0.25 s that may be
# lost with the process, and long enough that waking up costs nothing.
_PAUSE_SECONDS = 0.03

_STAMPS_KEPT = 100_000  # of each topic, to measure its rate: half an hour of a camera


class Item(NamedTuple, Generic[Payload]):
    """A queued message.

    Attributes:
        stamp_ns: of its acquisition.
        received_ns: when it came, on the clock of `tunenet_logs.clock`; never less than before.
        size_bytes: of the payload.
        follows_drop: whether the one before it on its topic was dropped.
    """

    topic: str
    stamp_ns: int
    received_ns: int
    payload: Payload
    size_bytes: int
    follows_drop: bool = False


@dataclass
class Tally:
    """Counts of one topic.

    Attributes:
        captured: messages put in, including those dropped.
        dropped: messages that found the queue full.
        stamps_ns: of the captured ones, the first 100,000.
    """

    captured: int = 0
    dropped: int = 0
    stamps_ns: array[int] = field(default_factory=lambda: array("q"))

    def add(self, stamp_ns: int, *, is_dropped: bool) -> None:
        """Count one message."""
        self.captured += 1
        self.dropped += is_dropped
        if len(self.stamps_ns) < _STAMPS_KEPT:
            self.stamps_ns.append(stamp_ns)


class TopicQueue(Generic[Payload]):
    """A counting queue for any number of topics and threads, bounded in bytes.

    Bounded in bytes, not in messages: a picture is a thousand times larger than a joint state. A
    message that is larger than the bound alone passes through an empty queue.

    Args:
        limit_bytes: of all messages that wait.
        drops: whether the newest message is dropped when the queue is full; else `put` waits.
        counts: whether messages count from the beginning; else from `start` on.
    """

    def __init__(self, limit_bytes: int, *, drops: bool, counts: bool = True) -> None:
        self._tallies: dict[str, Tally] = {}
        self._limit_bytes = limit_bytes
        self._drops = drops
        self._counts = counts
        self._items: deque[Item[Payload]] = deque()
        self._held_bytes = 0
        self._closed = False
        self._last_ns = 0
        self._broken: set[str] = set()
        self._changed = threading.Condition()

    def put(
        self,
        topic: str,
        stamp_ns: int,
        payload: Payload,
        size_bytes: int,
        received_ns: int | None = None,
        *,
        stands_alone: bool = True,
    ) -> bool:
        """Add a message; False once the queue is closed: it is not counted then.

        One that does not stand alone is dropped where the one before it on its topic was.
        """
        with self._changed:
            while not self._drops and self._is_full(size_bytes) and not self._closed:
                self._changed.wait()
            if self._closed:
                return False
            follows_drop = topic in self._broken
            is_full = self._is_full(size_bytes) or (follows_drop and not stands_alone)
            if self._counts:
                tally = self._tallies.get(topic)
                if tally is None:
                    tally = self._tallies[topic] = Tally()
                tally.add(stamp_ns, is_dropped=is_full)
            if is_full:
                self._broken.add(topic)
            else:
                self._broken.discard(topic)
                # Stamped under the lock, so that receipts never run backwards in the log.
                came_ns = now_ns() if received_ns is None else received_ns
                self._last_ns = max(self._last_ns, came_ns)
                self._items.append(
                    Item(topic, stamp_ns, self._last_ns, payload, size_bytes, follows_drop)
                )
                self._held_bytes += size_bytes
            return True

    def take(self) -> Item[Payload] | None:
        """Return the oldest message without waiting; None when there is none."""
        with self._changed:
            if not self._items:
                return None
            item = self._items.popleft()
            self._held_bytes -= item.size_bytes
            if not self._drops:
                self._changed.notify_all()
            return item

    def pause(self) -> None:
        """Let messages gather for a moment; return at once when the queue is closed.

        Messages do not end it: at a thousand a second, waking up for each is most of the work.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._closed, _PAUSE_SECONDS)

    def start(self) -> None:
        """Discard the queued messages, and count from here on."""
        with self._changed:
            self._items.clear()
            self._held_bytes = 0
            self._counts = True
            self._changed.notify_all()

    def close(self) -> None:
        """Accept no more messages; those inside can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def cut(self, topic: str, taken: int) -> None:
        """Accept no more messages; those inside count as if they had never come.

        Args:
            topic: the only one in use.
            taken: messages that were taken and do not count either.
        """
        with self._changed:
            if topic in self._tallies:
                self._tallies[topic].captured -= len(self._items) + taken
            self._items.clear()
            self._held_bytes = 0
            self._closed = True
            self._changed.notify_all()

    def tally(self, topic: str) -> Tally:
        """Return the counts of a topic so far."""
        with self._changed:
            return self._tallies.get(topic) or Tally()

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics with messages, in order of their first."""
        with self._changed:
            return tuple(self._tallies)

    @property
    def captured(self) -> int:
        """Number of messages put in, including those dropped."""
        with self._changed:
            return sum(tally.captured for tally in self._tallies.values())

    @property
    def dropped(self) -> int:
        """Number of messages that found the queue full."""
        with self._changed:
            return sum(tally.dropped for tally in self._tallies.values())

    @property
    def is_done(self) -> bool:
        """Whether it is closed and empty."""
        with self._changed:
            return self._closed and not self._items

    def _is_full(self, size_bytes: int) -> bool:
        return bool(self._items) and self._held_bytes + size_bytes > self._limit_bytes
