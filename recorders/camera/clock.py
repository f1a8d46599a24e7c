"""Stamp frames with their capture time: by the camera's clock, else by a uniform one.

`CameraTime` shifts the times that a camera reports by one offset, while the log is written. A
camera that reports none is stamped by arrival; `stamp_evenly` restamps its finished log by a
uniform clock fitted to all arrivals. The arrivals stay in the log as its log times.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tunenet_logs.episode import Frame
from tunenet_logs.messages import CAMERA_TOPIC, VIDEO_TOPIC
from tunenet_logs.recorders.camera.base import CapturedFrame
from tunenet_logs.recorders.session import Item
from tunenet_logs.timing.arrivals import (
    BY_ARRIVALS,
    MAX_SAMPLES,
    UniformClock,
    clock_behind,
    clock_in_words,
)
from tunenet_logs.timing.stamps import noted_gaps, parts_between
from tunenet_logs.writing.writer import header_stamps_ns, restamp

# First frames held back, in time and size, until the clocks are aligned: what comes later than that
# is late enough to be told from what had waited.
_HOLD_NS, _HOLD_BYTES = 500_000_000, 32 * 1024 * 1024
# A jump of the camera's clock: no reordered frames are so far apart, no delay estimate so wrong.
_MIN_LEAP_NS = 1_000_000_000
_MIN_FRAMES = 50  # behind fewer no uniform clock is sought


class Timed(NamedTuple):
    """A frame with its capture time."""

    frame: Frame  # stamped with the camera's time, on our clock
    arrived_ns: int
    # Whether the camera's clock was aligned anew before it, so that the interval from the frame
    # before is unknown.
    begins_anew: bool = False


class CameraTime:
    """Map camera timestamps to our clock [ns].

    Where the camera reports times, they are kept to the nanosecond, all shifted by one offset: the
    smallest delay from reported time to arrival within the first half second. (What was read ahead
    to probe the stream comes late, and would shift all that follows.) Where it reports none, or
    unless `is_told`, the time is the arrival's.

    The camera's clock has jumped where it goes back by over a second, or where one step takes it
    over a second beyond the arrival, which no delay does. It is then aligned anew, as with each new
    connection. A picture that merely comes late, however late, keeps its reported time.
    """

    def __init__(self, *, is_told: bool = True) -> None:
        self.leaps = 0  # jumps of the camera's clock
        self._uses_told = is_told
        self.is_placed = False  # while held-back frames are released, late by having been held
        self._held: list[Item[CapturedFrame]] = []
        self._held_bytes = 0
        self._anchor_ns: int | None = None
        self._latest: tuple[int, int] | None = None
        self._last_arrival_ns: int | None = None
        self._connection: int | None = None
        self._begins_anew = False
        self._newest_ns = 0
        self._told = self._untold = 0
        self._is_reordered = False

    def timed(self, item: Item[CapturedFrame]) -> Iterator[Timed]:
        """Yield the frames whose time is known by now, in order of arrival."""
        if not self._uses_told:
            item = item._replace(payload=item.payload._replace(source_stamp_ns=None))
        source_stamp_ns, connection = item.payload.source_stamp_ns, item.payload.connection
        if self._connection not in (None, connection):
            yield from self._begin_anew()
        self._connection = connection
        if source_stamp_ns is not None:
            if self._has_leapt(source_stamp_ns, item.received_ns):
                yield from self._begin_anew()
                self.leaps += 1
            if self._latest is None or source_stamp_ns > self._latest[0]:
                self._latest = source_stamp_ns, item.received_ns
            else:
                self._is_reordered = True
        if self._held or (source_stamp_ns is not None and self._anchor_ns is None):
            self._held.append(item)
            self._held_bytes += item.size_bytes
            yield from self.due(item.received_ns)
        else:
            self.is_placed = True
            yield self._placed(item)

    def due(self, now_ns: int) -> Iterator[Timed]:
        """Yield the held-back frames once they have been held for long enough."""
        is_full = self._held_bytes > _HOLD_BYTES
        if self._held and (is_full or now_ns - self._held[0].received_ns >= _HOLD_NS):
            yield from self.rest()

    def rest(self) -> Iterator[Timed]:
        """Yield all frames that are still held back."""
        held, self._held, self._held_bytes = self._held, [], 0
        self.is_placed = False
        came = [(one.received_ns, one.payload.source_stamp_ns) for one in held]
        if told := [(came_ns, told_ns) for came_ns, told_ns in came if told_ns is not None]:
            delay_ns = min(came_ns - told_ns for came_ns, told_ns in told)
            # What was read ahead is not placed among the pictures of the connection before.
            first_ns = min(told_ns for _, told_ns in told)
            self._anchor_ns = max(delay_ns, self._newest_ns + 1 - first_ns)
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

    def _has_leapt(self, source_stamp_ns: int, arrived_ns: int) -> bool:
        if self._latest is None:
            return False
        latest_ns, then_ns = self._latest
        if source_stamp_ns < latest_ns - _MIN_LEAP_NS:
            return True
        if self._anchor_ns is None:
            return False
        is_ahead = source_stamp_ns + self._anchor_ns > arrived_ns + _MIN_LEAP_NS
        step_ns, waited_ns = source_stamp_ns - latest_ns, arrived_ns - then_ns
        return is_ahead and step_ns - waited_ns > _MIN_LEAP_NS

    def _placed(self, item: Item[CapturedFrame]) -> Timed:
        frame, source_stamp_ns = item.payload.frame, item.payload.source_stamp_ns
        arrived_ns = item.received_ns
        if source_stamp_ns is not None and self._anchor_ns is not None:
            self._told += 1
            stamp_ns = source_stamp_ns + self._anchor_ns
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


def stamp_evenly(path: Path, notes: Mapping[str, str], spare_bytes: int) -> str:
    """Restamp the frames of a finished log by the uniform clock fitted to their arrivals.

    Each contiguous segment, by the gaps that the log's notes tell, has a clock of its own: a new
    connection may count anew. Where it finds none, or a copy would not leave `spare_bytes` of the
    disk free, the log stays as it was; which clock the stamps come from is returned in words.
    """
    of = {topic: header_stamps_ns(path, topic) for topic in (CAMERA_TOPIC, VIDEO_TOPIC)}
    topic = max(of, key=lambda one: len(of[one]))
    arrivals_ns = np.array(of[topic], np.int64)
    if len(arrivals_ns) < _MIN_FRAMES:
        return "arrival"
    if len(arrivals_ns) > MAX_SAMPLES:
        return f"arrival: no clock is sought behind more than {MAX_SAMPLES} pictures"
    parts = parts_between(arrivals_ns, noted_gaps(notes))
    stamps_ns = arrivals_ns.copy()
    found: list[UniformClock] = []
    for part in np.unique(parts):
        chosen = parts == part
        clock, rates = clock_behind(arrivals_ns[chosen], are_arrivals=True)
        if rates:
            return f"arrival: the rate of the pictures {rates}, so no even clock is behind them"
        if clock is not None:
            stamps_ns[chosen] = clock.stamps_ns
            found.append(clock)
        elif np.count_nonzero(chosen) >= _MIN_FRAMES:
            found.clear()
            break
    if not found or np.any(np.diff(stamps_ns) <= 0):
        return "arrival: no even clock is behind them"
    if shutil.disk_usage(path.parent).free < path.stat().st_size + spare_bytes:
        return "arrival: the disk has no room for a copy of the log"
    said = f"{BY_ARRIVALS} ({'; '.join(clock_in_words(clock) for clock in found)})"
    restamp(path, topic, dict(zip(arrivals_ns.tolist(), stamps_ns.tolist(), strict=True)), said)
    return said
