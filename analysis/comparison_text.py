"""Format a comparison for the terminal: a table for each group, and its tests."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

from analysis.comparison import ComparedGroup, ComparedQuantity, Comparison
from analysis.pair_test import TEST_WORDS, PairTest
from analysis.speed_transport import ComparedValue
from analysis.terminal_table import interval_words, quantity
from tunenet_logs.terminal import one_line, short_name

# Of one quantity that are printed with their figures; more are named, and the CSV has all.
_MAX_PAIRS = 10

_MAX_NAMED = 40  # pairs that are named
_WIDTH = 100  # characters of a line of prose
_NAME = 48  # characters of a cell of a table: a value with its interval, or a log's name
_MAX_SIZE = 1e9  # of a number that is written out
_MIN_SIZE = 1e-4  # of a probability: nobody needs to know how far under it one is


def comparison_text(comparison: Comparison) -> str:
    """Format tables, tests and what could not be compared."""
    numbers = {label: str(k) for k, label in enumerate(comparison.labels, 1)}
    verdicts = {
        label: record.verdict
        for label, record in zip(comparison.labels, comparison.records, strict=True)
    }
    parts = [_group(group, numbers, verdicts) for group in comparison.groups]
    if without := comparison.without_values:
        lines = ["without a value:"]
        for label, record in without:
            why = one_line(record.reason or "no reason is given")
            lines.append(f"  {numbers[label]} {short_name(label, _NAME)}  {record.verdict}: {why}")
        parts.append("\n".join(lines))
    if len(comparison.groups) > 1:
        parts.append("Logs of different tasks, presets or engines' numbers are never compared.")
    if any(quantity.tests for group in comparison.groups for quantity in group.quantities):
        parts.append(textwrap.fill(TEST_WORDS, _WIDTH))
    return "\n\n".join(parts)


def _group(group: ComparedGroup, numbers: Mapping[str, str], verdicts: Mapping[str, str]) -> str:
    rows: dict[str, dict[str, str]] = {
        label: {
            "": numbers[label],
            "log": label,
            "verdict": verdicts[label],
        }
        for label in group.labels
    }
    heads = ["", "log", "verdict"]
    for one in group.quantities:
        name = quantity(one.name, one.unit)
        heads.append(name)
        for value in one.values:
            rows[value.label][name] = value_words(value)
        speeds = {value.label: value.speed_m_s for value in one.values if value.is_restitution}
        if any(speed is not None for speed in speeds.values()):
            heads.append("at [m/s]")
            for label, speed in speeds.items():
                rows[label]["at [m/s]"] = "?" if speed is None else f"{speed:.2f}"
    lines = [one_line(group.title), *_table(heads, list(rows.values()))]
    for one in group.quantities:
        lines += quantity_lines(one, numbers)
    return "\n".join(lines)


def _table(heads: Sequence[str], rows: Sequence[Mapping[str, str]]) -> list[str]:
    shown = [list(heads), *([row.get(head, "-") for head in heads] for row in rows)]
    cells = [[short_name(cell, _NAME) for cell in row] for row in shown]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in cells
    ]


def value_words(value: ComparedValue) -> str:
    """Format a value with its interval, and a verdict that is not ok."""
    mark = "" if value.verdict == "ok" else f" ({value.verdict})"
    if value.interval95 is None:
        return f"{number_words(value.value)} (no interval){mark}"
    return f"{number_words(value.value)} ({interval_words(*value.interval95)}){mark}"


def number_words(value: float) -> str:
    """Format a number with four decimals, and no minus before a zero."""
    return f"{value:.4g}" if abs(value) > _MAX_SIZE else f"{round(value, 4) + 0.0:.4f}"


def summary_lines(one: ComparedQuantity, numbers: Mapping[str, str]) -> list[str]:
    """Summarise the tests of a quantity in a sentence, and list what could not be tested."""
    name = one_line(one.name)
    bare = [numbers[value.label] for value in one.values if value.interval95 is None]
    lines = [f"{name}: no interval, not compared: {', '.join(bare)}"] if bare else []
    tests = _tested(one)
    if tests:
        lines.append(f"{name}: {_summary(tests)}")
    elif not bare:
        lines.append(f"{name}: nothing to compare with")
    return lines


def _tested(one: ComparedQuantity) -> list[PairTest]:
    return [test for test in one.tests if test.probability is not None]


def named_lines(one: ComparedQuantity, numbers: Mapping[str, str]) -> list[str]:
    """List which pairs differ and which do not; nothing if all are alike."""
    tests = _tested(one)
    different = [_pair(test, numbers) for test in tests if test.differs]
    alike = [_pair(test, numbers) for test in tests if not test.differs]
    if not (different and alike):
        return []
    return [f"differ: {_some(different)}", f"not told apart: {_some(alike)}"]


def caution_lines(one: ComparedQuantity, numbers: Mapping[str, str]) -> list[str]:
    """List the cautions, each once with its pairs."""
    pairs: dict[str, list[str]] = {}
    for test in one.tests:
        if test.caution:
            pairs.setdefault(test.caution, []).append(_pair(test, numbers))
    found = [f"{_some(some)}: {one_line(caution)}" for caution, some in pairs.items()]
    more = [f"{len(found) - _MAX_PAIRS} more cautions"] if len(found) > _MAX_PAIRS else []
    return [*found[:_MAX_PAIRS], *more]


def _some(pairs: Sequence[str]) -> str:
    more = f" and {len(pairs) - _MAX_NAMED} more" if len(pairs) > _MAX_NAMED else ""
    return ", ".join(pairs[:_MAX_NAMED]) + more


def quantity_lines(one: ComparedQuantity, numbers: Mapping[str, str]) -> list[str]:
    """Summarise a quantity, then list its tests; of many pairs only their numbers."""
    lines = [*named_lines(one, numbers), *caution_lines(one, numbers)]
    if len(one.tests) <= _MAX_PAIRS:
        lines = [test_words(test, numbers) for test in one.tests]
    return [*summary_lines(one, numbers), *(f"  {line}" for line in lines)]


def _pair(test: PairTest, numbers: Mapping[str, str]) -> str:
    return f"{numbers[test.first]} - {numbers[test.second]}"


def _summary(tests: Sequence[PairTest]) -> str:
    differing = sum(test.differs for test in tests)
    if len(tests) == 1:
        return "they differ" if differing else "no difference beyond the intervals"
    if not differing:
        return f"no difference beyond the intervals in {len(tests)} pairs"
    return f"{differing} of {len(tests)} pairs differ"


def test_words(test: PairTest, numbers: Mapping[str, str]) -> str:
    """Format one test in a line."""
    difference = f"{_pair(test, numbers)}: {round(test.difference, 4) + 0.0:+.4f}"
    caution = f"; {one_line(test.caution)}" if test.caution else ""
    if test.corrected is None:
        return difference + caution
    speed = "" if test.speed_m_s is None else f", at {test.speed_m_s:.2f} m/s"
    ends, chance = interval_words(*test.interval95), probability_words(test.corrected)
    said = "differs" if test.differs else "not told apart"
    return f"{difference} ({ends}){speed}, {chance}: {said}{caution}"


def probability_words(probability: float) -> str:
    """Format a corrected p-value."""
    if probability < _MIN_SIZE:
        return f"p < {_MIN_SIZE:g}"
    return f"p = {probability:.2g}"
