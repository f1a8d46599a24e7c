"""Whether the times that a server writes beside its pictures are those of a clock."""

from __future__ import annotations

_MOST_FAULTY = 0.01
"""Of the times: a clock that is set goes back once, what counts in another way does so often."""

_FORGIVEN = 2
_LEAST_NS = 1_000_000_000
"""Over which the server's clock and ours are compared: jitter and bursts are shorter."""

_MOST_RATIO = 2.0
"""Between the two: no clock is so wrong, another unit is."""


class ToldTimes:
    """Lets through what a server tells, until it is seen to be no clock.

    Attributes:
        is_trusted: whether it may be one still.
    """

    def __init__(self) -> None:
        self.is_trusted = True
        self._first: tuple[int, int] | None = None
        self._latest_ns = 0
        self._count = self._faults = 0

    def taken_ns(self, told_ns: int | None, arrived_ns: int) -> int | None:
        """The time of a picture; None where what is told is none.

        Args:
            told_ns: by the server's clock.
            arrived_ns: by ours.
        """
        if told_ns is None or not self.is_trusted:
            return None
        if self._first is None:
            self._first = told_ns, arrived_ns
            self._latest_ns = told_ns
            return told_ns
        self._count += 1
        goes_on = told_ns > self._latest_ns
        self._latest_ns = told_ns
        if not goes_on:
            self._faults += 1
            self._first = told_ns, arrived_ns
            self.is_trusted = self._faults <= _FORGIVEN + _MOST_FAULTY * self._count
            return None
        self.is_trusted = self._runs_with_ours(
            told_ns - self._first[0], arrived_ns - self._first[1]
        )
        return told_ns if self.is_trusted else None

    @staticmethod
    def _runs_with_ours(told_ns: int, arrived_ns: int) -> bool:
        longest_ns = max(told_ns, arrived_ns)
        return longest_ns < _LEAST_NS or longest_ns < _MOST_RATIO * min(told_ns, arrived_ns)
