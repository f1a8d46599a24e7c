"""Tune balls in air whose restitution falls with speed: parameters, intervals, verdicts, motion.

A stranger's balls, those of a table of kinds, and videos of both; beside the product stands a fit
that knows the model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import chain
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.evaluation.studies.video import tune_track
from tunenet_logs.analysis.evaluation.study import (
    csv_text,
    json_text,
    seeds_in_words,
    short_or_dash,
    table_line,
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
from tunenet_logs.analysis.parallel import Piece, parallel_map
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

_GRID = 121  # slopes and drags that the ranges are kept to on
_ENDS = (0.025, 0.5, 0.975)


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

    truth = drop.ball
    start = np.array([*truth.values, 0.0, drop.level_m])
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
    # the stubs know "2-point" and the like alone
    by: Any = slopes
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
    others, _ = np.linalg.qr(slopes[:, 3:])
    own = slopes[:, :3] - others @ (others.T @ slopes[:, :3])
    misfit = misfit - others @ (others.T @ misfit)
    # Given slope and drag, the restitution is normal; their own weight is what that leaves.
    unit = own[:, 0] / (own[:, 0] @ own[:, 0])
    deviation = 1 / float(np.linalg.norm(own[:, 0]))
    shift = -unit @ np.column_stack([misfit, own[:, 1:]])
    rest = np.column_stack([misfit, own[:, 1:]])
    rest = rest + np.outer(own[:, 0], shift)
    precision = rest.T @ rest

    def over(low: float, high: float, at: float, weight: float) -> Array:
        reach = 8 / np.sqrt(max(weight, 1e-12))
        return np.linspace(max(low, at - reach), min(high, at + reach), _GRID)

    ranges = np.array([np.ptp(cell.slopes), np.ptp(cell.drags_1_m)])
    spread = np.linalg.inv(precision[1:, 1:] + np.diag(ranges**-2))
    slope = over(*cell.slopes, float(best[1]), 1 / spread[0, 0])
    drag = over(*cell.drags_1_m, float(best[2]), 1 / spread[1, 1])
    off = np.stack(np.meshgrid(slope - best[1], drag - best[2], indexing="ij"))
    squares = 2 * np.einsum("a,aij->ij", precision[0, 1:], off)
    squares += np.einsum("ab,aij,bij->ij", precision[1:, 1:], off, off)
    weights = np.exp(-(squares - squares.min()) / 2) / drag
    weights /= weights.sum()
    centres = best[0] + shift[0] + np.einsum("a,aij->ij", shift[1:], off)
    found = np.array(
        [
            _normal_quantiles(centres.ravel(), deviation, weights.ravel()),
            _grid_quantiles(slope, weights.sum(axis=1)),
            _grid_quantiles(drag, weights.sum(axis=0)),
        ]
    )
    return found[:, 1], found[:, [0, 2]]


def _grid_quantiles(grid: Array, weights: Array) -> Array:
    """Return the quantiles of a density on an even grid, by trapezia, shape (3,)."""
    mass = np.concatenate([[0.0], np.cumsum((weights[1:] + weights[:-1]) / 2)])
    return np.interp(_ENDS, mass / mass[-1], grid)


def _normal_quantiles(centres: Array, deviation: float, weights: Array) -> Array:
    """Return the quantiles of a mixture of normals of one deviation, shape (3,)."""
    from scipy.special import ndtr

    kept = weights > 1e-7 * weights.max()
    centres, weights = centres[kept], weights[kept] / weights[kept].sum()
    grid = np.linspace(centres.min() - 5 * deviation, centres.max() + 5 * deviation, 401)
    mass = np.array([weights @ ndtr((at - centres) / deviation) for at in grid])
    return np.interp(_ENDS, mass, grid)


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
LIGHT_DRAGS_1_M = (0.1, 0.14)
LIGHT_RADIUS_M = 0.02  # of light balls whose kind is not named, about a table-tennis ball's
LIGHT = ("light, no slope", "light, slope")  # their names in tables
_FILM_HZ = 60.0


@dataclass(frozen=True)
class CellPortion:
    """Some of a seed's drops of a cell."""

    cell: WorldCell
    seed: int
    numbers: range


