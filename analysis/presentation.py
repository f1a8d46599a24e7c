"""Format tunings and comparisons: tables for the terminal, texts for report pages and reviews."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from textwrap import fill, wrap
from typing import Any

import numpy as np

from tunenet_logs.addresses import Address
from tunenet_logs.analysis.checks import Check, CrossCheck
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
from tunenet_logs.analysis.record import Estimate, Rebound, Record
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2
from tunenet_logs.terminal import one_line, short_name

# ---- Layout: columns as text, all of them or what fits a narrow terminal.

_BETWEEN = "  "

# Which columns leave last, in this order; log, verdict and value never do.
_LAST = ("fits", "95 % interval")

# Of a log in a table that is too wide: so many while columns can leave, so few when none can.
_NAME_CHARACTERS = 28, 10

# Of a column's name in a table that is too wide: longer ones take several lines.
_HEAD_CHARACTERS = 20

# Where a name goes on in the next line: `joint/`, `elbow`, `.damping `, `[N·m]`; within `left_arm`
# where it has to.
_MARKS, _WEAK_MARKS = re.compile(r"(?<=[/ ])|(?=[.(])"), re.compile(r"(?<=_)")

_MIN_LINE_CHARACTERS = 20  # a narrower terminal is taken for one of these


def laid_out(
    columns: Mapping[str, Sequence[str]], below: Sequence[Sequence[str]], most: int | None
) -> str:
    """Format a table: a header, a line per row, and lines indented below each row.

    If it is wider than the terminal, a single row is transposed, a line per column; of several,
    long heads are wrapped, then the least important columns are left out, and named.

    Args:
        columns: Cells by the column's name, N each; the most important columns come first.
        below: Of each row, N.
        most: Characters of a line; None for any number.
    """
    if most is None:
        return _lines(columns, below, None)
    most = max(most, _MIN_LINE_CHARACTERS)
    if _width(columns) <= most:
        return _lines(columns, below, most)
    if len(below) == 1:
        return _upright(columns, below[0], most)
    kept, left_out = _fitted(columns, most)
    text = _lines(kept, below, most)
    if left_out:
        words = f"(left out, too wide for this terminal: {', '.join(left_out)}; | cat shows all)"
        text += "\n" + "\n".join(wrap(words, most))
    return text


def _lines(
    columns: Mapping[str, Sequence[str]], below: Sequence[Sequence[str]], most: int | None
) -> str:
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
    for line, words in zip(lines[height:], below, strict=True):
        out += [line, *_indented(words, most)]
    return "\n".join(out)


def _upright(columns: Mapping[str, Sequence[str]], below: Sequence[str], most: int) -> str:
    """Format one row transposed; only the log's path is shortened."""
    _, *cells = (cell for cell, *_ in columns.values())
    room = max(most - len(_BETWEEN) - max(map(len, cells), default=0), _MIN_LINE_CHARACTERS)
    names = [short_name(name, room) for name in columns]
    width = max(map(len, names))
    lines = [
        f"{name.ljust(width)}{_BETWEEN}{cell}"
        for name, (cell, *_) in zip(names, columns.values(), strict=True)
    ]
    return "\n".join([*lines, *_indented(below, most)])


def _indented(lines: Sequence[str], most: int | None) -> list[str]:
    if most is None:
        return [f"  {line}" for line in lines]
    return [
        part
        for line in lines
        for part in wrap(
            line,
            most,
            initial_indent="  ",
            subsequent_indent="    ",
            break_long_words=False,
            break_on_hyphens=False,
        )
    ]


def _fitted(
    columns: Mapping[str, Sequence[str]], most: int
) -> tuple[dict[str, Sequence[str]], list[str]]:
    """Return the columns that fit, and the names of the others in their order."""
    log, *_ = never = list(columns)[:3]
    many, few = _NAME_CHARACTERS
    kept = {**columns, log: [short_name(cell, many) for cell in columns[log]]}
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


def _widths(columns: Mapping[str, Sequence[str]]) -> list[int]:
    return [max(*map(len, name.split("\n")), *map(len, cells)) for name, cells in columns.items()]


