"""The result in words, as Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from analysis.checks import Check
from analysis.record import Rebound, Record
from analysis.report import extra_words, interval_words
from tunenet_logs.text import one_line

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
    if len(record.rebounds) > 1:
        lines += _bounces(record.rebounds)
    if record.iterations:
        lines += _iterations(record, preset)
    if record.checks:
        lines.append("\n".join(["checks:", "", *map(_check, record.checks)]))
    lines += [f"- {one_line(warning)}" for warning in record.warnings[:_MOST_WARNINGS]]
    if len(record.warnings) > _MOST_WARNINGS:
        lines.append(f"- {len(record.warnings) - _MOST_WARNINGS} more warnings")
    return "\n\n".join(lines)


def _bounces(bounces: Sequence[Rebound]) -> list[str]:
    rows = []
    for number, bounce in enumerate(bounces[:_MOST_BOUNCES], start=1):
        ends = "-" if bounce.interval95 is None else "{:.3f} to {:.3f}".format(*bounce.interval95)
        speed_m_s = bounce.impact_speed_m_s
        speed = "-" if speed_m_s is None else f"{speed_m_s:.2f} m/s"
        rows.append((str(number), f"{bounce.restitution:.3f}", ends, speed))
    shown = table(("bounce", "restitution", "95 %", "impact at"), rows)
    more = len(bounces) - _MOST_BOUNCES
    return [shown, f"{more} more in the JSON"] if more > 0 else [shown]


def _iterations(record: Record, preset: str) -> list[str]:
    said = f"{record.method}, preset {preset}, {record.rollouts} rollouts"
    if not record.physical:
        said += "; the engine's number under the paper's settings"
    name = next(iter(record.iterations[0]))
    shown = list(enumerate(record.iterations))[-_SHOWN:]
    cells = [(str(k), f"{values[name]:.4f}") for k, values in shown]
    if record.is_fitted:
        cells[-1] = ("refined", cells[-1][1])
    names, values = zip(("k", name), *cells, strict=True)
    return [said, table(names, [values])]


def _check(check: Check) -> str:
    """As a line of a list: what a table holds does not wrap."""
    name = one_line(check.name) if check.passed else f"**failed: {one_line(check.name)}**"
    return f"- {name}: {one_line(check.detail)}"


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table of text cells."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
