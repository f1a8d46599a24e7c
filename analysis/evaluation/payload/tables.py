"""Tabulate the payload's results for a terminal, the paper's figures beside ours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.evaluation.payload.logs import MAX_KG, LogRow
from analysis.evaluation.payload.masses import METHODS, SETS, MassOrder, MassRow
from analysis.evaluation.payload.stranger_conventions import OUTCOMES, ConventionRow
from analysis.evaluation.payload.strangers import Rival, StrangerRow
from analysis.evaluation.text import seeds_in_words, table_line

_WIDTHS = (30, 4, 32, 32, 0)
_LOG_WIDTHS = (38, 6, 10, 10, 10, 10, 8, 8, 0)
_STRANGER_WIDTHS = (26, 6, 6, 14, 8, 7, 9, 15, 17, 8, 8, 8, 8, 0)
_CONVENTION_WIDTHS = (20, 16, 16, 18, 18, 0)  # of the columns [characters]


def mass_table(rows: Sequence[MassRow], order: MassOrder) -> str:
    """Tabulate the paper's table 1: mean absolute errors and percent, over the seeds."""
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
    """Tabulate errors beside the Cramér-Rao bound, coverage, centres of mass."""
    head = ("logs", "count", "answered", "MAE, kg", "bound's", "secant", "held", "width", "centre")
    lines = [
        f"Payloads of 0 to {MAX_KG:g} kg in logs of 5 s, through the whole of tunenet-tune.",
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


def stranger_table(rows: Sequence[StrangerRow]) -> str:
    """Tabulate errors on arms that share no code with the fit, beside the baselines."""
    head = ("arms", "tare", "logs", "MAE, g", "median", "worst", "bound's", "least squares")
    head += ("tare subtracted", "held", "width", "ok", "ok, far", "ok, wrong sign or gravity")
    lines = [
        "Payloads of 0 to 2.5 kg on strangers' arms, through the whole of tunenet-tune, in g.",
        "MAE: with its standard error. bound's: of noise alone (Cramér and Rao). ahead, level,",
        "behind: ours, by a standard error of the paired difference. held: 95 % intervals, shown",
        "or not. ok, far: off by over three half widths of it; at most 1 log in 400 may be.",
        "",
        table_line(head, _STRANGER_WIDTHS),
    ]
    for row in rows:
        size = {0.5: ", half as large", 2.0: ", twice as large"}.get(row.case.size, "")
        mae = "-" if row.mae_g is None else f"{row.mae_g:.1f} ± {row.mae_sd_g:.1f}"
        figures = [_tenths(one) for one in (row.median_g, row.worst_g, row.bound_g)]
        rivals = [_rival(one) for one in (row.least_squares, row.tare_subtracted)]
        cells = [row.case.label + size, "yes" if row.has_tare else "no", str(row.logs), mae]
        cells += [*figures, *rivals, _percent(row.held), _tenths(row.width_g)]
        cells += [_percent(row.ok), _percent(row.far_ok), str(row.wrong_ok)]
        lines.append(table_line(cells, _STRANGER_WIDTHS))
    return "\n".join(lines)


def convention_table(rows: Sequence[ConventionRow]) -> str:
    """Tabulate the recognised conventions: a column for each kind of driver."""
    head = ["sign and gravity"]
    for row in rows:
        means = row.convention
        sign = "" if means is None else f"{'joint' if means.sign > 0 else 'load'}'s"
        weight = "" if means is None else f", {'with' if means.has_gravity else 'without'}"
        head.append(sign + weight or "all drivers")
    lines = [
        "What drivers mean by torque, the joint's or the load's, with the arm's weight or",
        "without, as told from strangers' logs without a tare, light and full ones in turn.",
        "",
        table_line(head, _CONVENTION_WIDTHS),
        table_line(["logs", *(str(row.logs) for row in rows)], _CONVENTION_WIDTHS),
    ]
    for what in OUTCOMES:
        counts = [str(row.outcomes[what]) for row in rows]
        lines.append(table_line([what, *counts], _CONVENTION_WIDTHS))
    return "\n".join(lines)


def _tenths(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.3g} %"


def _rival(rival: Rival | None) -> str:
    return "-" if rival is None else f"{rival.mae_g:.1f} {rival.standing}"


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
