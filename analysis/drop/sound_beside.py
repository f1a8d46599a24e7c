"""Sound beside a ball that is seen: the segment in which it bounces, and its onsets."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.drop.bounce_posterior import BallPosterior
from analysis.drop.ear_and_eye import EarAndEye, with_sound
from analysis.drop.heard import HeardImpacts
from analysis.listening.onsets import Onsets, onsets
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode
from tunenet_logs.errors import TuneNetError
from tunenet_logs.sound import Sound

# Around the impacts that are seen: what the sound's background is learnt from.
_BEFORE_S, _AFTER_S = 1.0, 0.5

# Of a knock that is as likely a ball's as not, and how fast that changes.
_TYPICAL_RISE_DB, _RISE_SD_DB = 5.0, 1.5


@dataclass(frozen=True, eq=False)
class SoundBeside:
    """Sound of an episode in which a ball is seen.

    Attributes:
        episode: with the ball and the sound.
        topic: of the sound.
        start_ns: where the drop's clock is 0.
    """

    episode: Episode
    topic: str
    start_ns: int

    def with_pictures(self, pictures: BallPosterior, why_not: str = "") -> EarAndEye:
        """Add the sound to what pictures or positions say, unless `why_not` gives a reason."""
        if why_not:
            return EarAndEye(pictures, pictures, reason=why_not)
        try:
            sound = self.episode.sounds(self.topic)
        except TuneNetError:
            sound = None
        if sound is None or not len(sound.samples):
            return EarAndEye(pictures, pictures, reason="it cannot be read")
        view = pictures.fit.projection()
        first_s, last_s = view.impact_s, float(pictures.fit.samples.seconds[-1])
        begins_s = (sound.start_ns - self.start_ns) * 1e-9
        part = _part(sound, first_s - _BEFORE_S - begins_s, last_s + _AFTER_S - begins_s)
        if len(part.samples) < 2:
            return EarAndEye(pictures, pictures, reason="it does not reach to the bounces")
        if not np.any(part.samples):
            return EarAndEye(pictures, pictures, reason="it is silent")
        heard = _impacts_in(onsets(part), part).since(self.start_ns)
        return with_sound(pictures, heard)


def sound_beside(episode: Episode, start_ns: int) -> SoundBeside | None:
    """Return the sound of an episode; None without one, or with several cameras."""
    if not episode.sound_topics or len(episode.picture_topics) > 1:
        return None
    return SoundBeside(episode, episode.sound_topics[0], start_ns)


def _part(sound: Sound, first_s: float, last_s: float) -> Sound:
    """Cut a sound from one time to another, on its own clock."""
    count = len(sound.samples)
    first, last = (int(np.clip(at * sound.rate_hz, 0, count)) for at in (first_s, last_s))
    start_ns = sound.start_ns + round(first * 1e9 / sound.rate_hz)
    return replace(sound, samples=sound.samples[first:last], start_ns=start_ns)


def _impacts_in(knocks: Onsets, sound: Sound) -> HeardImpacts:
    """Convert the onsets of a sound to what may be impacts."""
    return HeardImpacts(
        knocks.times_s,
        knocks.sds_s,
        _probabilities(knocks.rises_db),
        sound.start_ns,
        sound.name,
    )


def _probabilities(rises_db: Array) -> Array:
    """Return each onset's probability to be a ball's, by its rise over the background, (N,)."""
    return 1 / (1 + np.exp((_TYPICAL_RISE_DB - rises_db) / _RISE_SD_DB))
