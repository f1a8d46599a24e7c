"""Contact durations of a heard ball, marginalised in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.drop.times import impact_prior as priors
from analysis.drop.times.least_squares import BallsByTimes
from tunenet_logs.arrays import Array


@dataclass(frozen=True, eq=False)
class WithContacts:
    """Fit of every ball with every jitter, marginalised over contact durations.

    Attributes:
        middles: log speed after the first impact [m/s] and restitution at the second, shape
            (M, J, 2).
        covariances: of them, shape (M, J, 2, 2).
        contacts_s: how long the ball touches the table, shape (M, J).
        log_gains: what the contacts add to the logarithm of the evidence, shape (M, J).
    """

    middles: Array
    covariances: Array
    contacts_s: Array
    log_gains: Array

    @classmethod
    def of(cls, fit: BallsByTimes) -> WithContacts:
        """Marginalise contacts: their effect is linear, their prior a truncated normal."""
        jitters = priors.JITTERS_S
        sharpness = fit.bends[:, None] / jitters**2 + priors.CONTACT_SD_S**-2
        pull = fit.across[:, None] / jitters**2
        sd = sharpness**-0.5
        ends = np.array(priors.CONTACTS_S) - priors.CONTACT_S
        log_share, longer_s, variance = _cut_normal(pull / sharpness, sd, *ends)
        leans = fit.leans[:, None, 1:]
        own = jitters[:, None, None] ** 2 * fit.spread[:, None, 1:, 1:]
        shared = leans[..., :, None] * leans[..., None, :] * variance[..., None, None]
        gains = 0.5 * pull**2 / sharpness + np.log(sd / priors.CONTACT_SD_S) + log_share
        return cls(
            fit.unknowns[:, None, 1:] + leans * longer_s[..., None],
            own + shared,
            priors.CONTACT_S + longer_s,
            gains,
        )


def _cut_normal(middle: Array, sd: Array, low: float, high: float) -> tuple[Array, Array, Array]:
    """Return a truncated normal's log share between two ends, its mean and variance."""
    from scipy.special import log_ndtr

    flipped = middle > (low + high) / 2  # so that the nearer end is the lower one
    centre = np.where(flipped, -middle, middle)
    first, last = np.where(flipped, -high, low), np.where(flipped, -low, high)
    begin, end = (first - centre) / sd, (last - centre) / sd
    over, beyond = log_ndtr(-begin), log_ndtr(-end)
    log_share = over + np.log1p(-np.exp(np.minimum(beyond - over, -1e-12)))
    density_begin, density_end = (
        np.exp(-0.5 * at**2 - 0.5 * np.log(2 * np.pi) - log_share) for at in (begin, end)
    )
    shift = density_begin - density_end
    inside = np.clip(centre + sd * shift, first, last)
    bent = 1 + begin * density_begin - np.where(np.isfinite(end), end * density_end, 0.0) - shift**2
    variance = np.clip(sd**2 * bent, 0.0, sd**2)
    return log_share, np.where(flipped, -inside, inside), variance
