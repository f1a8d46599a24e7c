"""Impacts of a ball that is seen, as they were heard, each with its number."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.arrays import Array

OFFSET_SD_S = 0.1
"""By how much sound may be late, or early, beside the pictures: what phones and cameras do."""

TOUCH_S, TOUCH_SD_S = 0.002, 0.0025
"""How long a contact lasts: from .3 ms (steel on glass) to 8 ms (a soft ball on a table)."""

HEARD_FREEDOM = 4.0
"""Degrees of freedom of Student's t of a heard time: an onset may be an echo's."""


@dataclass(frozen=True, eq=False)
class HeardTouches:
    """When the ball is heard to touch the table.

    Attributes:
        numbers: of the impacts, 0 the first of the drop, shape (N,).
        times_s: on the samples' clock, but late by an offset, shape (N,).
        sds_s: standard deviations of them, shape (N,).
    """

    numbers: NDArray[np.intp]
    times_s: Array
    sds_s: Array

    def only(self, chosen: NDArray[np.bool_]) -> HeardTouches:
        """Those of a mask, shape (N,)."""
        return replace(
            self,
            numbers=self.numbers[chosen],
            times_s=self.times_s[chosen],
            sds_s=self.sds_s[chosen],
        )

    def beside(self, more: HeardTouches) -> HeardTouches:
        """And others, which come later."""
        return HeardTouches(
            np.concatenate([self.numbers, more.numbers]),
            np.concatenate([self.times_s, more.times_s]),
            np.concatenate([self.sds_s, more.sds_s]),
        )

    def uneven(self, fraction: float) -> HeardTouches:
        """By a ball that leaves its law by this fraction of a flight's duration."""
        flights_s = np.diff(self.times_s, prepend=np.nan)
        flights_s[0] = np.max(flights_s[1:])
        return replace(self, sds_s=np.hypot(self.sds_s, fraction * flights_s))