@dataclass(frozen=True, eq=False)
class Compared:
    """Results of the product and of the reference on a drop of a cell."""

    ours: Found
    reference: Found


@dataclass(frozen=True, eq=False)
class Moved:
    """Errors of each tuning's motion on a drop of the table.

    Every error is the mean distance from the release to the last bounce in view, over the drop; NaN
    where there is no answer.
    """

    ball: str  # its name
    drop_m: float  # that it fell
    ours: float  # tuned on the first `SEEN` of the time
    verdict: str  # of that tuning
    paper: float  # the preset "paper", tuned on all that it asks for, for any verdict
    first_rebound: float  # no air, the restitution that gives the first rebound's height
    best_airless: float  # no air, the restitution that is best on the first `SEEN`
    whole: Found  # what a tuning on all that is in view finds


@dataclass(frozen=True, eq=False)
class FilmedBall:
    """Video of a ball."""

    ball: str  # its name
    found: Found  # by a tuning on the whole film
    ahead: float  # mean error of the motion as in `Moved.ours`; NaN where it was not asked for


def compared_drops(portion: CellPortion) -> list[Compared]:
    """Tune each drop, and fit it by the reference."""
    found: list[Compared] = []
    for number in portion.numbers:
        drop = draw_drop(portion.cell, portion.seed, number)
        ours = found_by(tune_episode(drop.episode(), TuneOptions()), drop)
        found.append(Compared(ours, reference_found(drop, portion.cell)))
    return found


def reference_found(drop: RecordedDrop, cell: WorldCell) -> Found:
    """Fit a drop by the reference."""
    fit = fit_reference(drop, cell)
    seconds = drop.seconds[(drop.seconds >= 0) & (drop.seconds <= drop.last_bounce_s)]
    off = (fit.heights_m(seconds) - drop.truth_m(seconds)) / drop.ball.drop_m
    path = float(np.sqrt(np.mean(off**2)))
    return Found(drop.ball.values[:3], fit.values, fit.interval95, "", path)


def moved_drops(asked: tuple[TableBall, int, int]) -> list[Moved]:
    """Measure the motion of a ball, for a seed and a number of drops from each height."""
    ball, seed, count = asked
    found: list[Moved] = []
    for drop in table_drops(ball, seed, count):
        view = drop.view
        seen = view.until(SEEN * view.last_bounce_s)
        ahead = tune_episode(seen.episode(), TuneOptions())
        paper = tune_episode(drop.whole.episode(), TuneOptions(preset="paper"))
        found.append(
            Moved(
                ball=ball.name,
                drop_m=view.ball.drop_m,
                ours=_mean_error(off_motion(ahead, view)),
                verdict=ahead.verdict,
                paper=_mean_error(off_path(paper, drop.whole.until(view.last_bounce_s))),
                first_rebound=_mean_error(airless_off(first_rebound(view), view)),
                best_airless=_mean_error(airless_off(best_of_all(seen), view)),
                whole=found_by(tune_episode(view.episode(), TuneOptions()), view),
            )
        )
    return found


def filmed_table(asked: tuple[TableBall, int, int]) -> list[FilmedBall]:
    """Measure as `moved_drops`, on videos."""
    ball, seed, count = asked
    found: list[FilmedBall] = []
    for at, drop in enumerate(table_drops(ball, seed, count)):
        view = drop.view
        rng = np.random.default_rng([seed, at, *b"film", *ball.name.encode()])
        track = filmed(view, ball.diameter_m / 2, rng)
        rng = np.random.default_rng([seed, at, *b"film", *ball.name.encode()])
        seen = filmed(view.until(SEEN * view.last_bounce_s), ball.diameter_m / 2, rng)
        ahead = tune_track(seen, TuneOptions())
        whole = found_by(tune_track(track, TuneOptions()), view)
        found.append(FilmedBall(ball.name, whole, _mean_error(off_motion(ahead, view))))
    return found


