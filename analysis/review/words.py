"""The result in words."""

from __future__ import annotations

from analysis.report import interval_words
from analysis.tuning import Tuning
from tunenet_logs.wording import one_line

_SHOWN = 7
"""Iterations in the table: the last ones."""

_MOST_WARNINGS = 50


def result_words(tuning: Tuning) -> str:
    """Verdict, iterations and checks as Markdown."""
    lines: list[str] = []
    if tuning.estimate is not None:
        named = zip(tuning.parameters, tuning.estimate, strict=True)
        lines += [f"# {one.name} {value:.4f}" for one, value in named]
    if tuning.interval95 is not None:
        lines += [f"95 %: {interval_words(*ends)}" for ends in tuning.interval95]
    lines.append(
        f"**{tuning.verdict}**" + (f": {one_line(tuning.reason)}" if tuning.reason else "")
    )
    if tuning.trace is not None:
        lines.append(
            f"{tuning.method}, preset {tuning.preset}, {tuning.rollouts} rollouts"
            + ("" if tuning.physical else "; the engine's number at 60 Hz, not the ball's own")
        )
        shown = list(enumerate(tuning.trace.steps))[-_SHOWN:]
        cells = [(str(k), f"{step.values[0]:.4f}") for k, step in shown]
        if tuning.refined is not None:
            cells[-1] = ("refined", cells[-1][1])
        rows = [
            "| " + " | ".join(row) + " |" for row in zip(("k", "restitution"), *cells, strict=True)
        ]
        lines.append("\n".join([rows[0], "|" + " --- |" * (len(cells) + 1), rows[1]]))
    checks = [
        f"| {one.name} | {'passed' if one.passed else '**failed**'} | {one.detail} |"
        for one in tuning.checks
    ]
    if tuning.cross_check is not None:
        verdict = "agrees" if tuning.cross_check.agrees else "**disagrees**"
        checks.append(
            f"| cross-check | {verdict} | {tuning.cross_check.method}: "
            f"{tuning.cross_check.value:.4f} |"
        )
    if checks:
        lines.append("\n".join(["| check | | seen |", "| --- | --- | --- |", *checks]))
    lines += [f"- {one_line(warning)}" for warning in tuning.warnings[:_MOST_WARNINGS]]
    if len(tuning.warnings) > _MOST_WARNINGS:
        lines.append(f"- {len(tuning.warnings) - _MOST_WARNINGS} more warnings")
    return "\n\n".join(lines)
