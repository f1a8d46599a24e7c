"""Joint fit of pictures and sound: sound counts as far as the pictures confirm it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.drop.bounce_fit import BounceFit, fit_bounce
from analysis.drop.bounce_model import OFFSET, TOUCH, BounceSamples
from analysis.drop.bounce_posterior import BallPosterior, ball_posterior
from analysis.drop.heard import HeardImpacts
from analysis.drop.heard_match import (
    MIN_HEARD,
    MIN_LOG_ODDS,
    ForetoldImpacts,
    HeardMatch,
    foretold,
    later_touches,
    match_onsets,
)
from analysis.drop.heard_touches import SCATTERS, TOUCH_S, HeardTouches
from analysis.motion import SoundShare
from analysis.statistics import correlation_time
from tunenet_logs.arrays import Array

_MAX_ROUNDS = 3  # in each of which later impacts are listened for
# Log likelihood of the pictures that sound may take: with more the two contradict each other.
_MAX_LOST = 8.0

_LATE_SDS = 5.0  # standard deviations from the fit, from which on an onset is none of its impacts


@dataclass(frozen=True, eq=False)
class EarAndEye:
    """Ball by its pictures, with what sound adds to them.

    Attributes:
        posterior: of both where the sound is used, else of the pictures.
        pictures: of the pictures alone.
        impacts: by the pictures; None where the sound was not compared with them.
        match: the onsets that the pictures confirm; None where there are too few.
        touches: those in the fit; None where the sound is not used.
        reason: why it is not used, in words; "" where it is.
    """

    posterior: BallPosterior
    pictures: BallPosterior
    impacts: ForetoldImpacts | None = None
    match: HeardMatch | None = None
    touches: HeardTouches | None = None
    reason: str = ""

    @property
    def offset_s(self) -> float | None:
        """Delay of the sound; None where it is not used."""
        return None if self.touches is None else float(self.posterior.fit.unknowns[OFFSET])

    @property
    def share(self) -> SoundShare:
        """Summary of the sound's part in the fit, for the record."""
        low, high = self.pictures.interval95[0].tolist()
        seen = 0 if self.impacts is None else len(self.impacts.times_s)
        heard = 0 if self.touches is None else int(self.touches.numbers.max()) + 1
        return SoundShare(
            max(seen, heard),
            0 if self.touches is None else len(self.touches.numbers),
            self.offset_s,
            self.reason,
            float(self.pictures.values[0]),
            (low, high),
        )


def with_sound(pictures: BallPosterior, heard: HeardImpacts) -> EarAndEye:
    """Fit a ball to its pictures and to the onsets, on the same clock, that they confirm."""
    impacts = foretold(pictures.fit)
    alone = EarAndEye(pictures, pictures, impacts)
    if len(impacts.times_s) < MIN_HEARD:
        return replace(alone, reason=f"fewer than {MIN_HEARD} impacts are seen")
    match = match_onsets(impacts, heard)
    if match is None:
        reason = f"fewer than {MIN_HEARD} of its onsets fit the impacts"
        return replace(alone, reason=reason)
    if match.log_odds < MIN_LOG_ODDS:
        reason = f"{len(match.touches.numbers)} of its onsets fit the impacts, as chance has it"
        return replace(alone, match=match, reason=reason)
    fit = _joint_fit(pictures.fit, match, heard)
    if fit is None or _lost(pictures.fit, fit) > _MAX_LOST:
        return replace(alone, match=match, reason="its onsets contradict the pictures")
    return replace(alone, posterior=ball_posterior(fit), match=match, touches=fit.samples.heard)


def _joint_fit(fit: BounceFit, match: HeardMatch, heard: HeardImpacts) -> BounceFit | None:
    """Fit both, without onsets that are far off; None where too few are left."""
    start = fit.unknowns.copy()
    start[[OFFSET, TOUCH]] = match.offset_s, TOUCH_S
    touches = match.touches
    joint = _consistent(_likeliest(fit.samples, start, touches))
    for _ in range(_MAX_ROUNDS):
        more = None if joint is None else later_touches(joint, heard)
        if joint is None or more is None or more.numbers[-1] <= touches.numbers[-1]:
            break
        touches = touches.beside(more.only(more.numbers > touches.numbers[-1]))
        later = _consistent(_likeliest(fit.samples, joint.unknowns, touches))
        if later is None:
            break
        joint = later
    return joint


def _likeliest(samples: BounceSamples, start: Array, touches: HeardTouches) -> BounceFit:
    """Fit both with the likeliest of all scatters."""
    fits: list[tuple[float, BounceFit]] = []
    for scatter, likely in SCATTERS.items():
        scattered = replace(touches, scatter=scatter)
        both = replace(samples, heard=scattered)
        joint = fit_bounce(both, start, both.unknowns, most=60)
        surer = float(np.log(np.diag(scattered.whitening)).sum() + np.log(likely))
        fits.append((joint.cost(fits[0][1].scale if fits else joint.scale) - surer, joint))
    return min(fits, key=lambda pair: pair[0])[1]


def _consistent(fit: BounceFit) -> BounceFit | None:
    """Remove onsets that are far off, and refit; None where too few are left."""
    while True:
        touches = fit.samples.heard
        assert touches is not None
        times_s = fit.samples.touches_s(fit.unknowns, touches.numbers) + fit.unknowns[OFFSET]
        off = np.abs(touches.whitening @ (times_s - touches.times_s))
        if off.max() < _LATE_SDS:
            return fit
        if len(touches.numbers) <= MIN_HEARD:
            return None
        kept = replace(fit.samples, heard=touches.only(np.arange(len(off)) != off.argmax()))
        fit = fit_bounce(kept, fit.unknowns, kept.unknowns, most=60)


def _lost(alone: BounceFit, joint: BounceFit) -> float:
    """Return the log likelihood of the pictures that the joint fit gives up."""
    factor = max(correlation_time(alone.residuals, len(alone.free)), alone.effective_sample_factor)
    return (joint.misfit_cost(alone.scale) - alone.misfit_cost(alone.scale)) / factor
