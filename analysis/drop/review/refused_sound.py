"""A sound in which no ball is heard: its envelope, and all that knocks."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from analysis.drop.review.sound import Marks, log_sound, sound_of
from analysis.drop.times.detection import TimesDetection
from analysis.listening.onsets import onsets
from analysis.record import Tuning
from analysis.review.drawing import IMPACT


def log_refused_sound(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
    """Send envelope and knocks; None where there is no sound, or it is silent."""
    found: TimesDetection | None = tuning.refused
    if found is not None and found.listened is not None:
        sound, span_s = found.listened.sound, found.listened.part_s
        knocks_s = found.listened.knocks.times_s
    else:
        sound = sound_of(tuning.episode)
        if sound is None:
            return None
        span_s, knocks_s = (0.0, sound.lasts_s), onsets(sound).times_s
    marks = (Marks("knock", "knock", IMPACT, knocks_s),)
    said = f"red: what knocks ({len(knocks_s)})" if len(knocks_s) else "nothing knocks"
    view = log_sound(stream, sound, 0.0, span_s, marks, said)
    return None if view is None else rrb.Vertical(view)
