"""Check whether timestamps that a server sends with its pictures come from a clock."""

from __future__ import annotations

# Of the times: a clock that is set goes back once, what counts in another way does so often.
_MAX_FAULTY = 0.01

_FORGIVEN = 2
# Over which the server's clock and ours are compared: jitter and bursts are shorter.
_MIN_NS = 1_000_000_000

_MAX_RATIO = 2.0  # between the two: no clock is so wrong, another unit is


class ToldTimes:
    """A filter that passes reported timestamps until they prove not to be a clock's.

    Attributes:
        is_trusted: whether they may still be a clock's.
    """

    def __init__(self) -> None:
        self.is_trusted = True
        self._first: tuple[int, int] | None = None
        self._latest_ns = 0
        self._count = self._faults = 0

    def taken_ns(self, told_ns: int | None, arrived_ns: int) -> int | None:
        """Return a picture's reported time [ns]; None where it is not to be trusted.

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
            self.is_trusted = self._faults <= _FORGIVEN + _MAX_FAULTY * self._count
            return None
        self.is_trusted = self._runs_with_ours(
            told_ns - self._first[0], arrived_ns - self._first[1]
        )
        return told_ns if self.is_trusted else None

    @staticmethod
    def _runs_with_ours(told_ns: int, arrived_ns: int) -> bool:
        longest_ns = max(told_ns, arrived_ns)
        return longest_ns < _MIN_NS or longest_ns < _MAX_RATIO * min(told_ns, arrived_ns)
