"""Remove implausible values where a log enters, so that no sum overflows later."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tunenet_logs.episode import Episode, Signal
from tunenet_logs.left_out import IMPLAUSIBLE, added
from tunenet_logs.terminal import short_name

# Of a position, an angle or a torque in any unit: with it, squares and their sums stay finite.
_MAX_SIZE = 1e12

_MIN_SIZE = 1e-60  # apart from 0: below, a ratio could be infinite


def plausible(episode: Episode) -> Episode:
    """Remove values that nothing measures; a warning counts them by topic."""
    signals = {name: _bounded(signal) for name, signal in episode.signals.items()}
    warnings: list[str] = []
    for name, signal in episode.signals.items():
        if signals[name] is signal:
            continue
        count = int(np.sum(np.abs(signal.values) > _MAX_SIZE))
        if count:
            warnings.append(
                f"{short_name(name)}: {count} values beyond {_MAX_SIZE:g} were left out; "
                "nothing measures them"
            )
    if all(signals[name] is signal for name, signal in episode.signals.items()):
        return episode
    return replace(episode, signals=signals, warnings=(*episode.warnings, *warnings))


def _bounded(signal: Signal) -> Signal:
    size = np.abs(signal.values)
    is_huge, is_tiny = size > _MAX_SIZE, (size > 0) & (size < _MIN_SIZE)
    if not is_huge.any() and not is_tiny.any():
        return signal
    values = np.where(is_huge, np.nan, np.where(is_tiny, 0.0, signal.values))
    rows = {IMPLAUSIBLE: int(np.count_nonzero(is_huge.any(axis=1)))}
    return replace(signal, values=values, left_out=added(signal.left_out, rows))
