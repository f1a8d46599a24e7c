"""Run the tuning of real balls: the stranger's, those of a table, and videos of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import TypeVar

from analysis.evaluation.real_balls.balls import HEIGHTS_M, TABLE_BALLS
from analysis.evaluation.real_balls.drops import CELLS
from analysis.evaluation.real_balls.figures import (
    RealLine,
    compared_lines,
    filmed_lines,
    moved_lines,
)
from analysis.evaluation.real_balls.outcomes import (
    LIGHT,
    CellPortion,
    compared_drops,
    filmed_light,
    filmed_table,
    moved_drops,
)
from analysis.processes import Piece, parallel_map
from tunenet_logs.terminal import Progress

Asked = TypeVar("Asked")
Result = TypeVar("Result")

_PORTION = 5  # drops in a portion: few, so that the processes end together
_TARGETS_A_TABLE_DROP = 50  # drops of a cell for each drop of a ball of the table from one height


@dataclass(frozen=True)
class RealOrder:
    """Settings of the experiment.

    Attributes:
        seeds: each draws its own drops.
        targets: drops of each cell for each seed; of balls of the table fewer in proportion.
        jobs: processes; None for all cores.
    """

    seeds: tuple[int, ...]
    targets: int
    jobs: int | None = None

    @property
    def table_drops(self) -> int:
        """Drops of a ball of the table for each height and seed."""
        return max(1, self.targets // _TARGETS_A_TABLE_DROP)

    @property
    def portions(self) -> list[tuple[int, range]]:
        """Targets of all seeds, in portions."""
        return [
            (seed, range(at, min(at + _PORTION, self.targets)))
            for seed in self.seeds
            for at in range(0, self.targets, _PORTION)
        ]


def position_lines(order: RealOrder, progress: Progress) -> list[RealLine]:
    """Run the stranger's balls, cell by cell."""
    asked = {
        cell.label: [(CellPortion(cell, *one), len(one[1])) for one in order.portions]
        for cell in CELLS
    }
    return _lines(compared_drops, asked, compared_lines, order, progress)


def ball_lines(order: RealOrder, progress: Progress) -> list[RealLine]:
    """Run the table's balls."""
    asked = {ball.name: _table(order, ball) for ball in TABLE_BALLS}
    return _lines(moved_drops, asked, moved_lines, order, progress)


def film_lines(order: RealOrder, progress: Progress) -> list[RealLine]:
    """Run videos of the table's balls, and of light ones that are not named."""
    asked = {ball.name: _table(order, ball) for ball in TABLE_BALLS}
    lines = _lines(filmed_table, asked, filmed_lines, order, progress)
    light = {
        label: [((bool(slopes), *one), len(one[1])) for one in order.portions]
        for slopes, label in enumerate(LIGHT)
    }
    return [*lines, *_lines(filmed_light, light, filmed_lines, order, progress)]


def _table(order: RealOrder, ball: Asked) -> list[tuple[tuple[Asked, int, int], int]]:
    count = order.table_drops
    return [((ball, seed, count), count * len(HEIGHTS_M)) for seed in order.seeds]


def _lines(
    work: Callable[[Asked], list[Result]],
    asked: dict[str, list[tuple[Asked, int]]],
    lines: Callable[[str, Sequence[Result]], list[RealLine]],
    order: RealOrder,
    progress: Progress,
) -> list[RealLine]:
    """Return `lines` of each label, of what `work` makes of what is asked."""
    pieces = [Piece(item, units, label) for label, some in asked.items() for item, units in some]
    done = iter(parallel_map(work, pieces, order.jobs, progress, ("real balls", "drop")))
    found: list[RealLine] = []
    for label, some in asked.items():
        found += lines(label, list(chain.from_iterable(next(done) for _ in some)))
    return found