def _width(columns: Mapping[str, Sequence[str]]) -> int:
    return sum(_widths(columns)) + len(_BETWEEN) * (len(columns) - 1)


# ---- Tunings for the terminal: a table, and phrases that reports and reviews share.

_MIN_DECIMALS, _MAX_DECIMALS = 4, 6  # of an interval's ends
_MAX_WRITTEN_OUT = 1e9  # no quantity is larger, but a stranger's file may say so


@dataclass(frozen=True, eq=False)
class Row:
    """Table row of a tuning: small, so that it travels between processes.

    Attributes:
        is_read: Whether the log could be read at all.
        parameter: Name and unit of what was tuned; "" if unknown.
        extent: See `Detection.extent`; None if nothing was found.
        truth: Ground truth of a simulator, if the log has it; shown, never used.
    """

    log: Path | Address
    record: Record
    is_read: bool
    parameter: str
    extent: tuple[str, str] | None
    preset: str
    truth: float | None


def row_of(tuning: Tuning, record: Record) -> Row:
    """Build the row of a tuning and its record."""
    presets = tuning.experiment.presets if tuning.experiment else {}
    parameter = presets[tuning.preset].parameters[0] if tuning.preset in presets else None
    truth = None
    if tuning.episode is not None and parameter is not None:
        truth = tuning.episode.info.truth.get(parameter.name)
    return Row(
        log=tuning.log,
        record=record,
        is_read=tuning.episode is not None,
        parameter=quantity(parameter.name, parameter.unit) if parameter else "",
        extent=tuning.detection.extent if tuning.detection else None,
        preset=tuning.preset,
        truth=truth,
    )


def table(rows: Sequence[Row], most: int | None = None) -> str:
    """Format a line per log, with indented lines below it; a table for each parameter.

    Args:
        rows: Of the logs.
        most: Width of the terminal, to which it is fitted; None for all of it.
    """
    parameters = list(dict.fromkeys(row.parameter for row in rows if row.parameter)) or [""]
    parts = [
        [row for row in rows if (row.parameter or parameters[0]) == parameter]
        for parameter in parameters
    ]
    tables = [
        laid_out(_columns(parameter, its), [_lines_below(row) for row in its], most)
        for parameter, its in zip(parameters, parts, strict=True)
    ]
    return "\n\n".join(tables)


def _columns(parameter: str, rows: Sequence[Row]) -> dict[str, list[str]]:
    """Return the cells of each column, by its name."""
    records = [row.record for row in rows]
    crosses = [record.cross_check for record in records]
    extents = [row.extent[0] for row in rows if row.extent is not None]
    columns = {
        "log": [one_line(row.log) for row in rows],
        "verdict": [record.verdict for record in records],
        parameter: [_value(record.estimates[:1]) for record in records],
        "95 % interval": [_interval(record) for record in records],
        **_other_parameters(records),
        "cross-check (tolerance)": [_cross(cross) for cross in crosses],
        (extents or [""])[0]: ["-" if row.extent is None else row.extent[1] for row in rows],
        "fits": [_fits(record) for record in records],
        "rollouts": [str(record.rollouts) for record in records],
        "time": [f"{record.seconds.get('total', 0.0):.2f} s" for record in records],
        "truth": ["-" if row.truth is None else f"{row.truth:.4f}" for row in rows],
    }
    for optional in ("truth", "95 % interval", "fits"):
        if set(columns[optional]) == {"-"}:
            del columns[optional]
    return {name: cells for name, cells in columns.items() if name}


def _cross(cross: CrossCheck | None) -> str:
    """Format a second estimate, and its tolerance."""
    if cross is None:
        return "-"
    return f"{cross.value:.4f}" + ("" if cross.tolerance is None else f" ({cross.tolerance:.4f})")


def cross_words(cross: CrossCheck) -> str:
    """Format a second estimate with its noise, its method, and its tolerance."""
    noise = "" if cross.noise95 is None else f" ± {cross.noise95:.4f} by its noise alone"
    allowed = (
        "" if cross.tolerance is None else f"; up to {cross.tolerance:.4f} off counts as agreed"
    )
    return f"{cross.value:.4f}{noise}, by {cross.method}{allowed}"


