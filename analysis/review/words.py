"""The result in words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from analysis.drop.bounces import ReportedBounce, bounces_of
from analysis.drop.checks import Check
from analysis.record import further_words, interval_words
from analysis.tuning import Tuning
from recorders.simulators.base import Parameter
from tunenet_logs.wording import one_line

_SHOWN = 7
"""Iterations in the table: the last ones."""

_MOST_BOUNCES = 6
_MOST_WARNINGS = 50


def result_words(tuning: Tuning) -> str:
    """Value, verdict, what to do next time, bounces, iterations and checks as Markdown."""
    lines: list[str] = []
    if tuning.estimate is not None:
        named = zip(tuning.parameters, tuning.estimate, strict=True)
        lines += [f"# {one.name} {value:.4f}{_unit_of(one)}" for one, value in named]
    if tuning.interval95 is not None:
        lines += [f"95 %: {interval_words(*ends)}" for ends in tuning.interval95]
    lines += [further_words(one) for one in tuning.further]
    lines.append(
        f"**{tuning.verdict}**" + (f": {one_line(tuning.reason)}" if tuning.reason else "")
    )
    lines += _cross_check(tuning)
    lines += _next_time(tuning)
    if tuning.refined is not None and tuning.refined.rebounds:
        lines += _bounces(bounces_of(tuning))
    lines += _iterations(tuning)
    if tuning.checks:
        lines.append("\n".join(["checks:", "", *map(_check, tuning.checks)]))
    lines += [f"- {one_line(warning)}" for warning in tuning.warnings[:_MOST_WARNINGS]]
    if len(tuning.warnings) > _MOST_WARNINGS:
        lines.append(f"- {len(tuning.warnings) - _MOST_WARNINGS} more warnings")
    return "\n\n".join(lines)


def _cross_check(tuning: Tuning) -> list[str]:
    cross = tuning.cross_check
    if cross is None or tuning.estimate is None:
        return []
    verdict = "agrees" if cross.agrees else "**disagrees**"
    return [f"cross-check {verdict}: {cross.value:.4f} by {cross.method}"]


def _next_time(tuning: Tuning) -> list[str]:
    """What would let each failed check pass; the reason has the first one's only."""
    orders = [one.advice for one in tuning.checks if not one.passed and one.advice]
    if len(orders) < 2:
        return []
    named = "\n".join(f"- {order}" for order in dict.fromkeys(orders))
    return [f"at the next {tuning.occasion}:\n\n{named}"]


def _bounces(bounces: Sequence[ReportedBounce]) -> list[str]:
    if not bounces:
        return []
    rows = []
    for number, one in enumerate(bounces[:_MOST_BOUNCES], start=1):
        ends = "-" if one.interval95 is None else "{:.3f} to {:.3f}".format(*one.interval95)
        speed = "-" if one.impact_speed_m_s is None else f"{one.impact_speed_m_s:.2f} m/s"
        rows.append((str(number), f"{one.restitution:.3f}", ends, speed))
    told = table(("bounce", "restitution", "95 %", "impact at"), rows)
    left = len(bounces) - _MOST_BOUNCES
    return [told, f"{left} more in the JSON"] if left > 0 else [told]


def _iterations(tuning: Tuning) -> list[str]:
    if tuning.trace is None:
        return []
    said = f"{tuning.method}, preset {tuning.preset}, {tuning.rollouts} rollouts"
    if not tuning.physical:
        said += "; the engine's number under the paper's settings"
    shown = list(enumerate(tuning.trace.steps))[-_SHOWN:]
    cells = [(str(k), f"{step.values[0]:.4f}") for k, step in shown]
    if tuning.refined is not None:
        cells[-1] = ("refined", cells[-1][1])
    names, values = zip(("k", tuning.parameters[0].name), *cells, strict=True)
    return [said, table(names, [values])]


def _check(check: Check) -> str:
    """As a line of a list: what a table holds does not wrap."""
    name = one_line(check.name) if check.passed else f"**failed: {one_line(check.name)}**"
    return f"- {name}: {one_line(check.detail)}"


def _unit_of(parameter: Parameter) -> str:
    """What to write behind a value."""
    return "" if parameter.unit == "1" else f" {parameter.unit}"


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table of text cells."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
