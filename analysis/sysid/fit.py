"""Fit a simulator to a log: multi-start least squares, hold-out, and intervals.

Columns of log and rollout are paired by name. Levenberg-Marquardt descends by finite differences of
rollouts. The sandwich covariance gives intervals, widened where a profile likelihood or half the
time step says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.estimators.base import FitResult
from tunenet_logs.analysis.estimators.damped import Damping, damped_step
from tunenet_logs.analysis.record import Gap, Posterior
from tunenet_logs.episode import Array, Episode
from tunenet_logs.errors import NotFoundError
from tunenet_logs.recorders.simulators.base import Parameter

# ---- Columns of a log and of a rollout, paired by name, at the log's stamps

_MIN_SAMPLES = 20  # of one column


@dataclass(frozen=True, eq=False)
class Column:
    """One column of one signal in the log."""

    signal: str  # its signal's name
    name: str  # its own
    unit: str  # of its values
    seconds: Array  # since the first stamp that is compared, shape (T,), increasing
    values: Array  # shape (T,), finite
    noise: float  # standard deviation of what is faster than any motion
    spread: float  # standard deviation of its values

    @property
    def label(self) -> str:
        """Title of the column."""
        return f"{self.signal} {self.name}"

    @property
    def is_place(self) -> bool:
        """Whether it is a position or an angle, as which alone a motion goes astray."""
        return self.unit in ("m", "rad", "1")

    @property
    def is_jumpy(self) -> bool:
        """Whether it jumps with each sample, as a servo's efforts do, or is noise."""
        return self.noise > 0.25 * self.spread


@dataclass(frozen=True, eq=False)
class ComparedColumns:
    """All columns that a log and the rollouts share."""

    start_ns: int  # stamp that seconds count from
    columns: tuple[Column, ...]  # at least one

    @cached_property
    def end_s(self) -> float:
        """Last stamp."""
        return max(float(column.seconds[-1]) for column in self.columns)

    @cached_property
    def seconds(self) -> Array:
        """Stamps of all values, column by column, shape (N,)."""
        return np.concatenate([column.seconds for column in self.columns])

    @cached_property
    def values(self) -> Array:
        """All observed values, column by column, shape (N,)."""
        return np.concatenate([column.values for column in self.columns])

    @cached_property
    def which(self) -> NDArray[np.intp]:
        """Column index of each value, shape (N,)."""
        counts = [len(column.values) for column in self.columns]
        return np.repeat(np.arange(len(counts), dtype=np.intp), counts)

    def per_value(self, by_column: Sequence[float] | Array) -> Array:
        """Repeat one number per column for each of its values, shape (N,)."""
        return np.asarray(by_column, dtype=np.float64)[self.which]

    def clock_of(self, rollout: Episode) -> int:
        """Return the stamp of a rollout's that the seconds count from: the log's, or its first.

        A simulator may have a clock of its own.
        """
        shown = {column.signal for column in self.columns}
        stamps = [one.stamps_ns for name, one in rollout.signals.items() if name in shown]
        stamps = [one for one in stamps if len(one)]
        first_ns = min((int(one[0]) for one in stamps), default=self.start_ns)
        last_ns = max((int(one[-1]) for one in stamps), default=self.start_ns)
        return self.start_ns if first_ns <= self.start_ns <= last_ns else first_ns

    def seen_in(self, rollout: Episode) -> Array:
        """Interpolate a rollout at the same stamps, shape (N,); NaN where it has nothing."""
        found: list[Array] = []
        start_ns = self.clock_of(rollout)
        for column in self.columns:
            signal, track = rollout.signals.get(column.signal), np.full(len(column.seconds), np.nan)
            if signal is not None and column.name in signal.columns and len(signal.stamps_ns):
                at_s, values = (signal.stamps_ns - start_ns) * 1e-9, signal.values
                track = values[:, signal.columns.index(column.name)]
                track = np.interp(column.seconds, at_s, track, left=np.nan, right=np.nan)
            found.append(track)
        return np.concatenate(found)

    def between(self, from_s: float, until_s: float) -> NDArray[np.bool_]:
        """Return which values lie in a part of the log, its end excluded, shape (N,)."""
        return (self.seconds >= from_s) & (self.seconds < until_s)

    def part(self, from_s: float, until_s: float) -> ComparedColumns:
        """Cut out a part, whose seconds count from its own first stamp; NotFoundError if empty."""
        kept = [(one.seconds >= from_s) & (one.seconds < until_s) for one in self.columns]
        cut = [(one, keep) for one, keep in zip(self.columns, kept, strict=True) if keep.any()]
        if not cut:
            raise NotFoundError(f"nothing is seen from {from_s:.2f} to {until_s:.2f} s")
        first_ns = min(round(float(one.seconds[keep][0]) * 1e9) for one, keep in cut)
        columns = tuple(
            replace(
                one,
                seconds=1e-9 * (np.round(one.seconds[keep] * 1e9) - first_ns),
                values=one.values[keep],
            )
            for one, keep in cut
        )
        return ComparedColumns(self.start_ns + first_ns, columns)

    def columns_at(self, chosen: NDArray[np.bool_]) -> ComparedColumns:
        """Return whole columns, by which values they have, shape (N,); seconds from their first."""
        numbers = np.unique(self.which[chosen])
        first_s = min(float(self.columns[number].seconds[0]) for number in numbers)
        columns = [self.columns[number] for number in numbers]
        kept = tuple(replace(one, seconds=one.seconds - first_s) for one in columns)
        return ComparedColumns(self.start_ns + round(first_s * 1e9), kept)

    def rms(self, residuals: Array, chosen: Array | NDArray[np.bool_] | None = None) -> Array:
        """Return the root mean square by column, shape (C,), of values of shape (N,).

        `chosen` tells which count, or how much each counts.
        """
        good = np.isfinite(residuals)
        counts = np.where(good, 1.0 if chosen is None else chosen, 0.0)
        squares = counts * np.where(good, residuals, 0.0) ** 2
        sums = np.bincount(self.which, squares, minlength=len(self.columns))
        weights = np.bincount(self.which, counts, minlength=len(self.columns))
        return np.sqrt(sums / np.where(weights > 0, weights, 1.0))


