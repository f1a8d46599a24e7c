"""Run the paper's second experiment, restitution from a ball's height: its table 2 and its figure.

Every method of `drop_methods` runs on the same targets, rollout by rollout. Restitution from impact
times alone has a tool of its own, which prints errors beside the Cramér-Rao bound, and verdicts on
balls and on what is no ball:

    python -m tunenet_logs.analysis.evaluation.studies.drop --seed 11 --count 600 --verdicts 40
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from tunenet_logs.analysis.checks import Verdict
from tunenet_logs.analysis.drop.times import readings
from tunenet_logs.analysis.drop.times.model import DropSetup, heard_ball
from tunenet_logs.analysis.evaluation.studies.drop_methods import (
    DRAWN_NOISE_M,
    DRAWN_RESTITUTION,
    GIVEN_NOTE,
    MAX_ROLLOUTS,
    NPE,
    PUBLISHED_ROLLOUTS,
    TARGET_SETS,
    Cell,
    Coverage,
    Credible,
    DropResults,
    DropTarget,
    Effort,
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
    estimate_batches,
    interval_coverages,
    published_error,
    train_networks,
    train_posteriors,
)
from tunenet_logs.analysis.evaluation.study import (
    NEGLIGIBLE,
    csv_text,
    json_text,
    seeds_in_words,
    short,
    short_or_dash,
    table_line,
)
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.registry import needed
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.recorders.simulators.base import CALIBRATED, PAPER, ContactSettings
from tunenet_logs.terminal import Progress

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# ---- Curves of the figure: error against rollouts.


Color = tuple[int, int, int]

PANELS = ("Easy", "Hard")  # the paper's left and right
FLOOR = 1e-6  # of restitution: a smaller error is drawn here, for a logarithm
_COLORS: dict[str, Color] = {
    "mean": (140, 140, 140),
    "entropy-search": (148, 103, 189),
    "cma-es": (140, 86, 75),
    "direct": (227, 119, 194),
    "tunenet-paper": (127, 176, 222),
    "tunenet-paper-code": (31, 119, 210),
    "secant": (23, 170, 150),
    "brent": (120, 170, 30),
    "least-squares": (188, 160, 34),
    "tpe": (255, 150, 40),
    "npe": (140, 0, 120),
}
_OUR_COLORS: Sequence[Color] = ((220, 40, 40), (240, 110, 90))


@dataclass(frozen=True, eq=False)
class ErrorCurve:
    """Error curve of a method."""

    method: str
    label: str
    is_ours: bool
    is_users: bool
    color: Color
    # mean over the seeds of the mean absolute error after 0, 1, ... rollouts, shape (R,)
    mean: Array
    low: Array  # of the best seed, shape (R,)
    high: Array  # of the worst, shape (R,)
    paper: tuple[tuple[int, float], ...]  # (rollouts, error) of the published points

    @property
    def rollouts(self) -> Array:
        """0, 1, ..., shape (R,)."""
        return np.arange(len(self.mean), dtype=np.float64)


def error_curves(results: DropResults, panel: str) -> list[ErrorCurve]:
    """Return the curves of a target set's clean cell; beyond a budget a line goes on.

    Points that the paper gives for two methods of ours are the last one's.
    """
    outcomes = results.of(Cell("drop", "paper", panel, 0.0))
    colors = _colors(outcomes)
    most = max((one.allowed for one in outcomes), default=0)
    published = tuple(n for n in PUBLISHED_ROLLOUTS if n <= (results.rollouts or MAX_ROLLOUTS))
    curves = [_curve(one, max(most, 1), colors[one.method], published) for one in outcomes]
    last = {curve.paper: curve.method for curve in curves}
    return [
        curve if last[curve.paper] == curve.method else replace(curve, paper=()) for curve in curves
    ]


def _curve(one: MethodErrors, most: int, color: Color, budgets: tuple[int, ...]) -> ErrorCurve:
    """Return a method's curve; `budgets` are those whose published points are shown."""
    reach = [n for n in range(min(most, MAX_ROLLOUTS) + 1) if one.knows(n)]
    means = np.column_stack([one.errors_after(n).mean(axis=1) for n in reach])
    published = [(n, published_error(one.cell.which, one.method, n)) for n in budgets]
    return ErrorCurve(
        one.method,
        one.label,
        one.group == "ours",
        one.group == "user",
        color,
        np.maximum(means.mean(axis=0), FLOOR),
        np.maximum(means.min(axis=0), FLOOR),
        np.maximum(means.max(axis=0), FLOOR),
        tuple((n, error) for n, error in published if error is not None),
    )


