"""Fit a simulator to a log: multi-start least squares, hold-out, and intervals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import qmc, t

from analysis.estimators.base import FitResult
from analysis.sysid.compared import ComparedColumns
from analysis.sysid.covariance import covariance
from analysis.sysid.gauss_newton import RolloutLeastSquares, Run, Solution, ranges_of
from recorders.simulators.base import Parameter
from tunenet_logs.arrays import Array

_GOOD = 1.5  # times a column's noise: a solution that leaves less is not looked for elsewhere
_CLOSE_SHARE = 0.01  # of a column's spread, likewise, where the noise is less than that
_SCREENED, _RESTARTS = 24, 2
_HELD_OUT_FROM = 0.6  # of the log: a second fit to what is before is judged by what comes after
# Times less sure than if all others were known: from there on it is seen with them alone.
_TOGETHER = 40.0

# Of the cost, twice a log likelihood: two standard deviations; how a walk goes on until then.
_CONTRADICTS, _WALK_FACTOR, _MAX_WALKS = 4.0, 3.0, 8

_SECOND_DIFFERENCES = 6.0  # what the variance of a rough rollout grows by in them: 1 + 4 + 1
# Of a parameter's range: where 95 % reach further than this to each side, the log cannot tell.
_UNTOLD_SHARE = 0.25


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Hold-out: prediction of the part of the log that was not fitted.

    Attributes:
        from_s: Where that part begins.
        simulated: Of a fit to what is before, shape (M,).
        rms: Residual in that part, by column, shape (C,).
        before: Residual there of the simulator as given, shape (C,).
    """

    from_s: float
    simulated: Array
    rms: Array
    before: Array


@dataclass(frozen=True, eq=False)
class SimulatorFit:
    """Result of a fit, for checks and reviews.

    Attributes:
        target: What was compared.
        parameters: All P that were fitted, those of the initial state, too.
        tuned: How many of them, the first, are the user's.
        solution: Where the steps ended.
        simulated: What it shows at the log's stamps, shape (M,).
        first: What the simulator showed as given, shape (M,).
        sd: Standard deviation of each value, shape (P,), the time step's part included.
        half95: Half the 95 % interval of each value, shape (P,), bounds ignored.
        step_shift: Shift of each by half the time step, shape (P,); None if there is no other step.
        held_out: None if the log is too short.
        correlation: Of all values, shape (P, P).
        inflation: Ratio of each sd to that with all others known, shape (P,).
    """

    target: ComparedColumns
    parameters: tuple[Parameter, ...]
    tuned: int
    solution: Solution
    simulated: Array
    first: Array
    sd: Array
    half95: Array
    step_shift: Array | None
    held_out: HeldOut | None
    correlation: Array
    inflation: Array

    @property
    def untold(self) -> tuple[Parameter, ...]:
        """Unidentifiable tuned parameters: known to no better than a quarter of their range.

        One that is confounded with others must be known within a quarter of its value.
        """
        own, half95 = slice(self.tuned), self.half95[: self.tuned]
        wide = half95 > _UNTOLD_SHARE * ranges_of(self.parameters)[own]
        values = np.abs(self.solution.values[own])
        wide |= (self.inflation[own] > _TOGETHER) & (half95 > _UNTOLD_SHARE * values)
        return tuple(one for one, is_wide in zip(self.parameters, wide, strict=False) if is_wide)


