"""Tune balls in air whose restitution falls with speed: parameters, intervals, verdicts, motion.

A stranger's balls, those of a table of kinds, and videos of both; beside the product stands a fit
that knows the model.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tunenet_logs.analysis.evaluation.studies.video import tune_track
from tunenet_logs.analysis.evaluation.study import (
    Columns,
    Order,
    Part,
    Row,
    decimals,
    figure,
    holds,
    percent,
    scored,
    short,
    shown,
    table,
)
from tunenet_logs.analysis.evaluation.worlds.ball import (
    CELLS,
    DROPS_M,
    HEIGHTS_M,
    RESTITUTIONS,
    SLOPES,
    TABLE_BALLS,
    RealBall,
    RecordedDrop,
    TableBall,
    WorldCell,
    airless_off,
    best_of_all,
    draw_drop,
    fallen,
    first_rebound,
    record_drop,
    table_drops,
)
from tunenet_logs.analysis.evaluation.worlds.camera import filmed
from tunenet_logs.analysis.experiment import Tuning, record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import Piece
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array, Episode
from tunenet_logs.recorders.simulators.ball import DropSimulator
from tunenet_logs.terminal import Progress

# ---- Reference: least squares with the known model, the best that a log allows.
# It knows gravity, the noise and the ranges that the balls were drawn from. Around its best values
# the model is taken as linear; the rest is integrated over, within the ranges of slope and drag.

_STEPS = 12  # of half a flight: within some micrometres of the truth's
# For derivatives: of restitution, slope, drag, drop, release and level.
_NUDGES = np.array([1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-4])


@dataclass(frozen=True, eq=False)
class ReferenceFit:
    """Fitted restitution, slope and drag [1/m], in this order."""

    values: Array  # medians, shape (3,)
    interval95: Array  # lower and upper ends, shape (3, 2)
    ball: RealBall  # of the best path
    release_s: float  # of the best path, on the drop's clock: 0 is the truth

    def heights_m(self, seconds: Array) -> Array:
        """Return the best path over its contact, at times on the drop's clock, shape (T,)."""
        since = seconds - self.release_s
        return fallen(self.ball.values[None], float(since[-1])).at(since[None])[0]


def fit_reference(drop: RecordedDrop, cell: WorldCell) -> ReferenceFit:
    """Fit one drop whose slope and drag are from the ranges of `cell`."""
    from scipy.optimize import least_squares

    start = np.array([*drop.ball.values, 0.0, drop.level_m])
    low = np.array([0.0, cell.slopes[0], cell.drags_1_m[0], 0.01, -1.0, -np.inf])
    high = np.array([1.0, cell.slopes[1], cell.drags_1_m[1], np.inf, 1.0, np.inf])

    def residuals(values: Array) -> Array:
        return _residuals(values[None], drop)[0]

    def slopes(values: Array) -> Array:
        there = np.concatenate([values + np.diag(_NUDGES), values - np.diag(_NUDGES)])
        above, below = np.split(_residuals(there, drop), 2)
        return ((above - below) / (2 * _NUDGES[:, None])).T

    margin = 1e-9 * (high[1:3] - low[1:3])
    start[1:3] = np.clip(start[1:3], low[1:3] + margin, high[1:3] - margin)
    by: Any = slopes  # the stubs know "2-point" and the like alone
    best = least_squares(
        *(residuals, start, by),
        bounds=(low, high),
        x_scale="jac",
        ftol=1e-6,  # of a sum of some hundred squares: nothing beside the noise
        xtol=1e-6,
        max_nfev=30,
    )
    values, interval95 = _posterior(best.x[:3], best.fun, best.jac, cell)
    e, p, k, height, release, _ = (float(value) for value in best.x)
    return ReferenceFit(values, interval95, RealBall(e, p, k, height), release)


