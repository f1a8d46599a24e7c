"""Run the paper's second experiment, restitution from a ball's height: its table 2 and its figure.

Every method of `drop_methods` runs on the same targets, rollout by rollout.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from tunenet_logs.analysis.evaluation.studies import intervals
from tunenet_logs.analysis.evaluation.studies.curves import write_figure
from tunenet_logs.analysis.evaluation.studies.drop_methods import (
    GIVEN_NOTE,
    NPE,
    TARGET_SETS,
    Cell,
    DropResults,
    DropTarget,
    Group,
    Method,
    MethodErrors,
    Posteriors,
    Table,
    TargetBatch,
    TargetSet,
    choose_methods,
    credible_coverage,
    draw_targets,
    errors_of,
    train_networks,
    train_posteriors,
)
from tunenet_logs.analysis.evaluation.study import (
    NEGLIGIBLE,
    Order,
    Part,
    Row,
    scored,
    short,
    table,
)
from tunenet_logs.analysis.parallel import Piece
from tunenet_logs.analysis.registry import needed
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.base import CALIBRATED, PAPER, ContactSettings
from tunenet_logs.terminal import Progress

# ---- Run: every method on the same targets, rollout by rollout.


NOISE_M = 0.01  # standard deviation of a height in the noisy cells [m]: what a good tracker leaves
# Rollouts a target, by whose a method is; as in the paper's table 2.
_MAX_PAPER: Mapping[Group, int] = {"paper": 100, "user": 100, "ours": 100}

# A rollout takes 3 ms there, and three of a user's methods go on for as long as they may.
_MAX_CALIBRATED: Mapping[Group, int] = {"user": 40, "ours": 100}

_MAX_NOISY: Mapping[Group, int] = {"paper": 10, "user": 10, "ours": 40}
# Fewer where the paper has no figure beside which they would stand.
_MAX_ABLATION: Mapping[Group, int] = {"paper": 10}

_BATCH = 5  # targets in a batch: few, so that the processes end together


@dataclass(frozen=True)
class _EmptyCell:
    """Cell before it is filled."""

    cell: Cell
    table: Table
    which: TargetSet
    contact: ContactSettings
    most: Mapping[Group, int]  # rollouts that a method is allowed there, by whose it is

    def batches(
        self, method: Method, targets: Sequence[DropTarget], rollouts: int | None
    ) -> list[TargetBatch]:
        """Split a method's work on the targets; `rollouts` as in `Order`."""
        most = min(method.budget, self.most[method.group])
        most = most if rollouts is None else min(most, rollouts)
        return [
            TargetBatch(method, tuple(targets[at : at + _BATCH]), self.contact, most)
            for at in range(0, len(targets), _BATCH)
        ]


def run(order: Order, progress: Progress) -> Iterator[Part]:
    """Run the experiment; with all methods also the intervals of recorded drops.

    Raises:
        UsageError: a method is unknown, or it or a figure needs a library that is not installed.
    """
    if order.drawn and not choose_methods(order.methods).has_curves:
        form = order.drawn[0]
        raise UsageError(f"--{form}: no method chosen has a curve to draw; leave it out")
    if "png" in order.drawn:
        needed("matplotlib")
    results = run_drop(order, progress)

    def write_rrd(path: Path, _: str) -> None:
        from tunenet_logs.analysis.evaluation.studies.review import write_convergence

        write_convergence(results, drop_markdown(results), path)

    def write_png(path: Path, made: str) -> None:
        write_figure(results, path, made)

    more: dict[str, Sequence[Row]] = {}
    more |= {"summary": summary_rows(results), "curves": curve_rows(results)}
    more |= {"credible": results.credible} if results.credible else {}
    text = drop_tables(results)
    if order.methods is None:
        (held,) = intervals.run(order, progress)
        more["intervals"] = held.rows
        text += f"\n\n{held.text}"
    writers = {"png": write_png, "rrd": write_rrd}
    yield Part("", text, drop_rows(results), more, writers)


def run_drop(order: Order, progress: Progress) -> DropResults:
    """Train, draw, estimate: the same figures for any number of processes.

    Raises:
        UsageError: a method is unknown, or needs a library that is not installed.
    """
    chosen = choose_methods(order.methods)
    networks = {
        seed: train_networks(chosen.networks, seed, order, progress) for seed in order.seeds
    }
    posteriors: Posteriors = {}
    if chosen.has_posteriors:
        posteriors = train_posteriors((0.0, NOISE_M), order, progress)
    columns: list[tuple[Cell, Method]] = []
    cases: dict[int, list[Piece[TargetBatch]]] = {}  # by the number of the column
    for empty in _empty_cells():
        cell = empty.cell
        drawn = {
            seed: draw_targets(empty.which, order.targets, seed, cell.noise_m)
            for seed in order.seeds
        }
        methods = [
            chosen.methods(
                *(empty.table, networks[seed]),
                np.array([target.truth for target in drawn[seed]]),
                *(seed, posteriors.get((seed, cell.noise_m))),
            )
            for seed in order.seeds
        ]
        for column in zip(*methods, strict=True):  # one method, made anew for each seed
            cases[len(columns)] = [
                Piece(batch, len(batch.targets), batch.method.name)
                for method, targets in zip(column, drawn.values(), strict=True)
                for batch in empty.batches(method, targets, order.rollouts)
            ]
            columns.append((cell, column[0]))
    done = scored(errors_of, cases, order, progress, ("estimating", "target"))
    outcomes = tuple(
        MethodErrors(
            *(cell, method.name, method.label, method.group, method.budget),
            np.array(errors).reshape(len(order.seeds), order.targets, -1),
        )
        for (cell, method), errors in zip(columns, done.values(), strict=True)
    )
    with_posteriors = [
        (cell, [piece.item for piece in pieces])
        for (cell, method), pieces in zip(columns, cases.values(), strict=True)
        if method.name == NPE
    ]
    credible = credible_coverage(with_posteriors, order, progress)
    return DropResults(order.seeds, order.targets, outcomes, credible, order.rollouts)


