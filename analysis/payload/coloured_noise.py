"""Noise model of joint torques: white noise plus an Ornstein-Uhlenbeck process.

Unmodelled effects (ripple, hoses, warming) look like correlated noise. Taken for white they would
make intervals too narrow. The inverse covariance of an Ornstein-Uhlenbeck process (Uhlenbeck and
Ornstein 1930) is tridiagonal at any stamps, so weighting samples by it costs O(T).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tunenet_logs.arrays import Array

_TIMES_S = (0.05, 0.15, 0.5, 1.5, 5.0)
# Time constants, and variances by the white one's, that are tried.
_RATIOS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)

_SPIKE_SDS = 3.5  # residual beyond which a sample counts for less: 1 of 2000 where noise is normal
_MIN_SHARE = 2e-5  # of what a joint is built for: no sensor's noise is less
# Factor by which noise falls at most from one estimate to the next: a first fit that happens to be
# near a joint's torques would give it all the weight.
_MAX_FALL = 25.0


@dataclass(frozen=True, eq=False)
class SeriesNoise:
    """Noise of one joint's torques in one run.

    Attributes:
        seconds: Of the samples [s], shape (T,).
        weights: Of each sample's white noise: 1, less for spikes, shape (T,).
        white_nm: Standard deviation of the white part.
        wander_nm: Of the Ornstein-Uhlenbeck part; 0 for none.
        time_s: Its time constant.
    """

    seconds: Array
    weights: Array
    white_nm: float
    wander_nm: float
    time_s: float

    @cached_property
    def _wander(self) -> tuple[Array, float]:
        return _walk(self.seconds, self.time_s, self.wander_nm)

    @cached_property
    def _factor(self) -> Array:
        from scipy.linalg import cholesky_banded

        both = self._wander[0].copy()
        both[1] += self.weights / self.white_nm**2
        return cholesky_banded(both)

    def weighed(self, columns: Array) -> Array:
        """Multiply columns, shape (T, C), by the inverse covariance."""
        from scipy.linalg import cho_solve_banded

        white = (self.weights / self.white_nm**2)[:, None]
        if not self.wander_nm:
            return white * columns
        weighed = white * columns
        return weighed - white * cho_solve_banded((self._factor, False), weighed)

    def wandering(self, residual: Array) -> Array:
        """Estimate the correlated part of residuals, shape (T,): its posterior mean."""
        from scipy.linalg import cho_solve_banded

        if not self.wander_nm:
            return np.zeros_like(residual)
        weighed = self.weights / self.white_nm**2 * residual
        return cho_solve_banded((self._factor, False), weighed)

    @property
    def log_det(self) -> float:
        """Log determinant of the covariance, spikes' weights left out."""
        white = 2 * len(self.seconds) * np.log(self.white_nm)
        if not self.wander_nm:
            return float(white)
        return float(white + 2 * np.sum(np.log(self._factor[1])) - self._wander[1])

    def log_likelihood(self, residual: Array) -> float:
        """Return the log likelihood of residuals, shape (T,)."""
        weighed = self.weighed(residual[:, None])[:, 0]
        return -0.5 * (float(residual @ weighed) + self.log_det)


Noises = tuple[SeriesNoise, ...]  # of each joint in one run


def estimated(
    before: Noises, residual_nm: Array, fitted: Array, least_nm: Array, *, roughly: bool
) -> Noises:
    """Estimate the noise of a fit's residuals by maximum likelihood.

    All time constants and variances of all joints are one banded system, without a link between
    them: one call instead of hundreds.

    Args:
        before: Noise that the fit was made with.
        residual_nm: Of one run [N·m], shape (T, J).
        fitted: Degrees of freedom that the fit used of each joint, shape (J,).
        least_nm: Least noise of a sensor, shape (J,).
        roughly: Whether a coarse grid of time constants and variances suffices.
    """
    from scipy.linalg import cho_solve_banded, cholesky_banded

    count, joints = residual_nm.shape
    seconds = before[0].seconds
    left = np.column_stack(
        [
            residual - noise.wandering(residual)
            for noise, residual in zip(before, residual_nm.T, strict=True)
        ]
    )
    # By the middle: spikes do not count.
    usual = np.maximum(np.median(np.abs(left), axis=0) / 0.6745, least_nm)
    weights = (_SPIKE_SDS / np.maximum(np.abs(left) / usual, _SPIKE_SDS)) ** 2
    step = 2 if roughly else 1
    tried = [(time_s, ratio) for time_s in _TIMES_S[1::step] for ratio in _RATIOS[::step]]
    bands, walks = np.zeros((2, len(tried), joints, count)), np.zeros(len(tried))
    for number, (time_s, ratio) in enumerate(tried):
        walk, walks[number] = _walk(seconds, time_s, np.sqrt(ratio))
        bands[:, number] = walk[:, None]
    bands[1] += weights.T
    factor = cholesky_banded(bands.reshape(2, -1), check_finite=False)
    weighed = weights * residual_nm
    right = np.broadcast_to(weighed.T, (len(tried), joints, count)).ravel()
    solved = cho_solve_banded((factor, False), right, check_finite=False)
    solved = solved.reshape(len(tried), joints, count)
    log_dets = 2 * np.log(factor[1]).reshape(len(tried), joints, count).sum(axis=2) - walks[:, None]
    power = (np.sum(weighed * residual_nm, axis=0) - (solved * weighed.T).sum(axis=2)) / count
    plain = np.sum(weighed * residual_nm, axis=0) / count
    power, log_dets = np.vstack([plain, power]), np.vstack([np.zeros(joints), log_dets])
    scores = -0.5 * (count * np.log(np.maximum(power, 1e-300)) + log_dets)
    best = np.argmax(scores, axis=0)
    renewed: list[SeriesNoise] = []
    for joint, choice in enumerate(best.tolist()):
        time_s, ratio = (1.0, 0.0) if choice == 0 else tried[choice - 1]
        freedom = max(count - float(fitted[joint]), 1.0)
        white = float(np.sqrt(power[choice, joint] * count / freedom))
        white = max(white, float(least_nm[joint]), before[joint].white_nm / _MAX_FALL)
        wander = white * float(np.sqrt(ratio))
        renewed.append(SeriesNoise(seconds, weights[:, joint], white, wander, time_s))
    return tuple(renewed)


def _walk(seconds: Array, time_s: float, sd: float) -> tuple[Array, float]:
    """Return the banded Ornstein-Uhlenbeck inverse covariance, shape (2, T), and its log det.

    Args:
        seconds: Stamps [s], shape (T,).
        time_s: Time constant.
        sd: Standard deviation.
    """
    alike = np.exp(-np.diff(seconds) / time_s)
    own = 1 / np.maximum(1 - alike**2, 1e-12)
    bands = np.zeros((2, len(seconds)))
    bands[1] = 1.0
    bands[1, 1:] += alike**2 * own
    bands[1, :-1] += alike**2 * own
    bands[0, 1:] = -alike * own
    log_det = float(np.sum(np.log(own))) - 2 * len(seconds) * float(np.log(sd))
    return bands / sd**2, log_det


def unknown(seconds: Array, sd_nm: float) -> SeriesNoise:
    """Return white noise of this standard deviation, before anything is fitted."""
    return SeriesNoise(seconds, np.ones(len(seconds)), sd_nm, 0.0, 1.0)
