"""What noise is left of torques once they are fitted: by joint, without spikes, with its memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.model_averaging import correlation_time
from analysis.payload.evidence import Normal
from tunenet_logs.arrays import Array

_SPIKE = 3.5
"""Standard deviations beyond which a sample counts for less."""
_LEAST_SD_NM = 2e-3
"""No sensor's is less."""
_AT_ONCE = 5.0
"""By which factor the noise falls at most from one step to the next."""


@dataclass(frozen=True, eq=False)
class Noise:
    """Of one log.

    Attributes:
        sds_nm: of each joint, shape (J,).
        worth: how many samples are worth one, shape (J,).
        weights: of each sample, 1 but for spikes, and 0 of a joint that is left out, shape (T, J).
    """

    sds_nm: Array
    worth: Array
    weights: Array

    @classmethod
    def unknown(cls, effort_nm: Array, used: NDArray[np.bool_]) -> Noise:
        """Before anything is fitted: 1 N·m.

        Args:
            effort_nm: shape (T, J).
            used: which joints count, shape (J,).
        """
        ones = np.ones(effort_nm.shape[1])
        return cls(ones, ones, np.where(used, np.ones_like(effort_nm), 0.0))

    @property
    def log_density(self) -> float:
        """Of what is left, at its likeliest."""
        return -float(np.sum(self.weights * np.log(self.sds_nm)))

    def normal(self, slopes: Array, left_nm: Array) -> Normal:
        """Weighted sums of slopes, shape (T, J, N), and of what they are to explain, (T, J)."""
        share = self.weights / (self.sds_nm**2 * self.worth)
        flat = slopes.reshape(-1, slopes.shape[-1])
        weighted = flat * share.reshape(-1, 1)
        return Normal(flat.T @ weighted, weighted.T @ left_nm.ravel())

    def looked_at(self, left_nm: Array, slopes: Array, covariance: Array) -> Noise:
        """Estimated anew from what a fit leaves.

        Args:
            left_nm: shape (T, J).
            slopes: of the fit, shape (T, J, N).
            covariance: of its terms, shape (N, N).
        """
        spread = np.abs(left_nm) / self.sds_nm
        weights = (_SPIKE / np.maximum(spread, _SPIKE)) ** 2 * (self.weights > 0)
        sds, worth = np.empty_like(self.sds_nm), np.empty_like(self.worth)
        for joint, left in enumerate(left_nm.T):
            weighted = slopes[:, joint] * weights[:, joint, None]
            normal = weighted.T @ slopes[:, joint] / self.sds_nm[joint] ** 2 / self.worth[joint]
            fitted = float(np.sum(normal * covariance))
            count = float(weights[:, joint].sum())
            squares = float(weights[:, joint] @ left**2)
            freedom = max(count - fitted, 1.0)
            least = max(self.sds_nm[joint] / _AT_ONCE, _LEAST_SD_NM)
            sds[joint] = max(np.sqrt(squares / freedom), least)
            worth[joint] = correlation_time(left * np.sqrt(weights[:, joint]), round(fitted))
        return Noise(sds, worth, weights)
