"""Stamp each frame with its capture time: the camera's own clock, mapped to ours."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from recorders.camera.base import Shot
from recorders.topic_queue import Item
from tunenet_logs.episode import Frame

# How long the first pictures are looked at before the camera's clock is placed on ours.
_HOLD_NS = 500_000_000

# Of pictures that are looked at so; what comes then is late enough to be told from what waited.
_HOLD_BYTES = 32 * 1024 * 1024

# No two pictures change places so far apart, and no estimate of a delay is so wrong.
_LEAP_NS = 1_000_000_000


class Timed(NamedTuple):
    """A frame with its capture time.

    Attributes:
        frame: stamped with the camera's time, on our clock.
        begins_anew: whether the camera's clock was aligned anew before it, so that the interval
            from the frame before is unknown.
    """

    frame: Frame
    arrived_ns: int
    begins_anew: bool = False


class CameraTime:
    """Maps camera timestamps to our clock [ns].

    Where the camera reports times, they are kept to the nanosecond, all shifted by one offset: the
    smallest delay from reported time to arrival within the first half second. (What was read ahead
    to probe the stream comes late, and would shift all that follows.) Where it reports none, the
    time is the arrival's.

    The camera's clock has jumped where it goes back by over a second, or where one step takes it
    over a second beyond the arrival, which no delay does. It is then aligned anew, as with each new
    connection. A picture that merely comes late, however late, keeps its reported time.

    Args:
        is_told: whether reported times are used; else all times are the arrivals.

    Attributes:
        leaps: number of jumps of the camera's clock.
        is_placed: False while held-back frames are released, which are late by having been held.
    """

    def __init__(self, *, is_told: bool = True) -> None:
        self.leaps = 0
        self._uses_told = is_told
        self.is_placed = False
        self._held: list[Item[Shot]] = []
        self._held_bytes = 0
        self._anchor_ns: int | None = None
        self._latest: tuple[int, int] | None = None
        self._last_arrival_ns: int | None = None
        self._connection: int | None = None
        self._begins_anew = False
        self._newest_ns = 0
        self._told = self._untold = 0
        self._is_reordered = False

    def timed(self, item: Item[Shot]) -> Iterator[Timed]:
        """Yield the frames whose time is known by now, in order of arrival."""
        if not self._uses_told:
            item = item._replace(payload=item.payload._replace(told_ns=None))
        told_ns, connection = item.payload.told_ns, item.payload.connection
        if self._connection not in (None, connection):
            yield from self._begin_anew()
        self._connection = connection
        if told_ns is not None:
            if self._has_leapt(told_ns, item.received_ns):
                yield from self._begin_anew()
                self.leaps += 1
            if self._latest is None or told_ns > self._latest[0]:
                self._latest = told_ns, item.received_ns
            else:
                self._is_reordered = True
        if self._held or (told_ns is not None and self._anchor_ns is None):
            self._held.append(item)
            self._held_bytes += item.size_bytes
            yield from self.due(item.received_ns)
        else:
            self.is_placed = True
            yield self._placed(item)

    def due(self, now_ns: int) -> Iterator[Timed]:
        """Yield the held-back frames once they have been held for long enough."""
        if self._held and (
            now_ns - self._held[0].received_ns >= _HOLD_NS or self._held_bytes > _HOLD_BYTES
        ):
            yield from self.rest()

    def rest(self) -> Iterator[Timed]:
        """Yield all frames that are still held back."""
        held, self._held, self._held_bytes = self._held, [], 0
        self.is_placed = False
        told = [(one.received_ns, one.payload.told_ns) for one in held]
        delays_ns = [came_ns - told_ns for came_ns, told_ns in told if told_ns is not None]
        if delays_ns:
            first_ns = min(told_ns for _, told_ns in told if told_ns is not None)
            # What was read ahead is not placed among the pictures of the connection before.
            self._anchor_ns = max(min(delays_ns), self._newest_ns + 1 - first_ns)
        for item in held:
            yield self._placed(item)

    def notes(self) -> dict[str, str]:
        """Return notes on which clock the stamps come from."""
        if not self._told:
            return {"stamps": "arrival"}
        untold = f", {self._untold} by arrival" if self._untold else ""
        notes = {"stamps": f"camera{untold}"}
        if self._is_reordered:
            notes["b_frames"] = "yes: Foxglove shows no such video; --transcode makes one it shows"
        if self.leaps:
            notes["camera_clock_leaps"] = str(self.leaps)
        return notes

    def _begin_anew(self) -> Iterator[Timed]:
        yield from self.rest()
        self._anchor_ns = self._latest = None
        self._begins_anew = True

    def _has_leapt(self, told_ns: int, arrived_ns: int) -> bool:
        if self._latest is None:
            return False
        latest_ns, then_ns = self._latest
        if told_ns < latest_ns - _LEAP_NS:
            return True
        if self._anchor_ns is None or told_ns + self._anchor_ns <= arrived_ns + _LEAP_NS:
            return False
        return (told_ns - latest_ns) - (arrived_ns - then_ns) > _LEAP_NS

    def _placed(self, item: Item[Shot]) -> Timed:
        frame, told_ns = item.payload.frame, item.payload.told_ns
        arrived_ns = item.received_ns
        if told_ns is not None and self._anchor_ns is not None:
            self._told += 1
            stamp_ns = told_ns + self._anchor_ns
        else:
            self._untold += 1
            stamp_ns = frame.stamp_ns
            if self._last_arrival_ns is not None:  # both in one read
                stamp_ns = max(stamp_ns, self._last_arrival_ns + 1)
            self._last_arrival_ns = stamp_ns
            arrived_ns = max(arrived_ns, stamp_ns)
        begins_anew, self._begins_anew = self._begins_anew, False
        self._newest_ns = max(self._newest_ns, stamp_ns)
        return Timed(replace(frame, stamp_ns=stamp_ns), arrived_ns, begins_anew)
