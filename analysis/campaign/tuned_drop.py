"""A drop of a campaign, by the record of its tuning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from analysis.campaign.small_film import SmallFilm
from analysis.checks import Verdict
from analysis.motion import Curves
from analysis.record import Estimate, Record
from analysis.record_json import read_record
from tunenet_logs.errors import LogError

State = Literal["drop", "doubtful drop", "rejected drop"]

_FIRST_WALL_NS = 10**17
"""Stamps from 1973 on are a wall clock's; smaller ones count from a start."""

_STATES: Mapping[Verdict, State] = {
    "ok": "drop",
    "suspect": "doubtful drop",
    "rejected": "rejected drop",
}


@dataclass(frozen=True, eq=False)
class TunedDrop:
    """One recorded drop.

    Attributes:
        log: the recording; None where only its tuning is there.
        tuning: the JSON; None where it was tuned here and now.
        name: of the log.
        ball: as it was named when recording; "" if it was not.
        reason: why the verdict is not "ok".
        value: the restitution; None for a rejected drop.
        interval95: None where none is honest.
        overlay: the curves; None where no drop was found.
        window_s: its first and last sample, since the log's first.
        film: its pictures; None where it has none, or they were not asked for.
        others: what else was tuned, each one number: how the restitution falls with speed, drag.
    """

    log: Path | None
    tuning: Path | None
    name: str
    ball: str
    verdict: Verdict
    reason: str
    value: float | None
    interval95: tuple[float, float] | None
    overlay: Curves | None
    window_s: tuple[float, float] | None = None
    film: SmallFilm | None = None
    others: tuple[Estimate, ...] = ()

    @property
    def state(self) -> State:
        """The verdict in the words of a campaign."""
        return _STATES[self.verdict]

    @property
    def wall_ns(self) -> int | None:
        """When it was recorded [ns since 1970]; None where its clock does not tell."""
        known = self.overlay or self.film
        start_ns = known.start_ns if known is not None else 0
        return start_ns if start_ns > _FIRST_WALL_NS else None


def read_tuned_drop(tuning: Path) -> TunedDrop | None:
    """The drop of a tuning's JSON; None where the file is something else.

    Raises:
        OSError: it cannot be read.
    """
    tuning.stat()  # a file that cannot be read is no file of something else
    try:
        record = read_record(tuning)
    except LogError:
        return None
    if record.task not in ("drop", None):
        return None
    name = Path(record.log).name
    log = tuning.parent / name
    is_beside = name not in ("", "..") and log.exists()
    return drop_of(record, log if is_beside else None, tuning)


def drop_of(record: Record, log: Path | None, tuning: Path | None) -> TunedDrop:
    """The drop of a record: its log and its JSON, where they are there."""
    restitution = record.estimate("restitution")
    value, ends = (
        (None, None) if restitution is None else (restitution.value, restitution.interval95)
    )
    window = record.window
    return TunedDrop(
        log=log,
        tuning=tuning,
        name=record.log,
        ball=record.ball or "",
        verdict=record.verdict,
        reason=record.reason or "",
        value=value if isinstance(value, float) else None,
        interval95=ends,  # pyright: ignore[reportArgumentType] (one number has one interval)
        overlay=record.motion.curves,
        window_s=(window["start_s"], window["end_s"]) if window else None,
        others=tuple(
            known
            for known in record.estimates
            if known.name != "restitution" and isinstance(known.value, float)
        ),
    )
