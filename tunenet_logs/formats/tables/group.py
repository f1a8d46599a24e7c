"""Columns of a table that make up one signal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from tunenet_logs.formats.tables.meaning import Words, lowered, words_of
from tunenet_logs.formats.tables.times import Clock


@dataclass(frozen=True)
class Used:
    """One column of values: `row` of the result, in its unit, is `scale` times the text."""

    index: int
    row: int
    scale: float


@dataclass(frozen=True)
class Group:
    """Columns that make up one signal.

    Attributes:
        name: of the signal.
        columns: of the signal; an axis may have no column in the table.
        unit: of the signal.
        needs_all: whether a row with only some of the values is damaged.
        clock: time of arrival, or of acquisition, of a row.
        stamp: time of acquisition, where the table states it beside that of arrival.
        numbers: of the joints named by a number alone, by column.
        note: for the user.
        is_impacts: whether its samples are impacts: the clock's times, with the value 1.
    """

    name: str
    columns: tuple[str, ...]
    unit: str
    used: tuple[Used, ...]
    needs_all: bool
    clock: Clock
    stamp: Clock | None = None
    numbers: Mapping[str, str] = field(default_factory=dict)
    note: str = ""
    is_impacts: bool = False

    def name_of_run(self, run: str) -> str:
        """Return the name of a run's signal; a joint signal's ends with its quantity."""
        return name_of_run(self.name, run, is_joints=not (self.needs_all or self.is_impacts))


def name_of_run(name: str, run: str, *, is_joints: bool) -> str:
    """Return the name of a run's signal; a joint signal's ends with its quantity."""
    if not run:
        return name
    robot, _, quantity = name.rpartition(".") if is_joints else (name, "", "")
    return ".".join(filter(None, (robot, run, quantity)))


def stamp_for(words: Words, stamps: Sequence[Clock]) -> Clock | None:
    """Return the stamp of the message that a column belongs to, by the longest common prefix."""
    fitting = [clock for clock in stamps if words[: len(clock.scope)] == clock.scope]
    return max(fitting, key=lambda clock: len(clock.scope), default=None)


def plain_words(name: str) -> Words:
    """Split a name into lower-case words, not at capitals."""
    return lowered(words_of(name, camel=False))
