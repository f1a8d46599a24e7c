"""Tabulate the second experiment's results for a terminal, and in Markdown for reviews."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from analysis.evaluation.drop.intervals import NOISE_M, RESTITUTION, Coverage
from analysis.evaluation.drop.published import ROLLOUTS as PUBLISHED_ROLLOUTS
from analysis.evaluation.drop.results import GIVEN_NOTE, Cell, Credible, DropResults, MethodErrors
from analysis.evaluation.text import (
    NEGLIGIBLE,
    seeds_in_words,
    short,
    short_or_dash,
    table_line,
)

_SPREAD = "median [best–worst seed]"
_SPREADS_A_LINE = 3  # budgets whose spreads stand side by side: more would be wider than a terminal
_AHEAD_AT = (5, 10)  # rollouts at which methods are ranked: two of the paper's K
_OURS = "ours"  # the one method that stands for ours; named here, not picked by its errors
_COVERAGE_WIDTHS = (36, 8, 10, 15, 9, 15, 6)
_CREDIBLE_WIDTHS = (71, 8, 15, 6)  # of the columns [characters]


def drop_tables(results: DropResults) -> str:
    """Tabulate every cell, the ranking, and the ablation."""
    blocks = [_protocol(results)]
    compared = [cell for cell in results.cells if cell.experiment == "drop"]
    blocks += [_cell_table(cell, results) for cell in compared]
    if compared:
        blocks.append(_ahead(results, compared))
    ablation = [cell for cell in results.cells if cell.experiment == "ablation"]
    blocks += [_cell_table(cell, results) for cell in ablation]
    if results.credible:
        blocks.append(credible_table(results.credible))
    if results.coverage:
        blocks.append(coverage_table(results.coverage))
    return "\n\n".join(filter(None, blocks))


def title(cell: Cell) -> str:
    """Describe a cell."""
    what = "Ablation, " if cell.experiment == "ablation" else ""
    simulator = "the paper's simulator" if cell.simulator == "paper" else "calibrated simulator"
    noise = f", {100 * cell.noise_m:g} cm of noise on the target" if cell.noise_m else ""
    return f"{what}{cell.which}, {simulator}{noise}"


def _protocol(results: DropResults) -> str:
    given = any(outcome.is_given_truths for outcome in results.outcomes)
    return (
        f"Mean absolute error of the restitution after K rollouts; {seeds_in_words(results.seeds)}"
        f", {results.targets} targets each.\n"
        "In brackets: the paper's. [best–worst seed]: lowest and highest of the seeds' means.\n"
        "A dash: not run that far." + f"\n{GIVEN_NOTE}" * given
    )


def _cell_table(cell: Cell, results: DropResults) -> str:
    """Tabulate means beside the paper's, and below the medians and the spread over seeds."""
    outcomes = results.of(cell)
    compared = any(one.figures(1).paper for one in outcomes if one.knows(1))
    shown = _shown_columns(results, outcomes)
    label = 1 + max(len(_SPREAD), *(len(one.shown) for one in outcomes))
    widths = [label, *(16 if compared and n in PUBLISHED_ROLLOUTS else 8 for n in shown)]
    rows = [["mean error", *(f"K={n}" for n in shown)]]
    rows += [[one.shown, *(_mean(one, n) for n in shown)] for one in outcomes]
    lines = [table_line(row, widths) for row in rows]
    for first in range(0, len(shown), _SPREADS_A_LINE):
        spread_at = shown[first : first + _SPREADS_A_LINE]
        spreads = [[_SPREAD, *(f"K={n}" for n in spread_at)]]
        spreads += [[one.shown, *(_spread(one, n) for n in spread_at)] for one in outcomes]
        lines += [table_line(row, [label, *(24 for _ in spread_at)]) for row in spreads]
    return "\n".join([title(cell), *lines])


def _shown_columns(results: DropResults, outcomes: Sequence[MethodErrors]) -> list[int]:
    """Return the budgets that some method was allowed and can use; else the first."""
    columns = results.columns
    shown = [n for n in columns if any(one.knows(n) and one.budget >= n for one in outcomes)]
    return shown or list(columns[:1])


def _mean(one: MethodErrors, rollouts: int) -> str:
    if not one.knows(rollouts):
        return "-"
    figures = one.figures(rollouts)
    paper = f" ({figures.paper:.4f})".replace("0.", ".") if figures.paper is not None else ""
    return short(figures.mae) + paper


def _spread(one: MethodErrors, rollouts: int) -> str:
    if not one.knows(rollouts):
        return "-"
    figures = one.figures(rollouts)
    return f"{short(figures.median)} [{short(figures.lowest)}–{short(figures.highest)}]"


