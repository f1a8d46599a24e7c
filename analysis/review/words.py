"""A tuning in words for its review: Markdown, what matters first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from analysis.record import Estimate, Rebound, Record
from analysis.terminal_table import (
    cross_words,
    equivalent_words,
    extra_words,
    interval_mark,
    interval_words,
    markdown_table,
    quantity,
)
from tunenet_logs.terminal import one_line

_SHOWN = 7
"""Iterations in the table: the last ones."""

_MOST_BOUNCES = 6
_MOST_WARNINGS = 50
"""Rows and lines that a reader still looks through; the JSON has all."""


def result_words(record: Record, preset: str, occasion: str | None) -> str:
    """Verdict, what failed and what to do about it, parameters, bounces, iterations, checks.

    Args:
        record: of the tuning.
        preset: that it was tuned with.
        occasion: what a user does again, e.g. "drop"; None where that is not known.
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
    lines += [f"- {one_line(warning)}" for warning in record.warnings[:_MOST_WARNINGS]]
    if len(record.warnings) > _MOST_WARNINGS:
        lines.append(f"- {len(record.warnings) - _MOST_WARNINGS} more warnings")
    return "\n\n".join(lines)


def _failures(record: Record, occasion: str | None) -> list[str]:
    """Each failed check with figure, limit and remedy; the reason where none failed."""
    failed = [check for check in record.checks if not check.passed]
    if not failed:
        return [one_line(record.reason)] if record.reason else []
    again = f"at the next {occasion}: " if occasion else ""
    lines: list[str] = []
    for check in sorted(failed, key=lambda check: not check.fatal):
        remedy = f"\n    - {again}{one_line(check.advice)}" if check.advice else ""
        lines.append(f"- **failed: {one_line(check.name)}**: {one_line(check.detail)}{remedy}")
    return ["\n".join(lines)]


_MEANINGS = {
    "restitution": "e, the share of its speed that the ball keeps at the first impact",
    "restitution_slope": "p: at speed v it keeps e (v / v first)^-p",
    "drag": "k: the air slows it by k v²",
    "payload_mass": "held by the gripper",
}
"""What a parameter is, shortly: a table's cells do not wrap."""


def _parameters(record: Record) -> list[str]:
    """A table of them, or what there is of several numbers each."""
    single = [known for known in record.estimates if not isinstance(known.value, tuple)]
    several = [known for known in record.estimates if isinstance(known.value, tuple)]
    rows: list[tuple[str, ...]] = []
    for known in single:
        ends = "-"
        if known.interval95 is not None:
            low, high = known.interval95
            ends = interval_words(low, high)  # pyright: ignore[reportArgumentType]
        rows.append((_title(known), f"{known.value:.4f}", ends))
    lines = [markdown_table(("parameter", "value", f"95 %{interval_mark(record)}"), rows)]
    meanings = [
        f"- {known.name.replace('_', ' ')}: {_MEANINGS[known.name]}"
        + (_at(record) if known is single[0] else "")
        for known in single
        if known.name in _MEANINGS and record.physical
    ]
    lines += ["\n".join(meanings)] if meanings else []
    return [
        *(lines if rows else []),
        *(extra_words(replace(known, name=known.name.replace("_", " "))) for known in several),
    ]


def _title(known: Estimate) -> str:
    """A parameter as a heading: "payload mass [kg]"."""
    return quantity(known.name.replace("_", " "), known.unit)


def _at(record: Record) -> str:
    """The speed that the first parameter holds for, where it is known."""
    first = record.rebounds[0].impact_speed_m_s if record.rebounds else None
    return "" if first is None else f", {first:.2f} m/s"


def _motion(record: Record) -> list[str]:
    """How the tuned simulator moves beside what was observed, and what the log leaves open."""
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
    return [*lines, *filter(None, [equivalent_words(record)])]


def _bounces(bounces: Sequence[Rebound]) -> list[str]:
    if len(bounces) < 2:
        return []
    rows = []
    for number, bounce in enumerate(bounces[:_MOST_BOUNCES], start=1):
        ends = "-" if bounce.interval95 is None else interval_words(*bounce.interval95)
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
    shown = list(enumerate(record.iterations))[-_SHOWN:]
    heads = [str(k) for k, _ in shown]
    if record.is_fitted:
        heads[-1] = "refined"
    units = {known.name: known.unit for known in record.estimates}
    rows = [
        (
            quantity(name.replace("_", " "), units.get(name, "1")),
            *(f"{values[name]:.4f}" for _, values in shown),
        )
        for name in record.iterations[0]
    ]
    return [said, markdown_table(("k", *heads), rows)]
