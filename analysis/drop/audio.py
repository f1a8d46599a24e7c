"""Match the onsets in a sound track to the impacts that the pictures predict, and fit both jointly.

The fit to the pictures predicts when each impact was, with a covariance: two impacts that are
resolved well may both be late together. One offset is common to all that is heard. From each pair
of an impact and an onset on, the others are looked for in turn, the surest first, and each that is
heard narrows the rest (a Kalman filter's update). What a match is worth is by how much likelier its
onsets are as impacts than as so many onsets at any time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.drop.bounce_fit import MAX_IMPACTS, BounceFit, fit_bounce
from tunenet_logs.analysis.drop.bounce_model import (
    IMPACT,
    OFFSET,
    OFFSET_SD_S,
    SCATTERS,
    TOUCH,
    TOUCH_S,
    AudioImpacts,
    BounceSamples,
    nudged,
)
from tunenet_logs.analysis.drop.bounce_posterior import BallPosterior, ball_posterior
from tunenet_logs.analysis.onsets import onsets
from tunenet_logs.analysis.record import SoundShare
from tunenet_logs.episode import Array, Episode
from tunenet_logs.errors import TuneNetError


@dataclass(frozen=True, eq=False)
class HeardImpacts:
    """Onsets in a sound track, in order. Some are no impacts, and some impacts are missing."""

    times_s: Array  # of the onsets, shape (N,)
    sds_s: Array  # standard deviations of them, shape (N,)
    probabilities: Array  # of each to be an impact of a ball, by its sound, shape (N,)

    def only(self, chosen: NDArray[np.bool_]) -> HeardImpacts:
        """Return the onsets of a mask, shape (N,)."""
        columns = (self.times_s, self.sds_s, self.probabilities)
        return HeardImpacts(*(one[chosen] for one in columns))


# ---- Match of onsets to predicted impacts

FARTHEST_OFFSET_S = 0.1  # that sound and pictures may be apart
MIN_HEARD = 3  # impacts: two whole flights
_HEARD = 0.8  # probability that an impact is heard
_MIN_RATE_HZ = 1.0  # of onsets: in a silent room as many could be heard by chance


@dataclass(frozen=True, eq=False)
class HeardMatch:
    """Onsets matched to a drop's impacts."""

    touches: AudioImpacts  # the matched onsets
    offset_s: float  # by how much they are later than the pictures have them
    log_odds: float  # of the match against onsets at any time
    onsets: int  # how many there are in all, while the ball bounces


@dataclass(frozen=True, eq=False)
class PredictedImpacts:
    """Impact times predicted by a fit."""

    times_s: Array  # shape (K,)
    covariance: Array  # of them [s^2], shape (K, K)

    def told(self, at: int, off_s: float, variance: float) -> PredictedImpacts:
        """Apply a Kalman update: impact `at` is `off_s` late, with this variance [s^2]."""
        gain = self.covariance[:, at] / variance
        covariance = self.covariance - np.outer(gain, self.covariance[at])
        return replace(self, times_s=self.times_s + gain * off_s, covariance=covariance)


def foretold(fit: BounceFit, numbers: NDArray[np.intp] | None = None) -> PredictedImpacts:
    """Predict impacts of consecutive numbers, those that are within what was fitted if none.

    They are late by the sound's offset where the fit has one.
    """
    if numbers is None:
        count = len(fit.projection().impacts(float(fit.samples.seconds[-1])))
        numbers = np.arange(min(count, MAX_IMPACTS + 1))
    samples, unknowns = fit.samples, fit.unknowns
    times_s = samples.touches_s(unknowns, numbers)
    rows = np.zeros((len(numbers), len(fit.free)))
    for at, index in enumerate(fit.free):
        if index == OFFSET:
            rows[:, at] = 1.0
            continue
        moved, by = nudged(unknowns, index, 1e-6)
        rows[:, at] = (samples.touches_s(moved, numbers) - times_s) / by
    factor = fit.samples_as_one
    normal, _ = fit.normal_equations()
    covariance = rows @ np.linalg.pinv(normal) @ rows.T * factor
    before_s = samples.touches_s(unknowns, numbers[:1] - 1) if numbers[0] else unknowns[IMPACT]
    # Real flights leave any law by .3 % of their duration.
    uneven = np.cumsum((0.003 * np.diff(times_s, prepend=before_s)) ** 2)
    covariance += np.minimum(uneven[:, None], uneven)
    late_s = float(unknowns[OFFSET]) if OFFSET in fit.free else 0.0
    return PredictedImpacts(times_s + late_s, covariance)