def filmed_light(asked: tuple[bool, int, range]) -> list[FilmedBall]:
    """Tune videos of light balls that are not named: with a slope or none, of a seed."""
    slopes, seed, numbers = asked
    found: list[FilmedBall] = []
    for number in numbers:
        rng = np.random.default_rng([seed, number, *b"light"])
        ball = RealBall(
            rng.uniform(*RESTITUTIONS),
            rng.uniform(*SLOPES) * slopes,
            rng.uniform(*LIGHT_DRAGS_1_M),
            rng.uniform(*DROPS_M),
        )
        drop = record_drop(ball, _FILM_HZ, 0.0, rng)
        tuning = tune_track(filmed(drop, LIGHT_RADIUS_M, rng), TuneOptions())
        found.append(FilmedBall(LIGHT[slopes], found_by(tuning, drop), np.nan))
    return found


def _mean_error(off: Array | None) -> float:
    return np.nan if off is None or not len(off) else float(np.mean(np.abs(off)))


# ---- Figures of a line: errors with the worst beside the mean, intervals, verdicts.


PATH = "path"
# Quantities beside the parameters; see `Found` and `Moved`.
MOTION = ("ours", "paper", "first_rebound", "best_airless")


Shares = tuple[float | None, float | None, float | None]  # of the verdicts, in their order


@dataclass(frozen=True)
class Spread:
    """Statistics of absolute errors; None where there is none."""

    mean: float | None  # over all that were answered
    median: float | None  # likewise
    p99: float | None  # 99th percentile
    worst: float | None  # largest


@dataclass(frozen=True)
class RealLine:
    """Results of drops of one kind, for one quantity. Fractions; None where there is none."""

    section: str  # of the evaluation
    label: str  # the kind
    quantity: str  # one of `PARAMETERS`, `PATH`, or one of `MOTION`
    drops: int  # how many there were
    answered: int  # how many got a value
    ok: float | None  # share of that verdict; `suspect` and `rejected` likewise
    suspect: float | None
    rejected: float | None
    ours: Spread  # errors: of a path or a motion over the drop height, of a drag in 1/m
    reference: Spread  # those of the fit that knows the model
    intervals: int = 0  # how many 95 % intervals are given
    covered: float | None = None  # of these, how many hold the truth
    reference_covered: float | None = None  # of the reference's
    width: float | None = None  # median of an interval's width over the reference's
    widest: float | None = None  # the largest of these


NONE = Spread(None, None, None, None)


def compared_lines(label: str, drops: Sequence[Compared]) -> list[RealLine]:
    """Return a line for each parameter and the path."""
    ours = [drop.ours for drop in drops]
    return found_lines("positions", label, ours, [drop.reference for drop in drops])


def moved_lines(label: str, drops: Sequence[Moved]) -> list[RealLine]:
    """Return a line for each parameter, the path and each tuning's motion."""
    lines = found_lines("balls", label, [drop.whole for drop in drops])
    shares = _verdicts([drop.verdict for drop in drops])
    for name in MOTION:
        off = np.array([getattr(drop, name) for drop in drops])
        verdicts = shares if name == "ours" else (None, None, None)
        lines.append(_line("balls", label, name, off, verdicts))
    return lines


def filmed_lines(label: str, films: Sequence[FilmedBall]) -> list[RealLine]:
    """Return a line for each parameter and the path, and one for a table ball's motion."""
    lines = found_lines("films", label, [film.found for film in films])
    if label in LIGHT:
        return lines
    off = np.array([film.ahead for film in films])
    return [*lines, _line("films", label, "ours", off, (None, None, None))]


def found_lines(
    section: str, label: str, ours: Sequence[Found], reference: Sequence[Found] = ()
) -> list[RealLine]:
    """Return a line for each parameter and one for the path."""
    shares = _verdicts([found.verdict for found in ours])
    lines = [_parameter_line((section, label), at, ours, reference, shares) for at in range(3)]
    off, best = (np.array([found.path for found in some]) for some in (ours, reference))
    return [*lines, _line(section, label, PATH, off, shares, best)]


