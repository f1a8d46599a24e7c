"""Tunings and comparisons in words: blocks that terminal, review (Markdown) and page (HTML) render.

A record becomes blocks once. What a terminal shows of many logs is one table, whose columns leave
where it is narrow.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from textwrap import TextWrapper, fill, wrap
from typing import Any, ClassVar

import numpy as np

from tunenet_logs.addresses import Address
from tunenet_logs.analysis.compare import (
    TEST_WORDS,
    ComparedGroup,
    ComparedQuantity,
    ComparedValue,
    Comparison,
    PairTest,
    restitution_value,
)
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.record import Estimate, Interval, Record
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2
from tunenet_logs.terminal import one_line, short_name

# ---- Blocks, and their Markdown.

Cells = tuple[str, ...]


@dataclass(frozen=True)
class Heading:
    """Heading of a level from 1."""

    kind: ClassVar = "heading"
    text: str
    level: int = 3


@dataclass(frozen=True)
class Paragraph:
    """One paragraph."""

    kind: ClassVar = "paragraph"
    text: str


@dataclass(frozen=True)
class Items:
    """List of lines; `notes` stand below them, "" for none."""

    kind: ClassVar = "items"
    lines: Sequence[str]
    notes: Sequence[str] = ()


@dataclass(frozen=True)
class TextTable:
    """Table of text."""

    kind: ClassVar = "table"
    heads: Cells  # of the columns; none for rows of a name and a value
    rows: Sequence[Cells]
    notes: Sequence[Sequence[str]] = ()  # lines below each row; none for no row
    title: str = ""  # what it is, in a word or two; also the name of its style on a page
    anchors: Sequence[str] = ()  # where the second cell of each row leads on a page; "" for nowhere
    folded: str = ""  # what a page shows until a reader opens it; no terminal shows such a table


Block = Heading | Paragraph | Items | TextTable


def markdown(blocks: Iterable[Block]) -> str:
    """Format blocks as Markdown; of a table's notes, a list below it."""
    parts: list[str] = []
    for block in blocks:
        match block:
            case Heading():
                parts.append(f"{'#' * block.level} {block.text}")
            case Paragraph():
                parts.append(block.text)
            case Items():
                notes = block.notes or [""] * len(block.lines)
                parts.append(
                    "\n".join(
                        f"- {one_line(line)}" + (f"\n    - {one_line(note)}" if note else "")
                        for line, note in zip(block.lines, notes, strict=True)
                    )
                )
            case TextTable():
                parts.append(markdown_table(block.heads, block.rows))
    return "\n\n".join(parts)


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a Markdown table of text cells."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


# ---- Terminal: a table as text, all of its columns or what fits a narrow one.

_BETWEEN = "  "

_LAST = ("fits", "95 % interval")  # columns that leave last; log, verdict and value never do
_NAME_CHARACTERS = 28, 10  # of a log where it is too wide: while columns can leave, and when none
_HEAD_CHARACTERS = 20  # of a column's name where it is too wide: longer ones take several lines

# Where a name goes on in the next line: `joint/`, `elbow`, `.damping `, `[N·m]`; within `left_arm`
# where it has to.
_MARKS, _WEAK_MARKS = re.compile(r"(?<=[/ ])|(?=[.(])"), re.compile(r"(?<=_)")

_UNFOLDED_CHARACTERS = 10**9  # of a line where nothing is folded
_MIN_LINE_CHARACTERS = 20  # a narrower terminal is taken for one of these


Columns = Mapping[str, Sequence[str]]  # cells by the column's name


def laid_out(shown: TextTable, most: int | None = None) -> str:
    """Format a table: a header, a line per row, and its notes indented below.

    If it is wider than the terminal, a single row is transposed, a line per column; of several,
    long heads are wrapped, then the least important columns are left out, and named.
    """
    columns = dict(zip(shown.heads, zip(*shown.rows, strict=True), strict=True))
    most = None if most is None else max(most, _MIN_LINE_CHARACTERS)
    folds = TextWrapper(
        most or _UNFOLDED_CHARACTERS,
        initial_indent="  ",
        subsequent_indent="    ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    notes = [
        [part for line in lines for part in folds.wrap(line)]
        for lines in shown.notes or [()] * len(shown.rows)
    ]
    if most is None or _width(columns) <= most:
        return _lines(columns, notes)
    if len(shown.rows) == 1:  # only the log's path is shortened
        _, *cells = shown.rows[0]
        room = max(most - len(_BETWEEN) - max(map(len, cells), default=0), _MIN_LINE_CHARACTERS)
        names = [short_name(name, room) for name in shown.heads]
        width = max(map(len, names))
        lines = [
            f"{name.ljust(width)}{_BETWEEN}{cell}"
            for name, cell in zip(names, shown.rows[0], strict=True)
        ]
        return "\n".join([*lines, *notes[0]])
    kept, left_out = _fitted(columns, most)
    text = _lines(kept, notes)
    if left_out:
        words = f"(left out, too wide for this terminal: {', '.join(left_out)}; | cat shows all)"
        text += "\n" + "\n".join(wrap(words, most))
    return text


