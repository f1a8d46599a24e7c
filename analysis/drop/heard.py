"""Onsets that a microphone heard beside a ball that is seen, some of them its impacts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.arrays import Array


@dataclass(frozen=True, eq=False)
class HeardImpacts:
    """Onsets in a sound track, in order. Some are no impacts, and some impacts are missing.

    Attributes:
        start_ns: stamp that the times count from, on the log's clock.
        times_s: of the onsets, shape (N,).
        sds_s: standard deviations of them, shape (N,).
        probabilities: of each to be an impact of a ball, by its sound, shape (N,).
        topic: of the sound.
    """

    times_s: Array
    sds_s: Array
    probabilities: Array
    start_ns: int = 0
    topic: str = ""

    def since(self, start_ns: int) -> HeardImpacts:
        """Return the onsets with times that count from another stamp."""
        later_s = (self.start_ns - start_ns) * 1e-9
        return replace(self, start_ns=start_ns, times_s=self.times_s + later_s)

    def only(self, chosen: NDArray[np.bool_]) -> HeardImpacts:
        """Return the onsets of a mask, shape (N,)."""
        return replace(
            self,
            times_s=self.times_s[chosen],
            sds_s=self.sds_s[chosen],
            probabilities=self.probabilities[chosen],
        )