def fit_simulator(
    run: Run,
    finer: Run | None,
    target: ComparedColumns,
    parameters: tuple[Parameter, ...],
    start: Array,
    unresolved: Array | None = None,
) -> FitResult:
    """Fit all parameters to a log.

    Args:
        run: Makes rollouts.
        finer: Makes them with half the time step; None if there is none.
        target: Columns to compare with.
        parameters: P of them; those with a prior belong to the initial state.
        start: Of those that are tuned, shape (T,), the first of the P.
        unresolved: Uncertainty due to the time step, shape (P,); None for nothing.

    Returns:
        Of the T tuned ones; its detail is a `SimulatorFit`.
    """
    tuned = len(start)
    steps = RolloutLeastSquares(run, target, parameters)
    given = np.array([one.initial for one in parameters])
    first = run(given[None])[0]
    solution = steps.solve(np.concatenate([start, given[tuned:]]))
    if not _is_good(solution, target):
        solution = _from_elsewhere(steps, solution, tuned)
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
    wide = np.hypot(sd, np.sqrt(np.mean(np.square(rough), axis=0) / _SECOND_DIFFERENCES))
    if shift is not None:
        wide = np.hypot(wide, shift)
    if unresolved is not None:  # the others follow what the step leaves unsure of one
        followed = cov * (unresolved / np.diag(cov))
        wide = np.sqrt(wide**2 + np.sum(followed**2, axis=1))
    half95 = float(t.ppf(0.975, max(independent - len(sd), 3.0))) * wide
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
        wide,
        half95,
        shift,
        _held_out(run, target, parameters, solution, first),
        correlation,
        steps.inflation(solution),
    )
    return FitResult(solution.values[:tuned], ends.T[:tuned], detail=detail, path=solution.path)


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
        for _ in range(_MAX_WALKS):
            reach = min(reach, ranges[number])
            rises = [steps.follow(solution, number, side * reach, along) for side in (-1.0, 1.0)]
            moved = [(cost - start, far) for cost, far in rises if far > reach / 2]
            rise, far = min(moved, default=(0.0, reach))
            seen = max(rise, 0.0) / far**2
            if rise > _CONTRADICTS / 2 or reach >= ranges[number]:
                break
            reach *= _WALK_FACTOR
        if seen < curvature / 2:
            factors[number] = np.sqrt(curvature / max(seen, 1e-12 * curvature))
    return factors


def _is_good(solution: Solution, target: ComparedColumns) -> bool:
    """Return whether every informative column is met about as well as its noise allows."""
    left = target.rms(solution.residuals, solution.chosen)
    every = all(column.is_jumpy for column in target.columns)
    return all(
        rms <= max(_GOOD * column.noise, _CLOSE_SHARE * column.spread)
        for rms, column in zip(left, target.columns, strict=True)
        if every or not column.is_jumpy
    )


def _from_elsewhere(steps: RolloutLeastSquares, solution: Solution, tuned: int) -> Solution:
    """Restart from the best of many quasi-random (Halton) starts; keep the best solution."""
    low, high = np.array([one.training_range for one in steps.parameters[:tuned]]).T
    places = qmc.scale(qmc.Halton(tuned, rng=0).random(_SCREENED), low, high)
    rest = np.array([one.initial for one in steps.parameters[tuned:]])
    starts = np.column_stack([places, np.repeat(rest[None], _SCREENED, axis=0)])
    off = steps.residuals(starts)
    coarse = steps.coarse()
    costs = [steps.cost(row, start, coarse) for row, start in zip(off, starts, strict=True)]
    least = steps.cost(solution.residuals, solution.values, coarse)
    for place in np.argsort(costs)[:_RESTARTS]:
        other = steps.solve(starts[place])
        cost = steps.cost(other.residuals, other.values, coarse)
        if cost < least:
            least = cost
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
    precision = [1e-4 if one.prior_sd is None else 1.0 for one in parameters]
    normal = slopes.T @ (weights[:, None] * slopes) + np.diag(precision)
    return np.linalg.solve(normal, slopes.T @ (weights * change)) * scales


def _held_out(
    run: Run,
    target: ComparedColumns,
    parameters: tuple[Parameter, ...],
    solution: Solution,
    first: Array,
) -> HeldOut | None:
    from_s = _HELD_OUT_FROM * target.end_s
    later = target.seconds > from_s
    if min(np.bincount(target.which[later], minlength=len(target.columns))) < 2:
        return None
    _, residuals = RolloutLeastSquares(run, target, parameters, from_s).one_step(solution)
    return HeldOut(
        from_s,
        target.values + residuals,
        target.rms(residuals, later),
        target.rms(first - target.values, later),
    )
