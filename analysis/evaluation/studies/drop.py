"""Run the paper's second experiment, restitution from a ball's height: its table 2 and its figure.

Every method of `drop_methods` runs on the same targets, rollout by rollout.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tunenet_logs.analysis.evaluation.studies.drop_methods import (
    FLOOR,
    GIVEN_NOTE,
    MAX_ROLLOUTS,
    NPE,
    PANELS,
    TARGET_SETS,
    Cell,
    DropResults,
    Group,
    Method,
    MethodErrors,
    Posteriors,
    Simulator,
    TargetBatch,
    TargetSet,
    choose_methods,
    credible_coverage,
    draw_targets,
    error_curves,
    errors_of,
    train_networks,
    train_posteriors,
)
from tunenet_logs.analysis.evaluation.studies.positions import intervals, with_error
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
from tunenet_logs.recorders.simulators.base import CALIBRATED, PAPER
from tunenet_logs.terminal import Progress

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# ---- Run: every method on the same targets, rollout by rollout.

NOISE_M = 0.01  # standard deviation of a height in the noisy cells [m]: what a good tracker leaves


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
        # for a page's width, with the mark by which it is known
        figure = draw_figure(results)
        figure.savefig(path, format="png", dpi=120, metadata={"Software": made})

    more: dict[str, Sequence[Row]] = {}
    more |= {"summary": summary_rows(results), "curves": curve_rows(results)}
    more |= {"credible": results.credible} if results.credible else {}
    text = drop_tables(results)
    if order.methods is None:
        (held,) = intervals(order, progress)
        more["intervals"] = held.rows
        text += f"\n\n{held.text}"
    yield Part("", text, drop_rows(results), more, {"png": write_png, "rrd": write_rrd})


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
    for cell, which, allowed in _cells():
        contact = CALIBRATED if cell.simulator == "calibrated" else PAPER
        drawn = [draw_targets(which, order.targets, seed, cell.noise_m) for seed in order.seeds]
        methods = [
            chosen.methods(
                "ablation" if cell.experiment == "ablation" else cell.simulator,
                networks[seed],
                np.array([target.truth for target in targets]),
                *(seed, posteriors.get((seed, cell.noise_m))),
            )
            for seed, targets in zip(order.seeds, drawn, strict=True)
        ]
        for column in zip(*methods, strict=True):  # one method, made anew for each seed
            most = min(column[0].budget, allowed[column[0].group], order.rollouts or MAX_ROLLOUTS)
            batches = [
                TargetBatch(method, tuple(targets[at : at + 5]), contact, most)
                for method, targets in zip(column, drawn, strict=True)
                for at in range(0, len(targets), 5)
            ]
            cases[len(columns)] = [
                Piece(batch, len(batch.targets), batch.method.name) for batch in batches
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


def _cells() -> Iterator[tuple[Cell, TargetSet, Mapping[Group, int]]]:
    """Yield each cell, its targets, and the rollouts that a method may spend, by whose it is."""
    clean: dict[Simulator, Mapping[Group, int]] = {
        "paper": {"paper": 100, "user": 100, "ours": 100},
        # a rollout takes 3 ms there, and three of a user's methods go on for as long as they may
        "calibrated": {"user": 40, "ours": 100},
    }
    for simulator, most in clean.items():
        for which in TARGET_SETS:
            yield Cell("drop", simulator, which.name, 0.0), which, most
        for which in TARGET_SETS:
            allowed: Mapping[Group, int] = {"paper": 10, "user": 10, "ours": 40}
            yield Cell("drop", simulator, which.name, NOISE_M), which, allowed
    for which in TARGET_SETS[:2]:  # fewer where the paper has no figure to stand beside
        yield Cell("ablation", "paper", which.name, 0.0), which, {"paper": 10}


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

_OUR_METHOD = "ours"  # the one method that stands for ours; named here, not picked by its errors


def drop_tables(results: DropResults) -> str:
    """Tabulate every cell, the ranking, and the ablation."""
    given = any(outcome.is_given_truths for outcome in results.outcomes)
    protocol = (
        f"Mean absolute error of the restitution after K rollouts; "
        f"{Order(results.seeds, 0).seeds_in_words}, {results.targets} targets each.\n"
        "In brackets: the paper's. [best–worst seed]: lowest and highest of the seeds' means.\n"
        "A dash: not run that far." + f"\n{GIVEN_NOTE}" * given
    )
    compared, ablation = (
        [cell for cell in results.cells if (cell.experiment == "drop") == is_drop]
        for is_drop in (True, False)
    )
    blocks = [protocol, *(_cell_table(cell, results) for cell in compared)]
    blocks += [_ahead(results, compared), *(_cell_table(cell, results) for cell in ablation)]
    if results.credible:
        blocks.append(credible_table(results.credible))
    return "\n\n".join(filter(None, blocks))


def title(cell: Cell) -> str:
    """Describe a cell."""
    what = "Ablation, " if cell.experiment == "ablation" else ""
    simulator = "the paper's simulator" if cell.simulator == "paper" else "calibrated simulator"
    noise = f", {100 * cell.noise_m:g} cm of noise on the target" if cell.noise_m else ""
    return f"{what}{cell.which}, {simulator}{noise}"


def _cell_table(cell: Cell, results: DropResults) -> str:
    """Tabulate means beside the paper's, and below the medians and the spread over seeds."""
    outcomes = results.of(cell)
    shown = _shown_columns(results, outcomes)
    tables: list[str] = []
    # three spreads a line: more would be wider than a terminal
    parts = [("mean error", _mean, shown, title(cell))]
    parts += [
        ("median [best–worst seed]", _spread, shown[first : first + 3], "")
        for first in range(0, len(shown), 3)
    ]
    for head, figure, budgets, words in parts:
        lines = [[one.shown, *(figure(one, n) for n in budgets)] for one in outcomes]
        tables.append(table([[head, *(f"K={n}" for n in budgets)], *lines], words))
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
        held = with_error(row["held"], row["held_se"])
        lines.append([title(cell), str(row["targets"]), held, short(row["width"])])
    return table(lines)