def coverage_table(rows: Sequence[Coverage]) -> str:
    """Tabulate the coverage of recorded drops' intervals, and the errors of their values."""
    low, high = RESTITUTION
    most_cm = 100 * NOISE_M[1]
    lines = [
        f"95 % intervals, restitution {low:g} to {high:g}, noise of 0 to {most_cm:g} cm",
        table_line(
            ["recordings", "drops", "answered", "held", "ok", "held", "width"], _COVERAGE_WIDTHS
        ),
    ]
    for row in rows:
        held = _percent(row.covered, row.covered_se)
        ok, ok_held = f"{100 * row.ok:.1f} %", _percent(row.ok_covered, row.ok_covered_se)
        width, mae, network_mae = (
            short_or_dash(value) for value in (row.width, row.mae, row.network_mae)
        )
        cells = [row.label, str(row.targets), str(row.fitted), held, ok, ok_held, width]
        lines.append(table_line(cells, _COVERAGE_WIDTHS))
        lines.append(f"  mean error {mae}; the network's alone {network_mae}")
    return "\n".join(lines)


def credible_table(rows: Sequence[Credible]) -> str:
    """Tabulate the coverage of a posterior's intervals on the targets of the tables above."""
    head = ["95 % credible intervals of the neural posterior", "targets", "held", "width"]
    lines = [head]
    for row in rows:
        held = _percent(row.held, row.held_se)
        lines.append([title(row.cell), str(row.targets), held, short(row.width)])
    return "\n".join(table_line(line, _CREDIBLE_WIDTHS) for line in lines)


def _percent(fraction: float | None, error: float | None) -> str:
    """Format a fraction with its standard error."""
    if fraction is None or error is None:
        return "-"
    return f"{100 * fraction:.1f} ± {100 * error:.1f} %"


def _ahead(results: DropResults, cells: Iterable[Cell]) -> str:
    """Rank the methods in each cell, compare ours at 5 rollouts, and name each worst seed."""
    budgets = [n for n in _AHEAD_AT if n in results.columns]
    lines = []
    for cell in cells:
        ranked = [one for one in results.of(cell) if _is_ranked(one)]
        if not ranked or not budgets:
            continue
        lines.append(f"  {title(cell)}")
        for n in budgets:
            best = _best(ranked, n)
            if best is not None:
                mean = short(best.figures(n).mae)
                lines.append(f"    at {n:>2}: {best.label}, {mean}{_worst(best, n, results)}")
        lines += _ours_against_others(ranked, budgets)
    return "\n".join(["Who is ahead", *lines]) if lines else ""


def _is_ranked(one: MethodErrors) -> bool:
    """Check whether it is ranked: of ours the one named in advance, of others the blind ones."""
    return not one.is_given_truths and (one.group != "ours" or one.method == _OURS)


def _worst(one: MethodErrors, rollouts: int, results: DropResults) -> str:
    """Name the worst of several seeds and its mean error."""
    if len(results.seeds) == 1:
        return ""
    means = one.errors_after(rollouts).mean(axis=1)
    worst = int(means.argmax())
    return f" (worst: seed {results.seeds[worst]}, {short(float(means[worst]))})"


def _ours_against_others(ranked: Sequence[MethodErrors], budgets: Sequence[int]) -> list[str]:
    at = budgets[0]
    ours = _best([one for one in ranked if one.method == _OURS], at)
    if ours is None:
        return []
    mine = ours.figures(at).mae
    lines = []
    for n in budgets:
        best = _best([one for one in ranked if one.method != _OURS], n)
        if best is not None:
            theirs = best.figures(n).mae
            lines.append(
                f"    {ours.label} at {at} ({short(mine)}): {factor(mine, theirs)} "
                f"{best.label} at {n} ({short(theirs)})"
            )
    return lines


def factor(mine: float, theirs: float) -> str:
    """Compare an error with another in words; two that print as nothing are level."""
    if mine == theirs or max(mine, theirs) < NEGLIGIBLE:
        return "level with"
    ahead = mine < theirs
    less, more = sorted((mine, theirs))
    times = f"{more / less:.2g} times" if less else "without error,"
    return f"{times} {'ahead of' if ahead else 'behind'}"


def _best(outcomes: Iterable[MethodErrors], rollouts: int) -> MethodErrors | None:
    known = [one for one in outcomes if one.knows(rollouts)]
    return min(known, key=lambda one: one.figures(rollouts).mae, default=None)


def drop_markdown(results: DropResults) -> str:
    """Format Markdown, a table a cell: mean absolute error after K rollouts (the paper's)."""
    seeds = ", ".join(str(seed) for seed in results.seeds)
    head = (
        "# Restitution from the ball's height\n\n"
        f"Mean absolute error after K rollouts, mean over seeds {seeds}, {results.targets} targets "
        "each; in brackets the paper's."
    )
    if any(outcome.is_given_truths for outcome in results.outcomes):
        head += f"\n\n\\{GIVEN_NOTE}"
    tables = [
        f"## {title(cell)}\n\n{_markdown_table(results, results.of(cell))}"
        for cell in results.cells
    ]
    return "\n\n".join([head, *tables])


def _markdown_table(results: DropResults, outcomes: Sequence[MethodErrors]) -> str:
    shown = _shown_columns(results, outcomes)
    lines = ["| method | " + " | ".join(f"K = {n}" for n in shown) + " |"]
    lines.append("| --- |" + " ---: |" * len(shown))
    for one in outcomes:
        cells = [_mean(one, n).replace("(.", "(0.") for n in shown]
        lines.append(f"| {one.shown} | " + " | ".join(cells) + " |")
    return "\n".join(lines)