def _empty_cells() -> list[_EmptyCell]:
    cells = []
    simulators: tuple[tuple[Table, ContactSettings, Mapping[Group, int]], ...]
    simulators = (("paper", PAPER, _MAX_PAPER), ("calibrated", CALIBRATED, _MAX_CALIBRATED))
    for name, contact, most_clean in simulators:
        for noise_m, most in ((0.0, most_clean), (NOISE_M, _MAX_NOISY)):
            for which in TARGET_SETS:
                cell = Cell("drop", name, which.name, noise_m)
                cells.append(_EmptyCell(cell, name, which, contact, most))
    for which in TARGET_SETS[:2]:
        cell = Cell("ablation", "paper", which.name, 0.0)
        cells.append(_EmptyCell(cell, "ablation", which, PAPER, _MAX_ABLATION))
    return cells


# ---- Rows of files: in long form, one for each method, budget and seed of each cell.


def drop_rows(results: DropResults) -> list[Row]:
    """Return one row for each cell, method, number of rollouts and seed."""
    rows: list[Row] = []
    for one in results.outcomes:
        for n in filter(one.knows, results.columns):
            paper = one.figures(n).paper
            for seed, errors in zip(results.seeds, one.errors_after(n), strict=True):
                figures = {"mae": float(errors.mean()), "median": float(np.median(errors))}
                keys = {**one.cell.keys, "method": one.method, "rollouts": n}
                rows.append({**keys, "seed": seed, **figures, "paper": paper})
    return rows


def summary_rows(results: DropResults) -> list[Row]:
    """Return the figures over all seeds."""
    return [
        {**one.cell.keys, "method": one.method, "rollouts": n, **asdict(one.figures(n))}
        for one in results.outcomes
        for n in filter(one.knows, results.columns)
    ]


def curve_rows(results: DropResults) -> list[Row]:
    """Return the mean error of each seed after 0, 1, ... rollouts."""
    return [
        {
            **one.cell.keys,
            "method": one.method,
            "label": one.label,
            "mae": one.errors.mean(axis=1).tolist(),
        }
        for one in results.outcomes
    ]


# ---- Tables for a terminal, and in Markdown for reviews.


_SPREAD = "median [best–worst seed]"
_SPREADS_A_LINE = 3  # budgets whose spreads stand side by side: more would be wider than a terminal
_AHEAD_AT = (5, 10)  # rollouts at which methods are ranked: two of the paper's K
_OUR_METHOD = "ours"  # the one method that stands for ours; named here, not picked by its errors


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
        f"Mean absolute error of the restitution after K rollouts; "
        f"{Order(results.seeds, 0).seeds_in_words}, {results.targets} targets each.\n"
        "In brackets: the paper's. [best–worst seed]: lowest and highest of the seeds' means.\n"
        "A dash: not run that far." + f"\n{GIVEN_NOTE}" * given
    )


def _cell_table(cell: Cell, results: DropResults) -> str:
    """Tabulate means beside the paper's, and below the medians and the spread over seeds."""
    outcomes = results.of(cell)
    shown = _shown_columns(results, outcomes)
    lines = [["mean error", *(f"K={n}" for n in shown)]]
    lines += [[one.shown, *(_mean(one, n) for n in shown)] for one in outcomes]
    tables = [table(lines, title(cell))]
    for first in range(0, len(shown), _SPREADS_A_LINE):
        spread_at = shown[first : first + _SPREADS_A_LINE]
        lines = [[_SPREAD, *(f"K={n}" for n in spread_at)]]
        lines += [[one.shown, *(_spread(one, n) for n in spread_at)] for one in outcomes]
        tables.append(table(lines))
    return "\n".join(tables)


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


def credible_table(rows: Sequence[Row]) -> str:
    """Tabulate the coverage of a posterior's intervals on the targets of the tables above."""
    lines = [["95 % credible intervals of the neural posterior", "targets", "held", "width"]]
    for row in rows:
        cell = Cell(row["experiment"], row["simulator"], row["set"], row["noise_m"])
        held = intervals.with_error(row["held"], row["held_se"])
        lines.append([title(cell), str(row["targets"]), held, short(row["width"])])
    return table(lines)


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
    return not one.is_given_truths and (one.group != "ours" or one.method == _OUR_METHOD)


def _worst(one: MethodErrors, rollouts: int, results: DropResults) -> str:
    """Name the worst of several seeds and its mean error."""
    if len(results.seeds) == 1:
        return ""
    means = one.errors_after(rollouts).mean(axis=1)
    worst = int(means.argmax())
    return f" (worst: seed {results.seeds[worst]}, {short(float(means[worst]))})"


def _ours_against_others(ranked: Sequence[MethodErrors], budgets: Sequence[int]) -> list[str]:
    at = budgets[0]
    ours = _best([one for one in ranked if one.method == _OUR_METHOD], at)
    if ours is None:
        return []
    mine = ours.figures(at).mae
    lines = []
    for n in budgets:
        best = _best([one for one in ranked if one.method != _OUR_METHOD], n)
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
