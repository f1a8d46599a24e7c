"""A comparison for the terminal: a table for each group of logs, and the tests below it."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

from analysis.comparison import ComparedGroup, ComparedQuantity, Comparison
from analysis.pair_test import TEST_WORDS, PairTest
from analysis.speed_transport import ComparedValue
from analysis.terminal_table import interval_words, quantity
from tunenet_logs.terminal import one_line, short_name

_MOST_PAIRS = 10
"""Of one quantity that are printed with their figures; more are named, and the CSV has all."""

_MOST_NAMED = 40
"""Pairs that are named."""

_WIDTH = 100
"""Characters of a line of prose."""

_NAME = 40
"""Characters of a log's name in a table."""

_SMALLEST = 1e-4
"""Of a probability: nobody needs to know how far under it one is."""


def comparison_text(comparison: Comparison) -> str:
    """Tables, tests and what could not be compared, in lines."""
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
            "log": short_name(label, _NAME),
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
    cells = [list(heads), *([row.get(head, "-") for head in heads] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in cells
    ]


def value_words(value: ComparedValue) -> str:
    """A value with its interval; a suspect's is marked."""
    mark = "" if value.verdict == "ok" else f" ({value.verdict})"
    if value.interval95 is None:
        return f"{number_words(value.value)} (no interval){mark}"
    return f"{number_words(value.value)} ({interval_words(*value.interval95)}){mark}"


def number_words(value: float) -> str:
    """Four decimals, and no minus before a zero."""
    return f"{round(value, 4) + 0.0:.4f}"


def quantity_lines(one: ComparedQuantity, numbers: Mapping[str, str]) -> list[str]:
    """What the tests of a quantity say: in a sentence, then pair by pair."""
    name = one.name
    bare = [numbers[value.label] for value in one.values if value.interval95 is None]
    lines = [f"{name}: no interval, not compared: {', '.join(bare)}"] if bare else []
    tests = [test for test in one.tests if test.probability is not None]
    if not tests:
        if not bare:
            lines.append(f"{name}: nothing to compare with")
    else:
        lines.append(f"{name}: {_summary(tests)}")
    if len(one.tests) <= _MOST_PAIRS:
        return [*lines, *(f"  {test_words(test, numbers)}" for test in one.tests)]
    different = [_pair(test, numbers) for test in one.tests if test.differs]
    alike = [_pair(test, numbers) for test in tests if not test.differs]
    for words, pairs in (("differ", different), ("not told apart", alike)):
        more = f" and {len(pairs) - _MOST_NAMED} more" if len(pairs) > _MOST_NAMED else ""
        if pairs and (words != "differ" or alike):
            lines.append(f"  {words}: {', '.join(pairs[:_MOST_NAMED])}{more}")
    return lines


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
    """One test in a line."""
    pair = _pair(test, numbers)
    ends = interval_words(*test.interval95)
    speed = "" if test.speed_m_s is None else f", at {test.speed_m_s:.2f} m/s"
    caution = f"; {one_line(test.caution)}" if test.caution else ""
    if test.corrected is None:
        return f"{pair}: {round(test.difference, 4) + 0.0:+.4f}{caution}"
    said = "differs" if test.differs else "not told apart"
    return (
        f"{pair}: {round(test.difference, 4) + 0.0:+.4f} ({ends}){speed}, {probability_words(test.corrected)}: "
        f"{said}{caution}"
    )


def probability_words(probability: float) -> str:
    """A probability after the correction."""
    if probability < _SMALLEST:
        return f"p < {_SMALLEST:g}"
    return f"p = {probability:.2g}"
