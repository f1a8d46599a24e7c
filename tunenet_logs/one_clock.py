"""An episode as one clock saw it: every signal without what was stamped before or after a jump."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from tunenet_logs.clock_jumps import SoundPart, filmed_part, sound_part
from tunenet_logs.episode import Episode, Signal


def on_one_clock(episode: Episode) -> Episode:
    """The episode with the longest sound part of each signal, and a warning for each that was cut.

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
    return replace(signal, stamps_ns=signal.stamps_ns[part.keep], values=signal.values[part.keep])


def jump_warnings(episode: Episode, *, by_channel: bool = False) -> list[str]:
    """What a user should know of the clocks of an episode's signals; the same words only once.

    Args:
        episode: as it was read.
        by_channel: whether its channels' stamps are those of its pictures, as in a video file.
    """
    parts = {name: sound_part(signal.stamps_ns) for name, signal in episode.signals.items()}
    for channel in episode.channels if by_channel else ():
        if channel.pictures and channel.skipped is None:
            parts.setdefault(channel.topic, filmed_part(channel.log_ns))
    return _said(parts)


def _said(parts: Mapping[str, SoundPart]) -> list[str]:
    """What is wrong with the clocks, by the first name of those that share it."""
    found: dict[str, str] = {}
    for name, part in parts.items():
        for words in part.words:
            found.setdefault(words, name)
    return [f"{name}: {words}" for words, name in found.items()]