def _colors(outcomes: Iterable[MethodErrors]) -> dict[str, Color]:
    colors = dict(_COLORS)
    ours = [one.method for one in outcomes if one.group == "ours"]
    for index, method in enumerate(ours):
        colors.setdefault(method, _OUR_COLORS[index % len(_OUR_COLORS)])
    return colors


# ---- The figure as PNG: Easy and Hard side by side.


_ROOM = 1.3  # factor between the outermost errors and the ends of the axis
_TICKS = (0, 1, 2, 5, 10, 20, 40, 100)


def write_figure(results: DropResults, path: Path, made: str) -> None:
    """Write the figure as PNG, for a page's width, with the mark by which it is known.

    Raises:
        UsageError: matplotlib is not installed.
        OSError: `path` cannot be written.
    """
    needed("matplotlib")
    figure = draw_figure(results)
    figure.savefig(path, format="png", dpi=120, metadata={"Software": made})


def draw_figure(results: DropResults) -> Figure:
    """Draw the figure without writing it; every curve and point is inside its axes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 6.2), layout="constrained")
    FigureCanvasAgg(figure)
    panels = [panel for panel in PANELS if error_curves(results, panel)]
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    handles: dict[str, Any] = {}
    for axis, panel in zip(axes, panels, strict=True):
        for curve in error_curves(results, panel):
            handles[curve.label] = _draw(axis, curve)
        _dress(axis, panel, results.rollouts or MAX_ROLLOUTS)
    axes[0].set_ylim(*_limits([one for panel in panels for one in error_curves(results, panel)]))
    axes[0].set_ylabel(f"mean absolute error of the restitution (drawn from {FLOOR:g} up)")
    handles["the paper's"] = axes[0].plot([], [], "D", color="0.3", ms=5, mew=0)[0]
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=4)
    return figure


def _limits(curves: Iterable[ErrorCurve]) -> tuple[float, float]:
    """Return the lowest and highest error of all panels, which share the axis, with a margin."""
    shown = [np.concatenate([one.low, one.high, [y for _, y in one.paper]]) for one in curves]
    errors = np.concatenate(shown)
    return max(FLOOR, float(errors.min()) / _ROOM), float(errors.max()) * _ROOM


def _draw(axis: Any, curve: ErrorCurve) -> Any:
    color = tuple(part / 255 for part in curve.color)
    axis.fill_between(curve.rollouts, curve.low, curve.high, color=color, alpha=0.15, lw=0)
    for rollouts, error in curve.paper:
        axis.plot(rollouts, error, "D", color=color, ms=5, mew=0, zorder=4)
    style = {"lw": 2.6, "zorder": 5} if curve.is_ours else {"lw": 1.5}
    return axis.plot(
        curve.rollouts, curve.mean, "--" if curve.is_users else "-", color=color, **style
    )[0]


def _dress(axis: Any, panel: str, most: int) -> None:
    """Format the axes up to `most` rollouts."""
    ticks = [tick for tick in _TICKS if tick <= most]
    axis.set_title(f"GT {panel}")
    axis.set_xlabel("rollouts")
    axis.set_yscale("log")
    axis.set_xscale("symlog", linthresh=2)
    axis.set_xlim(0, 1.05 * most)
    axis.set_xticks(ticks, [str(tick) for tick in ticks])
    axis.set_xticks([], minor=True)
    axis.grid(alpha=0.25)


# ---- Restitution from impact times alone: errors and intervals on balls whose truth is known.


_GRAVITY_M_S2 = 9.80665
_STEP_S = 0.002
_MIN_SPEED_M_S = 0.25  # a slower impact is not heard
# Of the balls: half normal, and log normal within `_DRAGS_1_M`.
_SLOPE_SD, _LOG_DRAG_SD, _TYPICAL_DRAG_1_M = 0.08, 1.0, 0.03

_DRAGS_1_M = (0.002, 0.15)  # a steel ball's, and a little more than a table-tennis ball's
JITTERS_S = (0.0005, 0.001, 0.002)
_MIN_IMPACTS, _MAX_IMPACTS = 5, 12  # that are heard


@dataclass(frozen=True, eq=False)
class HeardSet:
    """Impact times of one ball."""

    times_s: Array  # as they were heard, shape (N,)
    restitution: float  # at the second impact
    bound: float  # least standard deviation of an estimate of it
    jitter_s: float  # of the times
    height_m: float  # of the drop
    first: float  # restitution at the first impact
    wrong: str  # "", "missed" or "noise"


def _landing(speed_m_s: float, drag_1_m: float, height_m: float = 0.0) -> tuple[float, float]:
    """Integrate a flight that begins upward (RK4): duration [s] and final speed [m/s]."""

    def change(state: Array) -> Array:
        return np.array([state[1], -_GRAVITY_M_S2 - drag_1_m * state[1] * abs(state[1])])

    def stepped(state: Array, step_s: float) -> Array:
        one = change(state)
        two = change(state + step_s / 2 * one)
        three = change(state + step_s / 2 * two)
        four = change(state + step_s * three)
        return state + step_s / 6 * (one + 2 * two + 2 * three + four)

    state, elapsed_s = np.array([height_m, speed_m_s]), 0.0
    while True:
        after = stepped(state, _STEP_S)
        if after[0] < 0:
            break
        state, elapsed_s = after, elapsed_s + _STEP_S
    rest_s = _STEP_S / 2
    for _ in range(30):  # Newton's method for the moment of the landing
        landed = stepped(state, rest_s)
        rest_s -= landed[0] / landed[1]
        if abs(landed[0]) < 1e-13:
            break
    return elapsed_s + rest_s, -float(stepped(state, rest_s)[1])


def _impacts(unknowns: Array, count: int, arrives_m_s: float) -> tuple[Array, Array]:
    """Return times after the first impact [s], and restitutions, of `count` impacts."""
    speed, drag_1_m = float(np.exp(unknowns[0])), float(unknowns[3])
    times, kept, second = [0.0], [speed / arrives_m_s], np.nan
    while len(times) < count:
        lasted, arrives = _landing(speed, drag_1_m)
        second = arrives if len(times) == 1 else second
        if arrives < _MIN_SPEED_M_S:
            break
        kept.append(unknowns[1] * (arrives / second) ** -unknowns[2])
        speed = kept[-1] * arrives
        times.append(times[-1] + lasted)
    return np.array(times), np.array(kept)


def _bound(unknowns: Array, count: int, jitter_s: float) -> float:
    """Return the Cramér-Rao bound on the restitution, all times right and the jitter known.

    The fit's priors of slope and log drag count as normal ones with their variances: a measure, not
    a proof.
    """
    columns = [np.ones(count)]
    for index in range(4):
        moved = [unknowns.copy(), unknowns.copy()]
        moved[0][index] += 1e-4
        moved[1][index] -= 1e-4
        ahead, behind = (_impacts(one, count, 1.0)[0] for one in moved)
        if len(ahead) != len(behind) or len(ahead) != count:
            return float("nan")
        columns.append((ahead - behind) / 2e-4)
    jacobian = np.column_stack(columns)
    slope_sd, log_drag_sd = _prior_sds()
    prior = np.diag([0.0, 0.0, 0.0, slope_sd**-2, (log_drag_sd * unknowns[3]) ** -2])
    return float(np.sqrt(np.linalg.inv(jacobian.T @ jacobian / jitter_s**2 + prior)[2, 2]))


@cache
def _prior_sds() -> tuple[float, float]:
    """Return the prior standard deviations of slope and log drag, as the fit has them."""
    nodes = readings.nodes(readings.WHOLE_SLOPE, readings.WHOLE_LOG_DRAG, (200, 200), None)
    weights = np.exp(nodes.log_prior)
    slows = nodes.drags_1_m > 0
    logs = np.log(nodes.drags_1_m[slows])
    return _sd(nodes.slopes, weights), _sd(logs, weights[slows])


def _sd(values: Array, weights: Array) -> float:
    weights = weights / weights.sum()
    return float(np.sqrt(weights @ (values - weights @ values) ** 2))


def heard_set(rng: np.random.Generator, number: int) -> HeardSet:
    """Draw one ball's impact times; each fourth set has a missed impact or a noise.

    Nothing is shared with the fit: flights in air by Runge and Kutta's method, restitution by a
    power of the speed. The jitter is normal.
    """
    while True:
        first, slope = float(rng.uniform(0.4, 0.9)), float(abs(rng.normal(0, _SLOPE_SD)))
        drag_1_m = float(np.exp(rng.normal(np.log(_TYPICAL_DRAG_1_M), _LOG_DRAG_SD)))
        height_m = float(rng.uniform(0.3, 2.0))
        jitter_s = float(rng.choice(JITTERS_S))
        most = int(rng.integers(_MIN_IMPACTS, _MAX_IMPACTS + 1))
        if not _DRAGS_1_M[0] < drag_1_m < _DRAGS_1_M[1]:
            continue
        _, arrives = _landing(0.0, drag_1_m, height_m)
        _, second = _landing(first * arrives, drag_1_m)
        at_second = first * (second / arrives) ** -slope
        if at_second > 0.97:
            continue
        unknowns = np.array([np.log(first * arrives), at_second, slope, drag_1_m])
        times, _ = _impacts(unknowns, most, arrives)
        wrong = ("", "", "", ("missed", "noise")[number // 4 % 2])[number % 4]
        if len(times) < _MIN_IMPACTS + (wrong == "missed"):
            continue
        bound = _bound(unknowns, len(times), jitter_s)
        if np.isfinite(bound):
            break
    heard = np.sort(times + rng.uniform(0.2, 2.0) + rng.normal(0.0, jitter_s, len(times)))
    if wrong == "missed":
        heard = np.delete(heard, int(rng.integers(2, len(heard) - 1)))
    elif wrong:
        heard = np.sort(np.append(heard, rng.uniform(heard[0], heard[-1])))
    return HeardSet(heard, at_second, bound, jitter_s, height_m, first, wrong)


@dataclass(frozen=True)
class TimesFigures:
    """Figures of sets of one kind."""

    label: str  # of the kind
    sets: int  # how many
    told: int  # how many of them have a value
    mae: float  # mean absolute error
    bound: float  # what the bound allows of it
    covered: float  # fraction of the intervals that hold the truth
    width: float  # median width of them


def times_figures(seed: int, count: int, *, with_height: bool = False) -> list[TimesFigures]:
    """Return the figures of all sets, and of those with each jitter and each wrong time."""
    rng = np.random.default_rng([seed, *b"impact times"])
    sets = [heard_set(rng, number) for number in range(count)]
    rows = np.array([_row(one, rng, with_height=with_height) for one in sets])
    kinds = {"all": np.ones(count, dtype=bool)}
    for jitter_s in JITTERS_S:
        kinds[f"jitter {1000 * jitter_s:g} ms"] = np.array([s.jitter_s == jitter_s for s in sets])
    for wrong, label in (("", "all right"), ("missed", "one missed"), ("noise", "one noise")):
        kinds[label] = np.array([one.wrong == wrong for one in sets])
    return [_figures(label, rows[chosen]) for label, chosen in kinds.items() if chosen.any()]


def _row(one: HeardSet, rng: np.random.Generator, *, with_height: bool) -> tuple[float, ...]:
    height_m = one.height_m * (1 + 0.004 * float(rng.normal())) if with_height else None
    ball = heard_ball(one.times_s, DropSetup(height_m=height_m))
    truth = one.first if with_height else one.restitution
    if ball is None:
        return truth, np.nan, np.nan, np.nan, one.bound
    return truth, float(ball.values[0]), *ball.interval95[0].tolist(), one.bound


def _figures(label: str, rows: Array) -> TimesFigures:
    truth, value, low, high, bound = rows[np.isfinite(rows[:, 1])].T
    return TimesFigures(
        label,
        len(rows),
        len(truth),
        float(np.mean(np.abs(value - truth))),
        float(np.mean(bound)) * float(np.sqrt(2 / np.pi)),
        float(np.mean((low <= truth) & (truth <= high))),
        float(np.median(high - low)),
    )


def times_table(figures: list[TimesFigures]) -> str:
    """Tabulate the figures, one line a kind."""
    head = f"{'impact times':16}{'sets':>6}{'told':>6}{'MAE':>9}{'bound':>9}{'ratio':>7}"
    lines = [head + f"{'covered':>9}{'width':>8}"]
    lines += [
        f"{one.label:16}{one.sets:6d}{one.told:6d}{one.mae:9.5f}{one.bound:9.5f}"
        f"{one.mae / one.bound:7.2f}{100 * one.covered:8.1f}%{one.width:8.4f}"
        for one in figures
    ]
    return "\n".join(lines)


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=600)
    parser.add_argument("--height", action="store_true", help="the drop's height is given")
    parser.add_argument("--verdicts", type=int, default=40, help="sets of each kind of no ball")
    arguments = parser.parse_args()
    print(times_table(times_figures(arguments.seed, arguments.count, with_height=arguments.height)))
    if arguments.verdicts:
        print(verdict_table(arguments.seed, arguments.verdicts, arguments.count))


# ---- JSON and CSV: one record a figure.


# Of the CSV, in long form: one row for each method, budget and seed of each cell.
COLUMNS = (
    "experiment",
    "simulator",
    "set",
    "noise_m",
    "method",
    "rollouts",
    "seed",
    "mae",
    "median",
    "paper",
)


def drop_rows(results: DropResults) -> list[dict[str, Any]]:
    """Return one record for each cell, method, number of rollouts and seed; see `COLUMNS`."""
    rows: list[dict[str, Any]] = []
    for one in results.outcomes:
        for n in filter(one.knows, results.columns):
            paper = one.figures(n).paper
            for seed, errors in zip(results.seeds, one.errors_after(n), strict=True):
                figures = {"mae": float(errors.mean()), "median": float(np.median(errors))}
                rows.append({**_keys(one, n), "seed": seed, **figures, "paper": paper})
    return rows


def drop_json(results: DropResults) -> str:
    """Serialise figures over all seeds, those of each seed, and the curves of the figure."""
    summary = []
    curves = []
    for one in results.outcomes:
        for n in filter(one.knows, results.columns):
            figures = one.figures(n)
            summary.append(
                {
                    **_keys(one, n),
                    "mae": figures.mae,
                    "median": figures.median,
                    "lowest": figures.lowest,
                    "highest": figures.highest,
                    "paper": figures.paper,
                }
            )
        keys = {key: value for key, value in _keys(one, 0).items() if key != "rollouts"}
        curves.append({**keys, "label": one.label, "mae": one.errors.mean(axis=1).tolist()})
    return json_text(
        {
            "experiment": "drop",
            "seeds": list(results.seeds),
            "targets": results.targets,
            **({} if results.rollouts is None else {"most_rollouts": results.rollouts}),
            "summary": summary,
            **_intervals(results.coverage),
            **_credible(results),
            "rows": drop_rows(results),
            "curves": curves,
        }
    )


def drop_csv(results: DropResults) -> str:
    """Format `drop_rows` as a table; an empty field where the paper has nothing."""
    return csv_text(COLUMNS, drop_rows(results))


def intervals_json(rows: Sequence[Coverage], seeds: Sequence[int], targets: int) -> str:
    """Serialise every figure of the intervals; null where there is none."""
    head = {"experiment": "intervals", "seeds": list(seeds), "targets": targets}
    return json_text({**head, **_intervals(rows)})


def intervals_csv(rows: Sequence[Coverage]) -> str:
    """Format one row for each kind of recording; an empty field without a figure."""
    return csv_text(tuple(one.name for one in fields(Coverage)), [asdict(one) for one in rows])


def _intervals(rows: Sequence[Coverage]) -> dict[str, Any]:
    """Return the intervals' records; left out where none were measured."""
    return {"intervals": [asdict(one) for one in rows]} if rows else {}


