"""What messages of an imported log cannot say: units that nobody named, samples that are left out.

An import writes it to the notes of the log, by topic, and a reader puts it back, so that an
imported log is tuned as what it was imported from.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import FRAME_NS, UNSTATED, Channel, Episode, Frame, Signal
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.left_out import added, as_note, of_note
from tunenet_logs.messages import HEADER

# How notes begin, before a signal's name.
_UNIT, _COUNTS, _IMPACTS, _LEFT_OUT = "length_unit:", "counts_frames:", "impacts:", "left_out:"

_UNTIMED = "frames_untimed"  # a note of a log whose pictures count
_YES = "1"
_UNKNOWN = "unknown"  # a unit of length that nobody names


def is_impacts(signal: Signal) -> bool:
    """Check whether a signal is a series of impact times, with no other content."""
    return signal.columns == ("impact",)


def notes_of(signal: Signal, name: str) -> dict[str, str]:
    """Return the notes on a signal, under its `name` in the imported log."""
    notes: dict[str, str] = {}
    if signal.is_position and signal.unit != "m":
        notes[_UNIT + name] = signal.unit or _UNKNOWN
    if signal.counts_frames:
        notes[_COUNTS + name] = _YES
    if is_impacts(signal):
        notes[_IMPACTS + name] = _YES
    if signal.left_out:
        notes[_LEFT_OUT + name] = as_note(signal.left_out)
    return notes


def notes_of_frames(episode: Episode) -> dict[str, str]:
    """Return the note on an episode's pictures, if there is one."""
    return {_UNTIMED: _YES} if episode.frames_untimed else {}


def notes_of_channels(episode: Episode, topic_of: Callable[[str], str]) -> dict[str, str]:
    """Return the notes on what pictures and sounds lack, by their topics after the import."""
    return {
        _LEFT_OUT + topic_of(one.topic): as_note(one.left_out)
        for one in episode.channels
        if any(one.left_out.values()) and one.skipped is None
    }


def restored(episode: Episode, options: ReadOptions) -> Episode:
    """Restore what an imported log's notes say; the user's options go before them."""
    notes = episode.info.notes
    if not any(key.startswith((_UNIT, _COUNTS, _IMPACTS, _LEFT_OUT, _UNTIMED)) for key in notes):
        return episode
    impacts = {
        one.topic: _impacts(one)
        for one in episode.channels
        if one.type_name == HEADER and notes.get(_IMPACTS + one.topic) == _YES and one.messages
    }
    channels = tuple(
        replace(
            one,
            skipped=None if one.topic in impacts else one.skipped,
            left_out=added(one.left_out, of_note(notes.get(_LEFT_OUT + one.topic, "")))
            if one.pictures or one.sounds
            else {},
        )
        for one in episode.channels
    )
    signals = {**episode.signals, **impacts}
    found = replace(
        episode,
        signals={name: _restored(one, notes, options) for name, one in signals.items()},
        channels=channels,
    )
    if notes.get(_UNTIMED) != _YES or episode.open_frames is None:
        return found
    if not options.rate_hz:
        return replace(found, frames_untimed=True)
    opened, rate_hz = episode.open_frames, options.rate_hz

    def timed(topic: str) -> Iterator[Frame]:
        for frame in opened(topic):
            stamp_ns = int(_timed(np.array([frame.stamp_ns]), rate_hz)[0])
            yield replace(frame, stamp_ns=stamp_ns)

    return replace(found, open_frames=timed)


def rate_is_unused(episode: Episode, options: ReadOptions) -> bool:
    """Check whether a frame rate was given for messages that all have times of their own."""
    keys = (_COUNTS, _UNTIMED)
    return options.rate_hz is not None and not any(
        key.startswith(keys) for key in episode.info.notes
    )


def _restored(signal: Signal, notes: Mapping[str, str], options: ReadOptions) -> Signal:
    unit = notes.get(_UNIT + signal.name, "")
    if signal.is_position and unit and not options.length_unit:
        signal = replace(signal, unit=UNSTATED if unit == _UNKNOWN else "px")
    if before := of_note(notes.get(_LEFT_OUT + signal.name, "")):
        signal = replace(signal, left_out=added(signal.left_out, before))
    if notes.get(_COUNTS + signal.name) != _YES:
        return signal
    if not options.rate_hz:
        return replace(signal, counts_frames=True)
    return replace(signal, stamps_ns=_timed(signal.stamps_ns, options.rate_hz))


def _timed(stamps_ns: NDArray[np.int64], rate_hz: float) -> NDArray[np.int64]:
    """Convert stamps that count frames to those of a rate [ns], shape (T,)."""
    return np.round(stamps_ns * (1e9 / rate_hz / FRAME_NS)).astype(np.int64)


def _impacts(channel: Channel) -> Signal:
    """Return impacts by the log's own stamps of their messages, which an import makes the same."""
    stamps_ns = np.unique(channel.log_ns)
    return Signal(channel.topic, stamps_ns, np.ones((len(stamps_ns), 1)), ("impact",), "1")
