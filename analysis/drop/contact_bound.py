"""Positive contact duration as a truncated normal, for a ball whose impacts are heard.

In a normal approximation the contact's duration is normal for each slope and drag, with the
restitution linear in it. Its part below 0 is cut off (the truncated normal distribution).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tunenet_logs.arrays import Array

_FAR = -30.0  # standard deviations below 0 beyond which a contact is as unlikely as at them


@dataclass(frozen=True, eq=False)
class ContactBound:
    """Contact duration before the bound, as a function of slope and drag.

    Attributes:
        value_s: at the likelihood's middle.
        moves: its derivatives by slope and drag, shape (2,).
        sd_s: standard deviation given the two.
        restitution_sd: of the restitution, by the contact alone; negative where a longer contact
            means a lower restitution.
    """

    value_s: float
    moves: Array
    sd_s: float
    restitution_sd: float

    def log_likelihood(self, off: Array) -> Array:
        """Return the log probability of a contact above 0, shape (M,), off the middle by (M, 2)."""
        from scipy.special import log_ndtr

        return np.asarray(log_ndtr(self._above(off)), dtype=np.float64)

    def restitution_moved(self, off: Array) -> Array:
        """Return how far the bound moves the restitution, shape (M,)."""
        return self.restitution_sd * self._cut(off)[0]

    def variance_taken(self, off: Array) -> Array:
        """Return how much the bound lowers the restitution's variance, shape (M,)."""
        return self.restitution_sd**2 * self._cut(off)[1]

    def _above(self, off: Array) -> Array:
        """Return the contact before the bound, in standard deviations, shape (M,)."""
        return np.maximum((self.value_s + off @ self.moves) / self.sd_s, _FAR)

    def _cut(self, off: Array) -> tuple[Array, Array]:
        """Return the truncated standard normal's mean and loss of variance, shape (M,)."""
        from scipy.special import log_ndtr

        above = self._above(off)
        mean = np.exp(-0.5 * above**2 - log_ndtr(above)) / np.sqrt(2 * np.pi)
        return mean, mean * (mean + above)