def _lines(columns: Columns, notes: Sequence[Sequence[str]]) -> str:
    heads = [name.split("\n") for name in columns]
    height = max(map(len, heads))
    standing = [[""] * (height - len(head)) + head for head in heads]
    widths = _widths(columns)
    lines = [
        _BETWEEN.join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in zip(
            *([*head, *cells] for head, cells in zip(standing, columns.values(), strict=True)),
            strict=True,
        )
    ]
    out = lines[:height]
    for line, words in zip(lines[height:], notes, strict=True):
        out += [line, *words]
    return "\n".join(out)


def _fitted(columns: Columns, most: int) -> tuple[dict[str, Sequence[str]], list[str]]:
    """Return the columns that fit, and the names of the others in their order."""
    log, *_ = never = list(columns)[:3]
    many, few = _NAME_CHARACTERS
    kept: dict[str, Sequence[str]] = {
        **columns,
        log: [short_name(cell, many) for cell in columns[log]],
    }
    heads = {name: "\n".join(_head(name)) for name in columns}
    order = [name for name in reversed(list(columns)) if name not in (*_LAST, *never)]
    order += [name for name in _LAST if name in columns and name not in never]
    for name in order:
        if _width({heads[one]: cells for one, cells in kept.items()}) <= most:
            break
        del kept[name]
    shown = {heads[name]: cells for name, cells in kept.items()}
    room = most - _width(shown) + _widths(shown)[0]
    shown[heads[log]] = [short_name(cell, max(few, room)) for cell in columns[log]]
    return shown, [name for name in columns if name not in kept]


def _head(name: str) -> list[str]:
    """Wrap a column's name at its marks."""
    lines = [""]
    for part in _MARKS.split(name):
        is_short = len(part.rstrip()) <= _HEAD_CHARACTERS
        for piece in [part] if is_short else _WEAK_MARKS.split(part):
            if lines[-1] and len(lines[-1]) + len(piece.rstrip()) > _HEAD_CHARACTERS:
                lines.append("")
            lines[-1] += short_name(piece, _HEAD_CHARACTERS)
    return [line.rstrip() for line in lines]


def _widths(columns: Columns) -> list[int]:
    return [max(*map(len, name.split("\n")), *map(len, cells)) for name, cells in columns.items()]


def _width(columns: Columns) -> int:
    return sum(_widths(columns)) + len(_BETWEEN) * (len(columns) - 1)


# ---- Phrases: numbers, intervals and second estimates.

_MAX_WRITTEN_OUT = 1e9  # no quantity is larger, but a stranger's file may say so
_SMALL, _NOTHING = 1e-2, 1e-9  # below the first, four decimals may be no digits; below both, none


def number_words(value: float, ends: Interval | None = None) -> str:
    """Format a number with the digits of its 95 % interval: four decimals, or more if it is small.

    Of a small one without an interval, three digits. There is no minus before a zero.
    """
    size = abs(value)
    if not size <= _MAX_WRITTEN_OUT:
        return f"{value:.4g}"
    if ends is not None:
        return _written(value, _decimals(*ends), max(map(abs, ends)))
    is_small = _NOTHING < size < _SMALL
    return _written(value, max(2 - math.floor(math.log10(size)), 4) if is_small else 4, size)


def interval_words(ends: Interval | None, none: str = "-") -> str:
    """Format an interval with enough decimals: equal ends would read as certainty.

    The last digits differ by two or more, of small numbers by ten. If six decimals do not show
    that, the ends are rounded away from each other; small numbers are written in powers of ten.
    """
    if ends is None:
        return none
    low, high = ends
    size = max(abs(low), abs(high))
    if size > _MAX_WRITTEN_OUT:
        return f"{low:.4g} to {high:.4g}"
    decimals = _decimals(low, high)
    unit = 10**decimals
    first, last = round(low * unit), round(high * unit)
    if last - first < 2:
        first, last = math.floor(low * unit), math.ceil(high * unit)
    return " to ".join(_written(end / unit, decimals, size) for end in (first, last))


def half_words(ends: Interval) -> str:
    """Format half an interval, as ± shows it, with the decimals of its value; never as nothing."""
    half, decimals = (ends[1] - ends[0]) / 2, _decimals(*ends)
    if half > _MAX_WRITTEN_OUT:
        return f"{half:.4g}"
    while decimals < 6 and half > 0 and round(half * 10**decimals) == 0:
        decimals += 1
    return _written(half, decimals, max(map(abs, ends)))


def _decimals(low: float, high: float) -> int:
    """Return how many decimals show that the ends of an interval differ: from 4 on."""
    is_small = max(abs(low), abs(high)) < _SMALL
    least, most, decimals = (10, 12, 4) if is_small else (2, 6, 4)
    while decimals < most and round(high * 10**decimals) - round(low * 10**decimals) < least:
        decimals += 1
    return decimals if high > low else min(decimals, 6)


def _written(value: float, decimals: int, size: float) -> str:
    """Write a number with so many decimals, or in powers of ten where `size` is small for that."""
    is_scientific = decimals > 6 and _NOTHING < size < _SMALL
    value = round(value, decimals if is_scientific else min(decimals, 6)) + 0.0
    if not is_scientific or not value:
        return f"{value:.{min(decimals, 6)}f}"
    digits = max(decimals + math.floor(math.log10(abs(value))), 0)
    mantissa, _, power = f"{value:.{digits}e}".partition("e")
    return f"{mantissa}e{int(power)}"