def _residuals(values: Array, drop: RecordedDrop) -> Array:
    """Return residuals of B sets of values, over the noise, shape (B, T)."""
    seconds = drop.seconds - values[:, 4:5]
    paths = fallen(values[:, :4], float(seconds.max()), _STEPS)
    heights = paths.at(seconds) + values[:, 5:6]
    return (heights - drop.positions_m[:, 2]) / drop.noise_m


def _posterior(best: Array, misfit: Array, slopes: Array, cell: WorldCell) -> tuple[Array, Array]:
    """Return medians, shape (3,), and 95 % intervals, shape (3, 2), of the parameters.

    Args:
        best: restitution, slope and drag of the best path, shape (3,).
        misfit: its residuals over the noise, shape (T,).
        slopes: their derivatives by these three and by what else is fitted, shape (T, 6).
        cell: whose ranges are kept to.
    """
    from scipy.special import ndtr

    others, _ = np.linalg.qr(slopes[:, 3:])
    own = slopes[:, :3] - others @ (others.T @ slopes[:, :3])
    misfit = misfit - others @ (others.T @ misfit)
    # Given slope and drag, the restitution is normal; their own weight is what that leaves.
    unit = own[:, 0] / (own[:, 0] @ own[:, 0])
    deviation = 1 / float(np.linalg.norm(own[:, 0]))
    rest = np.column_stack([misfit, own[:, 1:]])
    shift = -unit @ rest
    rest = rest + np.outer(own[:, 0], shift)
    precision = rest.T @ rest
    ranges = np.array([np.ptp(cell.slopes), np.ptp(cell.drags_1_m)])
    spread = np.linalg.inv(precision[1:, 1:] + np.diag(ranges**-2))
    grids: list[Array] = []
    for at, (low, high) in enumerate((cell.slopes, cell.drags_1_m)):
        middle, reach = float(best[1 + at]), 8 / np.sqrt(max(1 / spread[at, at], 1e-12))
        grids.append(np.linspace(max(low, middle - reach), min(high, middle + reach), 121))
    slope, drag = grids
    off = np.stack(np.meshgrid(slope - best[1], drag - best[2], indexing="ij"))
    squares = 2 * np.einsum("a,aij->ij", precision[0, 1:], off)
    squares += np.einsum("ab,aij,bij->ij", precision[1:, 1:], off, off)
    weights = np.exp(-(squares - squares.min()) / 2) / drag
    weights /= weights.sum()
    # of the restitution, a mixture of normals of one deviation
    centres = (best[0] + shift[0] + np.einsum("a,aij->ij", shift[1:], off)).ravel()
    kept = weights.ravel() > 1e-7 * weights.max()
    centres, parts = centres[kept], weights.ravel()[kept] / weights.ravel()[kept].sum()
    grid = np.linspace(centres.min() - 5 * deviation, centres.max() + 5 * deviation, 401)
    mass = np.array([parts @ ndtr((at - centres) / deviation) for at in grid])
    ends = (0.025, 0.5, 0.975)
    found = [np.interp(ends, mass, grid)]
    for grid, density in ((slope, weights.sum(axis=1)), (drag, weights.sum(axis=0))):
        sums = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2)])  # by trapezia
        found.append(np.interp(ends, sums / sums[-1], grid))
    quantiles = np.array(found)
    return quantiles[:, 1], quantiles[:, [0, 2]]


# ---- A tuning beside the truth: its parameters and its motion.

# By their names in a record; one that a tuning does not report is NaN.
PARAMETERS = ("restitution", "restitution_slope", "drag")

VERDICTS = ("ok", "suspect", "rejected")


@dataclass(frozen=True, eq=False)
class Found:
    """Result for one drop; NaN where there is none."""

    truth: Array  # restitution at the first impact, slope, drag [1/m], shape (3,)
    values: Array  # likewise
    interval95: Array  # lower and upper ends, shape (3, 2)
    verdict: str  # one of `VERDICTS`; "" for a fit that gives none
    # rms distance of its motion from the true one, from the release to the last bounce in view,
    # over the drop
    path: float


