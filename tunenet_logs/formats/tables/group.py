"""Columns of a table that are one signal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from tunenet_logs.formats.tables.meaning import Words, lowered, words_of
from tunenet_logs.formats.tables.times import Clock


@dataclass(frozen=True)
class Used:
    """One column of values: `row` of the result [its unit] is `scale` times the text."""

    index: int
    row: int
    scale: float


@dataclass(frozen=True)
class Group:
    """Columns that are one signal.

    Attributes:
        name: of the signal.
        columns: of the signal; no column of the table where an axis is missing.
        unit: of the signal.
        needs_all: whether a row that has some of the values is damaged.
        clock: when a row of it arrived, or was taken.
        stamp: when its samples were taken, where the table says that beside when they arrived.
        numbers: of the joints that go by a number alone, by column.
        note: what else to know of it.
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
        """What a run's signal is called; one of joints ends with its quantity."""
        return name_of_run(self.name, run, is_joints=not (self.needs_all or self.is_impacts))


def name_of_run(name: str, run: str, *, is_joints: bool) -> str:
    """What a run's signal is called; one of joints ends with its quantity."""
    if not run:
        return name
    robot, _, quantity = name.rpartition(".") if is_joints else (name, "", "")
    return ".".join(filter(None, (robot, run, quantity)))


def stamp_for(words: Words, stamps: Sequence[Clock]) -> Clock | None:
    """The stamp of the message that a column comes from: with the longest name in common."""
    fitting = [clock for clock in stamps if words[: len(clock.scope)] == clock.scope]
    return max(fitting, key=lambda clock: len(clock.scope), default=None)


def plain_words(name: str) -> Words:
    """The words of a name in small letters, camels whole."""
    return lowered(words_of(name, camel=False))
