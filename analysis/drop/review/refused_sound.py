"""Review of a sound in which no ball is heard, or beside no drop: its envelope and onsets."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from analysis.drop.review.sound import Marks, log_sound, sound_of
from analysis.drop.times.detection import TimesDetection
from analysis.listening.onsets import onsets
from analysis.record import Tuning
from analysis.review.drawing import IMPACT
from tunenet_logs.arrays import Array
from tunenet_logs.sound import Sound


def log_refused_sound(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
    """Send envelope and onsets; None where there is no sound, or it is silent."""
    found: TimesDetection | None = tuning.refused
    if found is not None and found.listened is not None:
        sound, span_s = found.listened.sound, found.listened.part_s
        knocks_s = found.listened.knocks.times_s
    else:
        sound = sound_of(tuning.episode)
        if sound is None:
            return None
        span_s, knocks_s = (0.0, sound.lasts_s), onsets(sound).times_s
    view = _log_knocks(stream, sound, 0.0, span_s, knocks_s)
    return None if view is None else rrb.Vertical(view)


def log_sound_of_heights(
    stream: rr.RecordingStream, tuning: Tuning, start_ns: int, span_s: tuple[float, float]
) -> rrb.View | None:
    """Send the sound beside positions without a drop; None where there is none, or it is silent.

    Args:
        stream: the recording.
        tuning: that was refused.
        start_ns: stamp where the heights' time is 0.
        span_s: first and last moment of the heights.
    """
    sound = sound_of(tuning.episode)
    if sound is None:
        return None
    begin_s = (sound.start_ns - start_ns) * 1e-9
    knocks_s = onsets(sound).times_s + begin_s
    inside = (knocks_s >= span_s[0]) & (knocks_s <= span_s[1])
    return _log_knocks(stream, sound, begin_s, span_s, knocks_s[inside])


def _log_knocks(
    stream: rr.RecordingStream,
    sound: Sound,
    begin_s: float,
    span_s: tuple[float, float],
    knocks_s: Array,
) -> rrb.View | None:
    marks = (Marks("knock", "knock", IMPACT, knocks_s),)
    said = f"red: what knocks ({len(knocks_s)})" if len(knocks_s) else "nothing knocks"
    return log_sound(stream, sound, begin_s, span_s, marks, said)
