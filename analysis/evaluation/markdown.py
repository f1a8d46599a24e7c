"""The results of the second experiment as Markdown, for reviews and documents."""

from __future__ import annotations

from collections.abc import Sequence

from analysis.evaluation.results import TOLD_NOTE, DropResults, Outcome
from analysis.evaluation.tables import short, title


def drop_markdown(results: DropResults) -> str:
    """A table for each cell: mean absolute error after K rollouts, the paper's in brackets."""
    seeds = ", ".join(str(seed) for seed in results.seeds)
    head = (
        "# Restitution from the ball's height\n\n"
        f"Mean absolute error after K rollouts, mean over seeds {seeds}, {results.targets} targets "
        "each; in brackets the paper's."
    )
    if any(one.is_told for one in results.outcomes):
        head += f"\n\n\\{TOLD_NOTE}"
    tables = [f"## {title(cell)}\n\n{_table(results, results.of(cell))}" for cell in results.cells]
    return "\n\n".join([head, *tables])


def _table(results: DropResults, outcomes: Sequence[Outcome]) -> str:
    shown = [
        n for n in results.columns if any(one.knows(n) and one.budget >= n for one in outcomes)
    ]
    shown = shown or list(results.columns[:1])
    lines = ["| method | " + " | ".join(f"K = {n}" for n in shown) + " |"]
    lines.append("| --- |" + " ---: |" * len(shown))
    for one in outcomes:
        cells = [_figure(one, n) for n in shown]
        lines.append(f"| {one.shown} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _figure(one: Outcome, rollouts: int) -> str:
    if not one.knows(rollouts):
        return "-"
    figures = one.figures(rollouts)
    paper = f" ({figures.paper:.4f})" if figures.paper is not None else ""
    return short(figures.mae) + paper
