"""Single samples that no ball can have been at: marker swaps, dropped detections."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_FEW = 4
_GRAVITY_M_S2 = 9.81


def strays(seconds: NDArray[np.float64], heights_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which samples leave both neighbours farther than a fall through the whole height could.

    The whole height is measured without the 4 highest and lowest samples, so a few strays are seen
    for what they are. Of many none is: then it is the recording that is in doubt.

    Args:
        seconds: times [s], shape (T,), increasing.
        heights_m: heights [m], shape (T,).

    Returns:
        Shape (T,).
    """
    found = np.zeros(len(heights_m), dtype=bool)
    if len(heights_m) < 4 * _FEW:
        return found
    ordered = np.partition(heights_m, (_FEW, len(heights_m) - 1 - _FEW))
    whole_m = ordered[-1 - _FEW] - ordered[_FEW]
    reach_m = np.sqrt(2 * _GRAVITY_M_S2 * whole_m) * (seconds[2:] - seconds[:-2])
    off_m = np.abs(heights_m[1:-1] - (heights_m[2:] + heights_m[:-2]) / 2)
    apart_m = np.abs(heights_m[2:] - heights_m[:-2])
    found[1:-1] = (off_m > reach_m + 0.05 * whole_m) & (apart_m < off_m)
    return found if found.sum() <= 2 * _FEW else np.zeros_like(found)
