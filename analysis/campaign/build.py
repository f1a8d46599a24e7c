"""Build a campaign's attempts, with images of the drops, from its files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from analysis.campaign.attempts import Attempt, attempts_of
from analysis.campaign.files import material_of, natural
from analysis.campaign.small_film import small_film
from analysis.campaign.tuned_drop import TunedDrop, drop_of
from analysis.processes import Piece, parallel_map
from tunenet_logs.errors import LogError
from tunenet_logs.outcome_reading import Warn
from tunenet_logs.regular_file import real_path
from tunenet_logs.terminal import Progress

# Of pictures before and after the curves, so that what led to them and what followed is seen.
_AROUND_S = 0.3


@dataclass(frozen=True, eq=False)
class Campaign:
    """A campaign to review.

    Attributes:
        name: Of the folder that was named first.
        attempts: In their order, at least one.
        tuned_now: How many drops had no tuning beside them.
        unread: How many logs cannot be read; they are no attempts.
        places: That were named, without links.
    """

    name: str
    attempts: tuple[Attempt, ...]
    tuned_now: int
    unread: int
    places: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Unread:
    """Log that cannot be read, and why."""

    reason: str


def campaign_of(
    places: Sequence[Path], jobs: int | None, progress: Progress, warn: Warn
) -> Campaign:
    """Read the files of a campaign, and tune drops that have no tuning; nothing is written.

    Args:
        places: Folders, logs, tunings, outcomes, tables of outcomes.
        jobs: Processes; None for all cores.
        progress: Shows the drop under way.
        warn: Called with what cannot be read or does not fit.

    Raises:
        LogError: No file of a campaign is there.
    """
    material = material_of(places, warn)
    work: list[TunedDrop | Path] = [*material.drops, *material.untuned]
    pieces = [Piece(item, 1, item.name) for item in work]
    read = parallel_map(_read, pieces, jobs, progress, ("reading", "drop")) if pieces else []
    unread = [log for log in read if isinstance(log, _Unread)]
    for log in unread:
        warn(log.reason)
    drops = sorted(
        (drop for drop in read if isinstance(drop, TunedDrop)), key=lambda drop: natural(drop.name)
    )
    attempts = attempts_of(replace(material, drops=tuple(drops), untuned=()), warn)
    if not attempts:
        named = ", ".join(map(str, places))
        raise LogError(f"{named}: no drop and no outcome of it can be read", "name others")
    name = real_path(places[0]).name or "campaign"
    tuned_now = sum(drop.tuning is None for drop in drops)
    return Campaign(name, attempts, tuned_now, len(unread), places_of(places))


def places_of(places: Sequence[Path]) -> tuple[str, ...]:
    """Return the identity of a campaign: its files and folders, without links."""
    return tuple(str(real_path(place)) for place in places)


def _read(item: TunedDrop | Path) -> TunedDrop | _Unread | None:
    """Read a drop with its images, in a worker process."""
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
    """Tune the drop of a log; None if it is something else than a drop."""
    from analysis.record import record_of
    from analysis.selection import Options
    from analysis.tuning import tune_log

    tuning = tune_log(log, Options())
    if tuning.episode is None:
        return _Unread(f"{log}: {tuning.reason}")
    if tuning.task not in ("drop", None):
        return None
    return drop_of(record_of(tuning), log, None)
