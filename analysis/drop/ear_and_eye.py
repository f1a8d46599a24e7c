"""One fit of what is seen and what is heard: sound counts as far as the pictures confirm it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.drop.bounce_fit import BounceFit, fit_bounce
from analysis.drop.bounce_model import OFFSET, TOUCH
from analysis.drop.bounce_posterior import BallPosterior, ball_posterior
from analysis.drop.heard import HeardImpacts
from analysis.drop.heard_match import (
    FEWEST_HEARD,
    LEAST_LOG_ODDS,
    ForetoldImpacts,
    HeardMatch,
    foretold,
    match_onsets,
)
from analysis.drop.heard_touches import TOUCH_S, HeardTouches
from analysis.motion import SoundShare
from analysis.statistics import correlation_time

_UNEVEN = 0.0005
"""Fraction of a flight's duration by which balls leave a law that is fitted to them."""

_MOST_LOST = 8.0
"""Log likelihood of the pictures that sound may take: with more the two contradict each other."""

_LATE_SDS = 5.0
"""Standard deviations from the fit, from which on an onset is none of its impacts."""


@dataclass(frozen=True, eq=False)
class EarAndEye:
    """A ball by its pictures, with what sound adds to them.

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
        """By how much the sound is late; None where it is not used."""
        return None if self.touches is None else float(self.posterior.fit.unknowns[OFFSET])

    @property
    def share(self) -> SoundShare:
        """What a record keeps of it."""
        low, high = self.pictures.interval95[0].tolist()
        return SoundShare(
            0 if self.impacts is None else len(self.impacts.times_s),
            0 if self.touches is None else len(self.touches.numbers),
            self.offset_s,
            self.reason,
            float(self.pictures.values[0]),
            (low, high),
        )


def with_sound(pictures: BallPosterior, heard: HeardImpacts) -> EarAndEye:
    """The ball by its pictures and by the onsets that they confirm.

    Args:
        pictures: what they say alone.
        heard: on the clock of their samples.
    """
    impacts = foretold(pictures.fit)
    alone = EarAndEye(pictures, pictures, impacts)
    if len(impacts.times_s) < FEWEST_HEARD:
        return replace(alone, reason=f"fewer than {FEWEST_HEARD} impacts are seen")
    match = match_onsets(impacts, heard)
    if match is None:
        reason = f"fewer than {FEWEST_HEARD} of its onsets fit the impacts"
        return replace(alone, reason=reason)
    if match.log_odds < LEAST_LOG_ODDS:
        reason = f"{len(match.touches.numbers)} of its onsets fit the impacts, as chance has it"
        return replace(alone, match=match, reason=reason)
    fit = _joint_fit(pictures.fit, match)
    if fit is None or _lost(pictures.fit, fit) > _MOST_LOST:
        return replace(alone, match=match, reason="its onsets contradict the pictures")
    return replace(alone, posterior=ball_posterior(fit), match=match, touches=fit.samples.heard)


def _joint_fit(fit: BounceFit, match: HeardMatch) -> BounceFit | None:
    """The fit to both, without onsets that are far off; None where too few are left."""
    touches = match.touches
    flights_s = np.diff(touches.times_s, prepend=np.nan)
    flights_s[0] = np.max(flights_s[1:])
    touches = replace(touches, sds_s=np.hypot(touches.sds_s, _UNEVEN * flights_s))
    start = fit.unknowns.copy()
    start[[OFFSET, TOUCH]] = match.offset_s, TOUCH_S
    while len(touches.numbers) >= FEWEST_HEARD:
        samples = replace(fit.samples, heard=touches)
        joint = fit_bounce(samples, start, samples.unknowns, most=60)
        times_s = samples.touches_s(joint.unknowns, touches.numbers) + joint.unknowns[OFFSET]
        off = np.abs(times_s - touches.times_s) / touches.sds_s
        if off.max() < _LATE_SDS:
            return joint
        touches = touches.only(np.arange(len(off)) != off.argmax())
    return None


def _lost(alone: BounceFit, joint: BounceFit) -> float:
    """Log likelihood of the pictures that the joint fit gives up."""
    factor = max(correlation_time(alone.residuals, len(alone.free)), alone.effective_sample_factor)
    return (joint.misfit_cost(alone.scale) - alone.misfit_cost(alone.scale)) / factor