def found_by(tuning: Tuning, drop: RecordedDrop) -> Found:
    """Return what a tuning on a drop found."""
    record = record_of(tuning)
    values, ends = np.full(3, np.nan), np.full((3, 2), np.nan)
    for at, name in enumerate(PARAMETERS):
        estimate = record.estimate(name)
        if estimate is None:
            continue
        values[at] = np.ravel(estimate.value)[0]
        if estimate.interval95 is not None:
            ends[at] = np.reshape(estimate.interval95, (-1, 2))[0]
    off = None if tuning.estimate is None else off_path(tuning, drop)
    path = np.nan if off is None else float(np.sqrt(np.mean(off**2)))
    return Found(drop.ball.values[:3], values, ends, tuning.verdict, path)


def off_path(tuning: Tuning, drop: RecordedDrop) -> Array | None:
    """Return the tuned simulator's position error over the drop, shape (T,).

    At the rollout's own samples, from the release to the last bounce in view. A film has no
    scale of its own: its rollout is in units of the drop that it simulates. None where nothing was
    simulated.
    """
    if tuning.trace is None:
        return None
    last = tuning.trace.steps[-1].evaluation
    assert last is not None
    return _off(tuning, last.episode, drop)


def off_motion(tuning: Tuning, drop: RecordedDrop) -> Array | None:
    """Return `off_path` with a rollout long enough for a drop that was seen in part.

    None for a rejected log, too.
    """
    if tuning.estimate is None or tuning.experiment is None:
        return None
    problem = tuning.experiment.problem(tuning.detection, tuning.estimate)
    simulator = problem.simulator
    assert isinstance(simulator, DropSimulator)
    rig = simulator.rig
    more = drop.last_bounce_s - drop.seconds_of(np.array([rig.start_ns]))[0]
    samples = max(rig.samples, int(np.ceil(more * rig.rate_hz)) + 2)
    names = [parameter.name for parameter in problem.parameters]
    values = dict(zip(names, map(float, tuning.estimate), strict=True))
    episode = simulator.with_rig(replace(rig, samples=samples)).rollout(values)
    return _off(tuning, episode, drop)


def _off(tuning: Tuning, episode: Episode, drop: RecordedDrop) -> Array:
    signal = next(iter(episode.signals.values()))
    rig = episode.info.rig
    heights = signal.values[:, 2] - rig["ball_diameter_m"] / 2
    is_film = tuning.detection is not None and tuning.detection.film is not None
    heights = heights / (rig["drop_height_m"] if is_film else drop.ball.drop_m)
    seconds = drop.seconds_of(signal.stamps_ns)
    shown = (seconds >= 0) & (seconds <= drop.last_bounce_s)
    return heights[shown] - drop.truth_m(seconds[shown]) / drop.ball.drop_m


# ---- Work of one process: drops of a cell, of a ball of the table, or videos.

SEEN = 0.6  # of the time from the release to the last bounce in view: what a prediction is tuned on
LIGHT = ("light, no slope", "light, slope")  # their names in tables
# By which a ball's motion is foretold: ours, tuned on the first `SEEN` of the time; the preset
# "paper" on all that it asks for, for any verdict; and without air, by the restitution that gives
# the first rebound's height, and by the one that is best on the first `SEEN`.
MOTION = ("ours", "paper", "first_rebound", "best_airless")


@dataclass(frozen=True, eq=False)
class Score:
    """Results of one drop."""

    ours: Found
    reference: Found | None = None
    # mean error of each foretold motion from the release to the last bounce in view, over the drop
    motion: dict[str, float] = field(default_factory=dict[str, float])
    verdict_ahead: str = ""  # of our tuning for it