def _lines_below(row: Row) -> list[str]:
    """List what a table's line has no room for."""
    record = row.record
    lines = [extra_words(known) for known in record.estimates[1:] if isinstance(known.value, tuple)]
    if record.estimates:
        lines += [*filter(None, [equivalent_words(record)]), *record.motion.unidentifiable]
        lines += filter(None, [sound_words(record)])
    if record.reason:
        lines.append(one_line(f"{record.verdict}: {record.reason}"))
    if record.estimates and not record.physical:
        lines.append(f"{row.preset}: the engine's number under the paper's settings")
    return lines


_SHORT = {"restitution_slope": "slope"}  # what a table calls a parameter whose name is long


def _other_parameters(records: Sequence[Record]) -> dict[str, list[str]]:
    """Build a column for each further scalar parameter, with half its interval."""
    others = [known for record in records for known in record.estimates[1:]]
    names = dict.fromkeys(
        (known.name, known.unit) for known in others if isinstance(known.value, float)
    )
    return {
        quantity(_SHORT.get(name, name), unit): [_other(record, name) for record in records]
        for name, unit in names
    }


def _other(record: Record, name: str) -> str:
    known = record.estimate(name)
    return "-" if known is None else _numbers(known)


def _value(known: Sequence[Estimate]) -> str:
    return f"{known[0].value:.4f}" if known else "-"


def _fits(record: Record) -> str:
    """Format the RMS residual beyond the noise."""
    fit = record.motion.fit
    return "-" if fit is None or not record.estimates else f"{fit.excess_percent:.2f} %"


def _interval(record: Record) -> str:
    """Format the first parameter's interval; a suspect's is marked."""
    known = record.estimates[0] if record.estimates else None
    if known is None or known.interval95 is None:
        return "-"
    low, high = known.interval95
    assert isinstance(low, float)
    assert isinstance(high, float)
    return interval_words(low, high) + interval_mark(record)


def interval_mark(record: Record) -> str:
    """Return a mark for the interval of a verdict that is not ok."""
    return "" if record.verdict == "ok" else f" ({record.verdict})"


def interval_words(low: float, high: float) -> str:
    """Format an interval with enough decimals: equal ends would read as certainty.

    The last digits differ by two or more. If six decimals do not show that, the ends are rounded
    away from each other.
    """
    if max(abs(low), abs(high)) > _MAX_WRITTEN_OUT:
        return f"{low:.4g} to {high:.4g}"
    decimals = _MIN_DECIMALS
    while decimals < _MAX_DECIMALS and round(high * 10**decimals) - round(low * 10**decimals) < 2:
        decimals += 1
    unit = 10**decimals
    first, last = round(low * unit), round(high * unit)
    if last - first < 2:
        first, last = math.floor(low * unit), math.ceil(high * unit)
    return f"{first / unit:.{decimals}f} to {last / unit:.{decimals}f}"


def quantity(name: str, unit: str) -> str:
    """Format a quantity's name with its unit: "restitution", "payload_mass [kg]"."""
    return name if unit == "1" else f"{name} [{unit}]"


def extra_words(known: Estimate) -> str:
    """Format a quantity of several numbers, each with half its interval if it has one."""
    return f"{quantity(known.name, known.unit)} {_numbers(known)}"


def _numbers(known: Estimate) -> str:
    values = np.atleast_1d(known.value)
    halves = [""] * len(values)
    if known.interval95 is not None:
        widths = np.ptp(np.reshape(known.interval95, (-1, 2)), axis=1)
        halves = [f" ± {width / 2:.4f}" for width in widths]
    return ", ".join(f"{value:.4f}{half}" for value, half in zip(values, halves, strict=True))


_SAME = 0.001  # of a restitution: with a ball that differs by less, a simulator needs no air


def equivalent_words(record: Record) -> str:
    """Describe the ball for a simulator without air; "" if it is the same there."""
    known = record.motion.equivalents
    if known is None or not record.estimates:
        return ""
    value = float(np.atleast_1d(record.estimates[0].value)[0])
    if max(abs(one.restitution - value) for one in (known.first, known.all)) < _SAME:
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
    ends = record.estimates[0].interval95 if record.estimates else None
    now = "" if ends is None else f", {interval_words(*map(float, np.ravel(ends)))} with it"
    return (
        f"sound: {sound.heard} of {sound.impacts} impacts heard, {1000 * abs(sound.offset_s):.1f} "
        f"ms {side} the pictures; interval {interval_words(*sound.interval95)} without it{now}"
    )


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a Markdown table of text cells."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