def quantity(name: str, unit: str) -> str:
    """Format a quantity's name with its unit: "restitution", "payload_mass [kg]"."""
    return name if unit == "1" else f"{name} [{unit}]"


def interval_mark(verdict: str) -> str:
    """Return a mark for the interval of a verdict that is not ok."""
    return "" if verdict == "ok" else f" ({verdict})"


def _numbers(known: Estimate) -> str:
    """Format one or several numbers, each with half its interval if it has one."""
    parts = [
        number_words(one.value, one.interval95)
        + ("" if one.interval95 is None else f" ± {half_words(one.interval95)}")
        for one in known.components
    ]
    return ", ".join(parts)


def equivalent_words(record: Record) -> str:
    """Describe the ball for a simulator without air; "" if it is the same there."""
    known = record.motion.equivalents
    if known is None or not record.estimates:
        return ""
    value = float(np.atleast_1d(record.estimates[0].value)[0])
    # With a restitution that differs by less, a simulator needs no air.
    if max(abs(one.restitution - value) for one in (known.first, known.all)) < 0.001:
        return ""
    return (
        f"without air: {known.first.restitution:.3f} for the first rebound "
        f"({known.first.rms_percent:.1f} % rms), {known.all.restitution:.3f} for all "
        f"({known.all.rms_percent:.1f} %)"
    )


def sound_words(record: Record) -> str:
    """Describe the contribution of sound, or why it is not used; "" if there is none."""
    sound = record.motion.sound
    if sound is None:
        return ""
    if sound.offset_s is None:
        return f"sound: not used: {sound.reason}"
    side = "after" if sound.offset_s >= 0 else "before"
    ends = record.estimates[0].components[0].interval95 if record.estimates else None
    now = "" if ends is None else f", {interval_words(ends)} with it"
    return (
        f"sound: {sound.heard} of {sound.impacts} impacts heard, {1000 * abs(sound.offset_s):.1f} "
        f"ms {side} the pictures; interval {interval_words(sound.interval95)} without it{now}"
    )


def value_words(value: ComparedValue) -> str:
    """Format a value with its interval, and a verdict that is not ok."""
    ends = interval_words(value.interval95, "no interval")
    return f"{number_words(value.value, value.interval95)} ({ends}){interval_mark(value.verdict)}"


# ---- Tunings for the terminal: one table.


@dataclass(frozen=True, eq=False)
class Row:
    """Table row of a tuning: small, so that it travels between processes."""

    log: Path | Address
    record: Record
    is_read: bool  # whether the log could be read at all
    parameter: str  # name and unit of what was tuned; "" if unknown
    extent: tuple[str, str] | None  # see `Detection.extent`; None if nothing was found
    preset: str
    truth: float | None  # ground truth of a simulator, if the log has it; shown, never used


def row_of(tuning: Tuning, record: Record) -> Row:
    """Build the row of a tuning and its record."""
    presets = tuning.experiment.presets if tuning.experiment else {}
    parameter = presets[tuning.preset].parameters[0] if tuning.preset in presets else None
    truth = tuning.episode.info.truth if tuning.episode else {}
    return Row(
        log=tuning.log,
        record=record,
        is_read=tuning.episode is not None,
        parameter=quantity(parameter.name, parameter.unit) if parameter else "",
        extent=tuning.detection.extent if tuning.detection else None,
        preset=tuning.preset,
        truth=truth.get(parameter.name) if parameter else None,
    )


def table(rows: Sequence[Row], most: int | None = None) -> str:
    """Format a line per log, with indented lines below it; a table for each parameter."""
    parameters = list(dict.fromkeys(row.parameter for row in rows if row.parameter)) or [""]
    return "\n\n".join(
        laid_out(
            _tunings(one, [row for row in rows if (row.parameter or parameters[0]) == one]), most
        )
        for one in parameters
    )


