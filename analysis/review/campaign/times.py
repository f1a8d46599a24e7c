"""When each part of a campaign is shown: by attempt, as one film of all drops, by the clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import rerun as rr

from analysis.campaign.attempts import Attempt
from analysis.campaign.tuned_drop import TunedDrop

ATTEMPT = "attempt"
"""The timeline that is stepped through: 1, 2, ..."""

FILM = "film_s"
"""The timeline that plays: all drops one after the other [s]."""

WALL = "wall_clock"
"""The timeline of when it was recorded, where that is known."""

_UNSEEN_S = 1.0
"""On `FILM`, of a drop without curves and pictures: long enough to read what it was."""

_STEP_S = 0.5
"""On `FILM`, of a tuning, a shot and an outcome, one after the other: each can be followed."""


@dataclass(frozen=True, eq=False)
class Shown:
    """One drop in the film.

    Attributes:
        start_s: where it begins on `FILM`.
        zero_s: the first time of its own clock that is shown.
        end_s: where it ends on `FILM`.
    """

    attempt: Attempt
    drop: TunedDrop
    start_s: float
    zero_s: float
    end_s: float

    def film_s(self, second: float) -> float:
        """A time of the drop's own clock on `FILM`."""
        return self.start_s + second - self.zero_s


@dataclass(frozen=True, eq=False)
class Slot:
    """One attempt in the film.

    Attributes:
        drops: in their order.
        start_s: where it begins on `FILM`.
        tuned_s: where its drops are over, on `FILM`.
    """

    attempt: Attempt
    drops: tuple[Shown, ...]
    start_s: float
    tuned_s: float

    @property
    def shot_s(self) -> float:
        """Where the shot stands on `FILM`."""
        return self.tuned_s + _STEP_S

    @property
    def outcome_s(self) -> float:
        """Where the outcome stands on `FILM`."""
        return self.tuned_s + 2 * _STEP_S

    @property
    def end_s(self) -> float:
        """Where the next attempt begins."""
        return self.tuned_s + 4 * _STEP_S


def slots_of(attempts: Sequence[Attempt]) -> tuple[Slot, ...]:
    """The attempts one after the other."""
    slots: list[Slot] = []
    at_s = 0.0
    for attempt in attempts:
        start_s = at_s
        shown: list[Shown] = []
        for drop in attempt.drops:
            first_s, last_s = _span(drop)
            shown.append(Shown(attempt, drop, at_s, first_s, at_s + last_s - first_s))
            at_s = shown[-1].end_s
        slots.append(Slot(attempt, tuple(shown), start_s, at_s))
        at_s = slots[-1].end_s
    return tuple(slots)


def at_attempts(slots: Sequence[Slot]) -> list[rr.TimeColumn]:
    """Indexes of something that is shown from the beginning of each attempt on."""
    return [
        rr.TimeColumn(ATTEMPT, sequence=[slot.attempt.number for slot in slots]),
        rr.TimeColumn(FILM, duration=[slot.start_s for slot in slots]),
    ]


def _span(drop: TunedDrop) -> tuple[float, float]:
    """First and last time of what is to be seen of a drop, on its own clock [s]."""
    times: list[float] = []
    for part in (drop.overlay, drop.film):
        if part is not None:
            times += (float(part.seconds[0]), float(part.seconds[-1]))
    return (min(times), max(times)) if times else (0.0, _UNSEEN_S)
