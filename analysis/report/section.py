"""Section of a report page on one tuning, from its record alone."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from analysis.checks import Check
from analysis.comparison_text import number_words
from analysis.record import Record
from analysis.report.meanings import NEXT, meaning
from analysis.terminal_table import cross_words, interval_words, quantity

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
        parameters=_parameters(record),
        notes=_notes(record),
        bounces=_bounces(record),
        checks=check_rows(record.checks),
        iteration_names=names,
        iterations=_iterations(record, names),
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


def _parameters(record: Record) -> tuple[tuple[str, str, str, str], ...]:
    rows: list[tuple[str, str, str, str]] = []
    for known in record.estimates[:_MAX_ROWS]:
        values = known.value if isinstance(known.value, tuple) else (known.value,)
        ends: Any = known.interval95
        intervals = ends if isinstance(known.value, tuple) else (ends,)
        said = [
            interval_words(*one) if one is not None else "none that is honest"
            for one in intervals or (None,)
        ]
        numbers = ", ".join(map(number_words, values))
        name = quantity(known.name, known.unit)
        rows.append((name, numbers, "; ".join(said), meaning(record, known)))
    unknown = record.motion.unknown[:_MAX_ROWS] if rows else ()
    needs = "needs units that the log does not tell"
    return (*rows, *((name, "not known", "-", needs) for name in unknown))


def _notes(record: Record) -> tuple[str, ...]:
    if not record.estimates:
        return ()
    notes: list[str] = []
    if record.verdict == "suspect" and any(known.interval95 for known in record.estimates):
        notes.append("The intervals hold as far as the doubts above are unfounded.")
    notes += record.motion.untold
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


def _bounces(record: Record) -> tuple[tuple[str, ...], ...]:
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


def _iterations(record: Record, names: Sequence[str]) -> tuple[tuple[str, ...], ...]:
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
