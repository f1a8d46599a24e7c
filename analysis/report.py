"""Tunings in words: a table for the terminal, Markdown for the review."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from analysis.record import Estimate, Rebound, Record, Tuning
from tunenet_logs.terminal import one_line

_FEWEST_DECIMALS, _MOST_DECIMALS = 4, 6
"""Of an interval's ends."""


@dataclass(frozen=True, eq=False)
class Row:
    """What a table shows of a tuning: small, so that it travels between processes.

    Attributes:
        is_read: whether the log could be read at all.
        parameter: name and unit of what was tuned; "" where that is not known.
        extent: see `Detection.extent`; None where nothing was found.
        truth: what a simulator was set to, where the log says so; shown, never used.
    """

    log: Path
    record: Record
    is_read: bool
    parameter: str
    extent: tuple[str, str] | None
    preset: str
    truth: float | None


def row_of(tuning: Tuning, record: Record) -> Row:
    """The row of a tuning and its record."""
    parameter = tuning.experiment.parameters[0] if tuning.experiment else None
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


def table(rows: Sequence[Row]) -> str:
    """One line a log, and lines below for what is more to say; a table for each parameter."""
    parameters = list(dict.fromkeys(row.parameter for row in rows if row.parameter)) or [""]
    parts = [
        [row for row in rows if (row.parameter or parameters[0]) == parameter]
        for parameter in parameters
    ]
    return "\n\n".join(map(_table, parameters, parts))


def _table(parameter: str, rows: Sequence[Row]) -> str:
    first = [row.record.estimates[0] if row.record.estimates else None for row in rows]
    crosses = [row.record.cross_check for row in rows]
    extents = [row.extent[0] for row in rows if row.extent is not None]
    columns = {
        "log": [one_line(row.log) for row in rows],
        "verdict": [row.record.verdict for row in rows],
        parameter: ["-" if known is None else f"{known.value:.4f}" for known in first],
        "95 % interval": [_interval(known) for known in first],
        "cross-check": ["-" if cross is None else f"{cross.value:.4f}" for cross in crosses],
        (extents or [""])[0]: ["-" if row.extent is None else row.extent[1] for row in rows],
        "rollouts": [str(row.record.rollouts) for row in rows],
        "time": [f"{row.record.seconds.get('total', 0.0):.2f} s" for row in rows],
        "truth": ["-" if row.truth is None else f"{row.truth:.4f}" for row in rows],
    }
    for optional in ("truth", "95 % interval"):
        if set(columns[optional]) == {"-"}:
            del columns[optional]
    columns = {name: cells for name, cells in columns.items() if name}
    widths = [max(len(name), *map(len, cells)) for name, cells in columns.items()]
    header, *lines = (
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in zip(*([name, *cells] for name, cells in columns.items()), strict=True)
    )
    out = [header]
    for row, line in zip(rows, lines, strict=True):
        record = row.record
        out += [line, *(f"  {extra_words(known)}" for known in record.estimates[1:])]
        if record.reason:
            out.append(one_line(f"  {record.verdict}: {record.reason}"))
        if record.estimates and not record.physical:
            out.append(f"  {row.preset}: the engine's number under the paper's settings")
    return "\n".join(out)


def _interval(known: Estimate | None) -> str:
    if known is None or known.interval95 is None:
        return "-"
    low, high = known.interval95
    assert isinstance(low, float)
    assert isinstance(high, float)
    return interval_words(low, high)


def interval_words(low: float, high: float) -> str:
    """An interval with as many decimals as its width needs: equal ends would read as certainty.

    The last digits differ by two or more. Where six decimals do not show that, the ends are rounded
    away from each other.
    """
    decimals = _FEWEST_DECIMALS
    while decimals < _MOST_DECIMALS and round(high * 10**decimals) - round(low * 10**decimals) < 2:
        decimals += 1
    unit = 10**decimals
    first, last = round(low * unit), round(high * unit)
    if last - first < 2:
        first, last = math.floor(low * unit), math.ceil(high * unit)
    return f"{first / unit:.{decimals}f} to {last / unit:.{decimals}f}"


def quantity(name: str, unit: str) -> str:
    """A quantity's name with its unit: "restitution", "payload_mass [kg]"."""
    return name if unit == "1" else f"{name} [{unit}]"


