"""A drop of a campaign as its tuning's JSON tells of it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from analysis.campaign.small_film import SmallFilm
from analysis.drop.curves import TunedCurves
from analysis.tuning import Verdict

State = Literal["drop", "doubtful drop", "rejected drop"]

_MOST_BYTES = 16 * 1024**2
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
    """

    log: Path | None
    tuning: Path | None
    name: str
    ball: str
    verdict: Verdict
    reason: str
    value: float | None
    interval95: tuple[float, float] | None
    overlay: TunedCurves | None
    window_s: tuple[float, float] | None = None
    film: SmallFilm | None = None

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
    if tuning.stat().st_size > _MOST_BYTES:
        return None
    try:
        told = json.loads(tuning.read_bytes())
        if told["task"] not in ("drop", None):
            return None
        name = Path(str(told["log"])).name
        log = tuning.parent / name
        is_beside = name not in ("", "..") and log.exists()
        return as_told(told, log if is_beside else None, tuning)
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError):
        return None


def as_told(told: Mapping[str, Any], log: Path | None, tuning: Path | None) -> TunedDrop:
    """The drop of what a tuning's JSON says.

    Raises:
        ValueError, TypeError, LookupError: it says something else.
    """
    restitution = (told["parameters"] or {}).get("restitution")
    ends = restitution and restitution["interval95"]
    window = told.get("window")
    if told["verdict"] not in _STATES:
        raise ValueError("no verdict")
    return TunedDrop(
        log=log,
        tuning=tuning,
        name=str(told["log"]),
        ball=str(told.get("ball") or ""),
        verdict=told["verdict"],
        reason=str(told["reason"] or ""),
        value=_finite(restitution["value"]) if restitution else None,
        interval95=(_finite(ends[0]), _finite(ends[1])) if ends else None,
        overlay=TunedCurves.from_json(told["curves"]) if "curves" in told else None,
        window_s=(_finite(window["start_s"]), _finite(window["end_s"])) if window else None,
    )


def _finite(value: Any) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{value} is no number")
    return number
