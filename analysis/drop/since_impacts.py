"""Flight time since each impact: by so much a faster return delays what follows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.arrays import Array


def since_impacts_s(times_s: Array, numbers: NDArray[np.integer]) -> Array:
    """Return the seconds from each impact to each that was heard, 0 for those before it.

    An impact that was not heard lies between its neighbours, or before the first as far from it as
    the first two are apart.

    Args:
        times_s: of those heard, rising, shape (N,), N at least 2.
        numbers: of them, 0 the first impact, shape (N,).

    Returns:
        Of the impacts 0 to K - 1, K the number of the last that was heard, shape (N, K).
    """
    first = int(numbers[0])
    impacts_s = np.interp(np.arange(numbers[-1]), numbers, times_s)
    impacts_s[:first] -= (times_s[1] - times_s[0]) * np.arange(first, 0, -1)
    return np.maximum(times_s[:, None] - impacts_s, 0.0)
