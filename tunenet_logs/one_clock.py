"""Reduce an episode to one clock: every signal without what was stamped across a jump."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from tunenet_logs.clock_jumps import SoundPart, filmed_part, sound_part
from tunenet_logs.episode import Episode, Signal
from tunenet_logs.left_out import BY_CLOCK, added


def on_one_clock(episode: Episode) -> Episode:
    """Keep the longest part of each signal without a clock jump, and warn of each cut.

    Pictures are cut by whoever looks at them: they are not in memory.
    """
    parts = {name: sound_part(signal.stamps_ns) for name, signal in episode.signals.items()}
    signals = {
        name: _kept(signal, parts[name]) if parts[name].words else signal
        for name, signal in episode.signals.items()
    }
    warnings = tuple(dict.fromkeys((*episode.warnings, *_said(parts))))
    return replace(episode, signals=signals, warnings=warnings)


def _kept(signal: Signal, part: SoundPart) -> Signal:
    stamps_ns, values = signal.stamps_ns[part.keep], signal.values[part.keep]
    cut = {BY_CLOCK: len(signal.stamps_ns) - len(stamps_ns)}
    return replace(signal, stamps_ns=stamps_ns, values=values, left_out=added(signal.left_out, cut))


def with_jumps_of_pictures(episode: Episode) -> Episode:
    """Mark the pictures of a video beyond a jump of their clock as left out.

    Args:
        episode: its channels' stamps are those of its pictures, as in a video file.
    """
    parts = {
        channel.topic: filmed_part(channel.log_ns)
        for channel in episode.channels
        if channel.pictures and channel.skipped is None
    }
    channels = tuple(
        replace(one, left_out={BY_CLOCK: one.messages - len(parts[one.topic].keep)})
        if one.topic in parts
        else one
        for one in episode.channels
    )
    return replace(episode, channels=channels, warnings=(*episode.warnings, *_said(parts)))


def jump_warnings(episode: Episode) -> list[str]:
    """Return warnings about clock jumps of an episode's signals; the same words only once."""
    return _said({name: sound_part(one.stamps_ns) for name, one in episode.signals.items()})


def _said(parts: Mapping[str, SoundPart]) -> list[str]:
    """List what is wrong with the clocks, by the first name of those that share it."""
    found: dict[str, str] = {}
    for name, part in parts.items():
        for words in part.words:
            found.setdefault(words, name)
    return [f"{name}: {words}" for words, name in found.items()]