def compared_drops(case: tuple[WorldCell, int, range]) -> list[Score]:
    """Tune drops of a cell and a seed, and fit them by the reference."""
    cell, seed, numbers = case
    found: list[Score] = []
    for number in numbers:
        drop = draw_drop(cell, seed, number)
        ours = found_by(tune_episode(drop.episode(), TuneOptions()), drop)
        found.append(Score(ours, reference_found(drop, cell)))
    return found


def reference_found(drop: RecordedDrop, cell: WorldCell) -> Found:
    """Fit a drop by the reference."""
    fit = fit_reference(drop, cell)
    seconds = drop.seconds[(drop.seconds >= 0) & (drop.seconds <= drop.last_bounce_s)]
    off = (fit.heights_m(seconds) - drop.truth_m(seconds)) / drop.ball.drop_m
    path = float(np.sqrt(np.mean(off**2)))
    return Found(drop.ball.values[:3], fit.values, fit.interval95, "", path)


def moved_drops(case: tuple[TableBall, int, int]) -> list[Score]:
    """Measure the motion of a ball, for a seed and a number of drops from each height."""
    found: list[Score] = []
    for drop in table_drops(*case):
        view = drop.view
        seen = view.until(SEEN * view.last_bounce_s)
        ahead = tune_episode(seen.episode(), TuneOptions())
        paper = tune_episode(drop.whole.episode(), TuneOptions(preset="paper"))
        offs = (
            off_motion(ahead, view),
            off_path(paper, drop.whole.until(view.last_bounce_s)),
            airless_off(first_rebound(view), view),
            airless_off(best_of_all(seen), view),
        )
        motion: dict[str, float] = dict(zip(MOTION, map(_mean_error, offs), strict=True))
        whole = found_by(tune_episode(view.episode(), TuneOptions()), view)
        found.append(Score(whole, None, motion, ahead.verdict))
    return found


def filmed_table(case: tuple[TableBall, int, int]) -> list[Score]:
    """Measure as `moved_drops`, on videos."""
    ball, seed, _ = case
    found: list[Score] = []
    for at, drop in enumerate(table_drops(*case)):
        view = drop.view

        def film(view: RecordedDrop, at: int = at) -> Tuning:
            rng = np.random.default_rng([seed, at, *b"film", *ball.name.encode()])
            return tune_track(filmed(view, ball.diameter_m / 2, rng), TuneOptions())

        ahead = film(view.until(SEEN * view.last_bounce_s))
        motion = {"ours": _mean_error(off_motion(ahead, view))}
        found.append(Score(found_by(film(view), view), None, motion))
    return found


def filmed_light(case: tuple[bool, int, range]) -> list[Score]:
    """Tune videos of light balls that are not named: with a slope or none, of a seed."""
    has_slope, seed, numbers = case
    found: list[Score] = []
    for number in numbers:
        rng = np.random.default_rng([seed, number, *b"light"])
        restitution, slope = rng.uniform(*RESTITUTIONS), rng.uniform(*SLOPES) * has_slope
        ball = RealBall(restitution, slope, rng.uniform(0.1, 0.14), rng.uniform(*DROPS_M))
        drop = record_drop(ball, 60.0, 0.0, rng)
        # of light balls whose kind is not named, about a table-tennis ball's
        tuning = tune_track(filmed(drop, 0.02, rng), TuneOptions())
        found.append(Score(found_by(tuning, drop)))
    return found


def _mean_error(off: Array | None) -> float:
    return np.nan if off is None or not len(off) else float(np.mean(np.abs(off)))


# ---- Run: the stranger's balls, those of the table, and videos.


