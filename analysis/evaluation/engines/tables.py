"""Tabulate the pairs of engines for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.evaluation.engines.run import METHODS, ROLLOUTS, EngineLine, EngineOrder
from analysis.evaluation.engines.targets import RANGES, Promise
from analysis.evaluation.text import seeds_in_words, short, short_or_dash, table_line

_WIDTHS = (10, 10, 7, 12, 8, 8, 10, 8, 8, 10, 10, 0)


def engine_tables(lines: Sequence[EngineLine], order: EngineOrder) -> str:
    """Tabulate all pairs for each range, each with the network alone and with the default."""
    head = [
        f"Made in one engine, tuned in another; {seeds_in_words(order.seeds)}, {order.targets} "
        f"targets each, {ROLLOUTS} rollouts.",
        "mean, worst: error of the effective restitution (the root of the first rebound's height",
        "over the drop's), by the source's motion and the tuned simulator's, of all answered.",
        "motion: rms difference of the two over the bounces in view, mean [% of the drop height].",
        "worst ok: of those whose verdict is ok, not suspect; a promise is for them.",
    ]
    return "\n".join(head) + "".join(f"\n\n{_table(one, lines)}" for one in RANGES)


def _table(promise: Promise, lines: Sequence[EngineLine]) -> str:
    own = [line for line in lines if line.promise == promise]
    network, default = ([line for line in own if line.method == name] for name in METHODS)
    methods = table_line(("", "", "", "", METHODS[0], "", "", METHODS[1]), _WIDTHS)
    columns = ("mean", "worst", "motion")
    rows = [
        methods,
        table_line(
            ("source", "tuned in", "ok", "answered", *columns, *columns, "worst ok"), _WIDTHS
        ),
        *(_row(*pair) for pair in zip(network, default, strict=True)),
    ]
    return "\n".join([f"{promise.name}{_promised(promise, default)}", *rows])


def _promised(promise: Promise, lines: Sequence[EngineLine]) -> str:
    if promise.worst is None:
        return " (slope and drag; nothing is promised)"
    verdicts = [line.is_kept for line in lines if line.is_kept is not None]
    kept = f"kept by {sum(verdicts)} of {len(verdicts)} pairs"
    return f" (promised of {METHODS[-1]}: worst within {short(promise.worst)}; {kept})"


def _row(network: EngineLine, default: EngineLine) -> str:
    if default.missing is not None:
        why = f"not run: {default.missing} is not installed"
        return table_line((default.source, default.engine, why), _WIDTHS)
    ok, answered = len(default.ok_errors), f"{len(default.outcomes)} of {default.targets}"
    cells = [default.source, default.engine, str(ok), answered]
    cells += [
        *_figures(network),
        *_figures(default),
        short_or_dash(max(default.ok_errors, default=None)),
    ]
    missed = "missed" if default.is_kept is False else ""
    return table_line((*cells, missed), _WIDTHS)


def _figures(line: EngineLine) -> tuple[str, str, str]:
    if not line.outcomes:
        return "-", "-", "-"
    motion = float(np.mean([one.apart_percent for one in line.outcomes]))
    errors = [one.error for one in line.outcomes]
    return short(float(np.mean(errors))), short(max(errors)), f"{short(motion)} %"