def _credible(results: DropResults) -> dict[str, Any]:
    """Return the credible intervals' records; left out where no method has a posterior."""
    rows = []
    for one in results.credible:
        figures = {key: value for key, value in asdict(one).items() if key != "cell"}
        rows.append({**_cell_keys(one.cell), **figures})
    return {"credible": rows} if rows else {}


def _keys(one: MethodErrors, rollouts: int) -> dict[str, Any]:
    return {**_cell_keys(one.cell), "method": one.method, "rollouts": rollouts}


def _cell_keys(cell: Cell) -> dict[str, Any]:
    return {
        "experiment": cell.experiment,
        "simulator": cell.simulator,
        "set": cell.which,
        "noise_m": cell.noise_m,
    }


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
class DropExperiment:
    """Settings of the experiment."""

    seeds: tuple[int, ...]  # each trains its own networks and draws its own targets
    targets: int  # test cases for each seed, set and noise
    methods: tuple[str, ...] | None = None  # names of those that compete; None for all
    jobs: int | None = None  # processes; None for all cores
    effort: Effort | None = None  # of training, in place of the presets'
    rollouts: int | None = None  # most that any method may spend; None for the cells' own limits


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
        """Split a method's work on the targets; `rollouts` as in `DropExperiment`."""
        most = min(method.budget, self.most[method.group])
        most = most if rollouts is None else min(most, rollouts)
        return [
            TargetBatch(method, tuple(targets[at : at + _BATCH]), self.contact, most)
            for at in range(0, len(targets), _BATCH)
        ]


