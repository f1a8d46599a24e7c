"""Link drops, tunings and outcomes into attempts, in the order in which they were made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from analysis.campaign.files import Material, natural
from analysis.campaign.tuned_drop import TunedDrop
from tunenet_logs.outcome import Outcome
from tunenet_logs.outcome_reading import Warn
from tunenet_logs.regular_file import real_path

_UNNAMED = "unnamed ball"  # of a drop whose recording names no ball, and that no outcome names


@dataclass(frozen=True, eq=False)
class Attempt:
    """One attempt: drops until one was good, then the shot's outcome.

    Attributes:
        number: Its position in the campaign, from 1.
        ball: Name of the ball.
        of_ball: Its position among those of this ball, from 1.
        drops: In their order; the shot was tuned from the last.
        outcome: None if none was recorded.
    """

    number: int
    ball: str
    of_ball: int
    drops: tuple[TunedDrop, ...]
    outcome: Outcome | None

    @property
    def used(self) -> TunedDrop | None:
        """Drop that the shot was tuned from, or the last that was tried."""
        return self.drops[-1] if self.drops else None

    @property
    def is_accepted(self) -> bool | None:
        """Whether that drop passed the checks; None if unknown."""
        return None if self.used is None else self.used.verdict != "rejected"

    @property
    def value(self) -> float | None:
        """Coefficient of restitution that the shot was planned with, or would have been."""
        if self.used is not None and self.used.value is not None:
            return self.used.value
        return None if self.outcome is None else self.outcome.tuned_parameter

    @property
    def interval95(self) -> tuple[float, float] | None:
        """95 % interval of the restitution, if its tuning has one."""
        return None if self.used is None else self.used.interval95

    @property
    def was_shot(self) -> bool:
        """Whether the shot was taken: one that was given up has neither height nor miss."""
        outcome = self.outcome
        if outcome is None:
            return False
        is_measured = outcome.shot_height_m is not None or outcome.miss_m is not None
        return outcome.success or is_measured or self.is_accepted is not False

    @property
    def name(self) -> str:
        """Name for titles."""
        return f"{self.number}: {self.ball}, {self.of_ball}"


def attempts_of(material: Material, warn: Warn) -> tuple[Attempt, ...]:
    """Link a campaign's drops and outcomes into attempts, in order.

    A drop belongs to every outcome that names it. One that none names and that came before one
    that is named, of the same ball, was tried for the same attempt. Drops are ordered by wall-clock
    time if all have one, else by name.
    """
    drops = sorted(material.drops, key=lambda drop: natural(drop.name))
    if all(drop.wall_ns is not None for drop in drops):
        drops = sorted(material.drops, key=lambda drop: drop.wall_ns or 0)
    latest = _latest(material.outcomes, warn)
    linked = _linked(latest, drops, material.roots)
    made: list[tuple[int, Attempt]] = []
    waiting: list[tuple[int, TunedDrop]] = []
    for index, drop in enumerate(drops):
        for outcome in linked.get(id(drop), ()):
            if drop.ball not in ("", outcome.ball):
                warn(
                    f"{outcome.name}: names {drop.name}, which was recorded as a drop of "
                    f"{drop.ball}; it counts as this attempt's, correct the outcome if it is not"
                )
            tried = [pair for pair in waiting if pair[1].ball in ("", outcome.ball)]
            waiting = [pair for pair in waiting if pair not in tried]
            own = (*(before for _, before in tried), drop)
            made.append((index, Attempt(0, outcome.ball, outcome.attempt, own, outcome)))
        if id(drop) not in linked:
            waiting.append((index, drop))
    made += [
        (index, Attempt(0, drop.ball or _UNNAMED, 0, (drop,), None)) for index, drop in waiting
    ]
    ordered = [attempt for _, attempt in sorted(made, key=lambda pair: pair[0])]
    with_drop = {id(attempt.outcome) for attempt in ordered}
    ordered += [
        Attempt(0, outcome.ball, outcome.attempt, (), outcome)
        for outcome in latest
        if id(outcome) not in with_drop
    ]
    if all(_wall_ns(attempt) is not None for attempt in ordered):
        ordered.sort(key=lambda attempt: _wall_ns(attempt) or 0)
    return tuple(_numbered(ordered))


def _latest(outcomes: Sequence[Outcome], warn: Warn) -> list[Outcome]:
    """Keep the last of several outcomes of one attempt, in the order of the first ones."""
    found: dict[tuple[str, str, int], Outcome] = {}
    for outcome in outcomes:
        key = (outcome.task, outcome.ball, outcome.attempt)
        if key in found:
            warn(
                f"{outcome.name}: has several outcomes; the one of the latest time counts "
                f"({outcome.word})"
            )
        found[key] = outcome
    return list(found.values())


def _linked(
    outcomes: Sequence[Outcome], drops: Sequence[TunedDrop], roots: Sequence[Path]
) -> dict[int, list[Outcome]]:
    """Map the id of each drop to the outcomes that name its log or tuning."""
    by_path = {real_path(path): drop for drop in drops for path in (drop.log, drop.tuning) if path}
    by_name: dict[str, list[TunedDrop]] = {}
    for drop in drops:
        names = {drop.name, *(path.name for path in (drop.log, drop.tuning) if path)}
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
    """Find a drop by a path, or by a name that only one has: paths may be another machine's."""
    for root in roots:
        found = by_path.get(real_path(root / text))
        if found is not None:
            return found
    same = by_name.get(Path(text).name, [])
    return same[0] if len(same) == 1 else None


def _wall_ns(attempt: Attempt) -> int | None:
    """Return the latest time of its drops and outcome [ns since 1970], or None."""
    times = [drop.wall_ns for drop in attempt.drops]
    if attempt.outcome is not None:
        times.append(attempt.outcome.stamp_ns or None)
    known = [time_ns for time_ns in times if time_ns is not None]
    return max(known) if known else None


def _numbered(attempts: Sequence[Attempt]) -> list[Attempt]:
    """Number attempts in the campaign, and by ball if the outcome does not."""
    counts: dict[str, int] = {}
    numbered: list[Attempt] = []
    for number, attempt in enumerate(attempts, 1):
        of_ball = attempt.of_ball or counts.get(attempt.ball, 0) + 1
        counts[attempt.ball] = max(of_ball, counts.get(attempt.ball, 0))
        numbered.append(replace(attempt, number=number, of_ball=of_ball))
    return numbered
