"""Drop of a campaign, read from the record of its tuning."""

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

_FIRST_WALL_NS = 10**17  # stamps from 1973 on are a wall clock's; smaller ones count from a start
_STATES: Mapping[Verdict, State] = {
    "ok": "drop",
    "suspect": "doubtful drop",
    "rejected": "rejected drop",
}


@dataclass(frozen=True, eq=False)
class TunedDrop:
    """One recorded drop.

    Attributes:
        log: The recording; None if only its tuning is there.
        tuning: The JSON; None if it was tuned here and now.
        name: Of the log.
        ball: As it was named when recording; "" if it was not.
        reason: Why the verdict is not "ok".
        value: The coefficient of restitution; None for a rejected drop.
        interval95: None if no valid one exists.
        overlay: The curves; None if no drop was found.
        window_s: Its first and last sample, since the log's first.
        film: Its images; None if it has none, or they were not read.
        others: Other scalar estimates: how the restitution falls with speed, drag.
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
        """Verdict in the words of a campaign."""
        return _STATES[self.verdict]

    @property
    def wall_ns(self) -> int | None:
        """Time of recording [ns since 1970]; None if its clock is no wall clock."""
        known = self.overlay or self.film
        start_ns = known.start_ns if known is not None else 0
        return start_ns if start_ns > _FIRST_WALL_NS else None


def read_tuned_drop(tuning: Path) -> TunedDrop | None:
    """Read the drop of a tuning's JSON; None if the file is something else.

    Raises:
        OSError: It cannot be read.
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
    """Build the drop of a record, with its log and its JSON if they exist."""
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
