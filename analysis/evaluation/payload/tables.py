"""The payload's tables for a terminal, the paper's figures beside ours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.evaluation.payload.logs import MOST_KG, LogRow
from analysis.evaluation.payload.masses import METHODS, SETS, MassOrder, MassRow
from analysis.evaluation.text import seeds_in_words, table_line

_WIDTHS = (30, 4, 32, 32, 0)
_LOG_WIDTHS = (38, 6, 10, 10, 10, 10, 8, 8, 0)
"""Of the columns [characters]."""


def mass_table(rows: Sequence[MassRow], order: MassOrder) -> str:
    """Table 1 of the paper: mean absolute errors and percent, mean and range over the seeds."""
    lines = [
        f"Mass in the gripper, mean absolute error in kg; {seeds_in_words(order.seeds)}, "
        f"{order.targets} targets each.",
        "In brackets: the paper's. [lowest–highest]: of the seeds.",
        "",
        table_line(("method", "K", "validation, 0 to 1 kg", "test, 1 to 2 kg", "test, %"), _WIDTHS),
    ]
    for method in METHODS:
        of = {row.which: row for row in rows if row.method == method}
        errors = [
            _figure(of[which], published)
            for which, published in zip(SETS, method.paper, strict=True)
        ]
        iterations = str(method.iterations) if method.iterations else "-"
        percent = f"{float(np.mean(of['test'].percents)):.2g}"
        if method.percent is not None:
            percent += f" ({method.percent:g})"
        lines.append(table_line((method.label, iterations, *errors, percent), _WIDTHS))
    return "\n".join(lines)


def log_table(rows: Sequence[LogRow]) -> str:
    """Errors in logs like a driver's beside the Cramér-Rao bound, coverage, centres of mass."""
    head = ("logs", "count", "answered", "MAE, kg", "bound's", "secant", "held", "width", "centre")
    lines = [
        f"Payloads of 0 to {MOST_KG:g} kg in logs of 5 s, through the whole of tunenet-tune.",
        "bound's: the best that the model which the answer states allows (Cramér and Rao).",
        "centre: how often it is given, with which errors of x, y, z and of the mass then.",
        "",
        table_line(head, _LOG_WIDTHS),
    ]
    for row in rows:
        figures = [_short(error) for error in (row.mae, row.bound, row.secant)]
        cells = [row.case.label, str(row.logs), f"{100 * row.answered:.3g} %", *figures]
        held = "-" if row.held is None else f"{100 * row.held:.3g} %"
        lines.append(table_line([*cells, held, _short(row.width), _centre(row)], _LOG_WIDTHS))
    return "\n".join(lines)


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"


def _centre(row: LogRow) -> str:
    if row.centre_mm is None or row.told_mae is None or not row.told:
        return "-"
    axes = " / ".join(f"{error_mm:.1f}" for error_mm in row.centre_mm)
    return f"{100 * row.told:.3g} %, {axes} mm, {row.told_mae:.4f} kg"


def _figure(row: MassRow, published: float | None) -> str:
    seeds = row.errors.mean(axis=1)
    paper = "" if published is None else f" ({published:g})"
    spread = f" [{seeds.min():.2g}–{seeds.max():.2g}]" if len(seeds) > 1 else ""
    return f"{seeds.mean():.2g}{paper}{spread}"