def _tunings(parameter: str, rows: Sequence[Row]) -> TextTable:
    """Build the table of logs with the same first parameter; notes are what it has no room for."""
    scalars = [
        (known.name, known.unit)
        for row in rows
        for known in row.record.estimates[1:]
        if isinstance(known.value, float)
    ]
    extent = next((row.extent[0] for row in rows if row.extent is not None), "")
    lines: list[dict[str, str]] = []
    notes: list[list[str]] = []
    for row in rows:
        record, cross, fit = row.record, row.record.cross_check, row.record.motion.fit
        first = record.estimates[0].components[0] if record.estimates else None
        ends = interval_words(first and first.interval95)
        second = "-"
        if cross is not None and cross.tells:
            second = f"{cross.value:.4f}"
            second += "" if cross.tolerance is None else f" ({cross.tolerance:.4f})"
        cells = {
            "log": one_line(row.log),
            "verdict": record.verdict,
            parameter: "-" if first is None else number_words(first.value, first.interval95),
            "95 % interval": ends if ends == "-" else ends + interval_mark(record.verdict),
        }
        for name, unit in scalars:
            title = quantity("slope" if name == "restitution_slope" else name, unit)
            known = record.estimate(name)
            cells[title] = "-" if known is None else _numbers(known)
        cells["cross-check (tolerance)"] = second
        cells[extent] = "-" if row.extent is None else row.extent[1]
        cells["fits"] = "-" if fit is None or first is None else f"{fit.excess_percent:.2f} %"
        cells["rollouts"] = str(record.rollouts)
        cells["time"] = f"{record.seconds.get('total', 0.0):.2f} s"
        cells["truth"] = "-" if row.truth is None else number_words(row.truth)
        below = [
            f"{quantity(known.name, known.unit)} {_numbers(known)}"
            for known in record.estimates[1:]
            if isinstance(known.value, tuple)
        ]
        if record.estimates:
            below += [equivalent_words(record), *record.motion.unidentifiable, sound_words(record)]
        if record.reason:
            below.append(one_line(f"{record.verdict}: {record.reason}"))
        if record.estimates and not record.physical:
            below.append(f"{row.preset}: the engine's number under the paper's settings")
        lines.append(cells)
        notes.append(list(filter(None, below)))
    empty = [
        name
        for name in ("", "truth", "95 % interval", "fits")
        if all(cells.get(name, "-") == "-" for cells in lines) or not name
    ]
    heads = tuple(name for name in lines[0] if name not in empty)
    return TextTable(heads, [tuple(cells[name] for name in heads) for cells in lines], notes)


# ---- Comparison: the blocks of each group, on a page as in a terminal.

_MAX_PAIRS = 10  # tests that are shown with their figures: of more, a terminal only names them
_MAX_NAMED = 40  # pairs that are named
_MIN_PROBABILITY = 1e-4  # nobody needs to know how far under it one is
_TEST_HEADS = ("parameter", "pair", "difference", "95 % interval", "at [m/s]", "p", "")
_TEST_HEADS += ("to bear in mind",)


def comparison_text(comparison: Comparison) -> str:
    """Format tables, tests and what could not be compared, for a terminal."""
    parts: list[str] = []
    for block in comparison_blocks(comparison):
        match block:
            case Heading():
                parts.append(one_line(block.text))
                continue
            case Paragraph():
                parts.append(fill(block.text, 100))  # of a line of prose
                continue
            case Items():
                text = "\n".join(map(one_line, block.lines))
            case TextTable(folded="", rows=rows):
                # A value with its interval, or a log's name, fits.
                cells = [
                    (*(short_name(one, 48) for one in row[:-1]), one_line(row[-1])) for row in rows
                ]
                text = laid_out(TextTable(tuple(map(one_line, block.heads)), cells))
            case _:
                continue
        parts[-1] += "\n" + text  # below its heading
    return "\n\n".join(parts)


def comparison_blocks(comparison: Comparison) -> list[Block]:
    """Make the blocks of a comparison."""
    numbers = {label: str(number) for number, label in enumerate(comparison.labels, 1)}
    pairs = zip(comparison.labels, comparison.records, strict=True)
    verdicts = {label: record.verdict for label, record in pairs}
    grouped = [_group_blocks(group, numbers, verdicts) for group in comparison.groups]
    blocks = [block for one in grouped for block in one]
    if without := comparison.without_values:
        rows = [
            (numbers[label], label, record.verdict, record.reason or "no reason is given")
            for label, record in without
        ]
        blocks.append(Heading("Without a value"))
        blocks.append(TextTable(("", "log", "verdict", "why"), rows, title="logs without a value"))
    if len(comparison.groups) > 1:
        said = "Logs of different tasks, presets or engines' numbers are never compared."
        blocks.append(Paragraph(said))
    if any(quantity.tests for group in comparison.groups for quantity in group.quantities):
        blocks.append(Paragraph(TEST_WORDS))
    return blocks


def _group_blocks(
    group: ComparedGroup, numbers: Mapping[str, str], verdicts: Mapping[str, str]
) -> list[Block]:
    heads = ["", "log", "verdict"]
    rows = {label: [numbers[label], label, verdicts[label]] for label in group.labels}
    lines: list[str] = []
    tests: list[tuple[str, PairTest]] = []
    are_few = sum(len(one.tests) for one in group.quantities) <= _MAX_PAIRS
    for one in group.quantities:
        heads.append(quantity(one.name, one.unit))
        values = {value.label: value for value in one.values}
        has_speed = any(value.speed_m_s is not None for value in one.values)
        heads += ["at [m/s]"] if has_speed else []
        for label, row in rows.items():
            value = values.get(label)
            row.append("-" if value is None else value_words(value))
            if has_speed:
                speed_m_s = None if value is None else value.speed_m_s
                row.append("?" if speed_m_s is None else f"{speed_m_s:.2f}")
        lines += _summary_lines(one, numbers)
        if not are_few:
            lines += _named_lines(one, numbers)
        tests += [(one.name, test) for test in one.tests]
    if not are_few:
        tests.sort(key=lambda pair: not pair[1].differs)
    shown = tests[:300]  # of one group on a page, those that differ first; the CSV has all
    blocks = [
        Heading(group.title),
        TextTable(tuple(heads), [tuple(row) for row in rows.values()], title=group.title),
        Items(lines),
    ]
    if shown:
        counted = f"{len(shown)} of {len(tests)}" if len(tests) > len(shown) else str(len(shown))
        cells = [_test_row(name, test, numbers) for name, test in shown]
        count = len(_TEST_HEADS) - (not any(test.caution for _, test in shown))
        cells = [row[:count] for row in cells]
        folded = "" if are_few else f"Each test ({counted})"
        blocks.append(TextTable(_TEST_HEADS[:count], cells, title="tests", folded=folded))
    return blocks