# ---- Comparison for the terminal: a table for each group, and its tests.

# Of one quantity, printed with their figures: more are only named, and the CSV has all.
_MAX_PAIRS = 10

_MAX_NAMED = 40  # pairs that are named
_PROSE_CHARACTERS = 100  # of a line of prose
_CELL_CHARACTERS = 48  # of a cell of a table: a value with its interval, or a log's name
_MIN_PROBABILITY = 1e-4  # nobody needs to know how far under it one is


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
            lines.append(
                f"  {numbers[label]} {short_name(label, _CELL_CHARACTERS)}  {record.verdict}: {why}"
            )
        parts.append("\n".join(lines))
    if len(comparison.groups) > 1:
        parts.append("Logs of different tasks, presets or engines' numbers are never compared.")
    if any(quantity.tests for group in comparison.groups for quantity in group.quantities):
        parts.append(fill(TEST_WORDS, _PROSE_CHARACTERS))
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
    cells = [[short_name(cell, _CELL_CHARACTERS) for cell in row] for row in shown]
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
    return f"{value:.4g}" if abs(value) > _MAX_WRITTEN_OUT else f"{round(value, 4) + 0.0:.4f}"


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
    return [f"differ: {_some(different)}", f"not distinguishable: {_some(alike)}"]


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
    said = "differs" if test.differs else "not distinguishable"
    return f"{difference} ({ends}){speed}, {chance}: {said}{caution}"


def probability_words(probability: float) -> str:
    """Format a corrected p-value."""
    if probability < _MIN_PROBABILITY:
        return f"p < {_MIN_PROBABILITY:g}"
    return f"p = {probability:.2g}"


# ---- Meanings: a tuning's figures in plain sentences.

_FIXED = {
    "payload_mass": "what the gripper holds",
    "payload_com": "centre of mass of what is held, in the frame of the tool's link",
}

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
    if known.name in _FIXED:
        return _FIXED[known.name]
    if not isinstance(known.value, float):
        return ""
    speed_m_s = first_speed_m_s(record)
    sentences = {
        "restitution": _restitution(known.value, speed_m_s),
        "restitution_slope": _slope(record, known.value, speed_m_s),
        "drag": _drag(known.value, speed_m_s),
    }
    return sentences.get(known.name, "")


def first_speed_m_s(record: Record) -> float | None:
    """Return the impact speed that the restitution holds for, or None."""
    blank = ComparedValue("", 0.0, None, record.verdict)
    return restitution_value(blank, record).speed_m_s


def _restitution(value: float, speed_m_s: float | None) -> str:
    at = "" if speed_m_s is None else f", at {speed_m_s:.2f} m/s"
    return f"at its first impact{at}, the ball keeps {100 * value:.1f} % of its speed"


def _slope(record: Record, slope: float, speed_m_s: float | None) -> str:
    restitution = record.estimate("restitution")
    if restitution is None or not isinstance(restitution.value, float):
        return "p: at speed v the ball keeps e (v / v first)^-p of it"
    half = min(restitution.value * math.exp(min(slope, 1.0) * math.log(2)), 1.0)
    at = "half the speed" if speed_m_s is None else f"half the speed, {speed_m_s / 2:.2f} m/s"
    return f"p: at speed v the ball keeps e (v / v first)^-p of it; at {at}, {100 * half:.1f} %"


def _drag(drag_1_m: float, speed_m_s: float | None) -> str:
    words = "k: the air slows the ball by k v²"
    if speed_m_s is None or speed_m_s > 1e3:
        return words
    slowed = drag_1_m * speed_m_s**2
    return f"{words}; at {speed_m_s:.2f} m/s that is {100 * slowed / GRAVITY_M_S2:.1f} % of gravity"


# ---- Report page: the section of one tuning, from its record alone.

