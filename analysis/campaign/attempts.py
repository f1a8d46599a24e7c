"""Attempts: which drops, tuning and outcome belong together, and in which order they came."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from analysis.campaign.files import Material, natural
from analysis.campaign.tuned_drop import TunedDrop
from tunenet_logs.outcome import Outcome

Warn = Callable[[str], None]

UNNAMED = "unnamed ball"


@dataclass(frozen=True, eq=False)
class Attempt:
    """One attempt: what was dropped, until a drop was good, and what the shot then did.

    Attributes:
        number: its place in the campaign, from 1.
        of_ball: which of its ball, from 1.
        drops: in their order; the last is the one that the shot was tuned from.
        outcome: None where none was recorded.
    """

    number: int
    ball: str
    of_ball: int
    drops: tuple[TunedDrop, ...]
    outcome: Outcome | None

    @property
    def used(self) -> TunedDrop | None:
        """The drop that the shot was tuned from, or the last that was tried."""
        return self.drops[-1] if self.drops else None

    @property
    def is_accepted(self) -> bool | None:
        """Whether that drop passed the checks; None where nothing is known of it."""
        return None if self.used is None else self.used.verdict != "rejected"

    @property
    def value(self) -> float | None:
        """The restitution that the shot was planned with, or would have been."""
        if self.used is not None and self.used.value is not None:
            return self.used.value
        return None if self.outcome is None else self.outcome.tuned_parameter

    @property
    def interval95(self) -> tuple[float, float] | None:
        """Of the restitution, where its tuning has one."""
        return None if self.used is None else self.used.interval95

    @property
    def was_shot(self) -> bool:
        """Whether there was a shot: one that was given up has neither height nor miss."""
        one = self.outcome
        if one is None:
            return False
        is_measured = one.shot_height_m is not None or one.miss_m is not None
        return one.success or is_measured or self.is_accepted is not False

    @property
    def name(self) -> str:
        """For titles."""
        return f"{self.number}: {self.ball}, {self.of_ball}"


def attempts_of(material: Material, warn: Warn) -> tuple[Attempt, ...]:
    """The attempts of a campaign in their order.

    A drop belongs to every outcome that names it. One that none names and that came before one
    that is named, of the same ball, was tried for the same attempt. Times decide where every drop
    has one of a wall clock, else names.
    """
    drops = _ordered(material.drops)
    latest = _latest(material.outcomes, warn)
    linked = _linked(latest, drops, material.roots)
    made: list[tuple[int, Attempt]] = []
    waiting: list[tuple[int, TunedDrop]] = []
    for place, drop in enumerate(drops):
        for outcome in linked.get(id(drop), ()):
            _check_ball(drop, outcome, warn)
            tried = [one for one in waiting if one[1].ball in ("", outcome.ball)]
            waiting = [one for one in waiting if one not in tried]
            own = (*(one for _, one in tried), drop)
            made.append((place, Attempt(0, outcome.ball, outcome.attempt, own, outcome)))
        if id(drop) not in linked:
            waiting.append((place, drop))
    made += [(place, _lone(drop)) for place, drop in waiting]
    ordered = [one for _, one in sorted(made, key=lambda one: one[0])]
    placed = {id(one.outcome) for one in ordered}
    rest = [one for one in latest if id(one) not in placed]
    ordered += [Attempt(0, one.ball, one.attempt, (), one) for one in rest]
    if all(_wall_ns(one) is not None for one in ordered):
        ordered.sort(key=lambda one: _wall_ns(one) or 0)
    return tuple(_numbered(ordered))


def _check_ball(drop: TunedDrop, outcome: Outcome, warn: Warn) -> None:
    if drop.ball not in ("", outcome.ball):
        warn(
            f"{outcome.name}: names {drop.name}, which was recorded as a drop of {drop.ball}; it "
            "counts as this attempt's, correct the outcome if it is not"
        )


def _ordered(drops: Sequence[TunedDrop]) -> list[TunedDrop]:
    if all(one.wall_ns is not None for one in drops):
        return sorted(drops, key=lambda one: one.wall_ns or 0)
    return sorted(drops, key=lambda one: natural(one.name))


def _latest(outcomes: Sequence[Outcome], warn: Warn) -> list[Outcome]:
    """Of several outcomes of one attempt the last, in the order of the first ones."""
    found: dict[tuple[str, str, int], Outcome] = {}
    for one in outcomes:
        key = (one.task, one.ball, one.attempt)
        if key in found:
            warn(
                f"{one.name}: has several outcomes; the one of the latest time counts ({one.word})"
            )
        found[key] = one
    return list(found.values())


def _linked(
    outcomes: Sequence[Outcome], drops: Sequence[TunedDrop], roots: Sequence[Path]
) -> dict[int, list[Outcome]]:
    """By the id of a drop, the outcomes that name its log or tuning."""
    by_path = {one.resolve(): drop for drop in drops for one in (drop.log, drop.tuning) if one}
    by_name: dict[str, list[TunedDrop]] = {}
    for drop in drops:
        names = {drop.name, *(one.name for one in (drop.log, drop.tuning) if one)}
        for name in names:
            by_name.setdefault(name, []).append(drop)
    linked: dict[int, list[Outcome]] = {}
    for outcome in outcomes:
        for text in (outcome.drop_log, outcome.tuning):
            drop = _named(text, by_path, by_name, roots) if text else None
            if drop is not None:
                linked.setdefault(id(drop), []).append(outcome)
                break
    return linked


def _named(
    text: str,
    by_path: dict[Path, TunedDrop],
    by_name: dict[str, list[TunedDrop]],
    roots: Sequence[Path],
) -> TunedDrop | None:
    """The drop of a path that may have been told elsewhere: by its name, where only one has it."""
    for root in roots:
        found = by_path.get((root / text).resolve())
        if found is not None:
            return found
    same = by_name.get(Path(text).name, [])
    return same[0] if len(same) == 1 else None


def _lone(drop: TunedDrop) -> Attempt:
    return Attempt(0, drop.ball or UNNAMED, 0, (drop,), None)


def _wall_ns(attempt: Attempt) -> int | None:
    times = [one.wall_ns for one in attempt.drops]
    if attempt.outcome is not None:
        times.append(attempt.outcome.stamp_ns or None)
    known = [one for one in times if one is not None]
    return max(known) if known else None


def _numbered(attempts: Sequence[Attempt]) -> list[Attempt]:
    counts: dict[str, int] = {}
    numbered: list[Attempt] = []
    for number, one in enumerate(attempts, 1):
        of_ball = one.of_ball or counts.get(one.ball, 0) + 1
        counts[one.ball] = max(of_ball, counts.get(one.ball, 0))
        numbered.append(replace(one, number=number, of_ball=of_ball))
    return numbered