def _test_row(name: str, test: PairTest, numbers: Mapping[str, str]) -> Cells:
    said = "differs" if test.differs else "not distinguishable"
    chance = "-"
    if test.corrected is not None:
        is_tiny = test.corrected < _MIN_PROBABILITY
        chance = f"p < {_MIN_PROBABILITY:g}" if is_tiny else f"p = {test.corrected:.2g}"
    return (
        name,
        _pair(test, numbers),
        f"{round(test.difference, 4) + 0.0:+.4f}",
        interval_words(test.interval95),
        "-" if test.speed_m_s is None else f"{test.speed_m_s:.2f}",
        chance,
        "not compared" if test.corrected is None else said,
        test.caution,
    )


def _summary_lines(one: ComparedQuantity, numbers: Mapping[str, str]) -> list[str]:
    """Summarise the tests of a quantity in a sentence, and list what could not be tested."""
    bare = [numbers[value.label] for value in one.values if value.interval95 is None]
    lines = [f"{one.name}: no interval, not compared: {', '.join(bare)}"] if bare else []
    tests = [test for test in one.tests if test.probability is not None]
    differing = sum(test.differs for test in tests)
    if len(tests) == 1:
        said = "they differ" if differing else "no difference beyond the intervals"
        return [*lines, f"{one.name}: {said}"]
    if tests:
        said = f"{differing} of {len(tests)} pairs differ"
        if not differing:
            said = f"no difference beyond the intervals in {len(tests)} pairs"
        lines.append(f"{one.name}: {said}")
    elif not bare:
        lines.append(f"{one.name}: nothing to compare with")
    return lines


def _named_lines(one: ComparedQuantity, numbers: Mapping[str, str]) -> list[str]:
    """List which pairs differ and which do not, unless all are alike; cautions with their pairs."""
    tests = [test for test in one.tests if test.probability is not None]
    different = [_pair(test, numbers) for test in tests if test.differs]
    alike = [_pair(test, numbers) for test in tests if not test.differs]
    lines: list[str] = []
    if different and alike:
        lines = [f"differ: {_some(different)}", f"not distinguishable: {_some(alike)}"]
    pairs: dict[str, list[str]] = {}
    for test in one.tests:
        if test.caution:
            pairs.setdefault(test.caution, []).append(_pair(test, numbers))
    found = [f"{_some(some)}: {caution}" for caution, some in pairs.items()]
    more = [f"{len(found) - _MAX_PAIRS} more cautions"] if len(found) > _MAX_PAIRS else []
    return [f"{one.name}, {line}" for line in (*lines, *found[:_MAX_PAIRS], *more)]


def _some(pairs: Sequence[str]) -> str:
    more = f" and {len(pairs) - _MAX_NAMED} more" if len(pairs) > _MAX_NAMED else ""
    return ", ".join(pairs[:_MAX_NAMED]) + more


def _pair(test: PairTest, numbers: Mapping[str, str]) -> str:
    return f"{numbers[test.first]} - {numbers[test.second]}"


# ---- Meanings: a tuning's figures in plain sentences.

# What to do, by verdict.
NEXT = {
    "ok": "The values can be used.",
    "suspect": "The values may be wrong: use them only after looking at what failed.",
    "rejected": "No value can be reported from this recording.",
}


def meaning(record: Record, known: Estimate) -> str:
    """Explain one estimate in a sentence; "" if there is no explanation."""
    if not record.physical:
        return "a number of this engine's settings under the paper's presets, not the ball's own"
    value = known.value if isinstance(known.value, float) else math.nan
    # The impact speed that the restitution holds for.
    blank = ComparedValue("", 0.0, None, record.verdict)
    speed_m_s = restitution_value(blank, record).speed_m_s
    words = {
        "payload_mass": "what the gripper holds",
        "payload_com": "centre of mass of what is held, in the frame of the tool's link",
        "restitution_slope": "p: at speed v the ball keeps e (v / v first)^-p of it",
        "drag": "k: the air slows the ball by k v²",
    }.get(known.name, "")
    if known.name == "restitution":
        at = "" if speed_m_s is None else f", at {speed_m_s:.2f} m/s"
        words = f"at its first impact{at}, the ball keeps {100 * value:.1f} % of its speed"
    first = record.estimate("restitution")
    if known.name == "restitution_slope" and first is not None and isinstance(first.value, float):
        half = min(first.value * math.exp(min(value, 1.0) * math.log(2)), 1.0)
        at = "" if speed_m_s is None else f", {speed_m_s / 2:.2f} m/s"
        words += f"; at half the speed{at}, {100 * half:.1f} %"
    if known.name == "drag" and speed_m_s is not None and speed_m_s <= 1e3:
        percent = 100 * value * speed_m_s**2 / GRAVITY_M_S2
        words += f"; at {speed_m_s:.2f} m/s that is {percent:.1f} % of gravity"
    return words