def later_touches(fit: BounceFit, heard: HeardImpacts) -> AudioImpacts | None:
    """Match the onsets after those of a joint fit, on its clock, to the impacts that follow.

    Too low to be seen, later bounces tell most of how the restitution falls with speed.
    """
    assert fit.samples.heard is not None
    begin = int(fit.samples.heard.numbers.max()) + 1
    # The first 25 impacts of a drop are listened for, up to a flight between two that is too short.
    numbers = np.arange(begin, 25)
    times_s = fit.samples.touches_s(fit.unknowns, np.arange(begin - 1, 25))
    numbers = numbers[np.cumprod(np.diff(times_s) > 0.03).astype(bool)]
    if not len(numbers) or not len(heard.times_s):
        return None
    impacts = foretold(fit, numbers)
    span_s = float(np.ptp(heard.times_s))
    rate_hz = max(len(heard.times_s) / max(span_s, 1e-3), _MIN_RATE_HZ)
    pairs: list[tuple[int, int]] = []
    passed_over = 0
    for at in range(len(numbers)):
        onset = int(np.abs(heard.times_s - impacts.times_s[at]).argmin())
        off_s, variance, gained = _compared(impacts, heard, (at, onset), rate_hz)
        # One impact may be passed over, and the next be unsure by 4 ms.
        if passed_over > 1 or variance > 0.004**2:
            break
        if gained < np.log(1 - _HEARD):
            passed_over += 1
            continue
        pairs.append((int(numbers[at]), onset))
        impacts = impacts.told(at, off_s, variance)
        passed_over = 0
    return _touches(pairs, heard) if pairs else None


def match_onsets(impacts: PredictedImpacts, heard: HeardImpacts) -> HeardMatch | None:
    """Match onsets to three impacts or more, on one clock; None where too few onsets fit."""
    first_s, last_s = impacts.times_s[[0, -1]]
    near = heard.times_s > first_s - FARTHEST_OFFSET_S
    near &= heard.times_s < last_s + FARTHEST_OFFSET_S
    heard = heard.only(near)
    count = len(heard.times_s)
    if not MIN_HEARD <= count <= 400:  # more of them leave no silence to hear a bounce in
        return None
    rate_hz = max(count / float(last_s - first_s + 2 * FARTHEST_OFFSET_S), _MIN_RATE_HZ)
    offsets_s = heard.times_s - impacts.times_s[:, None]
    best: HeardMatch | None = None
    tried: set[tuple[int, int]] = set()
    for number, onset in np.argwhere(np.abs(offsets_s) < FARTHEST_OFFSET_S).tolist():
        if (number, onset) in tried:
            continue
        found, pairs = _from_pair(impacts, heard, (number, onset), rate_hz)
        tried.update(pairs)  # from any of its pairs it would be found again
        if len(pairs) >= MIN_HEARD and (best is None or found.log_odds > best.log_odds):
            best = found
    return None if best is None else replace(best, onsets=count)


