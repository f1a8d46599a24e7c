"""Describe a tuning for its review in Markdown, the most important first."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from analysis.record import Rebound, Record
from analysis.review.said_names import said_names
from analysis.terminal_table import (
    cross_words,
    equivalent_words,
    extra_words,
    interval_mark,
    interval_words,
    markdown_table,
    quantity,
    sound_words,
)
from tunenet_logs.terminal import one_line, short_name

_SHOWN, _FEW_SHOWN = 5, 3  # iterations in the table: the last ones; fewer where names are long
# Characters of a parameter: a table on a laptop's screen has room for so many beside five values,
# for so many beside three.
_LONG, _MAX_OF_A_NAME = 24, 32

_MAX_BOUNCES = 6
_MAX_WARNINGS = 50  # rows and lines that a reader still looks through; the JSON has all


def result_words(record: Record, preset: str, occasion: str | None) -> str:
    """Format verdict, failures with remedies, parameters, bounces, iterations, checks.

    Args:
        record: Of the tuning.
        preset: That it was tuned with.
        occasion: What a user repeats, e.g. "drop"; None if unknown.
    """
    lines = [f"# {record.verdict}", *_failures(record, occasion), *_parameters(record)]
    cross = record.cross_check
    if cross is not None and record.estimates:
        agrees = "agrees" if cross.agrees else "**disagrees**"
        lines.append(f"cross-check {agrees}: {cross_words(cross)}")
    lines += [*_motion(record), *_bounces(record.rebounds), *_iterations(record, preset)]
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


def _parameters(record: Record) -> list[str]:
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
    return any(len(name) > _LONG for name in names)


def _listed(head: tuple[str, str, str], rows: Sequence[tuple[str, str, str]]) -> str:
    """List parameters whose names are too long for a table: a list's lines wrap."""
    *_, interval = head
    return "\n".join(f"- {name}: **{value}**, {interval}: {ends}" for name, value, ends in rows)


def _at(record: Record) -> str:
    """Return the speed that the first parameter holds for, if known."""
    first = record.rebounds[0].impact_speed_m_s if record.rebounds else None
    return "" if first is None else f", {first:.2f} m/s"


def _motion(record: Record) -> list[str]:
    """Describe the residual of the tuned simulator, and what the log leaves undetermined."""
    if not record.estimates:
        return []
    lines = list(record.motion.untold)
    fit = record.motion.fit
    if fit is not None:
        left = f", {fit.left_out} left out" if fit.left_out else ""
        lines.append(
            f"simulation against {fit.samples} samples{left}: {fit.rms_percent:.2f} % of the drop "
            f"height apart, rms, of which noise {fit.noise_percent:.2f}; "
            f"at worst {fit.worst_percent:.2f}"
        )
    return [*lines, *filter(None, [equivalent_words(record), sound_words(record)])]


def _bounces(bounces: Sequence[Rebound]) -> list[str]:
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


def _iterations(record: Record, preset: str) -> list[str]:
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
        titles = {name: short_name(spoken[name], _MAX_OF_A_NAME) for name in spoken}
    shown = list(enumerate(record.iterations))[-(_FEW_SHOWN if is_long else _SHOWN) :]
    heads = [str(k) for k, _ in shown]
    if record.is_fitted:
        heads[-1] = "refined"
    rows = [
        (titles[name], *(f"{values[name]:.4f}" for _, values in shown))
        for name in record.iterations[0]
    ]
    return [said, markdown_table(("k", *heads), rows)]