# ---- A record's blocks, for its review and its page.

_MAX_ROWS = 100  # of one table; what a file beyond any of ours holds is counted
_MAX_BOUNCES = 6  # rows of a review; the JSON has all
_SHOWN, _FEW_SHOWN = 5, 3  # iterations of a review: the last ones; fewer where names are long
# Characters of a name that a review's table has room for: beside five values, and beside three.
_LONG_NAME_CHARACTERS, _MAX_NAME_CHARACTERS = 24, 32
_MAX_WARNINGS = 50  # lines of a review that a reader still looks through; the JSON has all
_TASKS = {"drop": "ball drop", "payload": "payload of an arm"}
_OCCASIONS = {"drop": "drop", "payload": "recording"}


def failures(record: Record, occasion: str | None) -> Items:
    """List each failed check with figure, limit and remedy; the reason if none failed."""
    failed = [check for check in record.checks if not check.passed][:_MAX_ROWS]
    if not failed:
        return Items((record.reason,) if record.reason else ())
    failed.sort(key=lambda check: (not check.fatal, check.secondary))
    again = f"at the next {occasion}: " if occasion else ""
    return Items(
        [f"failed: {check.name}: {check.detail}" for check in failed],
        [f"{again}{check.advice}" if check.advice else "" for check in failed],
    )


def parameters_table(record: Record, names: Mapping[str, str] | None = None) -> TextTable:
    """Build rows of name, value and 95 % interval; the notes say what each parameter is."""
    rows: list[Cells] = []
    notes: list[Cells] = []
    for known in record.estimates[:_MAX_ROWS]:
        name = (names or {}).get(known.name, known.name)
        text = meaning(record, known)
        for number, one in enumerate(known.components):
            ends = interval_words(one.interval95, "no reliable interval")
            axis = one.name.removeprefix(known.name).replace("_", " ")  # of a vector
            value = number_words(one.value, one.interval95)
            rows.append((quantity(name + axis, known.unit), value, ends))
            notes.append((text,) if text and not number else ())
    for name in record.motion.unknown[:_MAX_ROWS] if rows else ():
        rows.append((name, "not known", "-"))
        notes.append(("needs units that the log does not state",))
    heads = ("parameter", "value", f"95 % interval{interval_mark(record.verdict)}")
    return TextTable(heads, rows, notes, title="parameters")


_TOGETHER = 0.5  # correlation from which on two values are named


def correlations_table(record: Record, names: Mapping[str, str] | None = None) -> TextTable:
    """Build rows of two values of which the log tells a combination better than each."""
    known = record.posterior
    said = [(names or {}).get(one.name, one.name) for one in record.estimates]
    pairs = [] if known is None else list(combinations(range(len(said)), 2))
    found = [(known.correlation[one][other], one, other) for one, other in pairs if known]
    found = [pair for pair in found if abs(pair[0]) >= _TOGETHER]
    found.sort(key=lambda pair: -abs(pair[0]))
    rows = [(said[one], said[other], f"{share:+.3f}") for share, one, other in found[:_MAX_ROWS]]
    return TextTable(("value", "with", "correlation"), rows, title="correlations")


def gaps_table(record: Record) -> TextTable:
    """Build a row per signal and motion: errors and delays as given and tuned, what is left.

    Where joints' positions are compared, of these alone.
    """
    positions = [one for one in record.gaps if ".position" in one.signal]
    rows = [
        (
            quantity(f"{one.motion} {one.signal.rpartition('.')[2]}".strip(), one.unit)
            + (", held out" if one.is_held_out else ""),
            " to ".join(f"{value:.3g}" for value in one.rms),
            " to ".join(f"{1e3 * value:.0f}" for value in one.delay_s) if one.delay_s else "-",
            f"{100 * one.left:.2g} %" if one.left is not None else "-",
        )
        for one in (positions or record.gaps)[:_MAX_ROWS]
    ]
    return TextTable(("signal", "rms error", "delay [ms]", "left"), rows, title="gap")


def remarks(record: Record) -> Items:
    """List what is to be said of the values: cross-check, fit, air, sound, what is not known."""
    if not record.estimates:
        return Items(())
    lines: list[str] = []
    if record.verdict == "suspect" and any(known.interval95 for known in record.estimates):
        lines.append("The intervals hold as far as the doubts above are unfounded.")
    lines += record.motion.unidentifiable
    cross, fit, same = record.cross_check, record.motion.fit, record.motion.equivalents
    if cross is not None and cross.tells:
        within = "is within what such logs allow" if cross.agrees else "disagrees"
        said = f"A second estimate {within}: {cross.value:.4f}"
        said += "" if cross.noise95 is None else f" ± {cross.noise95:.4f} by its noise alone"
        said += f", by {cross.method}"
        if cross.tolerance is not None:
            said += f"; allowed is {cross.tolerance:.4f}"
        lines.append(f"{said}.")
    if fit is not None:
        left = f", {fit.left_out} left out" if fit.left_out else ""
        lines.append(
            f"Simulation against {fit.samples} samples{left}: {fit.rms_percent:.2f} % of the drop "
            f"height apart, rms, of which noise {fit.noise_percent:.2f}; at worst "
            f"{fit.worst_percent:.2f}."
        )
    if same is not None:
        lines.append(
            "For a simulator without air and with one restitution for all speeds: "
            f"{same.first.restitution:.4f} makes the first rebound as high "
            f"({same.first.rms_percent:.2f} % of the drop height off, rms), "
            f"{same.all.restitution:.4f} is best over all bounces ({same.all.rms_percent:.2f} %)."
        )
    lines += filter(None, [sound_words(record)])
    return Items(lines[:_MAX_ROWS])