def spread_of(errors: Array) -> Spread:
    """Compute the statistics of errors, shape (N,); NaN where there is no answer."""
    known = np.abs(errors[np.isfinite(errors)])
    if not len(known):
        return NONE
    middle, high = np.percentile(known, [50, 99])
    return Spread(float(known.mean()), float(middle), float(high), float(known.max()))


def _parameter_line(
    where: tuple[str, str],
    at: int,
    ours: Sequence[Found],
    reference: Sequence[Found],
    shares: Shares,
) -> RealLine:
    truth, values, ends = _columns(ours, at)
    told = np.isfinite(ends[:, 0])
    widths = np.array([])
    covered, best = None, np.array([])
    if reference:
        _, best_values, best_ends = _columns(reference, at)
        best, covered = best_values - truth, _mean(_holds(best_ends, truth))
        widths = (np.ptp(ends, axis=1) / np.ptp(best_ends, axis=1))[told]
    line = _line(*where, PARAMETERS[at], values - truth, shares, best)
    return replace(
        line,
        intervals=int(told.sum()),
        covered=_mean(_holds(ends, truth)[told]),
        reference_covered=covered,
        width=float(np.median(widths)) if len(widths) else None,
        widest=float(widths.max()) if len(widths) else None,
    )


def _columns(found: Sequence[Found], at: int) -> tuple[Array, Array, Array]:
    """Return truth and value, shape (N,), and interval, shape (N, 2), of a parameter."""
    return (
        np.array([one.truth[at] for one in found]),
        np.array([one.values[at] for one in found]),
        np.array([one.interval95[at] for one in found]).reshape(-1, 2),
    )


def _line(
    section: str,
    label: str,
    quantity: str,
    off: Array,
    shares: Shares,
    reference: Array | None = None,
) -> RealLine:
    answered = int(np.isfinite(off).sum())
    best = NONE if reference is None else spread_of(reference)
    return RealLine(section, label, quantity, len(off), answered, *shares, spread_of(off), best)


def _verdicts(verdicts: Sequence[str]) -> Shares:
    ok, suspect, rejected = (
        _mean(np.array([one == name for one in verdicts])) for name in VERDICTS
    )
    return ok, suspect, rejected


def _holds(ends: Array, truth: Array) -> NDArray[np.bool_]:
    return (ends[:, 0] <= truth) & (truth <= ends[:, 1])


def _mean(holds: NDArray[np.bool_]) -> float | None:
    return float(holds.mean()) if len(holds) else None


# ---- Run: the stranger's balls, those of the table, and videos.


Asked = TypeVar("Asked")
Result = TypeVar("Result")

_PORTION = 5  # drops in a portion: few, so that the processes end together
_TARGETS_A_TABLE_DROP = 50  # drops of a cell for each drop of a ball of the table from one height