def _from_pair(
    impacts: PredictedImpacts, heard: HeardImpacts, pair: tuple[int, int], rate_hz: float
) -> tuple[HeardMatch, list[tuple[int, int]]]:
    """Grow the match that one impact and one onset begin."""
    told = replace(impacts, covariance=impacts.covariance + OFFSET_SD_S**2)
    open_numbers = set(range(len(told.times_s)))
    number, onset = pair
    pairs: list[tuple[int, int]] = []
    log_odds = 0.0
    while True:
        off_s, variance, gained = _compared(told, heard, (number, onset), rate_hz)
        if not pairs or gained > np.log(1 - _HEARD):
            log_odds += gained
            pairs.append((number, onset))
            told = told.told(number, off_s, variance)
        else:
            log_odds += np.log(1 - _HEARD)
        open_numbers.discard(number)
        if not open_numbers:
            break
        number = min(open_numbers, key=lambda one: float(told.covariance[one, one]))
        onset = int(np.abs(heard.times_s - told.times_s[number]).argmin())
    pairs.sort()
    touches = _touches(pairs, heard)
    offset_s = float(np.median(touches.times_s - impacts.times_s[touches.numbers]))
    return HeardMatch(touches, offset_s, float(log_odds), len(heard.times_s)), pairs


def _compared(
    impacts: PredictedImpacts, heard: HeardImpacts, pair: tuple[int, int], rate_hz: float
) -> tuple[float, float, float]:
    """Compare an onset with an impact: how late it is, the variance of that, and its log odds."""
    at, onset = pair
    variance = float(impacts.covariance[at, at]) + _sds_s(heard)[onset] ** 2
    off_s = float(heard.times_s[onset] - impacts.times_s[at])
    if abs(off_s) > 4.0 * np.sqrt(variance):  # it is not that impact
        return off_s, variance, -np.inf
    # What an onset's own sound takes from a match: it adds nothing.
    probability = float(np.clip(heard.probabilities[onset], 1e-3, 0.5))
    gained = np.log(_HEARD / rate_hz) - 0.5 * off_s**2 / variance
    gained += -0.5 * np.log(2 * np.pi * variance) + float(np.log(probability / (1 - probability)))
    return off_s, variance, float(gained)


def _touches(pairs: list[tuple[int, int]], heard: HeardImpacts) -> AudioImpacts:
    """Build the touches of pairs of an impact's number and an onset."""
    numbers, onsets = np.array(pairs).T
    return AudioImpacts(numbers, heard.times_s[onsets], _sds_s(heard)[onsets])


def _sds_s(heard: HeardImpacts) -> Array:
    return np.maximum(heard.sds_s, 1e-4)  # no microphone's distance and no table is better


# ---- Joint fit of pictures and sound: sound counts as far as the pictures confirm it


@dataclass(frozen=True, eq=False)
class FusedEstimate:
    """Ball by its pictures, with what sound adds to them."""

    posterior: BallPosterior  # of both where the sound is used, else of the pictures
    pictures: BallPosterior  # of the pictures alone
    # By the pictures; None where the sound was not compared with them.
    impacts: PredictedImpacts | None = None
    # The onsets that the pictures confirm; None where there are too few.
    match: HeardMatch | None = None
    touches: AudioImpacts | None = None  # those in the fit; None where the sound is not used
    reason: str = ""  # why it is not used, in words; "" where it is

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


def with_sound(pictures: BallPosterior, heard: HeardImpacts) -> FusedEstimate:
    """Fit a ball to its pictures and to the onsets, on the same clock, that they confirm."""
    impacts = foretold(pictures.fit)
    alone = FusedEstimate(pictures, pictures, impacts)
    if len(impacts.times_s) < MIN_HEARD:
        return replace(alone, reason=f"fewer than {MIN_HEARD} impacts are seen")
    match = match_onsets(impacts, heard)
    if match is None:
        reason = f"fewer than {MIN_HEARD} of its onsets fit the impacts"
        return replace(alone, reason=reason)
    if match.log_odds < 7.0:  # chance has as much
        reason = f"{len(match.touches.numbers)} of its onsets fit the impacts, as chance has it"
        return replace(alone, match=match, reason=reason)
    alone_fit, fit = pictures.fit, _joint_fit(pictures.fit, match, heard)
    # The log likelihood of the pictures that the joint fit gives up: with more they contradict.
    if (
        fit is None
        or (fit.misfit_cost(alone_fit.scale) - alone_fit.misfit_cost(alone_fit.scale))
        / alone_fit.samples_as_one
        > 8.0
    ):
        return replace(alone, match=match, reason="its onsets contradict the pictures")
    return replace(alone, posterior=ball_posterior(fit), match=match, touches=fit.samples.heard)