def bounces_table(record: Record) -> TextTable:
    """Build a row per impact."""
    heads = ("bounce", "time [s]", "restitution", "95 % interval", "at [m/s]")
    rows = [
        (
            str(number),
            f"{one.impact_s:.4f}",
            f"{one.restitution:.4f}",
            interval_words(one.interval95),
            "not known" if one.impact_speed_m_s is None else f"{one.impact_speed_m_s:.3f}",
        )
        for number, one in enumerate(record.rebounds[:_MAX_ROWS], 1)
    ]
    return TextTable(heads, rows, title="bounces")


def iterations_table(record: Record) -> TextTable:
    """Build a row per iterate; the last may be the exact fit's."""
    steps = record.iterations
    names = tuple(steps[0])[:_MAX_ROWS] if steps else ()
    rows = [
        (str(k), *(number_words(step[name]) if name in step else "-" for name in names))
        for k, step in enumerate(steps[:_MAX_ROWS])
    ]
    if record.is_fitted and 0 < len(steps) <= _MAX_ROWS:
        rows[-1] = ("refined", *rows[-1][1:])
    return TextTable(("k", *names), rows, title="iterations")


def page_facts(record: Record) -> tuple[str, ...]:
    """List what stands in the head of a tuning's page."""
    facts = [_TASKS.get(record.task or "", record.task or "a log that could not be read")]
    if record.ball:
        facts.append(f"ball: {record.ball}")
    if record.provenance:
        facts.append(f"tuned {record.provenance.date[:16].replace('T', ' ')} UTC")
    return tuple(facts)


def page_todo(record: Record, tuning: Path) -> Items:
    """List what failed and its remedies, or what the values are for."""
    if record.verdict == "ok":
        to, told = "ENGINE", record.provenance and record.provenance.model
        if record.task == "simulator":
            is_urdf = told and told.path.lower().endswith(".urdf")
            to = "yaml" if not told else "urdf" if is_urdf else "mjcf"
        what = {"ENGINE": "a file of your engine", "yaml": "a file"}.get(to, "your model's file")
        return Items([f"As {what}: tunenet-export {tuning.name} --to {to}"])
    return failures(record, _OCCASIONS.get(record.task or "", "recording"))


def page_values(record: Record) -> list[Block]:
    """Make the blocks of a page above its figures."""
    shown = parameters_table(record)
    blocks: list[Block] = [Heading("Parameters"), shown] if shown.rows else []
    together = correlations_table(record)
    blocks += [Heading("Values that hang together"), together] if together.rows else []
    if (known := record.posterior) is not None and len(known.sd) > 1 and not together.rows:
        most = float(np.abs(np.triu(known.correlation, 1)).max())
        blocks.append(
            Paragraph(f"No two values hang together: correlations are {most:.2f} at most.")
        )
    gaps = gaps_table(record)
    blocks += [Heading("Gap to the log, as given and tuned"), gaps] if gaps.rows else []
    return [*blocks, remarks(record)]


def page_details(record: Record, tuning: Path) -> list[Block]:
    """Make the blocks of a page below its figures."""
    checks = TextTable(
        ("", "check", "what was seen", "limit"),
        [
            (
                "✓ passed" if one.passed else "✕ failed",
                one.name,
                one.figure,
                one.wanted.removeprefix("wanted: "),
            )
            for one in sorted(record.checks, key=lambda check: check.passed)[:_MAX_ROWS]
        ],
        title="checks",
    )
    without = ", without a result" if record.verdict == "rejected" else ""
    tables = {
        "Bounces": bounces_table(record),
        "Checks": checks,
        f"Iterations{without}": iterations_table(record),
    }
    blocks: list[Block] = []
    for title, shown in tables.items():
        blocks += [Heading(title), shown] if shown.rows else []
    if record.warnings:
        blocks += [Heading("Warnings"), Items(record.warnings[:_MAX_ROWS])]
    # How it was simulated.
    pairs = [
        (name.replace("step_hz", "steps a second"), one) for name, one in _pairs(record.simulator)
    ]
    pairs += [("method", record.method)] if record.method else []
    pairs += [("simulator runs", str(record.rollouts))] if record.rollouts else []
    pairs += [(f"weights {name}", value) for name, value in _pairs(record.weights)]
    if pairs:
        blocks += [Heading("Simulator"), TextTable((), pairs, title="simulator")]
    # Where it comes from.
    pairs = [("log", record.log), ("JSON", tuning.name)]
    pairs += [("topic", record.topic)] if record.topic else []
    window = [
        f"{name.removesuffix('_s')} {at_s:.3f} s" for name, at_s in (record.window or {}).items()
    ]
    pairs += [("window", ", ".join(window[:_MAX_ROWS]))] if window else []
    if (known := record.provenance) is not None:
        options = ", ".join(f"{name}={value}" for name, value in _pairs(known.options))
        pairs += [
            ("SHA-256 of the log", known.log_sha256 or "not read"),
            ("date", known.date),
            ("version", f"tunenet-logs {known.version}"),
            ("engine", known.engine or "none"),
            ("options", options or "the defaults"),
        ]
        pairs += [("tare", " ".join(map(str, tare.values()))) for tare in known.tares]
    seconds = ", ".join(f"{name} {value:.2f} s" for name, value in record.seconds.items())
    pairs += [("time", seconds)] if seconds else []
    blocks += [Heading("Where this comes from"), TextTable((), pairs, title="provenance")]
    counts = {
        "bounces": len(record.rebounds),
        "checks": len(record.checks),
        "iterations": len(record.iterations),
        "warnings": len(record.warnings),
    }
    more = [f"{n - _MAX_ROWS} more {what}" for what, n in counts.items() if n > _MAX_ROWS]
    return [*blocks, Paragraph(f"In the JSON: {', '.join(more)}.")] if more else blocks


