"""Detect reading options that made no difference."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tunenet_logs.episode import Episode, Signal
from tunenet_logs.errors import LogError
from tunenet_logs.formats.read_options import AS_IT_SAYS, FIELDS, ReadOptions
from tunenet_logs.import_notes import rate_is_unused

if TYPE_CHECKING:
    from tunenet_logs.formats.base import Container

_CHANGED_NOTHING = "not used: the file reads the same without"

_NO_RATE = "--fps not used: its messages have times of their own"
_NO_CURRENTS = (
    "--torque-constants not used: no current is read of its messages (where its efforts are "
    "currents, add --effort-unit A)"
)


def said_unused(name: str, warnings: Iterable[str]) -> bool:
    """Check whether one of the warnings says that an option changed nothing."""
    return any(warning.startswith(f"{name} not used") for warning in warnings)


def unused_of_messages(episode: Episode, options: ReadOptions) -> tuple[str, ...]:
    """Return a line for each option that counts for nothing in a log of messages."""
    reads_currents = any(name.startswith("current") for name in options.columns)
    has_constants = bool(options.torque_constants)
    lines = {
        _NO_RATE: rate_is_unused(episode, options),
        _NO_CURRENTS: has_constants and not reads_currents,
    }
    return tuple(filter(lines.get, lines))


def unused_reading(
    path: Path,
    episode: Episode,
    options: ReadOptions,
    read: Callable[[Path, ReadOptions], Container | Episode],
) -> tuple[str, ...]:
    """Return a line for each option without which a file reads the same.

    Pictures and tables are not asked about what always counts there: their rate, their columns.
    """
    has_pictures = episode.open_frames is not None
    is_table = episode.info.source.startswith("table ")
    counts = {"--fps": has_pictures, "--columns": is_table}
    found: list[str] = []
    for name in options.given:
        if counts.get(name):
            continue
        if not has_pictures or episode.signals:
            field = FIELDS[name]
            without = replace(options, **{field: getattr(AS_IT_SAYS, field)})
            try:
                other = read(path, without)
            except LogError:
                continue
            if not isinstance(other, Episode) or not _is_same(episode, other):
                continue
        found.append(f"{name} {_CHANGED_NOTHING}")
    return tuple(found)


def _is_same(one: Episode, other: Episode) -> bool:
    return list(one.signals) == list(other.signals) and all(
        map(_is_same_signal, one.signals.values(), other.signals.values())
    )


def _is_same_signal(one: Signal, other: Signal) -> bool:
    facts = [(each.columns, each.unit, each.counts_frames) for each in (one, other)]
    return (
        facts[0] == facts[1]
        and np.array_equal(one.stamps_ns, other.stamps_ns)
        and np.array_equal(one.values, other.values, equal_nan=True)
    )
