"""Section of a report page on a comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from analysis.comparison import ComparedGroup, Comparison
from analysis.comparison_text import (
    caution_lines,
    named_lines,
    number_words,
    probability_words,
    summary_lines,
    value_words,
)
from analysis.pair_test import TEST_WORDS, PairTest
from analysis.report.drawn import DrawnFigure
from analysis.terminal_table import interval_words, quantity

_MAX_TESTS = 300  # of one group, those that differ first; the CSV has all
Cells = tuple[str, ...]


@dataclass(frozen=True)
class ComparedTable:
    """Table of a group of comparable logs.

    Attributes:
        heads: Of the rows, one per log.
        lines: Summary of each parameter's tests, in a sentence.
        tests: Rows, one per pair and parameter.
        more: Tests that are not shown.
    """

    title: str
    heads: Cells
    rows: tuple[Cells, ...]
    lines: tuple[str, ...]
    tests: tuple[Cells, ...]
    more: int


@dataclass(frozen=True)
class ComparedSection:
    """Figures and tables of a comparison.

    Attributes:
        test_words: Description of the test; "" if nothing was tested.
        without: Rows of number, log, verdict and reason.
    """

    drawn: tuple[DrawnFigure, ...]
    groups: tuple[ComparedTable, ...]
    test_words: str
    without: tuple[Cells, ...]


def compared_section(comparison: Comparison, drawn: Sequence[DrawnFigure]) -> ComparedSection:
    """Build the tables of a comparison beside its figures."""
    numbers = {label: str(number) for number, label in enumerate(comparison.labels, 1)}
    groups = tuple(_table(group, numbers) for group in comparison.groups)
    without = tuple(
        (numbers[label], label, record.verdict, record.reason or "no reason is given")
        for label, record in comparison.without_values
    )
    has_tests = any(group.tests for group in groups)
    return ComparedSection(tuple(drawn), groups, TEST_WORDS if has_tests else "", without)


def _table(group: ComparedGroup, numbers: Mapping[str, str]) -> ComparedTable:
    rows: dict[str, list[str]] = {label: [numbers[label], label] for label in group.labels}
    heads = ["", "log"]
    lines: list[str] = []
    tests: list[tuple[str, PairTest]] = []
    for one in group.quantities:
        heads.append(quantity(one.name, one.unit))
        cells = {value.label: value_words(value) for value in one.values}
        has_speed = any(value.speed_m_s is not None for value in one.values)
        speeds = {value.label: value.speed_m_s for value in one.values}
        for label, row in rows.items():
            row.append(cells.get(label, "-"))
            if has_speed:
                speed = speeds.get(label)
                row.append("?" if speed is None else f"{speed:.2f}")
        if has_speed:
            heads.append("at [m/s]")
        lines.append("; ".join([*summary_lines(one, numbers), *named_lines(one, numbers)]))
        lines += [f"{one.name}, {caution}" for caution in caution_lines(one, numbers)]
        tests += [(one.name, test) for test in one.tests]
    tests.sort(key=lambda pair: not pair[1].differs)
    shown = tuple(_test(name, test, numbers) for name, test in tests[:_MAX_TESTS])
    more = max(0, len(tests) - _MAX_TESTS)
    cells_of_logs = tuple(tuple(row) for row in rows.values())
    return ComparedTable(group.title, tuple(heads), cells_of_logs, tuple(lines), shown, more)


def _test(name: str, test: PairTest, numbers: Mapping[str, str]) -> Cells:
    chance = "-" if test.corrected is None else probability_words(test.corrected)
    said = "differs" if test.differs else "not told apart"
    return (
        name,
        f"{numbers[test.first]} - {numbers[test.second]}",
        number_words(test.difference),
        interval_words(*test.interval95),
        "-" if test.speed_m_s is None else f"{test.speed_m_s:.2f}",
        chance,
        "not compared" if test.corrected is None else said,
        test.caution,
    )