def _pairs(known: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    return [(str(name), str(value)) for name, value in list((known or {}).items())[:_MAX_ROWS]]


def result_words(record: Record, preset: str, occasion: str | None) -> str:
    """Format a review's text: verdict, failures with remedies, values, iterations, checks."""
    failed = failures(record, occasion)
    blocks: list[Block] = [Heading(record.verdict, 1), *([failed] if failed.lines else [])]
    shown = parameters_table(record, said_names(known.name for known in record.estimates))
    if any(len(name) > _LONG_NAME_CHARACTERS for name, *_ in shown.rows):  # a list's lines wrap
        blocks.append(Items([f"{name}: {value}, 95 %: {ends}" for name, value, ends in shown.rows]))
    elif shown.rows:
        blocks.append(shown)
    meanings = [
        f"{name}: {note}"
        for (name, *_), notes in zip(shown.rows, shown.notes, strict=True)
        for note in notes
    ]
    blocks += [Items(meanings)] if meanings and record.physical else []
    notes = remarks(record)
    blocks += [notes] if notes.lines else []
    together = correlations_table(record, said_names(known.name for known in record.estimates))
    blocks += [together] if together.rows else []
    gaps = gaps_table(record)
    blocks += [TextTable(gaps.heads, gaps.rows[:_MAX_BOUNCES])] if gaps.rows else []
    bounces = bounces_table(record)
    if len(bounces.rows) > 1:
        blocks.append(TextTable(bounces.heads, bounces.rows[:_MAX_BOUNCES]))
        more = len(record.rebounds) - _MAX_BOUNCES
        blocks += [Paragraph(f"{more} more in the JSON")] if more > 0 else []
    if record.iterations:
        # The last iterates as columns: a review is narrow, and parameters may be many.
        said = f"{record.method}, preset {preset}, {record.rollouts} rollouts"
        if not record.physical:
            said += "; the engine's number under the paper's settings"
        whole = iterations_table(record)
        names = said_names(whole.heads[1:])
        units = {known.name: known.unit for known in record.estimates}
        titles = [quantity(names[name], units.get(name, "1")) for name in whole.heads[1:]]
        last = whole.rows[-_SHOWN:]
        if any(len(title) > _LONG_NAME_CHARACTERS for title in titles):  # units are listed above
            titles = [short_name(names[name], _MAX_NAME_CHARACTERS) for name in whole.heads[1:]]
            last = whole.rows[-_FEW_SHOWN:]
        heads, *columns = zip(*last, strict=True)
        rows = [(title, *cells) for title, cells in zip(titles, columns, strict=True)]
        blocks += [Paragraph(said), TextTable(("k", *heads), rows)]
    if record.checks:
        passed = sum(check.passed for check in record.checks)
        blocks.append(Paragraph(f"{passed} of {len(record.checks)} checks passed: see their tab."))
    warnings = list(record.warnings[:_MAX_WARNINGS])
    if len(record.warnings) > _MAX_WARNINGS:
        warnings.append(f"{len(record.warnings) - _MAX_WARNINGS} more warnings")
    blocks += [Items(warnings)] if warnings else []
    return markdown(blocks)


def checks_words(record: Record) -> str:
    """Format every check of a review, those that failed first."""
    ordered = sorted(record.checks, key=lambda check: check.passed)
    marks = {True: "✓", False: "✕"}
    lines = [f"{marks[one.passed]} **{one.name}**: {one.detail}" for one in ordered]
    return markdown([Heading("checks", 1), Items(lines)])


# ---- Short names: of parameters in a review, as long as they stay distinct.


def said_names(names: Iterable[str]) -> Mapping[str, str]:
    """Shorten each parameter's name: "restitution slope", "elbow.damping"."""
    ends: dict[str, str] = {}
    for name in names:
        _, kind, rest = name.partition("/")  # an address loses its kind; others are put in words
        ends[name] = (rest if "." in rest else name) if kind else name.replace("_", " ")
    counts = Counter(ends.values())
    return {name: end if counts[end] == 1 else name for name, end in ends.items()}
