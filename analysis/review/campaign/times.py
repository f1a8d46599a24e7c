"""Timelines of a campaign: by attempt, as one film of all drops, by wall clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr

from analysis.campaign.attempts import Attempt
from analysis.campaign.tuned_drop import TunedDrop

ATTEMPT = "attempt"  # the timeline that is stepped through: 1, 2, ..
FILM = "film_s"  # the timeline that plays: all drops one after the other [s]
# The timeline of when it was recorded; attempts of which that is not known are not on it.
WALL = "wall_clock"

_UNSEEN_S = 1.0  # on `FILM`, of a drop without curves and pictures: long enough to read what it was
# On `FILM`, of a tuning, a shot and an outcome, one after the other: each can be followed.
_STEP_S = 0.5


@dataclass(frozen=True, eq=False)
class Shown:
    """One drop in the film.

    Attributes:
        start_s: Where it begins on `FILM`.
        zero_s: First time of its own clock that is shown.
        end_s: Where it ends on `FILM`.
    """

    attempt: Attempt
    drop: TunedDrop
    start_s: float
    zero_s: float
    end_s: float

    def film_s(self, second: float) -> float:
        """Convert a time of the drop's own clock to `FILM`."""
        return self.start_s + second - self.zero_s

    def wall_ns(self, second: float) -> int:
        """Convert a time of the drop's own clock, if a wall clock's, to `WALL`."""
        assert self.drop.wall_ns is not None
        return self.drop.wall_ns + round(second * 1e9)

    @property
    def begin_ns(self) -> int | None:
        """Where it begins on `WALL`; None if its clock is no wall clock."""
        return None if self.drop.wall_ns is None else self.wall_ns(self.zero_s)


@dataclass(frozen=True, eq=False)
class Slot:
    """One attempt in the film.

    Attributes:
        drops: In their order.
        start_s: Where it begins on `FILM`.
        tuned_s: Where its drops end on `FILM`.
        begin_ns: Where it begins on `WALL`; None if nothing of it has a wall clock.
    """

    attempt: Attempt
    drops: tuple[Shown, ...]
    start_s: float
    tuned_s: float
    begin_ns: int | None

    @property
    def shot_s(self) -> float:
        """Where the shot is on `FILM`."""
        return self.tuned_s + _STEP_S

    @property
    def outcome_s(self) -> float:
        """Where the outcome is on `FILM`."""
        return self.tuned_s + 2 * _STEP_S

    @property
    def end_s(self) -> float:
        """Where the next attempt begins."""
        return self.tuned_s + 4 * _STEP_S

    @property
    def used(self) -> Shown | None:
        """The drop that the shot was tuned from, or the last that was tried."""
        return self.drops[-1] if self.drops else None

    def is_on_wall(self, shown: Shown) -> bool:
        """Return whether one of its drops happened on `WALL` within this attempt."""
        if shown.begin_ns is None or self.begin_ns is None:
            return False
        return shown.begin_ns >= self.begin_ns

    def drop_ns(self, shown: Shown | None) -> int | None:
        """Return where one of its drops is on `WALL`: where it happened, else where this begins."""
        return shown.begin_ns if shown and self.is_on_wall(shown) else self.begin_ns

    @property
    def end_ns(self) -> int | None:
        """Where shot and outcome are on `WALL`."""
        outcome = self.attempt.outcome
        if self.begin_ns is None or outcome is None:
            return self.begin_ns
        return max(self.begin_ns, outcome.stamp_ns)


def slots_of(attempts: Sequence[Attempt]) -> tuple[Slot, ...]:
    """Lay out the attempts one after the other."""
    slots: list[Slot] = []
    begun: set[int] = set()
    at_s = 0.0
    for attempt in attempts:
        start_s = at_s
        shown: list[Shown] = []
        for drop in attempt.drops:
            first_s, last_s = _span(drop)
            shown.append(Shown(attempt, drop, at_s, first_s, at_s + last_s - first_s))
            at_s = shown[-1].end_s
        begin_ns = _begin_ns(attempt, shown, begun)
        begun |= set() if begin_ns is None else {begin_ns}
        slots.append(Slot(attempt, tuple(shown), start_s, at_s, begin_ns))
        at_s = slots[-1].end_s
    return tuple(slots)


def _begin_ns(attempt: Attempt, drops: Sequence[Shown], begun: set[int]) -> int | None:
    """Return its first drop's beginning; its end if another attempt began with that drop."""
    known = [shown.begin_ns for shown in drops if shown.begin_ns is not None]
    ended_ns = (attempt.outcome and attempt.outcome.stamp_ns) or None
    if known and (min(known) not in begun or ended_ns is None):
        return min(known)
    return ended_ns


# What is shown from a moment on: an attempt, and which of its drops; None where it has none.
Begun = tuple[Slot, Shown | None]


def beginnings(slots: Sequence[Slot]) -> list[tuple[str, rr.TimeColumn, list[Begun]]]:
    """Return each timeline's name, its index, and what begins at each row.

    On `ATTEMPT` these are the attempts, each with its last drop; on the others every drop. A view
    with a row, maybe an empty one, at each of them never shows another's data. `WALL` is left out
    without a wall clock.
    """
    steps: dict[int, Begun] = {slot.attempt.number: (slot, slot.used) for slot in slots}
    played: dict[float, Begun] = {}
    clock: dict[int, Begun] = {}
    for slot in slots:
        for shown in slot.drops or (None,):
            played[slot.start_s if shown is None else shown.start_s] = slot, shown
            if (begin_ns := slot.drop_ns(shown)) is not None:
                clock[begin_ns] = slot, shown
    found = [
        (ATTEMPT, rr.TimeColumn(ATTEMPT, sequence=list(steps)), list(steps.values())),
        (FILM, rr.TimeColumn(FILM, duration=list(played)), list(played.values())),
    ]
    if clock:
        found.append((WALL, wall_column(list(clock)), list(clock.values())))
    return found


def moments(slot: Slot, shown: Shown, seconds: Sequence[float]) -> list[rr.TimeColumn]:
    """Return indexes at times of a drop's own clock, on each timeline that plays it."""
    found = [rr.TimeColumn(FILM, duration=[shown.film_s(second) for second in seconds])]
    if slot.is_on_wall(shown):
        found.append(wall_column([shown.wall_ns(second) for second in seconds]))
    return found


def wall_column(stamps_ns: Sequence[int]) -> rr.TimeColumn:
    """Return the index of rows at these times on `WALL`."""
    return rr.TimeColumn(WALL, timestamp=np.array(stamps_ns, "datetime64[ns]"))


def _span(drop: TunedDrop) -> tuple[float, float]:
    """Return first and last time of a drop's visible data, on its own clock [s]."""
    times: list[float] = []
    for part in (drop.overlay, drop.film):
        if part is not None:
            times += (float(part.seconds[0]), float(part.seconds[-1]))
    return (min(times), max(times)) if times else (0.0, _UNSEEN_S)
