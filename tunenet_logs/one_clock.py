"""An episode as one clock saw it: every signal without what was stamped before or after a jump."""

from __future__ import annotations

from dataclasses import replace

from tunenet_logs.clock_jumps import filmed_part, sound_part
from tunenet_logs.episode import Episode, Signal


def on_one_clock(episode: Episode) -> Episode:
    """The episode with the longest sound part of each signal, and a warning for each that was cut.

    Pictures are cut by whoever looks at them: they are not in memory.
    """
    signals: dict[str, Signal] = {}
    for name, signal in episode.signals.items():
        part = sound_part(signal.stamps_ns)
        if part.words:
            stamps_ns, values = signal.stamps_ns[part.keep], signal.values[part.keep]
            signal = replace(signal, stamps_ns=stamps_ns, values=values)  # noqa: PLW2901
        signals[name] = signal
    warnings = tuple(dict.fromkeys((*episode.warnings, *jump_warnings(episode))))
    return replace(episode, signals=signals, warnings=warnings)


def jump_warnings(episode: Episode, *, by_channel: bool = False) -> list[str]:
    """What a user should know of the clocks of an episode's signals; the same words only once.

    Args:
        episode: as it was read.
        by_channel: whether its channels' stamps are those of its pictures, as in a video file.
    """
    found: dict[str, str] = {}
    for name, signal in episode.signals.items():
        for words in sound_part(signal.stamps_ns).words:
            found.setdefault(words, name)
    for channel in episode.channels if by_channel else ():
        if channel.pictures and channel.skipped is None:
            for words in filmed_part(channel.log_ns).words:
                found.setdefault(words, channel.topic)
    return [f"{name}: {words}" for words, name in found.items()]