def compared(observed: Episode, rollout: Episode) -> ComparedColumns:
    """Pair the columns that a log and a rollout of the simulator share."""
    shared: list[tuple[str, str]] = []
    for name, signal in rollout.signals.items():
        seen = observed.signals.get(name)
        if seen is not None:
            shared += [(name, column) for column in signal.columns if column in seen.columns]
    if not shared:
        there, wanted = sorted(observed.signals), sorted(rollout.signals)
        raise NotFoundError(
            f"the log and the simulator share no signal (log: {', '.join(there[:5]) or 'none'}; "
            f"simulator: {', '.join(wanted[:5]) or 'none'})",
            "name the simulator's signals and columns as the log's",
        )
    start_ns = min(int(observed.signals[name].stamps_ns[0]) for name, _ in shared)
    columns: list[Column] = []
    for name, column in shared:
        signal = observed.signals[name]
        values = signal.values[:, signal.columns.index(column)]
        good = np.flatnonzero(np.isfinite(values))
        noise = noise_of(values[good])
        spread = float(np.std(values[good])) if len(good) else 0.0
        # More are thinned: neighbours tell the same.
        good = good[:: max(-(-len(good) // 20_000), 1)]
        seconds = 1e-9 * (signal.stamps_ns[good] - start_ns).astype(np.float64)
        columns.append(Column(name, column, signal.unit, seconds, values[good], noise, spread))
    kept = tuple(column for column in columns if len(column.values) >= _MIN_SAMPLES)
    if not kept:
        most = max(len(column.values) for column in columns)
        raise NotFoundError(
            f"{shared[0][0]}: {most} samples are too few to tune from",
            f"record {_MIN_SAMPLES} or more",
        )
    return ComparedColumns(start_ns, kept)


def noise_of(values: Array) -> float:
    """Estimate the standard deviation of white noise in a sampled curve, by third differences.

    What is smooth over four samples has none; a step of the values' resolution is the least.
    """
    if len(values) < 5:
        return 0.0
    # Third differences have 1 + 9 + 9 + 1 times the variance of white noise.
    noise = 1.4826 * float(np.median(np.abs(np.diff(values, 3)))) / np.sqrt(20.0)  # of the median
    steps = np.abs(np.diff(np.unique(values)))
    resolution = float(steps.min()) / np.sqrt(12.0) if len(steps) else 0.0
    return max(noise, resolution)


def noises_of(target: ComparedColumns, residuals: Array) -> Array:
    """Return the noise of each column, shape (C,), by what a simulator leaves of it, shape (M,).

    A servo's efforts jump with each command: by themselves they look like noise, of a size at which
    any simulator would match. So of a column that jumps it is that of its residual.
    """
    found: list[float] = []
    for number, column in enumerate(target.columns):
        own = residuals[target.which == number]
        noise = noise_of(own[np.isfinite(own)]) if column.is_jumpy else column.noise
        found.append(min(noise, column.noise))
    return np.array(found)


# ---- How a small error of the start grows

GROWTH = 10.0  # of an error of the start, from which on little is predicted
GROWN = 30.0  # from which on a fit begins anew
BINS = 200  # of time, over which growth is told
_CHANGES = 10  # that a log has at least, of a part that is compared with what follows


def _bins_of(target: ComparedColumns) -> NDArray[np.intp]:
    """Return the bin of time of each value, shape (N,)."""
    return np.minimum((target.seconds / max(target.end_s, 1e-9) * BINS).astype(np.intp), BINS - 1)


def growth(target: ComparedColumns, changes: Array) -> tuple[Array, Array]:
    """Return how many times as large errors of a start are, by bins of time: all, and the worst.

    `changes` is what an error of each number of the start changes, in spreads, shape (S, N). It is
    measured against the largest that it is until the motion has changed by its own size: an error
    of a speed is none of a place at first.
    """
    place = _bins_of(target)
    counts = np.maximum(np.bincount(place, minlength=BINS), 1)
    squares = [np.bincount(place, row**2, minlength=BINS) for row in changes]
    error = np.sqrt(np.array(squares).reshape(-1, BINS) / counts)
    first = max(int(BINS * _changes_s(target) / max(target.end_s, 1e-9)), 1)
    begins = np.maximum(error[:, :first].max(axis=1, initial=0.0), 1e-12)
    every = np.linalg.norm(error, axis=0)
    every /= max(float(every[:first].max()), 1e-12)
    return every, (error / begins[:, None]).max(axis=0, initial=0.0)


def _changes_s(target: ComparedColumns) -> float:
    """Return the time in which the fastest column changes by its standard deviation, rms."""
    found = [target.end_s / _CHANGES]
    for one in target.columns:
        spread = float(np.std(one.values))
        if spread < 3.0 * one.noise:
            continue
        for lag in range(1, max(len(one.values) // _CHANGES, 2)):
            if np.mean((one.values[lag:] - one.values[:-lag]) ** 2) >= spread**2:
                found.append(float(np.median(one.seconds[lag:] - one.seconds[:-lag])))
                break
    return min(found)


# ---- Finite differences of rollouts: slopes, second differences, and the cost's minimum


@dataclass(frozen=True, eq=False)
class Differences:
    """Finite differences about one place, each of P parameters moved alone."""

    place: Array  # values, shape (P,)
    residuals: Array  # there, shape (M,)
    moved: Array  # step of each parameter to one side, shape (P,)
    beside: Array  # residuals there, shape (P, M)
    # Step to the other side, below 0 where `moved` is above; 0 at a bound; None if one-sided; (P,).
    back: Array | None = None
    behind: Array | None = None  # residuals there, shape (P, M)

    @cached_property
    def slopes(self) -> Array:
        """Jacobian of the residuals by the parameters, shape (M, P)."""
        if self.back is None or self.behind is None:
            return ((self.beside - self.residuals) / self.moved[:, None]).T
        return ((self.beside - self.behind) / (self.moved - self.back)[:, None]).T

    @cached_property
    def bends(self) -> Array:
        """Second differences of the residuals, shape (P, M); 0 where one side is missing."""
        if self.back is None or self.behind is None:
            return np.zeros_like(self.beside)
        bends = self.beside + self.behind - 2 * self.residuals
        return np.where(self.back[:, None] != 0, bends, 0.0)

    def lowest(self, cost: Callable[[Array, Array], float], least: float) -> Array | None:
        """Minimise the cost along one parameter by a parabola through three rollouts, shape (P,).

        The most promising one that lowers the cost by `least`, or None. Slopes over a kink may
        point uphill where it does not.
        """
        if self.back is None or self.behind is None:
            return None
        middle = cost(self.residuals, self.place)
        best: Array | None = None
        for number in np.flatnonzero(self.back).tolist():
            sides: list[tuple[float, float]] = []
            for by, seen in ((self.moved, self.beside), (self.back, self.behind)):
                there = self.place.copy()
                there[number] += by[number]
                sides.append((float(by[number]), cost(seen[number], there)))
            (down, low), (up, high) = sorted(sides)
            falls, rises = (middle - low) / -down, (high - middle) / up
            bend = 2 * (rises - falls) / (up - down)
            slope = (falls * up - rises * down) / (up - down)
            if bend <= 0 or slope**2 / (2 * bend) <= least:
                continue
            least = slope**2 / (2 * bend)
            best = self.place.copy()
            best[number] += np.clip(-slope / bend, down, up)
        return best


# ---- Which values a parameter moves: those that move others are moved in one rollout


@dataclass(frozen=True, eq=False)
class Reach:
    """Which of M values each of P parameters moves."""

    only: NDArray[np.bool_]  # these and no other, shape (P, M)
    mostly: NDArray[np.bool_]  # others little, as a servo does other joints, shape (P, M)

    @cached_property
    def is_rough(self) -> bool:
        """Whether what is mostly moved is less than all."""
        return not np.array_equal(self.only, self.mostly)


def reach_of(
    parameters: Sequence[Parameter],
    target: ComparedColumns,
    logs: tuple[tuple[str, ...], NDArray[np.intp]] | None,
    joints: Mapping[str, str],
) -> Reach:
    """Tell it by names: a start is of one log, `joints` are those of servos by their addresses."""
    every = np.ones((len(parameters), len(target.values)), np.bool_)
    mostly = every.copy()
    for number, one in enumerate(parameters):
        log, mark, address = one.name.rpartition(": ")
        if mark and logs is not None:
            every[number] = logs[1] == logs[0].index(log)
        own = np.array([column.name == joints.get(address) for column in target.columns])
        mostly[number] = every[number] & own[target.which] if own.any() else every[number]
    return Reach(every, mostly)


def _groups(
    mask: NDArray[np.bool_] | None, count: int
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Group parameters that move no value both, (G, P), and return what each moves, (P, M or 1)."""
    if mask is None:
        return np.eye(count, dtype=np.bool_), np.ones((count, 1), np.bool_)
    groups, taken = list[NDArray[np.bool_]](), list[NDArray[np.bool_]]()
    for number, own in enumerate(mask):
        place = next((at for at, one in enumerate(taken) if not (one & own).any()), len(groups))
        if place == len(groups):
            groups.append(np.zeros(count, np.bool_))
            taken.append(np.zeros(mask.shape[1], np.bool_))
        groups[place][number], taken[place] = True, taken[place] | own
    return np.array(groups), mask


# ---- Nonlinear least squares by rollouts: Levenberg-Marquardt
# The columns' noise is not known beforehand: in the end, each is weighted by its residual.

# Rollouts at values of shape (N, P) -> what they show at the log's stamps, shape (N, M).
Run = Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class Begun:
    """Simulator that begins anew inside a log, with the state that the log shows there."""

    target: ComparedColumns  # what is compared, from there to the end that was asked for
    starts: tuple[Parameter, ...]  # S of that state
    run: Run  # rollouts at values of the T tuned parameters and of the state, shape (N, T + S)
    finer: Run | None = None  # likewise with half the time step


# From the T tuned values whenever an error of the start has grown far, or None: in the middle of
# each log. Which values, shape (M,), are seen from each begin; none where it cannot.
Shots = Sequence[tuple[NDArray[np.bool_], Begun]]
Anew = Callable[[Array | None], Shots]

_FIRST_DAMPING = 1e-4
_DAMPING = Damping(tries=7, raised_by=10, lowered_by=30, least=1e-7, raised_from=1e-3)
_NO_GAIN = 0.05  # of the cost: a step that lowers it by less is the last
_LOWER = 0.95  # of the cost of an end: one as low is the same
_AMISS = 0.2  # of the gain that slopes promise: with more error they are differenced anew


@dataclass(frozen=True, eq=False)
class Solution:
    """Least-squares solution."""

    values: Array  # of all parameters, shape (P,)
    residuals: Array  # simulated less observed, shape (M,)
    slopes: Array  # Jacobian of the rollouts, shape (M, P)
    noise: Array  # RMS residual of each column, shape (C,)
    path: tuple[Array, ...]  # the values of each step, the start first
    chosen: Array  # how much each of the M values counted, 0 to 1
    bends: Array  # second differences of the rollouts, by the parameters, shape (P, M)
    together: float = 1.0  # how many neighbouring residuals count as one, beside a weak prior


def ranges_of(parameters: Sequence[Parameter]) -> Array:
    """Return each parameter's scale: its range, or its prior's sd; shape (P,)."""
    widths = [
        one.training_range[1] - one.training_range[0] if one.prior_sd is None else one.prior_sd
        for one in parameters
    ]
    return np.array(widths)


def precisions_of(parameters: Sequence[Parameter], together: float) -> Array:
    """Return the precision of each parameter's prior, shape (P,); 0 without one.

    The samples are weighed as if each told something new. What others of its kind have is weighed
    by as much more as neighbours tell the same (a tempered likelihood).
    """
    found = np.zeros(len(parameters))
    for place, one in enumerate(parameters):
        if one.prior_sd is not None:
            found[place] = one.prior_sd**-2
        elif one.usual is not None:
            found[place] = together * one.usual[1] ** -2
    return found


def correlation_length(values: Array) -> float:
    """Return the samples over which a series hangs together, 1 or more (Sokal's window)."""
    power = np.abs(np.fft.rfft(values, 2 * len(values))) ** 2
    shared = np.fft.irfft(power)[: len(values)]
    if len(values) < 2 or shared[0] <= 0:
        return 1.0
    sums = 2 * np.cumsum(shared / shared[0]) - 1
    inside = np.flatnonzero(np.arange(len(sums)) >= 5 * sums)
    return max(float(sums[inside[0] if len(inside) else -1]), 1.0)


@dataclass(eq=False)
class RolloutLeastSquares:
    """Least squares on one log."""

    run: Run  # makes rollouts
    target: ComparedColumns  # columns to compare with
    parameters: tuple[Parameter, ...]  # all that are fitted, P of them
    fitted: NDArray[np.bool_] | None = None  # which values it is fitted to, shape (M,); None: all
    counts: Array | None = None  # how much each value counts, 0 to 1, shape (M,); None: all alike
    reach: Reach | None = None  # which values each parameter moves; None: all
    is_rough: bool = False  # whether slopes stay those of `Reach.mostly` to the end

    def __post_init__(self) -> None:
        self._apart = _groups(self.reach.mostly if self.reach else None, len(self.parameters))
        self._scales = ranges_of(self.parameters)
        self._bounds = np.array([one.bounds for one in self.parameters]).T
        self._centres = np.array(
            [one.usual[0] if one.usual else one.initial for one in self.parameters]
        )
        self._is_start = np.array([one.prior_sd is not None for one in self.parameters])
        self._together = 1.0
        every = np.ones(len(self.target.values)) if self.counts is None else self.counts
        self.chosen = every if self.fitted is None else every * self.fitted
        self._spread = np.array([column.spread for column in self.target.columns])
        # A simulator is never weighed as more exact than this share of a column's spread.
        self._floor = np.maximum(1e-3 * self._spread, 1e-12)
        # Of the finite differences, by a parameter's range or prior: least, most, and first.
        self._least = 1e-5 * self._scales
        self._most = np.where(self._is_start, 1.0, 2e-2) * self._scales
        self._steps = np.where(self._is_start, 0.2, 3e-3) * self._scales
        self._known: Differences | None = None

    @property
    def _precision(self) -> Array:
        """Precision of each parameter's prior, shape (P,); 0 without one."""
        return precisions_of(self.parameters, self._together)

    def residuals(self, values: Array) -> Array:
        """Return simulated less observed, (N, M), at values of shape (N, P)."""
        off = self.run(values) - self.target.values
        # Where a rollout has diverged, a sample counts as three spreads off.
        lost = self.target.per_value(3.0 * self._spread)
        return np.where(np.isfinite(off), off, lost)

    def cost(self, residuals: Array, values: Array, noise: Array) -> float:
        """Return twice the negative log likelihood and prior, up to a constant, at values (P,)."""
        scaled = residuals / self.target.per_value(noise)
        fit = float(np.sum(self.chosen * scaled**2))
        return fit + float(np.sum(self._precision * (values - self._centres) ** 2))

    def unlikely(self, solution: Solution) -> float:
        """Return twice the negative log likelihood and prior, each column's noise being unknown."""
        counts = np.bincount(self.target.which, self.chosen, minlength=len(self.target.columns))
        fit = 2.0 * float(counts @ np.log(self.left(solution.residuals)))
        return fit + float(np.sum(self._precision * (solution.values - self._centres) ** 2))

    def curvature(self, solution: Solution, along: Array) -> float:
        """Return the linearised rise of the cost per squared step along (P,)."""
        weights = self.chosen / self.target.per_value(solution.noise) ** 2
        change = solution.slopes @ along
        prior = float(np.sum(self._precision * along**2))
        return max(float(np.sum(weights * change**2)) + prior, 1e-300)

    def inflation(self, solution: Solution) -> Array:
        """Return the ratio of each sd to that with all others known, shape (P,)."""
        normal, _ = self._equations(
            solution.values, solution.residuals, solution.slopes, solution.noise
        )
        return np.sqrt(np.diag(normal) * np.diag(np.linalg.inv(normal)))

    def follow(
        self, solution: Solution, number: int, step: float, along: Array
    ) -> tuple[float, float]:
        """Return the profile cost: one parameter a step off, all others refitted: `along` (P,)."""
        values = np.clip(solution.values + step * along, *self._bounds)
        others = np.arange(len(values)) != number
        residuals = self.residuals(values[None])[0]
        least = self.cost(residuals, values, solution.noise)
        for _ in range(4):  # steps of all others where one parameter is moved
            normal, slope = self._equations(values, residuals, solution.slopes, solution.noise)
            step_by = np.zeros(len(values))
            step_by[others] = -np.linalg.solve(normal[np.ix_(others, others)], slope[others])
            if -float(step_by @ slope) < 0.1 * _CONTRADICTS:  # what it can gain
                break
            tried = np.clip(values + step_by * self._scales, *self._bounds)
            off = self.residuals(tried[None])[0]
            cost = self.cost(off, tried, solution.noise)
            if cost >= least:
                break
            gain = least - cost
            values, residuals, least = tried, off, cost
            if gain < _NO_GAIN:
                break
        return least, abs(float(values[number] - solution.values[number]))

    def left(self, residuals: Array) -> Array:
        """Return the RMS residual of each column, shape (C,)."""
        return np.maximum(self.target.rms(residuals, self.chosen), self._floor)

    def _correlation(self, residuals: Array) -> float:
        """Return over how many samples the residuals of a column hang together, at most."""
        columns = range(len(self.target.columns))
        kept = [residuals[(self.chosen > 0) & (self.target.which == number)] for number in columns]
        return max(correlation_length(one) for one in kept)

    def coarse(self) -> Array:
        """Return the residual scale of each column far from the solution, shape (C,).

        Columns that jump do not count where others do: whether their jumps meet says nothing of how
        far off a delay is.
        """
        noise = np.array([column.noise for column in self.target.columns])
        jumpy = np.array([column.is_jumpy for column in self.target.columns])
        off = np.maximum(np.maximum(self._floor, 0.03 * self._spread), noise)
        return off if jumpy.all() else np.where(jumpy, 5.0 * off, off)

    def solve(self, start: Array) -> Solution:
        """Iterate from values of shape (P,) until steps are small beside the noise."""
        path: list[Array] = []
        values, residuals, noise = self._settled(start, path, is_central=True)
        if self.reach is not None and not self.is_rough and self.reach.is_rough:
            self._apart, self._known = _groups(self.reach.only, len(values)), None
            values, residuals = self._descend(values, residuals, noise, path, is_central=True)
        seen = self._differences(values, residuals, is_central=True)
        return Solution(
            values,
            residuals,
            seen.slopes,
            noise,
            tuple(path),
            self.chosen,
            seen.bends,
            self._together,
        )

    def least_residuals(self, start: Array) -> Array:
        """Return the residuals, (M,), where the same ends, without what says how sure it is."""
        return self._settled(start, [], is_central=False)[1]

    def coarsely(self, start: Array, residuals: Array) -> tuple[Array, Array]:
        """Descend with all columns of equal weight: values, (P,), and residuals, (M,), there."""
        return self._descend(start, residuals, self.coarse(), [])

    def _settled(
        self, start: Array, path: list[Array], *, is_central: bool
    ) -> tuple[Array, Array, Array]:
        """Return values, residuals and each column's noise at the end; add the steps to the path.

        All columns have equal weight at first; then each by its residual.
        """
        values = np.clip(start, *self._bounds)
        path.append(values)
        residuals = self.residuals(values[None])[0]
        noise = self.coarse()
        if np.any(self.left(residuals) > noise):
            values, residuals = self._descend(values, residuals, noise, path)
        for _ in range(3):  # times that columns are weighed by what is left of them
            noise = self.left(residuals)
            if any(one.usual for one in self.parameters):
                self._together = self._correlation(residuals)
            values, residuals = self._descend(values, residuals, noise, path, is_central=is_central)
            if np.allclose(self.left(residuals), noise, rtol=0.1):
                break
        return values, residuals, noise

    def _descend(
        self,
        values: Array,
        residuals: Array,
        noise: Array,
        path: list[Array],
        *,
        is_central: bool = False,
    ) -> tuple[Array, Array]:
        """Descend with fixed noise of each column; append each step to the path."""
        cost, damping = self.cost(residuals, values, noise), _FIRST_DAMPING
        differences = partial(self._differences, is_central=is_central)
        beside = differences(values, residuals)
        slopes = beside.slopes
        for _ in range(25):
            normal, slope = self._equations(values, residuals, slopes, noise)
            sd = np.sqrt(np.diag(np.linalg.inv(normal))) * self._scales
            still = 0.05 * sd  # a shorter step is the last
            seen = np.sqrt(np.diag(normal) / self.chosen.sum()) / self._scales
            # Once it is known, a step changes what is seen by half the noise, rms: contacts and dry
            # friction make rollouts rough where they are looked at more closely.
            self._steps = np.clip(0.5 / seen, self._least, self._most)
            tried = partial(self._stepped, values, (normal, slope), noise, still)
            is_own = slopes is beside.slopes  # else carried: where they mislead, others are made
            rule = _DAMPING if is_own else replace(_DAMPING, tries=1)
            moved, new, after = damped_step(tried, cost, damping, rule)
            if moved is None and after == damping:  # even the first step is too short
                break
            if moved is None and not is_own:
                beside = differences(values, residuals)
                slopes = beside.slopes
                continue
            if moved is None:  # slopes over a kink may point uphill
                # It has to promise that much of the cost.
                lowest = beside.lowest(partial(self.cost, noise=noise), 2.0)
                if lowest is None:
                    break
                moved, new = self._seen_at(np.clip(lowest, *self._bounds), noise)
                if new >= cost:
                    break
                after = _DAMPING.lowered(_FIRST_DAMPING)
            gain, is_short = cost - new, np.all(np.abs(moved[0] - values) < still)
            carried = None if is_central else self._carried(slopes, values, residuals, moved, noise)
            (values, residuals), cost, damping = moved, new, after
            path.append(values)
            if is_short or gain < _NO_GAIN:
                break
            if carried is None:
                beside = differences(values, residuals)
            slopes = beside.slopes if carried is None else carried
        return values, residuals

    def _carried(
        self,
        slopes: Array,
        values: Array,
        residuals: Array,
        moved: tuple[Array, Array],
        noise: Array,
    ) -> Array | None:
        """Update slopes to where a step led by Broyden's rule (1965); None where it went amiss."""
        by = moved[0] - values
        expected = residuals + slopes @ by
        before, told, found = (
            self.cost(left, place, noise)
            for left, place in ((residuals, values), (expected, moved[0]), (moved[1], moved[0]))
        )
        if not abs(found - told) <= _AMISS * (before - told):
            return None
        scaled = by / self._scales**2
        return slopes + np.outer(moved[1] - expected, scaled / (scaled @ by))

    def _stepped(
        self,
        values: Array,
        equations: tuple[Array, Array],
        noise: Array,
        still: Array,
        damping: float,
    ) -> tuple[tuple[Array, Array], float] | None:
        """Take a damped step within the bounds; None where it is shorter than `still`, (P,).

        Or where it promises too little.
        """
        tried = np.clip(values + self._step(values, *equations, damping), *self._bounds)
        if np.all(np.abs(tried - values) < still):
            return None
        normal, slope = equations
        by = (tried - values) / self._scales
        promised = -float(by @ (2.0 * slope + normal @ by))
        least = (
            _NO_GAIN if damping > _FIRST_DAMPING else 0.2 * _NO_GAIN
        )  # a step again, or the first
        return None if 0.0 <= promised < least else self._seen_at(tried, noise)

    def _seen_at(self, values: Array, noise: Array) -> tuple[tuple[Array, Array], float]:
        """Roll out at values, (P,): return them with their residuals, (M,), and their cost."""
        residuals = self.residuals(values[None])[0]
        return (values, residuals), self.cost(residuals, values, noise)

    def _differences(
        self, values: Array, residuals: Array, *, is_central: bool = False
    ) -> Differences:
        """Return differences, one-sided on the way, central at its end; reuse near ones."""
        known, steps = self._known, self._steps
        is_enough = known is not None and (known.back is not None or not is_central)
        if known is not None and is_enough and np.all(np.abs(values - known.place) <= 0.5 * steps):
            return known
        # Roll out beside the place, all at once.
        low, high = self._bounds
        moved = np.where(values + steps > high, -steps, steps)
        groups, mask = self._apart
        if is_central:
            inside = (values - moved >= low) & (values - moved <= high)
            back = np.where(inside, -moved, 0.0)
            off = self.residuals(np.concatenate([values + groups * moved, values + groups * back]))
            beside, behind = (
                np.where(mask, some[groups.argmax(axis=0)], residuals)
                for some in (off[: len(groups)], off[len(groups) :])
            )
            known = Differences(values, residuals, moved, beside, back, behind)
        else:
            off = self.residuals(values + groups * moved)[groups.argmax(axis=0)]
            known = Differences(values, residuals, moved, np.where(mask, off, residuals))
        self._known = known
        return known

    def one_step(self, solution: Solution) -> tuple[Array, Array]:
        """Refit to the chosen samples by one Gauss-Newton step from another solution.

        With its slopes: if a solution explains what is left out, too, the step is small.
        """
        noise = self.left(solution.residuals)
        values, self._together = solution.values, solution.together
        normal, slope = self._equations(values, solution.residuals, solution.slopes, noise)
        tried = np.clip(values + self._step(values, normal, slope, 0.0), *self._bounds)
        return tried, self.residuals(tried[None])[0]

    def _equations(
        self, values: Array, residuals: Array, slopes: Array, noise: Array
    ) -> tuple[Array, Array]:
        """Return the normal equations in units of the ranges: (P, P) and (P,)."""
        weights = self.chosen / self.target.per_value(noise) ** 2
        scaled = slopes * self._scales
        precision = self._precision * self._scales**2
        normal = scaled.T @ (weights[:, None] * scaled)
        # Precision of a parameter of which nothing is known, in its range
        normal[np.diag_indices_from(normal)] += precision + 1e-4
        slope = scaled.T @ (weights * residuals)
        return normal, slope + precision * (values - self._centres) / self._scales

    def _step(self, values: Array, normal: Array, slope: Array, damping: float) -> Array:
        """Return a damped step, shape (P,), with active bounds fixed."""
        low, high = self._bounds
        free = ~(((values <= low) & (slope > 0)) | ((values >= high) & (slope < 0)))
        step = np.zeros(len(values))
        part = normal[np.ix_(free, free)]
        step[free] = -np.linalg.solve(part + damping * np.diag(np.diag(part)), slope[free])
        tuned = np.abs(step[~self._is_start]).max(initial=0.0)
        return step * self._scales * min(1.0, 0.5 / max(tuned, 1e-12))  # half a range at most


# ---- Sandwich covariance: Newey-West (1987), with Andrews' bandwidth (1991)
# Residuals of a simulator are autocorrelated: noise is filtered, and no model is exact.


def covariance(
    solution: Solution, target: ComparedColumns, parameters: tuple[Parameter, ...]
) -> tuple[Array, float]:
    """Return the values' sandwich covariance, shape (P, P), and the effective sample size."""
    scales = ranges_of(parameters)
    weights = solution.chosen / target.per_value(solution.noise) ** 2
    slopes = solution.slopes * scales
    precision = precisions_of(parameters, solution.together) * scales**2
    # Of a parameter of which nothing is known: ten ranges are one sd.
    precision = np.where(precision > 0, precision, 1e-2)
    bread = np.linalg.inv(slopes.T @ (weights[:, None] * slopes) + np.diag(precision))
    # Sum scores over columns in bins of time, shape (K, P).
    scores = slopes * (weights * solution.residuals)[:, None]
    longest = max(len(column.values) for column in target.columns)
    count = min(longest, 2000)  # bins of time
    place = np.minimum((target.seconds / max(target.end_s, 1e-9) * count).astype(int), count - 1)
    sums = np.zeros((count, scores.shape[1]))
    np.add.at(sums, place, scores)
    scores = sums
    # Andrews' bandwidth by an AR(1) model of each parameter's scores.
    influences = scores @ bread
    before, after = influences[:-1], influences[1:]
    power = np.sum(before**2, axis=0)
    share = np.where(power > 0, np.sum(before * after, axis=0) / np.maximum(power, 1e-300), 0.0)
    share = np.clip(share, 0.0, 0.97)
    alpha = 4 * share**2 / ((1 - share) ** 2 * (1 + share) ** 2)
    span = 1.1447 * (float(alpha.max(initial=0.0)) * count) ** (1 / 3)
    # Scores are taken to hang together over a fifth of the log at most.
    span = int(np.clip(span, 1, 0.2 * count))
    meat = scores.T @ scores
    for lag in range(1, span + 1):
        shared = scores[lag:].T @ scores[:-lag]
        meat += (1 - lag / (span + 1)) * (shared + shared.T)
    white = slopes.T @ (weights[:, None] * slopes)
    # Raise the meat so that it is nowhere below that of white noise.
    factor = np.linalg.cholesky(white + (1e-9 * np.trace(white) + 1e-30) * np.eye(len(white)))
    inner = np.linalg.solve(factor, np.linalg.solve(factor, meat).T)
    sizes, axes = np.linalg.eigh((inner + inner.T) / 2)
    kept = axes @ np.diag(np.maximum(sizes, 1.0)) @ axes.T
    # A weighed prior's scores have the weight twice, its precision once.
    usual = np.array([one.prior_sd is None and one.usual is not None for one in parameters])
    prior = np.where(usual, solution.together, 1.0) * precision
    found = bread @ ((factor @ kept @ factor.T) + np.diag(prior)) @ bread
    independent = len(scores) / (1 + span)
    found *= independent / max(independent - len(parameters), 1.0)
    return found * np.outer(scales, scales), independent


# ---- Fit of all parameters, its hold-out, and how sure each is

MISSED = 0.03  # of how much a column varies in what is held out, that may be missed
TOLD = 0.6  # of the sd of what others have: a log that leaves more tells nothing of it
_LOOSENED, _LOOSEST = 1.5, 10.0  # times as unsure a start as read: from when on, and at most
_LOST = 0.2  # of how much a column varies: with more left, no start leads to a log's end
_PARTS = 3  # of a log that is begun anew, by which its intervals are tried
_FEW_SHOTS = 8  # pieces of a log; of more, other starts cost too much to be followed
_LOOKS = 2  # at where a motion is predictable, from the start and from what that gave
_STEP_ORDER = 2.0  # an infinitely short step moves values twice as far as half a step (first order)
_CONTRADICTS = 4.0  # of the cost, twice a log likelihood: two standard deviations


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Hold-out: prediction of what was not fitted, in C columns."""

    columns: tuple[Column, ...]  # what is predicted
    from_s: Array  # where its part begins in each, shape (C,)
    rms: Array  # residual there, shape (C,)
    before: Array  # that of the simulator as given, shape (C,)
    simulated: Array | None  # of the log that was fitted, shape (M,); None if it is another's
    horizon_s: float | None = None  # how long it lasts before it begins anew; None if it never does
    count: int = 1  # how many times it begins
    # Residual of straight lines in its place, and standard deviation there, shape (C,) both.
    straight: Array | None = None
    spread: Array | None = None
    whole: Array | None = None  # of a run that is held out: as given and predicted, shape (2, N)
    untold: tuple[str, ...] = ()  # parameters of which what was fitted for it tells nothing

    @property
    def limits(self) -> Array:
        """What may be missed where a prediction begins with its own start, shape (C,)."""
        assert self.spread is not None
        most = [
            max(one.spread for one in self.columns if one.unit == each.unit)
            for each in self.columns
        ]
        noise = np.array([one.noise for one in self.columns])
        least = np.maximum(0.1 * MISSED * np.array(most), 2.0 * noise)
        return np.maximum(np.maximum(MISSED * self.spread, least), 1e-12)

    @property
    def is_told(self) -> bool:
        """Whether something is to be predicted: by straight lines it is missed by twice that."""
        return self.straight is None or bool((self.straight > 2 * self.limits).any())


# From values of the T tuned parameters, which saw nothing of it, and what the simulator as given
# shows, shape (M,); None if nothing can be told.
Predict = Callable[[Array, Array], HeldOut | None]


@dataclass(frozen=True, eq=False)
class Agreement:
    """What each of L logs says of the T tuned parameters by itself, and all others of them."""

    names: tuple[str, ...]  # of the logs
    alone: Array  # shape (L, T)
    others: Array  # shape (L, T)
    apart: Array  # difference, in standard deviations, shape (L, T)

    @property
    def birge(self) -> Array:
        """How many times as far the logs scatter as each by itself lets expect, shape (T,).

        Birge's ratio (1932); 1 where chance scatters them so in more than one case of ten.
        """
        from scipy.special import chdtri

        squares, free = np.mean(self.apart**2, axis=0), len(self.names) - 1
        return np.sqrt(np.where(squares > chdtri(free, 0.1) / free, squares, 1.0))


@dataclass(frozen=True, eq=False)
class SimulatorFit:
    """Result of a fit, for checks and reviews."""

    target: ComparedColumns  # what was compared
    parameters: tuple[Parameter, ...]  # all P that were fitted, those of the initial state, too
    tuned: int  # how many of them, the first, are the user's
    solution: Solution  # where the steps ended
    simulated: Array  # what it shows at the log's stamps, shape (M,)
    first: Array  # what the simulator showed as given, shape (M,)
    sd: Array  # standard deviation of each value, shape (P,), the time step's part included
    half95: Array  # half the 95 % interval of each value, shape (P,), bounds ignored
    # shift of each by half the time step, shape (P,); None if there is no other step
    step_shift: Array | None
    held_out: HeldOut | None  # None if the log is too short
    correlation: Array  # of all values, shape (P, P)
    inflation: Array  # ratio of each sd to that with all others known, shape (P,)
    predictable: Array  # how much each value says of the model, 0 to 1, shape (M,)
    is_begun_anew: bool  # whether the rollout begins anew, wherever an error of its start has grown
    is_tried: bool  # whether the intervals were tried, and widened, by parts of what was fitted
    agreement: Agreement | None = None  # of several logs

    @property
    def unidentifiable(self) -> tuple[Parameter, ...]:
        """Unidentifiable tuned parameters: 95 % reach further than a quarter of their range.

        One that is confounded with others must be known within a quarter of its value.
        """
        own, half95 = slice(self.tuned), self.half95[: self.tuned]
        wide = _is_wide(half95, self.parameters[own])
        values = np.abs(self.solution.values[own])
        # Times less sure than if all others were known: from there on it is seen with them alone
        wide |= (self.inflation[own] > 40.0) & (half95 > 0.25 * values)
        return tuple(one for one, is_wide in zip(self.parameters, wide, strict=False) if is_wide)


def _is_wide(half95: Array, parameters: Sequence[Parameter]) -> NDArray[np.bool_]:
    """Return which intervals tell nothing: beside the ranges, or what others have; shape (T,)."""
    usual = np.array([one.usual[1] if one.usual else np.inf for one in parameters])
    return (half95 > 0.25 * ranges_of(parameters)) | (half95 > 1.96 * TOLD * usual)


def fit_simulator(
    run: Run,
    finer: Run | None,
    target: ComparedColumns,
    parameters: tuple[Parameter, ...],
    start: Array,
    unresolved: Array | None = None,
    predict: Predict | None = None,
    later: NDArray[np.bool_] | None = None,
    logs: tuple[tuple[str, ...], NDArray[np.intp]] | None = None,
    omitted: Callable[[Array], Array] | None = None,
    anew: Anew | None = None,
    joints: Mapping[str, str] | None = None,
) -> FitResult:
    """Fit all parameters to a log, the user's from `start`, shape (T,).

    `finer` makes rollouts with half the time step; `unresolved` is what the step leaves unsure of
    each parameter, one standard deviation, shape (P,). `predict` tells how well a fit predicts
    what is held out, `later` what of the log that is, shape (M,): the last 40 % of the time. `logs`
    are the names of several, and which each value is of, shape (M,). `omitted` tells what the
    rollout at values, shape (P,), would change by each effect that is left out, (G, M). `anew`
    begins rollouts inside the log. `joints` are those that servos' parameters move, by their
    addresses.
    """
    from scipy.special import stdtrit

    tuned = len(start)
    reach = reach_of(parameters, target, logs, joints or {})
    steps = RolloutLeastSquares(run, target, parameters, reach=reach)
    given = np.array([one.initial for one in parameters])
    first = run(given[None])[0]
    which = np.zeros(len(target.values), dtype=np.intp) if logs is None else logs[1]
    steps, solution, shots = _followed(steps, start, which, anew)
    if shots:
        finer = _shooting(shots, target, parameters[:tuned], is_finer=True).run
        more = np.zeros(len(solution.values) - tuned)
        unresolved = None if unresolved is None else np.concatenate([unresolved[:tuned], more])
        omitted = None
    parameters = steps.parameters
    cov, independent = covariance(solution, target, parameters)
    sd = np.sqrt(np.diag(cov))
    correlation = cov / np.outer(sd, sd)
    sd[:tuned] *= _walked(steps, solution, cov, tuned)
    shift = None
    if finer is not None:
        moved = finer(solution.values[None])[0] - (target.values + solution.residuals)
        moved = np.where(np.isfinite(moved), moved, 0.0)
        shift = np.abs(_moved_by(moved, solution, target, parameters))
    rough = [_moved_by(bend, solution, target, parameters) for bend in solution.bends]
    # Factor on the variance of white noise in them: 1 + 4 + 1
    wide = np.hypot(sd, np.sqrt(np.mean(np.square(rough), axis=0) / 6.0))
    if omitted is not None:
        for change in omitted(solution.values):
            by = _moved_by(change, solution, target, parameters)
            wide = np.hypot(wide, np.sqrt(_possible(change, by, solution, target)) * np.abs(by))
    if unresolved is not None:  # the others follow what the step leaves unsure of one
        followed = cov * (unresolved / np.diag(cov))
        wide = np.sqrt(wide**2 + np.sum(followed**2, axis=1))
    agreement = None
    if logs is not None:
        agreement = _agreement(steps, solution, tuned, *logs)
    elif shots:  # in three parts
        order = np.argmax([seen for seen, _ in sorted(shots, key=_begins_s)], axis=0)
        which = order * min(_PARTS, len(shots)) // len(shots)
        agreement = _agreement(steps, solution, tuned, ("",) * (int(which.max()) + 1), which)
    if agreement is not None:
        wide[:tuned] *= agreement.birge
    students = float(stdtrit(max(independent - len(sd), 3.0), 0.975))  # Student's t
    held_out = _held_out(
        steps, solution, first, tuned, later_part(target) if later is None else later, predict
    )
    is_tried = agreement is not None
    if not is_tried and anew is not None and not _is_noise(steps, solution, held_out):
        apart = _apart(anew(None), parameters[:tuned], solution)
        is_tried = apart is not None
        if apart is not None:
            wide[:tuned] = np.maximum(wide[:tuned], apart / students)
    half95 = students * wide
    if shift is not None:
        half95 += _STEP_ORDER * shift
    low, high = np.array([one.bounds for one in parameters]).T
    ends = np.stack([solution.values - half95, solution.values + half95])
    ends = np.clip(ends, low, high)
    detail = SimulatorFit(
        target,
        parameters,
        tuned,
        solution,
        target.values + solution.residuals,
        first,
        half95 / students,
        half95,
        shift,
        held_out,
        correlation,
        steps.inflation(solution),
        np.ones(len(which))
        if shots or _is_good(solution, target)
        else _predictable(steps, solution, which)[1],
        bool(shots),
        is_tried,
        None if logs is None else agreement,
    )
    posterior = Posterior(
        tuple((half95[:tuned] / 1.96).tolist()),  # as wide as the intervals
        tuple(map(tuple, correlation[:tuned, :tuned].tolist())),
        tuple(one.bounds for one in parameters[:tuned]),
        tuple(one.training_range for one in parameters[:tuned]),
        tuple(one.name for one in detail.unidentifiable),
    )
    return FitResult(
        solution.values[:tuned],
        ends.T[:tuned],
        detail=detail,
        path=solution.path,
        posterior=posterior,
        gaps=_gaps(detail, logs),
    )


def _gaps(
    fit: SimulatorFit, logs: tuple[tuple[str, ...], NDArray[np.intp]] | None
) -> tuple[Gap, ...]:
    """Compare each column of each log with the simulator, as given and tuned."""
    target, found = fit.target, list[Gap]()
    for number, column in enumerate(target.columns):
        mine = target.which == number
        motion = "" if logs is None else logs[0][int(logs[1][mine][0])]
        own = replace(column, signal=column.signal.removeprefix(f"{motion}: "))
        found.append(_gap(own, motion, fit.first[mine], fit.simulated[mine]))
    held = fit.held_out
    if held is not None and held.whole is not None:
        ends = np.cumsum([len(one.values) for one in held.columns])
        for column, end in zip(held.columns, ends.tolist(), strict=True):
            motion, _, signal = column.signal.partition(": ")
            motion = motion.removesuffix(" (held out)")
            first, tuned = held.whole[:, end - len(column.values) : end]
            own = replace(column, signal=signal)
            found.append(replace(_gap(own, motion, first, tuned), is_held_out=True))
    return tuple(found)


_LAG_S, _LAGS = 0.3, 121  # of a simulator, to each side; how many are tried


def _gap(column: Column, motion: str, *both: Array) -> Gap:
    rms, delays = list[float](), list[float]()
    lags = np.linspace(-_LAG_S, _LAG_S, _LAGS)
    for curve in both:
        good = np.isfinite(curve)
        if not good.any():  # it was stopped
            return Gap(column.label, motion, False, column.unit, (np.nan, np.nan), None, np.nan)
        at_s, seen, own = column.seconds[good], column.values[good], curve[good]
        rms.append(float(np.sqrt(np.mean((own - seen) ** 2))))
        # What changes alone: an offset is no delay.
        inside = (at_s > at_s[0] + _LAG_S) & (at_s < at_s[-1] - _LAG_S)
        at = -1
        if inside.sum() > 2 and np.std(own) > 0:
            shifted = (np.interp(at_s - lag, at_s, own)[inside] for lag in lags)
            at = int(np.argmin([np.std(one - seen[inside]) for one in shifted]))
        delays.append(float(lags[at]) if 0 < at < _LAGS - 1 else np.nan)
    delay_s = (delays[0], delays[1])
    is_told = column.spread > 3 * column.noise and bool(np.isfinite(delay_s).all())
    left = rms[1] / max(column.spread, 1e-12)
    signal, unit = column.label, column.unit
    return Gap(signal, motion, False, unit, (rms[0], rms[1]), delay_s if is_told else None, left)


def _walked(steps: RolloutLeastSquares, solution: Solution, cov: Array, tuned: int) -> Array:
    """Return by which factor, 1 or more, each sd exceeds the linear one, shape (T,).

    A profile likelihood: each parameter is moved, the others following, until the log contradicts.
    For confounded parameters, errors of the slopes look like knowledge.
    """
    ranges = ranges_of(steps.parameters)
    factors = np.ones(tuned)
    start = steps.cost(solution.residuals, solution.values, solution.noise)
    for number in range(tuned):
        along = cov[:, number] / cov[number, number]
        curvature = steps.curvature(solution, along)
        reach, seen = np.sqrt(_CONTRADICTS / curvature), 0.0
        for _ in range(8):
            reach = min(reach, ranges[number])
            rises = [steps.follow(solution, number, side * reach, along) for side in (-1.0, 1.0)]
            moved = [(cost - start, far) for cost, far in rises if far > reach / 2]
            rise, far = min(moved, default=(0.0, reach))
            seen = max(rise, 0.0) / far**2
            if rise > _CONTRADICTS / 2 or reach >= ranges[number]:
                break
            reach *= 3.0
        if seen < curvature / 2:
            factors[number] = np.sqrt(curvature / max(seen, 1e-12 * curvature))
    return factors


def _is_good(solution: Solution, target: ComparedColumns) -> bool:
    """Return whether every informative column is met about as well as its noise allows."""
    left = target.rms(solution.residuals, solution.chosen)
    every = all(column.is_jumpy for column in target.columns)
    # A hundredth of a column's spread counts where its noise is less.
    return all(
        rms <= max(1.5 * column.noise, 0.01 * column.spread)
        for rms, column in zip(left, target.columns, strict=True)
        if every or not column.is_jumpy
    )


def _predictable(
    steps: RolloutLeastSquares, solution: Solution, which: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Return how much each value says of a model, 0 to 1; `which` is each value's log, all (M,).

    Where an error of the start has grown more than tenfold, so has any error of the model, and a
    value counts by so much less: by the growth of all numbers of the start, and of the worst.
    """
    starts = [number for number, one in enumerate(steps.parameters) if one.prior_sd is not None]
    spread = steps.target.per_value([max(one.spread, 1e-12) for one in steps.target.columns])
    moved = (solution.slopes * ranges_of(steps.parameters))[:, starts].T / spread
    counts = np.ones((2, len(which)))
    for log in np.unique(which):
        here = which == log
        own = steps.target.columns_at(here)
        for count, grown in zip(counts, growth(own, moved[:, here]), strict=True):
            most = np.maximum.accumulate(grown)[_bins_of(own)]
            count[here] = (GROWTH / np.maximum(most, GROWTH)) ** 2
    return counts[0], counts[1]


def _where_predictable(
    steps: RolloutLeastSquares, solution: Solution, which: NDArray[np.intp]
) -> tuple[RolloutLeastSquares, Solution]:
    """Fit a chaotic motion by what a start predicts, if that is met then."""
    weighed, found = steps, solution
    for _ in range(_LOOKS):
        counts, _ = _predictable(weighed, found, which)
        if counts.min() == 1:
            break
        weighed = replace(weighed, counts=counts)
        found = weighed.solve(solution.path[0])
    return (weighed, found) if _is_good(found, steps.target) else (steps, solution)


def _followed(
    steps: RolloutLeastSquares, start: Array, which: NDArray[np.intp], anew: Anew | None
) -> tuple[RolloutLeastSquares, Solution, Shots]:
    """Fit from the log's start, or begun anew where no start leads to its end; `start` is (T,)."""
    target, parameters, tuned = steps.target, steps.parameters, len(start)
    begins = [one.initial for one in parameters[tuned:]]
    solution = steps.solve(np.concatenate([start, begins]))
    shots: Shots = ()
    if not _is_good(solution, target) and anew is not None:
        spreads = [max(one.spread, 1e-12) if one.is_place else np.inf for one in target.columns]
        left = steps.left(solution.residuals) / spreads
        grows = _predictable(steps, solution, which)[1].min() < (GROWTH / GROWN) ** 2
        if grows or np.any(left > _LOST):
            shots = anew(solution.values[:tuned]) or anew(start)
    if not shots:
        if not _is_good(solution, target):
            steps, solution = _where_predictable(steps, solution, which)
        steps, solution = _loosened(steps, solution)
        if not _is_good(solution, target):
            solution = _from_elsewhere(steps, solution, tuned)
        return steps, solution, shots
    steps = _shooting(shots, target, parameters[:tuned])
    begins = [one.initial for one in steps.parameters[tuned:]]
    solution = steps.solve(np.concatenate([start, begins]))
    if len(shots) <= _FEW_SHOTS and not _is_good(solution, target):
        solution = _from_elsewhere(steps, solution, tuned, is_rough=True)
    steps, solution = _loosened(steps, solution)
    return steps, solution, shots


def _begins_s(shot: tuple[NDArray[np.bool_], Begun]) -> int:
    return shot[1].target.start_ns


def _shooting(
    shots: Shots,
    target: ComparedColumns,
    tuned: tuple[Parameter, ...],
    *,
    is_finer: bool = False,
) -> RolloutLeastSquares:
    """Pose the fit of a log that is begun anew several times (multiple shooting; Bock 1983)."""
    ends = len(tuned) + np.cumsum([0, *(len(begun.starts) for _, begun in shots)])

    def run(values: Array) -> Array:
        found = np.full((len(values), len(target.values)), np.nan)
        for number, (seen, begun) in enumerate(shots):
            own = values[:, [*range(len(tuned)), *range(ends[number], ends[number + 1])]]
            rows, place = np.unique(own, axis=0, return_inverse=True)
            roll = begun.finer if is_finer and begun.finer else begun.run
            found[:, seen] = roll(rows)[place.ravel()]
        return found

    starts = [one for _, begun in shots for one in begun.starts]
    return RolloutLeastSquares(run, target, (*tuned, *starts))


def _loosened(
    steps: RolloutLeastSquares, solution: Solution
) -> tuple[RolloutLeastSquares, Solution]:
    """Fit again with starts as unsure as what is left of the columns that tell them.

    A start is read with the noise of its column, of which smooth errors, such as a tracker's, are
    no part.
    """
    target = steps.target
    noise = np.array([max(one.noise, 1e-12) for one in target.columns])
    left = steps.left(solution.residuals)
    wider = np.clip(left / noise, 1.0, _LOOSEST) ** 2
    told = np.array(
        [
            np.bincount(target.which, column**2, minlength=len(left)) / left**2
            for column in (solution.slopes * np.sqrt(solution.chosen)[:, None]).T
        ]
    )
    total = told.sum(axis=1)
    factors = np.sqrt((told @ wider) / np.where(total > 0, total, 1.0))
    if not any(
        factor > _LOOSENED and one.prior_sd is not None
        for factor, one in zip(factors, steps.parameters, strict=True)
    ):
        return steps, solution
    parameters = tuple(
        one if one.prior_sd is None else replace(one, prior_sd=one.prior_sd * max(factor, 1.0))
        for factor, one in zip(factors.tolist(), steps.parameters, strict=True)
    )
    steps = replace(steps, parameters=parameters)
    again = steps.solve(solution.values)
    return steps, replace(again, path=(*solution.path, *again.path[1:]))


def _from_elsewhere(
    steps: RolloutLeastSquares, solution: Solution, tuned: int, *, is_rough: bool = False
) -> Solution:
    """Restart from the best of many quasi-random (Halton) starts; keep the likeliest solution.

    Where a fit that begins anew is rough, more of them are followed to their end.
    """
    from scipy.stats import qmc

    low, high = np.array([one.training_range for one in steps.parameters[:tuned]]).T
    places = qmc.scale(qmc.Halton(tuned, rng=0).random(24), low, high)
    rest = np.array([one.initial for one in steps.parameters[tuned:]])
    starts = np.column_stack([places, np.repeat(rest[None], len(places), axis=0)])
    off = steps.residuals(starts)
    coarse = steps.coarse()
    costs = [steps.cost(row, start, coarse) for row, start in zip(off, starts, strict=True)]
    least = steps.cost(solution.residuals, solution.values, coarse)
    likeliest = steps.unlikely(solution)
    for place in np.argsort(costs)[: 4 if is_rough else 2]:
        values, residuals = steps.coarsely(starts[place], off[place])
        cost = steps.cost(residuals, values, coarse)
        if not is_rough and cost >= _LOWER * least - 2.0:  # it ends no better
            continue
        other = steps.solve(values)
        if steps.unlikely(other) < likeliest:
            least, likeliest = min(least, cost), steps.unlikely(other)
            solution = replace(other, path=(*solution.path[:1], *other.path))
        if _is_good(solution, steps.target):
            break
    return solution


def _moved_by(
    change: Array, solution: Solution, target: ComparedColumns, parameters: tuple[Parameter, ...]
) -> Array:
    """Return how far a change of the simulation moves the least-squares solution, shape (P,)."""
    scales = ranges_of(parameters)
    weights = solution.chosen / target.per_value(solution.noise) ** 2
    slopes = solution.slopes * scales
    precision = precisions_of(parameters, solution.together) * scales**2
    precision = np.where(precision > 0, precision, 1e-4)
    normal = slopes.T @ (weights[:, None] * slopes) + np.diag(precision)
    return np.linalg.solve(normal, slopes.T @ (weights * change)) * scales


def _possible(change: Array, by: Array, solution: Solution, target: ComparedColumns) -> float:
    """Return the variance that a log leaves of an effect's size, of a prior of 1 about none.

    Of its `change` of the rollout, (M,), what other values do not undo, `by` (P,), is seen.
    """
    left = change - solution.slopes @ by
    seen = np.sum(solution.chosen * (left / target.per_value(solution.noise)) ** 2)
    return 1.0 / (1.0 + float(seen) / solution.together)


def _is_noise(steps: RolloutLeastSquares, solution: Solution, held_out: HeldOut | None) -> bool:
    """Return whether what is left is the noise, and what is held out is predicted."""
    left = steps.left(solution.residuals)
    noise = np.array([np.inf if one.is_jumpy else one.noise for one in steps.target.columns])
    is_met = held_out is None or held_out.spread is None or np.all(held_out.rms < held_out.limits)
    return bool(is_met and np.all(left < _LOOSENED * noise))


def _apart(
    parts: Shots,
    tuned: tuple[Parameter, ...],
    solution: Solution,
) -> Array | None:
    """Return how far values by parts of a log are from those by all of it, shape (T,).

    0 where that is within two standard deviations of theirs; None without parts.
    """
    found = np.zeros(len(tuned))
    if not parts:
        return None
    for _, begun in parts:
        steps = RolloutLeastSquares(begun.run, begun.target, (*tuned, *begun.starts))
        begins = [one.initial for one in begun.starts]
        start = np.concatenate([solution.values[: len(tuned)], begins])
        steps, own = _loosened(steps, steps.solve(start))
        cov, _ = covariance(own, begun.target, steps.parameters)
        apart = np.abs(own.values - start)[: len(tuned)]
        sd = np.sqrt(np.diag(cov))[: len(tuned)]
        found = np.maximum(found, np.where(apart > 2.0 * sd, apart, 0.0))
    return found


def _agreement(
    steps: RolloutLeastSquares,
    solution: Solution,
    tuned: int,
    names: tuple[str, ...],
    which: NDArray[np.intp],
) -> Agreement:
    """Refit to each log alone, and to all others, by two Gauss-Newton steps each."""

    def refitted(fitted: NDArray[np.bool_]) -> tuple[Array, Array]:
        part, found = replace(steps, fitted=fitted), solution
        for _ in range(2):
            values, residuals = part.one_step(found)
            noise = part.left(residuals)
            found = replace(
                found, values=values, residuals=residuals, noise=noise, chosen=part.chosen
            )
        cov, _ = covariance(found, steps.target, steps.parameters)
        return found.values[:tuned], np.diag(cov)[:tuned]

    each = [(refitted(which == log), refitted(which != log)) for log in range(len(names))]
    alone, others = (np.array([one[side][0] for one in each]) for side in (0, 1))
    variance = np.array([one[0][1] + one[1][1] for one in each])
    return Agreement(names, alone, others, np.abs(alone - others) / np.sqrt(variance))


FITTED = 0.6  # of the time: the rest is held out


def later_part(target: ComparedColumns) -> NDArray[np.bool_]:
    """Return what is held out of a log, shape (M,): the last 40 % of the time."""
    return target.seconds > FITTED * target.end_s


def _held_out(
    steps: RolloutLeastSquares,
    solution: Solution,
    first: Array,
    tuned: int,
    later: NDArray[np.bool_],
    predict: Predict | None,
) -> HeldOut | None:
    """Judge a second fit, to what is not held out, by the rest."""
    target, residuals, values = steps.target, solution.residuals, solution.values
    untold = tuple[str, ...]()
    if later.any():
        if min(np.bincount(target.which[later], minlength=len(target.columns))) < 2:
            return None
        values, residuals = replace(steps, fitted=~later).one_step(solution)
        earlier = replace(solution, chosen=solution.chosen * ~later)
        cov, _ = covariance(earlier, target, steps.parameters)
        own = steps.parameters[:tuned]
        wide = _is_wide(1.96 * np.sqrt(np.diag(cov))[:tuned], own)
        untold = tuple(one.name for one, is_so in zip(own, wide, strict=True) if is_so)
    if predict is not None and (found := predict(values[:tuned], first)) is not None:
        found = replace(found, untold=untold)
        if found.simulated is None:
            return found
        before = np.where(later, np.nan, target.values + residuals)
        return replace(found, simulated=np.where(later, found.simulated, before))
    if not later.any():
        return None
    begins = [
        float(target.seconds[later & (target.which == number)][0])
        for number in range(len(target.columns))
    ]
    return HeldOut(
        target.columns,
        np.array(begins),
        target.rms(residuals, later),
        target.rms(first - target.values, later),
        target.values + residuals,
        untold=untold,
    )
