"""From the files of a campaign to its attempts, with the drops' pictures."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from analysis.campaign.attempts import Attempt, attempts_of
from analysis.campaign.files import material_of, natural
from analysis.campaign.small_film import small_film
from analysis.campaign.tuned_drop import TunedDrop, as_told
from analysis.processes import Piece, parallel_map
from tunenet_logs.errors import UsageError
from tunenet_logs.progress import Progress

Warn = Callable[[str], None]

_AROUND_S = 0.3
"""Of pictures before and after the curves."""


@dataclass(frozen=True, eq=False)
class Campaign:
    """What is reviewed.

    Attributes:
        attempts: in their order, at least one.
        tuned_now: drops that had no tuning beside them.
        unread: logs that cannot be read, and are no attempts.
    """

    name: str
    attempts: tuple[Attempt, ...]
    tuned_now: int
    unread: int


@dataclass(frozen=True)
class _Unread:
    """A log that cannot be read, and why."""

    reason: str


def campaign_of(
    places: Sequence[Path], jobs: int | None, progress: Progress, warn: Warn
) -> Campaign:
    """Read folders and files of a campaign; drops that were not tuned are tuned, nothing is kept.

    Args:
        places: folders, logs, tunings, outcomes, tables of outcomes.
        jobs: processes; None for all cores.
        progress: shows the drop under way.
        warn: told of what cannot be read or does not fit.

    Raises:
        UsageError: nothing of a campaign is there.
    """
    material = material_of(places, warn)
    work: list[TunedDrop | Path] = [*material.drops, *material.untuned]
    pieces = [Piece(one, 1, one.name) for one in work]
    read = parallel_map(_read, pieces, jobs, progress, ("reading", "drop")) if pieces else []
    unread = [one for one in read if isinstance(one, _Unread)]
    for one in unread:
        warn(one.reason)
    drops = sorted(
        (one for one in read if isinstance(one, TunedDrop)), key=lambda one: natural(one.name)
    )
    attempts = attempts_of(replace(material, drops=tuple(drops), untuned=()), warn)
    if not attempts:
        named = ", ".join(str(one) for one in places)
        raise UsageError(f"{named}: no drop and no outcome of it can be read")
    name = places[0].resolve().name or "campaign"
    return Campaign(name, attempts, sum(one.tuning is None for one in drops), len(unread))


def _read(item: TunedDrop | Path) -> TunedDrop | _Unread | None:
    """A drop with its pictures; runs in the worker processes."""
    drop = _tuned(item) if isinstance(item, Path) else item
    if not isinstance(drop, TunedDrop) or drop.log is None:
        return drop
    overlay = drop.overlay
    window_s = drop.window_s
    if overlay is not None:
        window_s = overlay.seconds[0] - _AROUND_S, overlay.seconds[-1] + _AROUND_S
    start_ns = overlay.start_ns if overlay is not None else None
    return replace(drop, film=small_film(drop.log, start_ns, window_s))


def _tuned(log: Path) -> TunedDrop | _Unread | None:
    """The drop of a log that nobody tuned yet; None where it is something else than a drop."""
    from analysis.record import to_json
    from analysis.tuning import Options, tune_log

    tuning = tune_log(log, Options())
    if tuning.episode is None:
        return _Unread(f"{log}: {tuning.reason}")
    if tuning.task not in ("drop", None):
        return None
    return as_told(json.loads(to_json(tuning)), log, None)