def run_drop(order: DropExperiment, progress: Progress) -> DropResults:
    """Train, draw, estimate.

    The same order gives the same figures for any `jobs`.

    Raises:
        UsageError: a method is unknown, or needs a library that is not installed.
    """
    chosen = choose_methods(order.methods)
    networks = {
        seed: train_networks(chosen.networks, seed, order.jobs, progress, order.effort)
        for seed in order.seeds
    }
    posteriors: Posteriors = {}
    if chosen.has_posteriors:
        noises_m = (0.0, NOISE_M)
        posteriors = train_posteriors(order.seeds, noises_m, order.jobs, progress, order.effort)
    batches: list[TargetBatch] = []
    columns: list[tuple[Cell, Method, slice]] = []
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
            start = len(batches)
            for method, targets in zip(column, drawn.values(), strict=True):
                batches += empty.batches(method, targets, order.rollouts)
            columns.append((cell, column[0], slice(start, len(batches))))
    done = estimate_batches(batches, order.jobs, progress)
    outcomes: list[MethodErrors] = []
    for cell, method, own in columns:
        errors = np.concatenate(done[own]).reshape(len(order.seeds), order.targets, -1)
        name, label = method.name, method.label
        outcomes.append(MethodErrors(cell, name, label, method.group, method.budget, errors))
    with_posteriors = [(cell, batches[own]) for cell, method, own in columns if method.name == NPE]
    credible = credible_coverage(with_posteriors, order.jobs, progress)
    coverage: tuple[Coverage, ...] = ()
    if order.methods is None:
        coverage = interval_coverages(order.seeds, order.targets, order.jobs, progress)
    return DropResults(
        order.seeds, order.targets, tuple(outcomes), coverage, credible, order.rollouts
    )


