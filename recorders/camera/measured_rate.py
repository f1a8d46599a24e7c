"""How fast frames come, by their stamps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_FASTEST_HZ = 100_000.0
"""No film is faster: what seems so has stamps that tell no rate."""

_FASTEST_LIVE_HZ = 2000.0
"""No camera that is plugged in or in a network is faster: what seems so came in one piece."""

_LAG_FRAMES = 30
"""Over which frames that come in bursts are counted: few bursts are longer."""


def measured_hz(stamps_ns: Sequence[int], *, live: bool) -> float:
    """Median rate of frames [Hz]; 0 where their stamps tell none.

    The median of the intervals, which pauses do not change. Where frames come in bursts, it is that
    of a burst; then frames are counted over many intervals.

    Args:
        stamps_ns: in their order.
        live: whether they are of a camera, not of a file.
    """
    stamps = np.array(stamps_ns, np.int64)
    if len(stamps) < 2:
        return 0.0
    lag = max(1, min(_LAG_FRAMES, (len(stamps) - 1) // 2))
    period_ns = float(np.median(np.diff(stamps)))
    even_ns = float(np.median(stamps[lag:] - stamps[:-lag])) / lag
    if period_ns < even_ns / 2:
        period_ns = even_ns
    fastest_hz = _FASTEST_LIVE_HZ if live else _FASTEST_HZ
    return 1e9 / period_ns if period_ns >= 1e9 / fastest_hz else 0.0
