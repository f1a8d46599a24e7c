"""Which tuning is of which log, where they lie apart or one log has several tunings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from analysis.campaign.tuned_drop import TunedDrop
from tunenet_logs.wording import listed

Warn = Callable[[str], None]


def with_logs(drops: Iterable[TunedDrop], logs: Iterable[Path], warn: Warn) -> list[TunedDrop]:
    """Give tunings that lie apart from their logs the one log of that name.

    Args:
        drops: a tuning without a log whose name several logs have is left out; `warn` is told.
        logs: all recordings of the campaign.
        warn: told of tunings that may be of several logs.
    """
    by_name: dict[str, list[Path]] = {}
    for log in logs:
        by_name.setdefault(log.name, []).append(log)
    placed: list[TunedDrop] = []
    for drop in drops:
        same = by_name.get(drop.name, []) if drop.log is None else []
        if len(same) > 1:
            warn(
                f"{drop.tuning}: is left out, as {len(same)} logs are called {drop.name} "
                f"({listed(map(str, same))}); put it beside its own"
            )
        else:
            placed.append(replace(drop, log=same[0]) if same else drop)
    return placed


def one_each(drops: Sequence[TunedDrop], named: frozenset[Path], warn: Warn) -> list[TunedDrop]:
    """Of several tunings of one log the one that counts, so that no drop is counted twice.

    Args:
        drops: those without a log stay.
        named: what outcomes name, resolved: that counts; else what is called as the log is.
        warn: told which counts.
    """
    by_log: dict[Path, list[TunedDrop]] = {}
    for drop in drops:
        if drop.log is not None:
            by_log.setdefault(drop.log.resolve(), []).append(drop)
    kept = [one for one in drops if one.log is None]
    for log, several in by_log.items():
        chosen = min(several, key=lambda one: _rank(one, named))
        if len(several) > 1:
            warn(f"{log}: has {len(several)} tunings; {chosen.tuning} counts")
        kept.append(chosen)
    return kept


def _rank(drop: TunedDrop, named: frozenset[Path]) -> tuple[bool, bool, str]:
    tuning, log = drop.tuning or Path(), drop.log or Path()
    return tuning.resolve() not in named, tuning.stem != log.stem, str(tuning)