def _empty_cells() -> list[_EmptyCell]:
    cells = []
    simulators: tuple[tuple[Table, ContactSettings, Mapping[Group, int]], ...]
    simulators = (("paper", PAPER, _MAX_PAPER), ("calibrated", CALIBRATED, _MAX_CALIBRATED))
    for table, contact, most_clean in simulators:
        for noise_m, most in ((0.0, most_clean), (NOISE_M, _MAX_NOISY)):
            for which in TARGET_SETS:
                cell = Cell("drop", table, which.name, noise_m)
                cells.append(_EmptyCell(cell, table, which, contact, most))
    for which in TARGET_SETS[:2]:
        cell = Cell("ablation", "paper", which.name, 0.0)
        cells.append(_EmptyCell(cell, "ablation", which, PAPER, _MAX_ABLATION))
    return cells


# ---- Tables for a terminal, and in Markdown for reviews.


_SPREAD = "median [best–worst seed]"
_SPREADS_A_LINE = 3  # budgets whose spreads stand side by side: more would be wider than a terminal
_AHEAD_AT = (5, 10)  # rollouts at which methods are ranked: two of the paper's K
_OUR_METHOD = "ours"  # the one method that stands for ours; named here, not picked by its errors
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
    low, high = DRAWN_RESTITUTION
    most_cm = 100 * DRAWN_NOISE_M[1]
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