def extra_words(known: Estimate) -> str:
    """A quantity of several numbers, each with half its interval where it has one."""
    values = np.atleast_1d(known.value)
    halves = [""] * len(values)
    if known.interval95 is not None:
        widths = np.ptp(np.reshape(known.interval95, (-1, 2)), axis=1)
        halves = [f" ± {width / 2:.4f}" for width in widths]
    numbers = ", ".join(f"{value:.4f}{half}" for value, half in zip(values, halves, strict=True))
    return f"{quantity(known.name, known.unit)} {numbers}"


_SHOWN = 7
"""Iterations in the table: the last ones."""

_MOST_BOUNCES = 6
_MOST_WARNINGS = 50
"""Rows and lines that a reader still looks through; the JSON has all."""


def result_words(record: Record, preset: str, occasion: str | None) -> str:
    """Value, verdict, what to do next time, bounces, iterations and checks.

    Args:
        record: of the tuning.
        preset: that it was tuned with.
        occasion: what a user does again, e.g. "drop"; None where that is not known.
    """
    lines: list[str] = []
    for known in record.estimates:
        if isinstance(known.value, tuple):
            lines.append(extra_words(known))
            continue
        unit = "" if known.unit == "1" else f" {known.unit}"
        lines.append(f"# {known.name} {known.value:.4f}{unit}")
        if known.interval95 is not None:
            low, high = known.interval95
            lines.append(f"95 %: {interval_words(low, high)}")  # pyright: ignore[reportArgumentType]
    reason = f": {one_line(record.reason)}" if record.reason else ""
    lines.append(f"**{record.verdict}**{reason}")
    cross = record.cross_check
    if cross is not None and record.estimates:
        agrees = "agrees" if cross.agrees else "**disagrees**"
        lines.append(f"cross-check {agrees}: {cross.value:.4f} by {cross.method}")
    # What would let each failed check pass; the reason has the first one's only.
    remedies = [check.advice for check in record.checks if not check.passed and check.advice]
    if len(remedies) > 1:
        listed = "\n".join(f"- {remedy}" for remedy in dict.fromkeys(remedies))
        lines.append(f"at the next {occasion}:\n\n{listed}")
    lines += [*_bounces(record.rebounds), *_iterations(record, preset)]
    if record.checks:
        lines.append("checks:\n")  # a list: what a table holds does not wrap
        for check in record.checks:
            name = one_line(check.name)
            name = name if check.passed else f"**failed: {name}**"
            lines[-1] += f"\n- {name}: {one_line(check.detail)}"
    lines += [f"- {one_line(warning)}" for warning in record.warnings[:_MOST_WARNINGS]]
    if len(record.warnings) > _MOST_WARNINGS:
        lines.append(f"- {len(record.warnings) - _MOST_WARNINGS} more warnings")
    return "\n\n".join(lines)


def _bounces(bounces: Sequence[Rebound]) -> list[str]:
    if len(bounces) < 2:
        return []
    rows = []
    for number, bounce in enumerate(bounces[:_MOST_BOUNCES], start=1):
        ends = "-" if bounce.interval95 is None else "{:.3f} to {:.3f}".format(*bounce.interval95)
        speed_m_s = bounce.impact_speed_m_s
        speed = "-" if speed_m_s is None else f"{speed_m_s:.2f} m/s"
        rows.append((str(number), f"{bounce.restitution:.3f}", ends, speed))
    shown = markdown_table(("bounce", "restitution", "95 %", "impact at"), rows)
    more = len(bounces) - _MOST_BOUNCES
    return [shown, f"{more} more in the JSON"] if more > 0 else [shown]


def _iterations(record: Record, preset: str) -> list[str]:
    if not record.iterations:
        return []
    said = f"{record.method}, preset {preset}, {record.rollouts} rollouts"
    if not record.physical:
        said += "; the engine's number under the paper's settings"
    name = next(iter(record.iterations[0]))
    shown = list(enumerate(record.iterations))[-_SHOWN:]
    cells = [(str(k), f"{values[name]:.4f}") for k, values in shown]
    if record.is_fitted:
        cells[-1] = ("refined", cells[-1][1])
    names, values = zip(("k", name), *cells, strict=True)
    return [said, markdown_table(names, [values])]


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table of text cells."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
