"""Heard impacts of a ball that is seen, each with its number."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from analysis.drop.since_impacts import since_impacts_s
from tunenet_logs.arrays import Array

# By how much sound may be late, or early, beside the pictures: what phones and cameras do.
OFFSET_SD_S = 0.1

# How long a contact lasts: from .3 ms (steel on glass) to 8 ms (a soft ball on a table).
TOUCH_S, TOUCH_SD_S = 0.002, 0.0025

HEARD_FREEDOM = 4.0  # degrees of freedom of Student's t of a heard time: an onset may be an echo's
# How likely is each standard deviation of an impact's own restitution about the law, as a fraction
# of it.
SCATTERS = {0.0005: 0.5, 0.002: 0.3, 0.006: 0.15, 0.02: 0.05}


@dataclass(frozen=True, eq=False)
class HeardTouches:
    """Times at which the ball is heard to touch the table.

    Attributes:
        numbers: of the impacts, 0 the first of the drop, shape (N,).
        times_s: on the samples' clock, but late by an offset, shape (N,).
        sds_s: standard deviations of the onsets, shape (N,).
        scatter: of each impact's own restitution about the law, as a fraction.
    """

    numbers: NDArray[np.intp]
    times_s: Array
    sds_s: Array
    scatter: float = 0.0

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the times about a law's [s²]: a faster return delays all that follows."""
        later_s = since_impacts_s(self.times_s, self.numbers)
        return np.diag(self.sds_s**2) + self.scatter**2 * later_s @ later_s.T

    @cached_property
    def whitening(self) -> Array:
        """Whitening matrix of the times' residuals, shape (N, N)."""
        rows = np.linalg.inv(np.linalg.cholesky(self.covariance))
        return np.asarray(rows, dtype=np.float64)

    def only(self, chosen: NDArray[np.bool_]) -> HeardTouches:
        """Return the touches of a mask, shape (N,)."""
        return replace(
            self,
            numbers=self.numbers[chosen],
            times_s=self.times_s[chosen],
            sds_s=self.sds_s[chosen],
        )

    def beside(self, more: HeardTouches) -> HeardTouches:
        """Append other touches, which come later."""
        return replace(
            self,
            numbers=np.concatenate([self.numbers, more.numbers]),
            times_s=np.concatenate([self.times_s, more.times_s]),
            sds_s=np.concatenate([self.sds_s, more.sds_s]),
        )