def run(order: Order, progress: Progress) -> Iterator[Part]:
    """Tune the drops of each section; the first part says what is measured."""
    # drops of a ball of the table for each height and seed: one for 50 drops of a cell
    count = max(1, order.targets // 50)
    yield Part("", protocol(order, count))
    of_table = {
        one.name: [
            Piece((one, seed, count), count * len(HEIGHTS_M), one.name) for seed in order.seeds
        ]
        for one in TABLE_BALLS
    }
    of_cells = {cell.label: order.pieces(5, cell, name=cell.label) for cell in CELLS}
    of_light = {
        label: order.pieces(5, bool(slopes), name=label) for slopes, label in enumerate(LIGHT)
    }
    work = {
        "positions": [(compared_drops, of_cells)],
        "balls": [(moved_drops, of_table)],
        "films": [(filmed_table, of_table), (filmed_light, of_light)],
    }
    for section in order.sections:
        rows: list[Row] = []
        for score, cases in work[section]:
            done = scored(score, cases, order, progress, ("real balls", "drop"))
            for label, scores in done.items():
                rows += lines_of(label, scores)
        yield Part(section, "\n\n".join(section_tables(section, rows)), rows)


# ---- Figures of a line: errors with the worst beside the mean, intervals, verdicts.

PATH = "path"


def lines_of(label: str, scores: Sequence[Score]) -> list[Row]:
    """Return a line for each parameter, one for the path, and one for each foretold motion."""
    ours = [one.ours for one in scores]
    reference = [one.reference for one in scores if one.reference is not None]
    verdicts = _shares([one.verdict for one in ours])
    rows: list[Row] = []
    for at, name in enumerate(PARAMETERS):
        truth, off, low, high = _columns(ours, at)
        best_off, widths = np.array([]), np.array([])
        row: Row = {"label": label, "quantity": name, **verdicts}
        row["intervals"] = int(np.isfinite(low).sum())
        row["covered"] = figure(holds(low, high, truth))
        row["reference_covered"] = None
        if reference:
            _, best_off, best_low, best_high = _columns(reference, at)
            row["reference_covered"] = figure(holds(best_low, best_high, truth))
            widths = (high - low) / (best_high - best_low)
        # over the reference's
        row |= {"width": figure(widths, np.median), "widest": figure(widths, np.max)}
        rows.append({**row, **_spread(off), **_spread(best_off, "reference_")})
    off, best = (np.array([one.path for one in some]) for some in (ours, reference))
    row = {"label": label, "quantity": PATH, **verdicts}
    rows.append({**row, **_spread(off), **_spread(best, "reference_")})
    for name in MOTION:
        off = np.array([one.motion[name] for one in scores if name in one.motion])
        if len(off):
            ahead = [one.verdict_ahead for one in scores if name == "ours" and one.verdict_ahead]
            rows.append({"label": label, "quantity": name, **_shares(ahead), **_spread(off)})
    return rows


def _columns(found: Sequence[Found], at: int) -> tuple[Array, Array, Array, Array]:
    """Return a parameter's truth, error, and ends of the interval, shape (N,) each."""
    truth = np.array([one.truth[at] for one in found])
    values = np.array([one.values[at] for one in found])
    low, high = np.array([one.interval95[at] for one in found]).reshape(-1, 2).T
    return truth, values - truth, low, high


def _spread(off: Array, prefix: str = "") -> Row:
    """Return the statistics of errors, shape (N,); NaN where there is no answer."""
    errors = np.abs(off)
    spread = {
        "mean": figure(errors),
        "median": figure(errors, np.median),
        "p99": figure(errors, lambda known: np.percentile(known, 99)),
        "worst": figure(errors, np.max),
    }
    counts = {} if prefix else {"drops": len(off), "answered": int(np.isfinite(off).sum())}
    return {**counts, **{f"{prefix}{name}": value for name, value in spread.items()}}


def _shares(verdicts: Sequence[str]) -> Row:
    return {name: figure([one == name for one in verdicts]) for name in VERDICTS}


# ---- Tables for a terminal.

_TITLES = {
    "positions": "the stranger's balls, positions",
    "balls": "balls of the table, positions",
    "films": "films",
}
_QUANTITIES = {
    "restitution": "Restitution at the first impact",
    "restitution_slope": "Slope of the restitution",
    "drag": "Drag, 1/m",
    PATH: "Tuned rollout against the true path, rms in % of the height",
}
_ERRORS: Columns = (
    ("", lambda row: row["label"]),
    ("drops", lambda row: str(row["drops"])),
    ("ok", lambda row: percent(row["ok"])),
    ("suspect", lambda row: percent(row["suspect"])),
    ("mean", lambda row: short(row["mean"])),
    ("worst", lambda row: short(row["worst"])),
    (
        "held",
        lambda row: (
            "-" if row["covered"] is None else f"{percent(row['covered'])} ({row['intervals']})"
        ),
    ),
)
_REFERENCE: Columns = (
    ("fit: mean", lambda row: short(row["reference_mean"])),
    ("worst", lambda row: short(row["reference_worst"])),
    ("held", lambda row: percent(row["reference_covered"])),
    ("width", lambda row: decimals(row["width"], 2)),
    ("most", lambda row: decimals(row["widest"], 2)),
)
_PATHS: Columns = (
    ("", lambda row: row["label"]),
    ("answered", lambda row: str(row["answered"])),
    ("mean", lambda row: _of_height(row["mean"])),
    ("median", lambda row: _of_height(row["median"])),
    ("99th", lambda row: _of_height(row["p99"])),
    ("worst", lambda row: _of_height(row["worst"])),
)
_REFERENCE_PATHS: Columns = (
    ("fit: median", lambda row: _of_height(row["reference_median"])),
    ("99th", lambda row: _of_height(row["reference_p99"])),
    ("worst", lambda row: _of_height(row["reference_worst"])),
)


def protocol(order: Order, table_drops: int) -> str:
    """Describe what is measured, and how."""
    return (
        f"Balls in air whose restitution falls with speed; {order.seeds_in_words}, "
        f"{order.targets} drops a cell each,\n{table_drops} of each ball of the table from "
        "each height.\n"
        "x .5, 1, 2: what slope and drag of the stranger's balls are multiplied by. fit: least "
        "squares that\nknow the model and the ranges; width, most: median and largest ratio of an "
        "interval to the fit's.\nheld: percent of the 95 % intervals that hold the truth, and how "
        "many are given.\nErrors are of all answers: verdict ok or suspect. A dash: there is none."
    )


def section_tables(section: str, rows: Sequence[Row]) -> Iterator[str]:
    """Yield a table for each quantity of a section, and one for the foretold motions."""
    reference = section == "positions"
    for quantity, words in _QUANTITIES.items():
        columns, more = (_PATHS, _REFERENCE_PATHS) if quantity == PATH else (_ERRORS, _REFERENCE)
        own = [row for row in rows if row["quantity"] == quantity]
        shown_ones = (*columns, *more) if reference else columns
        yield table(shown(shown_ones, own), f"{words}: {_TITLES[section]}")
    if reference:
        return
    names = ("ours", "the paper's", "first rebound", "best airless")
    heads = dict(zip(MOTION, names if section == "balls" else names[:1], strict=False))
    lines = [["", "answered", *heads.values()]]
    for ours in rows:
        if ours["quantity"] != "ours":
            continue
        own = {row["quantity"]: row for row in rows if row["label"] == ours["label"]}
        cells = (f"{_of_height(own[q]['mean'])}, {_of_height(own[q]['worst'])}" for q in heads)
        lines.append([ours["label"], f"{ours['answered']} of {ours['drops']}", *cells])
    yield table(
        lines,
        f"Motion error up to the last bounce in view: {_TITLES[section]}\n"
        "(mean, worst in % of the height; ours and best airless tuned on the first 60 % of the\n"
        "time, the paper's on 7 s at 60 Hz)",
    )


def _of_height(fraction: float | None) -> str:
    return percent(fraction, 1 if fraction is not None and fraction >= 0.1 else 3)
