"""Assign the points of blank-separated MTrack2 rows to tracks.

A track that is not seen leaves blanks alone, so the row does not say which is missing. But MTrack2
numbers tracks as they begin: a row holds some of those that were seen before, in their order, and
behind them those that begin; each is near its last place or its extrapolation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import dist, inf

Point = tuple[float, float]

# Between a track's place and where it was to be expected; a track that begins costs as much.
_FARTHEST = 60.0

_MAX_WORK = 5_000_000  # of comparisons, in the whole file
_MAX_POINTS = 80  # in a row: a block holds 75 tracks


@dataclass(frozen=True)
class _Seen:
    """Last frame, place and velocity [per frame] of a track."""

    frame: float
    place: Point
    speed: Point

    def off(self, frame: float, point: Point) -> float:
        """Return a point's distance to the last or extrapolated place; infinite if too far."""
        passed = frame - self.frame
        going = (
            self.place[0] + passed * self.speed[0],
            self.place[1] + passed * self.speed[1],
        )
        off = min(dist(point, self.place), dist(point, going))
        return off if off <= _FARTHEST else inf


class Follower:
    """Tracker of one block's tracks, row by row."""

    def __init__(self, first: int) -> None:
        self._first = first
        self._seen: list[_Seen] = []
        self._work = 0

    def named(self, frame: float, points: Sequence[Point]) -> list[int]:
        """Return the track number of each point, by dynamic programming over the track order.

        Raises:
            ValueError: there are more points than a block's tracks.
        """
        self._work += len(self._seen) * len(points)
        if len(points) > _MAX_POINTS or self._work > _MAX_WORK:
            raise ValueError("it holds more tracks than a block does")
        matched = _matched([[one.off(frame, point) for point in points] for one in self._seen])
        matched += [None] * (len(points) - len(matched))
        numbers: list[int] = []
        for point, at in zip(points, matched, strict=True):
            if at is None:
                numbers.append(self._first + len(self._seen))
                self._seen.append(_Seen(frame, point, (0.0, 0.0)))
            else:
                old = self._seen[at]
                passed = max(frame - old.frame, 1.0)
                speed = ((point[0] - old.place[0]) / passed, (point[1] - old.place[1]) / passed)
                self._seen[at] = _Seen(frame, point, speed)
                numbers.append(self._first + at)
        return numbers


def points_of(cells: Sequence[str]) -> tuple[list[tuple[str, str]], list[bool]]:
    """Pair the numbers behind a row's frame, and return which pairs carry a flag.

    Raises:
        ValueError: the numbers are not in pairs.
    """
    values = [at for at, cell in enumerate(cells) if cell != "*"]
    if len(values) % 2 or any(cells[at - 1 : at] == ["*"] for at in values[1::2]):
        raise ValueError("its numbers are no pairs")
    pairs = [(cells[x], cells[y]) for x, y in zip(values[::2], values[1::2], strict=True)]
    return pairs, [cells[y + 1 : y + 2] == ["*"] for y in values[1::2]]


def _matched(off: Sequence[Sequence[float]]) -> list[int | None]:
    """Assign points to tracks in order, by dynamic programming; None where a point begins a track.

    Minimizes the sum of the distances `off`, with a fixed cost for each new track.
    """
    count = len(off[0]) if off else 0
    # costs[i][j]: of the first j points among the first i tracks
    costs = [[0.0] + [inf] * count]
    for row in off:
        pairs = zip(row, pairwise(costs[-1]), strict=True)
        costs.append([0.0] + [min(one, before + apart) for apart, (before, one) in pairs])
    whole = [cost + _FARTHEST * (count - j) for j, cost in enumerate(costs[-1])]
    j = min(range(count + 1), key=lambda at: (whole[at], -at))
    found: list[int | None] = [None] * count
    for i in range(len(off), 0, -1):
        if j and costs[i][j] < costs[i - 1][j]:
            j -= 1
            found[j] = i - 1
    return found