def _ahead(results: DropResults, cells: Iterable[Cell]) -> str:
    """Rank the methods in each cell, compare ours at 5 rollouts, and name each worst seed."""
    budgets = [n for n in (5, 10) if n in results.columns]  # two of the paper's K
    lines: list[str] = []
    for cell in cells:
        # of ours the one named in advance, of others those that know nothing of the targets
        ranked = [
            one
            for one in results.of(cell)
            if not one.is_given_truths and (one.group != "ours" or one.method == _OUR_METHOD)
        ]
        if not ranked or not budgets:
            continue
        lines.append(f"  {title(cell)}")
        for n in budgets:
            best = _best(ranked, n)
            if best is None:
                continue
            lines.append(f"    at {n:>2}: {best.label}, {short(best.figures(n).mae)}")
            if len(results.seeds) > 1:
                means = best.errors_after(n).mean(axis=1)
                worst = int(means.argmax())
                error = short(float(means[worst]))
                lines[-1] += f" (worst: seed {results.seeds[worst]}, {error})"
        at = budgets[0]
        ours = _best([one for one in ranked if one.method == _OUR_METHOD], at)
        for n in budgets if ours is not None else []:
            best = _best([one for one in ranked if one.method != _OUR_METHOD], n)
            if ours is not None and best is not None:
                mine, theirs = ours.figures(at).mae, best.figures(n).mae
                lines.append(
                    f"    {ours.label} at {at} ({short(mine)}): {factor(mine, theirs)} "
                    f"{best.label} at {n} ({short(theirs)})"
                )
    return "\n".join(["Who is ahead", *lines]) if lines else ""


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
    parts = [
        "# Restitution from the ball's height",
        f"Mean absolute error after K rollouts, mean over seeds {seeds}, {results.targets} targets "
        "each; in brackets the paper's.",
    ]
    if any(outcome.is_given_truths for outcome in results.outcomes):
        parts.append(f"\\{GIVEN_NOTE}")
    for cell in results.cells:
        outcomes = results.of(cell)
        shown = _shown_columns(results, outcomes)
        lines = ["| method | " + " | ".join(f"K = {n}" for n in shown) + " |"]
        lines.append("| --- |" + " ---: |" * len(shown))
        for one in outcomes:
            cells = [_mean(one, n).replace("(.", "(0.") for n in shown]
            lines.append(f"| {one.shown} | " + " | ".join(cells) + " |")
        parts += [f"## {title(cell)}", "\n".join(lines)]
    return "\n\n".join(parts)


# ---- The figure: Easy and Hard side by side.


def draw_figure(results: DropResults) -> Figure:
    """Draw the figure without writing it; every curve and point is inside its axes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 6.2), layout="constrained")
    FigureCanvasAgg(figure)
    panels = {panel: curves for panel in PANELS if (curves := error_curves(results, panel))}
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    handles: dict[str, Any] = {}
    most = results.rollouts or MAX_ROLLOUTS
    ticks = [tick for tick in (0, 1, 2, 5, 10, 20, 40, 100) if tick <= most]
    for axis, (panel, curves) in zip(axes, panels.items(), strict=True):
        for curve in curves:
            color = tuple(part / 255 for part in curve.color)
            axis.fill_between(curve.rollouts, curve.low, curve.high, color=color, alpha=0.15, lw=0)
            for rollouts, error in curve.paper:
                axis.plot(rollouts, error, "D", color=color, ms=5, mew=0, zorder=4)
            style = {"lw": 2.6, "zorder": 5} if curve.is_ours else {"lw": 1.5}
            dashes = "--" if curve.is_users else "-"
            (line,) = axis.plot(curve.rollouts, curve.mean, dashes, color=color, **style)
            handles[curve.label] = line
        axis.set(title=f"GT {panel}", xlabel="rollouts", yscale="log")
        axis.set_xscale("symlog", linthresh=2)
        axis.set_xlim(0, 1.05 * most)
        axis.set_xticks(ticks, [str(tick) for tick in ticks])
        axis.set_xticks([], minor=True)
        axis.grid(alpha=0.25)
    # the outermost errors of all panels, which share the axis, with a margin
    curves = [one for own in panels.values() for one in own]
    shown = [np.concatenate([one.low, one.high, [y for _, y in one.paper]]) for one in curves]
    errors = np.concatenate(shown)
    axes[0].set_ylim(max(FLOOR, float(errors.min()) / 1.3), float(errors.max()) * 1.3)
    axes[0].set_ylabel(f"mean absolute error of the restitution (drawn from {FLOOR:g} up)")
    handles["the paper's"] = axes[0].plot([], [], "D", color="0.3", ms=5, mew=0)[0]
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=4)
    return figure