@dataclass(frozen=True)
class RealOrder:
    """Settings of the experiment."""

    seeds: tuple[int, ...]  # each draws its own drops
    targets: int  # drops of each cell for each seed; of balls of the table fewer in proportion
    jobs: int | None = None  # processes; None for all cores

    @property
    def table_drops(self) -> int:
        """Drops of a ball of the table for each height and seed."""
        return max(1, self.targets // _TARGETS_A_TABLE_DROP)

    @property
    def portions(self) -> list[tuple[int, range]]:
        """Targets of all seeds, in portions."""
        return [
            (seed, range(at, min(at + _PORTION, self.targets)))
            for seed in self.seeds
            for at in range(0, self.targets, _PORTION)
        ]


def position_lines(order: RealOrder, progress: Progress) -> list[RealLine]:
    """Run the stranger's balls, cell by cell."""
    asked = {
        cell.label: [(CellPortion(cell, *one), len(one[1])) for one in order.portions]
        for cell in CELLS
    }
    return _lines(compared_drops, asked, compared_lines, order, progress)


def ball_lines(order: RealOrder, progress: Progress) -> list[RealLine]:
    """Run the table's balls."""
    asked = {ball.name: _table(order, ball) for ball in TABLE_BALLS}
    return _lines(moved_drops, asked, moved_lines, order, progress)


def film_lines(order: RealOrder, progress: Progress) -> list[RealLine]:
    """Run videos of the table's balls, and of light ones that are not named."""
    asked = {ball.name: _table(order, ball) for ball in TABLE_BALLS}
    lines = _lines(filmed_table, asked, filmed_lines, order, progress)
    light = {
        label: [((bool(slopes), *one), len(one[1])) for one in order.portions]
        for slopes, label in enumerate(LIGHT)
    }
    return [*lines, *_lines(filmed_light, light, filmed_lines, order, progress)]


def _table(order: RealOrder, ball: Asked) -> list[tuple[tuple[Asked, int, int], int]]:
    count = order.table_drops
    return [((ball, seed, count), count * len(HEIGHTS_M)) for seed in order.seeds]


def _lines(
    work: Callable[[Asked], list[Result]],
    asked: dict[str, list[tuple[Asked, int]]],
    lines: Callable[[str, Sequence[Result]], list[RealLine]],
    order: RealOrder,
    progress: Progress,
) -> list[RealLine]:
    """Return `lines` of each label, of what `work` makes of what is asked."""
    pieces = [Piece(item, units, label) for label, some in asked.items() for item, units in some]
    done = iter(parallel_map(work, pieces, order.jobs, progress, ("real balls", "drop")))
    found: list[RealLine] = []
    for label, some in asked.items():
        found += lines(label, list(chain.from_iterable(next(done) for _ in some)))
    return found


# ---- JSON and CSV: one record a line and quantity.


_SPREADS = ("ours", "reference")
# Of the CSV: the errors without a prefix are ours.
COLUMNS = (
    *(field.name for field in fields(RealLine) if field.name not in _SPREADS),
    *(field.name for field in fields(Spread)),
    *(f"reference_{field.name}" for field in fields(Spread)),
)


def real_records(lines: Sequence[RealLine]) -> list[dict[str, Any]]:
    """Return one record for each line; see `COLUMNS`."""
    records: list[dict[str, Any]] = []
    for line in lines:
        record = asdict(line)
        ours, reference = (record.pop(name) for name in _SPREADS)
        named = {f"reference_{name}": value for name, value in reference.items()}
        records.append({**record, **ours, **named})
    return records


def real_json(lines: Sequence[RealLine], order: RealOrder) -> str:
    """Serialise every figure; null where there is none."""
    head = {"experiment": "real-balls", "seeds": list(order.seeds), "targets": order.targets}
    return json_text({**head, "rows": real_records(lines)})


def real_csv(lines: Sequence[RealLine]) -> str:
    """Format `real_records` as a table; an empty field where there is no figure."""
    return csv_text(COLUMNS, real_records(lines))


# ---- Tables for a terminal.


_FIRST = 17  # width of the labels [characters]
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
_MOTION_HEADS = ("ours", "the paper's", "first rebound", "best airless")

Column = tuple[str, int, Callable[[RealLine], str]]


def _percent(fraction: float | None) -> str:
    return "-" if fraction is None else f"{100 * fraction:.1f}"


def _held(line: RealLine) -> str:
    return "-" if line.covered is None else f"{_percent(line.covered)} ({line.intervals})"


def _ratio(ratio: float | None) -> str:
    return "-" if ratio is None else f"{ratio:.2f}"


_REFERENCE: tuple[Column, ...] = (
    ("fit: mean", 10, lambda line: short_or_dash(line.reference.mean)),
    ("worst", 7, lambda line: short_or_dash(line.reference.worst)),
    ("held", 6, lambda line: _percent(line.reference_covered)),
    ("width", 6, lambda line: _ratio(line.width)),
    ("most", 6, lambda line: _ratio(line.widest)),
)
_ERRORS: tuple[Column, ...] = (
    ("drops", 6, lambda line: str(line.drops)),
    ("ok", 7, lambda line: _percent(line.ok)),
    ("suspect", 8, lambda line: _percent(line.suspect)),
    ("mean", 7, lambda line: short_or_dash(line.ours.mean)),
    ("worst", 7, lambda line: short_or_dash(line.ours.worst)),
    ("held", 12, _held),
)
_PATHS: tuple[Column, ...] = (
    ("answered", 9, lambda line: str(line.answered)),
    ("mean", 7, lambda line: _of_height(line.ours.mean)),
    ("median", 7, lambda line: _of_height(line.ours.median)),
    ("99th", 7, lambda line: _of_height(line.ours.p99)),
    ("worst", 7, lambda line: _of_height(line.ours.worst)),
)
_REFERENCE_PATHS: tuple[Column, ...] = (
    ("fit: median", 12, lambda line: _of_height(line.reference.median)),
    ("99th", 7, lambda line: _of_height(line.reference.p99)),
    ("worst", 7, lambda line: _of_height(line.reference.worst)),
)


def protocol(order: RealOrder) -> str:
    """Describe what is measured, and how."""
    return (
        f"Balls in air whose restitution falls with speed; {seeds_in_words(order.seeds)}, "
        f"{order.targets} drops a cell each,\n{order.table_drops} of each ball of the table from "
        "each height.\n"
        "x .5, 1, 2: what slope and drag of the stranger's balls are multiplied by. fit: least "
        "squares that\nknow the model and the ranges; width, most: median and largest ratio of an "
        "interval to the fit's.\nheld: percent of the 95 % intervals that hold the truth, and how "
        "many are given.\nErrors are of all answers: verdict ok or suspect. A dash: there is none."
    )


def section_blocks(section: str, lines: Sequence[RealLine]) -> Iterator[str]:
    """Yield a table for each quantity of a section."""
    reference = section == "positions"
    for quantity in (*PARAMETERS, PATH):
        if quantity == PATH:
            columns = (*_PATHS, *(_REFERENCE_PATHS if reference else ()))
        else:
            columns = (*_ERRORS, *(_REFERENCE if reference else ()))
        title = f"{_QUANTITIES[quantity]}: {_TITLES[section]}"
        rows = [line for line in lines if line.quantity == quantity]
        yield "\n".join([title, *_table_lines(columns, rows)])
    if section != "positions":
        yield motion_table(section, lines)


def motion_table(section: str, lines: Sequence[RealLine]) -> str:
    """Tabulate the predicted motion by each tuning."""
    names = MOTION if section == "balls" else MOTION[:1]
    heads = _MOTION_HEADS[: len(names)]
    widths = (_FIRST, 10, *[18] * len(names))
    text = [
        f"Motion error up to the last bounce in view: {_TITLES[section]}",
        "(mean, worst in % of the height; ours and best airless tuned on the first 60 % of the",
        "time, the paper's on 7 s at 60 Hz)",
        table_line(["", "answered", *heads], widths),
    ]
    known = [line for line in lines if line.quantity in MOTION]
    for label in dict.fromkeys(line.label for line in known):
        own = {line.quantity: line for line in known if line.label == label}
        first = own["ours"]
        cells = [_pair(own[name].ours) for name in names]
        text.append(table_line([label, f"{first.answered} of {first.drops}", *cells], widths))
    return "\n".join(text)


def _table_lines(columns: Sequence[Column], rows: Sequence[RealLine]) -> list[str]:
    widths = [_FIRST, *(width for _, width, _ in columns)]
    head = table_line(["", *(name for name, _, _ in columns)], widths)
    return [
        head,
        *(table_line([row.label, *(show(row) for _, _, show in columns)], widths) for row in rows),
    ]


def _of_height(fraction: float | None) -> str:
    if fraction is None:
        return "-"
    percent = 100 * fraction
    return f"{percent:.1f}" if percent >= 10 else f"{percent:.3f}"


def _pair(errors: Spread) -> str:
    return f"{_of_height(errors.mean)}, {_of_height(errors.worst)}"