_MAX_ROWS = 100  # of one table; what a file beyond any of ours holds is counted
# How a check says what it saw: the figure, its limit in brackets, perhaps more.
_FIGURE_LIMIT = re.compile(
    r"(?P<figure>.*?) \((?P<limit>(?:wanted|at most|less than|over|[\d.]+ or more)[^()]*)\)"
    r"(?P<rest>.*)",
    re.DOTALL,
)

_TASKS = {"drop": "ball drop", "payload": "payload of an arm"}

_OCCASIONS = {"drop": "drop", "payload": "recording"}


@dataclass(frozen=True)
class CheckRow:
    """Table row of a check.

    Attributes:
        limit: "" if it is in the figure's own words.
        advice: How to make it pass; "" if it passed.
    """

    name: str
    passed: bool
    figure: str
    limit: str
    advice: str


@dataclass(frozen=True)
class TuningSection:
    """Texts and tables of one tuning.

    Attributes:
        anchor: Of links to it.
        label: Of the log.
        facts: Short, in the head: task, ball, date.
        lead: The verdict in a sentence.
        todo: What to do, first things first.
        parameters: Rows of name, value, 95 % interval, meaning.
        notes: Remarks on these.
        bounces: Rows of number, time, restitution, 95 % interval, impact speed.
        checks: Failed ones first.
        iterations: Rows of k and values, below `iteration_names`.
        settings: Name and value, of the simulator.
        origin: Name and value, of the provenance.
        left_out: Tables that are longer in the JSON, in words.
    """

    anchor: str
    label: str
    verdict: str
    facts: tuple[str, ...]
    lead: str
    todo: tuple[str, ...]
    parameters: tuple[tuple[str, str, str, str], ...]
    notes: tuple[str, ...]
    bounces: tuple[tuple[str, ...], ...]
    checks: tuple[CheckRow, ...]
    iteration_names: tuple[str, ...]
    iterations: tuple[tuple[str, ...], ...]
    settings: tuple[tuple[str, str], ...]
    origin: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]
    left_out: tuple[str, ...]


def section_of(record: Record, label: str, tuning: Path, number: int) -> TuningSection:
    """Build the section of a tuning; `number` is its position on the page, from 1."""
    counts = {
        "bounces": len(record.rebounds),
        "checks": len(record.checks),
        "iterations": len(record.iterations),
        "warnings": len(record.warnings),
    }
    names = tuple(record.iterations[0])[:_MAX_ROWS] if record.iterations else ()
    return TuningSection(
        anchor=f"log-{number}",
        label=label,
        verdict=record.verdict,
        facts=_facts(record),
        lead=NEXT[record.verdict],
        todo=_todo(record, tuning),
        parameters=_parameter_rows(record),
        notes=_notes(record),
        bounces=_bounce_rows(record),
        checks=check_rows(record.checks),
        iteration_names=names,
        iterations=_iteration_rows(record, names),
        settings=_settings(record),
        origin=_origin(record, tuning),
        warnings=record.warnings[:_MAX_ROWS],
        left_out=tuple(
            f"{count - _MAX_ROWS} more {what}"
            for what, count in counts.items()
            if count > _MAX_ROWS
        ),
    )


def _facts(record: Record) -> tuple[str, ...]:
    facts = [_TASKS.get(record.task or "", record.task or "a log that could not be read")]
    if record.ball:
        facts.append(f"ball: {record.ball}")
    if record.provenance:
        facts.append(f"tuned {record.provenance.date[:16].replace('T', ' ')} UTC")
    return tuple(facts)


def _todo(record: Record, tuning: Path) -> tuple[str, ...]:
    """List failed checks' remedies, or what the values are for."""
    failed = [check for check in record.checks if not check.passed]
    lines: list[str] = [record.reason] if record.reason else []
    occasion = _OCCASIONS.get(record.task or "", "recording")
    advice = list(dict.fromkeys(check.advice for check in failed if check.advice))
    said = record.reason or ""
    lines += [f"At the next {occasion}: {one}." for one in advice if one not in said]
    if record.verdict == "ok":
        lines.append(f"As a file of your engine: tunenet-export {tuning.name} --to ENGINE")
    return tuple(lines[:_MAX_ROWS])


