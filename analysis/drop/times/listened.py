"""Sound of an episode, and its onsets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.drop.remedies import RIGHT_SOUND
from analysis.drop.times.ball_among import BallAmong, ball_among
from analysis.drop.times.fit import Rig
from analysis.listening.onsets import Onsets, onsets
from analysis.selection import Selection, check_start
from tunenet_logs.episode import Episode
from tunenet_logs.errors import NotFoundError
from tunenet_logs.sound import Sound
from tunenet_logs.terminal import listed


@dataclass(frozen=True, eq=False)
class Listened:
    """Sound, and the onsets in the chosen part of it.

    Attributes:
        sound: all of it.
        knocks: of the part, their times on the sound's clock.
        part_s: first and last moment of the part, on the same clock.
    """

    sound: Sound
    knocks: Onsets
    part_s: tuple[float, float]

    def ball(self, rig: Rig) -> BallAmong | None:
        """Find the ball that is heard best; None where nothing sounds like one."""
        return ball_among(self.knocks, self.part_s[1] - self.part_s[0], rig)


def listened(episode: Episode, selection: Selection) -> Listened:
    """Detect the onsets in an episode's sound.

    Raises:
        NotFoundError: there is no sound of that name, or it is silent.
    """
    topic = selection.topic
    if topic is not None and topic not in episode.sound_topics:
        what = f"no sound in topic {topic} (there is: {listed(episode.sound_topics)})"
        raise NotFoundError(what, "name one of these with --topic, or leave it out")
    sound = episode.sounds(topic)
    if sound is None:
        raise NotFoundError("no sound")
    check_start(selection.start_s, sound.lasts_s)
    begin_s = selection.start_s or 0.0
    end_s = min(selection.end_s or np.inf, sound.lasts_s)
    if not np.any(sound.samples):
        raise NotFoundError(f"{sound.name}: the sound is silent", RIGHT_SOUND)
    knocks = onsets(sound)
    inside = (knocks.times_s >= begin_s) & (knocks.times_s <= end_s)
    return Listened(sound, knocks.only(inside), (begin_s, end_s))