# ---- Verdicts on impact times: of balls, and of rhythms and noises that are no ball's.


_SHARP_S = 0.001  # jitter of times that a machine might have made
_MANY = 6  # impacts from which on a ball should mostly be told


def _clapping(jitter_s: float) -> Callable[[np.random.Generator, int], Array]:
    def times(rng: np.random.Generator, count: int) -> Array:
        return np.cumsum(rng.uniform(0.25, 0.7) + rng.normal(0.0, jitter_s, count))

    return times


def _linear(rng: np.random.Generator, count: int) -> Array:
    shorter = rng.uniform(0.3, 0.9) * np.arange(count) / count
    return np.cumsum(rng.uniform(0.3, 0.9) * (1 - shorter)) + rng.normal(0.0, _SHARP_S, count)


def _poisson(rng: np.random.Generator, count: int) -> Array:
    return np.cumsum(rng.exponential(0.4, count))


def _uniform(rng: np.random.Generator, count: int) -> Array:
    return np.sort(rng.uniform(0.0, 0.4 * count, count))


def _increasing(rng: np.random.Generator, count: int) -> Array:
    times = np.cumsum(0.2 * rng.uniform(1.03, 1.2) ** np.arange(count))
    return times + rng.normal(0.0, _SHARP_S, count)


def _drum_roll(rng: np.random.Generator, count: int) -> Array:
    tempos_hz = np.linspace(1 / rng.uniform(0.4, 0.8), 1 / rng.uniform(0.1, 0.2), count)
    return np.cumsum((1 + rng.normal(0.0, 0.03, count)) / tempos_hz)


