"""Descend to the least squares of a log by rollouts, and tell how sure the end is.

Levenberg-Marquardt descends by finite differences of rollouts; the sandwich covariance says how
sure its end is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.estimators.damped import Damping, damped_step
from tunenet_logs.analysis.sysid.columns import ComparedColumns
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.base import Parameter

_ROUGH = 0.3  # of how far a step moves what is seen: it bends by more where it is rough

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

    @property
    def is_rough(self) -> bool:
        """Whether steps to both sides bend what is seen, or may: of one side it is not known."""
        if self.back is None:
            return True
        moved = np.linalg.norm(self.slopes * self.moved, axis=0)
        return bool(np.any(np.linalg.norm(self.bends, axis=1) > _ROUGH * moved))

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
    def is_approximate(self) -> bool:
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

_FIRST_DAMPING = 1e-4
_DAMPING = Damping(tries=7, raised_by=10, lowered_by=30, least=1e-7, raised_from=1e-3)
_NO_GAIN = 0.05  # of the cost: a step that lowers it by less is the last
# Where no step lowers a rough cost, it is looked at from farther off: by how much, at most.
_WIDER, _WIDEST = 4.0, 16.0
_AMISS = 0.2  # of the gain that slopes promise: with more error they are differenced anew
CONTRADICTS = 4.0  # of the cost, twice a log likelihood: two standard deviations


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
    is_approximate: bool = False  # whether slopes stay those of `Reach.mostly` to the end

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
            if -float(step_by @ slope) < 0.1 * CONTRADICTS:  # what it can gain
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

    def is_met(self, residuals: Array) -> bool:
        """Return whether every informative column is met about as well as its noise allows."""
        columns, left = self.target.columns, self.left(residuals)
        every = all(column.is_jumpy for column in columns)
        # A hundredth of a column's spread counts where its noise is less.
        return all(
            rms <= max(1.5 * column.noise, 0.01 * column.spread)
            for rms, column in zip(left, columns, strict=True)
            if every or not column.is_jumpy
        )

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
        if self.reach is not None and not self.is_approximate and self.reach.is_approximate:
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

    def descended(self, solution: Solution) -> tuple[Array, Array]:
        """Descend from another's solution with its weights: values, (P,), and residuals, (M,)."""
        self._together = solution.together
        residuals = self.residuals(solution.values[None])[0]
        return self._descend(solution.values, residuals, solution.noise, [])

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
        slopes, wider = beside.slopes, 1.0
        for _ in range(25):
            normal, slope = self._equations(values, residuals, slopes, noise)
            sd = np.sqrt(np.diag(np.linalg.inv(normal))) * self._scales
            still = 0.05 * sd  # a shorter step is the last
            seen = np.sqrt(np.diag(normal) / self.chosen.sum()) / self._scales
            # Once it is known, a step changes what is seen by half the noise, rms: contacts and dry
            # friction make rollouts rough where they are looked at more closely.
            self._steps = np.clip(wider * 0.5 / seen, self._least, self._most)
            tried = partial(self._stepped, values, (normal, slope), noise, still)
            is_own = slopes is beside.slopes  # else carried: where they mislead, others are made
            rule = _DAMPING if is_own else replace(_DAMPING, tries=1)
            moved, new, after = damped_step(tried, cost, damping, rule)
            if moved is None and after == damping:  # even the first step is too short
                break
            if moved is None and is_own:  # slopes over a kink may point uphill
                # It has to promise that much of the cost.
                lowest = beside.lowest(partial(self.cost, noise=noise), 2.0)
                if lowest is not None:
                    moved, new = self._seen_at(np.clip(lowest, *self._bounds), noise)
                    moved = moved if new < cost else None
                after = _DAMPING.lowered(_FIRST_DAMPING)
            if moved is None:
                is_end = self.is_approximate or wider >= _WIDEST or not beside.is_rough
                if is_own and is_end:
                    break
                if is_own:
                    wider *= _WIDER
                    self._steps = np.clip(_WIDER * self._steps, self._least, self._most)
                    self._known = None
                beside = differences(values, residuals)
                slopes = beside.slopes
                continue
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