def _parameter_rows(record: Record) -> tuple[tuple[str, str, str, str], ...]:
    rows: list[tuple[str, str, str, str]] = []
    for known in record.estimates[:_MAX_ROWS]:
        values = known.value if isinstance(known.value, tuple) else (known.value,)
        ends: Any = known.interval95
        intervals = ends if isinstance(known.value, tuple) else (ends,)
        said = [
            interval_words(*one) if one is not None else "no reliable interval"
            for one in intervals or (None,)
        ]
        numbers = ", ".join(map(number_words, values))
        name = quantity(known.name, known.unit)
        rows.append((name, numbers, "; ".join(said), meaning(record, known)))
    unknown = record.motion.unknown[:_MAX_ROWS] if rows else ()
    needs = "needs units that the log does not state"
    return (*rows, *((name, "not known", "-", needs) for name in unknown))


def _notes(record: Record) -> tuple[str, ...]:
    if not record.estimates:
        return ()
    notes: list[str] = []
    if record.verdict == "suspect" and any(known.interval95 for known in record.estimates):
        notes.append("The intervals hold as far as the doubts above are unfounded.")
    notes += record.motion.unidentifiable
    cross, same = record.cross_check, record.motion.equivalents
    if cross is not None:
        agrees = "agrees" if cross.agrees else "disagrees"
        notes.append(f"A second estimate {agrees}: {cross_words(cross)}.")
    if same is not None:
        notes.append(
            "For a simulator without air and with one restitution for all speeds: "
            f"{same.first.restitution:.4f} makes the first rebound as high "
            f"({same.first.rms_percent:.2f} % of the drop height off, rms), "
            f"{same.all.restitution:.4f} is best over all bounces ({same.all.rms_percent:.2f} %)."
        )
    return tuple(notes[:_MAX_ROWS])


def _bounce_rows(record: Record) -> tuple[tuple[str, ...], ...]:
    rows: list[tuple[str, ...]] = []
    for number, bounce in enumerate(record.rebounds[:_MAX_ROWS], 1):
        ends = "-" if bounce.interval95 is None else interval_words(*bounce.interval95)
        speed = bounce.impact_speed_m_s
        rows.append(
            (
                str(number),
                f"{bounce.impact_s:.4f}",
                f"{bounce.restitution:.4f}",
                ends,
                "not known" if speed is None else f"{speed:.3f}",
            )
        )
    return tuple(rows)


def check_rows(checks: Sequence[Check]) -> tuple[CheckRow, ...]:
    """Build the rows of checks, failed ones first, figure and limit apart if separable."""
    rows: list[CheckRow] = []
    for check in sorted(checks, key=lambda check: check.passed)[:_MAX_ROWS]:
        found = _FIGURE_LIMIT.fullmatch(check.detail[:2000])
        figure, limit = check.detail, ""
        if found is not None:
            figure = f"{found['figure']}{found['rest']}"
            limit = found["limit"].removeprefix("wanted: ")
        rows.append(CheckRow(check.name, check.passed, figure, limit, check.advice))
    return tuple(rows)