def _joint_fit(fit: BounceFit, match: HeardMatch, heard: HeardImpacts) -> BounceFit | None:
    """Fit both, without onsets that are far off; None where too few are left."""
    start = fit.unknowns.copy()
    start[OFFSET] = match.offset_s
    if not fit.samples.is_soft:  # else pictures show how long a contact lasts
        start[TOUCH] = TOUCH_S
    touches = match.touches
    joint = _consistent(_likeliest(fit.samples, start, touches))
    for _ in range(3):  # in each, later impacts are listened for
        more = None if joint is None else later_touches(joint, heard)
        if joint is None or more is None or more.numbers[-1] <= touches.numbers[-1]:
            break
        touches = touches.beside(more.only(more.numbers > touches.numbers[-1]))
        later = _consistent(_likeliest(fit.samples, joint.unknowns, touches))
        if later is None:
            break
        joint = later
    return joint


def _likeliest(samples: BounceSamples, start: Array, touches: AudioImpacts) -> BounceFit:
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
        if off.max() < 5.0:  # farther off it is none of its impacts
            return fit
        if len(touches.numbers) <= MIN_HEARD:
            return None
        kept = replace(fit.samples, heard=touches.only(np.arange(len(off)) != off.argmax()))
        fit = fit_bounce(kept, fit.unknowns, kept.unknowns, most=60)


# ---- Sound of an episode: the segment in which the ball bounces, and its onsets


@dataclass(frozen=True, eq=False)
class SoundBeside:
    """Sound of an episode in which a ball is seen."""

    episode: Episode  # with the ball and the sound
    topic: str  # of the sound
    start_ns: int  # where the drop's clock is 0

    def with_pictures(self, pictures: BallPosterior, why_not: str = "") -> FusedEstimate:
        """Add the sound to what pictures or positions say, unless `why_not` gives a reason."""
        if why_not:
            return FusedEstimate(pictures, pictures, reason=why_not)
        try:
            sound = self.episode.sounds(self.topic)
        except TuneNetError:
            sound = None
        if sound is None or not len(sound.samples):
            return FusedEstimate(pictures, pictures, reason="it cannot be read")
        view = pictures.fit.projection()
        first_s, last_s = view.impact_s, float(pictures.fit.samples.seconds[-1])
        begins_s = (sound.start_ns - self.start_ns) * 1e-9
        # Around the impacts that are seen: what the sound's background is learnt from.
        ends_s = (first_s - 1.0 - begins_s, last_s + 0.5 - begins_s)
        count = len(sound.samples)
        first, last = (int(np.clip(at_s * sound.rate_hz, 0, count)) for at_s in ends_s)
        start_ns = sound.start_ns + round(first * 1e9 / sound.rate_hz)
        part = replace(sound, samples=sound.samples[first:last], start_ns=start_ns)
        if len(part.samples) < 2:
            return FusedEstimate(pictures, pictures, reason="it does not reach to the bounces")
        if not np.any(part.samples):
            return FusedEstimate(pictures, pictures, reason="it is silent")
        knocks = onsets(part)
        times_s = knocks.times_s + (part.start_ns - self.start_ns) * 1e-9
        # A knock that rises by 5 dB over the background is as likely a ball's as not.
        probabilities = 1 / (1 + np.exp((5.0 - knocks.rises_db) / 1.5))
        return with_sound(pictures, HeardImpacts(times_s, knocks.sds_s, probabilities))


def sound_beside(episode: Episode, start_ns: int) -> SoundBeside | None:
    """Return the sound of an episode; None without one, or with several cameras."""
    if not episode.sound_topics or len(episode.picture_topics) > 1:
        return None
    return SoundBeside(episode, episode.sound_topics[0], start_ns)
