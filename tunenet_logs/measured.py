"""Reduce an episode to its measurements, without commands and forces."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from tunenet_logs.episode import Episode
from tunenet_logs.formats.shape_messages import UNUSED
from tunenet_logs.terminal import short_name


def measured(episode: Episode) -> Episode:
    """Return the episode without commands, forces, and warnings about their channels.

    A commanded trajectory is no joint's state, and a sensor's torque no joint's: whoever looks for
    something in a log by its units looks at this. One without any is given back as it is.
    """
    driving = {name for name, signal in episode.signals.items() if signal.drives}
    channels = [channel for channel in episode.channels if channel.drives]
    if not driving and not channels:
        return episode
    others = {channel.topic for channel in episode.channels if not channel.drives}
    names = driving | ({channel.topic for channel in channels} - others)
    starts = tuple(f"{one}: " for name in names for one in (name, short_name(name)))

    def kept(lines: Iterable[str]) -> tuple[str, ...]:
        return tuple(line for line in lines if not line.startswith(starts))

    return replace(
        episode,
        signals={name: one for name, one in episode.signals.items() if name not in driving},
        channels=tuple(
            replace(one, skipped=UNUSED) if one.drives else one for one in episode.channels
        ),
        warnings=kept(episode.warnings),
        losses=kept(episode.losses),
    )
