"""Samples that were stamped when they arrived, and were held up on their way.

A sensor with an even clock gives no burst. So a pause, and after it as many samples as it would
have held, one close upon the other, are what a stalled network or a busy machine makes of an even
clock: no sample was lost, and each was taken where that clock says.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_PAUSE = 1.5
_CLOSE = 0.9
_ON_TIME = 0.3
"""All in periods: what is a pause, how close samples follow in a burst, and how late is not."""

_PATIENCE = 3
"""Samples in a row that are not close, after which what follows a pause is no burst."""

_FEWEST = 10


class Arrivals(NamedTuple):
    """Stamps as they were recorded, and of an even clock.

    Attributes:
        recorded_ns: shape (T,).
        stamps_ns: when the samples were taken, shape (T,); never after `recorded_ns`.
    """

    recorded_ns: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]

    @property
    def taken_ns(self) -> dict[int, int]:
        """When a sample was taken, by its recorded stamp; only of those that came late."""
        late = self.recorded_ns != self.stamps_ns
        return dict(
            zip(self.recorded_ns[late].tolist(), self.stamps_ns[late].tolist(), strict=True)
        )

    def words(self, samples: str) -> list[str]:
        """What to tell a user whose samples came late; nothing if none did."""
        count = len(self.taken_ns)
        if not count:
            return []
        latest_ms = float(np.max(self.recorded_ns - self.stamps_ns)) * 1e-6
        return [
            f"{count} {samples} came in bursts, up to {latest_ms:.0f} ms late: their stamps are "
            "taken as even"
        ]


def on_time(stamps_ns: NDArray[np.int64]) -> Arrivals:
    """Where samples that arrived in a burst after a pause belong.

    A burst that does not make up for its pause is left as it is: then samples were lost, and
    nothing tells which.

    Args:
        stamps_ns: not decreasing, shape (T,).
    """
    if len(stamps_ns) < _FEWEST:
        return Arrivals(stamps_ns, stamps_ns)
    steps = np.diff(stamps_ns).astype(np.float64)
    period = float(np.median(steps))
    mended, after = stamps_ns.copy(), 0
    for pause in np.flatnonzero(steps > _PAUSE * period):
        end = _caught_up(steps, int(pause), period)
        if end is None or pause < after:
            continue
        inside = slice(pause + 1, end)
        even = stamps_ns[pause] + np.round(period * np.arange(1, end - pause)).astype(np.int64)
        mended[inside] = np.minimum(even, stamps_ns[inside])
        after = end
    return Arrivals(stamps_ns, mended)


def _caught_up(steps: NDArray[np.float64], pause: int, period: float) -> int | None:
    """The first sample after a pause that is where an even clock has it; None if none is."""
    lateness, slow = steps[pause] - period, 0
    for at in range(pause + 1, len(steps)):
        slow = 0 if steps[at] < _CLOSE * period else slow + 1
        lateness += steps[at] - period
        if lateness <= _ON_TIME * period:
            return at + 1
        if slow == _PATIENCE:
            return None
    return None