def _iteration_rows(record: Record, names: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    steps = record.iterations
    rows: list[tuple[str, ...]] = []
    for k, step in enumerate(steps[:_MAX_ROWS]):
        head = "fit" if record.is_fitted and k == len(steps) - 1 else str(k)
        rows.append((head, *(number_words(step[name]) if name in step else "-" for name in names)))
    return tuple(rows)


def _pairs(fields: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    return [(str(name), str(value)) for name, value in list((fields or {}).items())[:_MAX_ROWS]]


def _settings(record: Record) -> tuple[tuple[str, str], ...]:
    pairs = [
        (name.replace("step_hz", "steps a second"), one) for name, one in _pairs(record.simulator)
    ]
    if record.method:
        pairs.append(("method", record.method))
    if record.rollouts:
        pairs.append(("simulator runs", str(record.rollouts)))
    pairs += [(f"weights {name}", value) for name, value in _pairs(record.weights)]
    return tuple(pairs)


def _origin(record: Record, tuning: Path) -> tuple[tuple[str, str], ...]:
    pairs = [("log", record.log), ("JSON", tuning.name)]
    if record.topic:
        pairs.append(("topic", record.topic))
    window = [
        f"{name.removesuffix('_s')} {at_s:.3f} s" for name, at_s in (record.window or {}).items()
    ]
    if window:
        pairs.append(("window", ", ".join(window[:_MAX_ROWS])))
    known = record.provenance
    if known is not None:
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
    return (*pairs, ("time", seconds)) if seconds else tuple(pairs)


# ---- Short names: of parameters in a review, as long as they stay distinct.


def said_names(names: Iterable[str]) -> Mapping[str, str]:
    """Shorten each parameter's name: "restitution slope", "elbow.damping".

    Args:
        names: Of all parameters; addresses such as `joint/elbow.damping` lose the kind if no other
            one ends the same.
    """
    every = list(dict.fromkeys(names))
    ends = [_end(name) for name in every]
    return {
        name: end if ends.count(end) == 1 else name for name, end in zip(every, ends, strict=True)
    }


def _end(name: str) -> str:
    """Return an address without its kind, or another name in words."""
    _, kind, rest = name.partition("/")
    if kind:
        return rest if "." in rest else name
    return name.replace("_", " ")


# ---- Review: a tuning in Markdown, the most important first.

_SHOWN, _FEW_SHOWN = 5, 3  # iterations in the table: the last ones; fewer where names are long
# Characters of a parameter's name that a table on a laptop's screen has room for: beside five
# values, and beside three.
_LONG_NAME_CHARACTERS, _MAX_NAME_CHARACTERS = 24, 32
_MAX_BOUNCES = 6  # rows; the JSON has all
_MAX_WARNINGS = 50  # rows and lines that a reader still looks through; the JSON has all


def result_words(record: Record, preset: str, occasion: str | None) -> str:
    """Format verdict, failures with remedies, parameters, bounces, iterations, checks.

    Args:
        record: Of the tuning.
        preset: That it was tuned with.
        occasion: What a user repeats, e.g. "drop"; None if unknown.
    """
    lines = [f"# {record.verdict}", *_failures(record, occasion), *_parameter_words(record)]
    cross = record.cross_check
    if cross is not None and record.estimates:
        agrees = "agrees" if cross.agrees else "**disagrees**"
        lines.append(f"cross-check {agrees}: {cross_words(cross)}")
    lines += [
        *_motion_words(record),
        *_bounce_words(record.rebounds),
        *_iteration_words(record, preset),
    ]
    passed = [check for check in record.checks if check.passed]
    if passed:
        listed = [f"- {one_line(check.name)}: {one_line(check.detail)}" for check in passed]
        lines.append("passed checks:\n\n" + "\n".join(listed))  # what a table holds does not wrap
    lines += [f"- {one_line(warning)}" for warning in record.warnings[:_MAX_WARNINGS]]
    if len(record.warnings) > _MAX_WARNINGS:
        lines.append(f"- {len(record.warnings) - _MAX_WARNINGS} more warnings")
    return "\n\n".join(lines)


def _failures(record: Record, occasion: str | None) -> list[str]:
    """List each failed check with figure, limit and remedy; the reason if none failed."""
    failed = [check for check in record.checks if not check.passed]
    if not failed:
        return [one_line(record.reason)] if record.reason else []
    again = f"at the next {occasion}: " if occasion else ""
    lines: list[str] = []
    for check in sorted(failed, key=lambda check: not check.fatal):
        remedy = f"\n    - {again}{one_line(check.advice)}" if check.advice else ""
        lines.append(f"- **failed: {one_line(check.name)}**: {one_line(check.detail)}{remedy}")
    return ["\n".join(lines)]


# What a parameter is, shortly: a table's cells do not wrap.
_MEANINGS = {
    "restitution": "e, the share of its speed that the ball keeps at the first impact",
    "restitution_slope": "p: at speed v it keeps e (v / v first)^-p",
    "drag": "k: the air slows it by k v²",
    "payload_mass": "held by the gripper",
}


def _parameter_words(record: Record) -> list[str]:
    """Format a table of the scalars, and lines of the vectors."""
    single = [known for known in record.estimates if not isinstance(known.value, tuple)]
    several = [known for known in record.estimates if isinstance(known.value, tuple)]
    said = said_names(known.name for known in record.estimates)
    rows: list[tuple[str, str, str]] = []
    for known in single:
        ends = "-"
        if known.interval95 is not None:
            low, high = known.interval95
            ends = interval_words(low, high)  # pyright: ignore[reportArgumentType]
        rows.append((quantity(said[known.name], known.unit), f"{known.value:.4f}", ends))
    head = ("parameter", "value", f"95 %{interval_mark(record)}")
    is_long = _are_long(name for name, *_ in rows)
    lines = [_listed(head, rows) if is_long else markdown_table(head, rows)]
    meanings = [
        f"- {said[known.name]}: {_MEANINGS[known.name]}"
        + (_at(record) if known is single[0] else "")
        for known in single
        if known.name in _MEANINGS and record.physical
    ]
    lines += ["\n".join(meanings)] if meanings else []
    return [
        *(lines if rows else []),
        *(extra_words(replace(known, name=said[known.name])) for known in several),
    ]


def _are_long(names: Iterable[str]) -> bool:
    return any(len(name) > _LONG_NAME_CHARACTERS for name in names)


def _listed(head: tuple[str, str, str], rows: Sequence[tuple[str, str, str]]) -> str:
    """List parameters whose names are too long for a table: a list's lines wrap."""
    *_, interval = head
    return "\n".join(f"- {name}: **{value}**, {interval}: {ends}" for name, value, ends in rows)


def _at(record: Record) -> str:
    """Return the speed that the first parameter holds for, if known."""
    first = record.rebounds[0].impact_speed_m_s if record.rebounds else None
    return "" if first is None else f", {first:.2f} m/s"


def _motion_words(record: Record) -> list[str]:
    """Describe the residual of the tuned simulator, and what the log leaves undetermined."""
    if not record.estimates:
        return []
    lines = list(record.motion.unidentifiable)
    fit = record.motion.fit
    if fit is not None:
        left = f", {fit.left_out} left out" if fit.left_out else ""
        lines.append(
            f"simulation against {fit.samples} samples{left}: {fit.rms_percent:.2f} % of the drop "
            f"height apart, rms, of which noise {fit.noise_percent:.2f}; "
            f"at worst {fit.worst_percent:.2f}"
        )
    return [*lines, *filter(None, [equivalent_words(record), sound_words(record)])]


def _bounce_words(bounces: Sequence[Rebound]) -> list[str]:
    if len(bounces) < 2:
        return []
    rows = []
    for number, bounce in enumerate(bounces[:_MAX_BOUNCES], start=1):
        ends = "-" if bounce.interval95 is None else interval_words(*bounce.interval95)
        speed_m_s = bounce.impact_speed_m_s
        speed = "-" if speed_m_s is None else f"{speed_m_s:.2f} m/s"
        rows.append((str(number), f"{bounce.restitution:.3f}", ends, speed))
    shown = markdown_table(("bounce", "restitution", "95 %", "impact at"), rows)
    more = len(bounces) - _MAX_BOUNCES
    return [shown, f"{more} more in the JSON"] if more > 0 else [shown]


def _iteration_words(record: Record, preset: str) -> list[str]:
    if not record.iterations:
        return []
    said = f"{record.method}, preset {preset}, {record.rollouts} rollouts"
    if not record.physical:
        said += "; the engine's number under the paper's settings"
    spoken = said_names(record.iterations[0])
    units = {known.name: known.unit for known in record.estimates}
    titles = {name: quantity(spoken[name], units.get(name, "1")) for name in spoken}
    is_long = _are_long(titles.values())
    if is_long:  # the list above has the units
        titles = {name: short_name(spoken[name], _MAX_NAME_CHARACTERS) for name in spoken}
    shown = list(enumerate(record.iterations))[-(_FEW_SHOWN if is_long else _SHOWN) :]
    heads = [str(k) for k, _ in shown]
    if record.is_fitted:
        heads[-1] = "refined"
    rows = [
        (titles[name], *(f"{values[name]:.4f}" for _, values in shown))
        for name in record.iterations[0]
    ]
    return [said, markdown_table(("k", *heads), rows)]