# Kinds of times that are no ball's: from random numbers and a count, times [s].
NO_BALLS: dict[str, Callable[[np.random.Generator, int], Array]] = {
    "clapping, 2 ms": _clapping(0.002),
    "clapping, 5 ms": _clapping(0.005),
    "clapping, 20 ms": _clapping(0.02),
    "linearly shorter": _linear,
    "Poisson": _poisson,
    "uniform": _uniform,
    "longer and longer": _increasing,
    "drum roll": _drum_roll,
}


def heard_verdict(times_s: Array) -> Verdict:
    """Return the verdict of `tunenet-tune` on these times, shape (N,) [s]."""
    stamps_ns = np.round(times_s * 1e9).astype(np.int64)
    signal = Signal("impacts", stamps_ns, np.ones((len(stamps_ns), 1)), ("impact",), "1")
    return tune_episode(
        Episode(EpisodeInfo(), {"impacts": signal}), TuneOptions(), Path("a")
    ).verdict


def _sets(seed: int, count: int, balls: int) -> Iterator[tuple[list[str], Array]]:
    """Yield the names of a set's kinds, and its times [s]."""
    rng = np.random.default_rng([seed, *b"no balls"])
    for name, made in NO_BALLS.items():
        for _ in range(count):
            yield [name], made(rng, int(rng.integers(_MIN_IMPACTS, _MAX_IMPACTS + 1)))
    rng = np.random.default_rng([seed, *b"impact times"])  # the balls of the first table
    for number in range(balls):
        one = heard_set(rng, number)
        many = "6 or more" if len(one.times_s) >= _MANY else "fewer"
        part = [f"with a {one.wrong}" if one.wrong == "noise" else "with one missed"]
        yield [f"balls, {many}", *(part if one.wrong else [])], one.times_s


def verdicts(seed: int, count: int, balls: int) -> dict[str, Counter[Verdict]]:
    """Count how often each kind has each verdict, of `count` sets a kind, and of `balls`."""
    found: dict[str, Counter[Verdict]] = {}
    for names, times_s in _sets(seed, count, balls):
        verdict = heard_verdict(times_s)
        for name in names:
            found.setdefault(name, Counter())[verdict] += 1
    return found


def verdict_table(seed: int, count: int, balls: int) -> str:
    """Tabulate `verdicts`, one line a kind."""
    names = get_args(Verdict)
    lines = [f"{'verdicts':20}{'sets':>6}" + "".join(f"{name:>10}" for name in names)]
    for kind, each in verdicts(seed, count, balls).items():
        counts = "".join(f"{each[name]:10d}" for name in names)
        lines.append(f"{kind:20}{each.total():6d}{counts}")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
