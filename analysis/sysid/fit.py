"""Fit a simulator to a log: multi-start least squares, hold-out, and intervals.

A profile likelihood and half the time step widen the intervals of the sandwich covariance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.estimators.base import FitResult
from tunenet_logs.analysis.record import Gap, Posterior
from tunenet_logs.analysis.sysid.columns import (
    GROWN,
    GROWTH,
    Column,
    ComparedColumns,
    bins_of,
    growth,
)
from tunenet_logs.analysis.sysid.least_squares import (
    CONTRADICTS,
    RolloutLeastSquares,
    Run,
    Solution,
    covariance,
    precisions_of,
    ranges_of,
    reach_of,
)
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.base import Parameter

# ---- Fit of all parameters, its hold-out, and how sure each is

MISSED = 0.03  # of how much a column varies in what is held out, that may be missed
TOLD = 0.6  # of the sd of what others have: a log that leaves more tells nothing of it
_LOOSENED, _LOOSEST = 1.5, 10.0  # times as unsure a start as read: from when on, and at most
_LOST = 0.2  # of how much a column varies: with more left, no start leads to a log's end
_PARTS = 3  # of a log that is begun anew, by which its intervals are tried
# Pieces of each log, and of several; of more, other starts cost too much to be followed.
_FEW_SHOTS, _MOST_SHOTS = 8, 32
_LOOKS = 2  # at where a motion is predictable, or at each wavy cost, and from what that gave
_STEP_ORDER = 2.0  # an infinitely short step moves values twice as far as half a step (first order)
_SURELY_SEEN = 1e4  # of twice a log likelihood: so much by straight lines is no error of theirs
_LOWER = 0.95  # of the cost of an end: one as low is the same


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
    half95: Array  # how far the 95 % interval of each value reaches, shape (P,), bounds ignored
    # shift of each by half the time step, shape (P,); None if there is no other step
    step_shift: Array | None
    held_out: HeldOut | None  # None if the log is too short
    correlation: Array  # of all values, shape (P, P)
    inflation: Array  # ratio of each sd to that with all else known, shape (P,)
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
        # Times less sure than if all else was known: from there on it is seen with that alone
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
    omitted: Sequence[Run] = (),
    anew: Anew | None = None,
    joints: Mapping[str, str] | None = None,
) -> FitResult:
    """Fit all parameters to a log, the user's from `start`, shape (T,).

    `finer` makes rollouts with half the time step; `unresolved` is what the step leaves unsure of
    each parameter, one standard deviation, shape (P,). `predict` tells how well a fit predicts
    what is held out, `later` what of the log that is, shape (M,): the last 40 % of the time. `logs`
    are the names of several, and which each value is of, shape (M,). `omitted` roll out with one
    effect each that is left out, of the usual size. `anew` begins rollouts inside the log. `joints`
    are those that servos' parameters move, by their addresses.
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
        omitted = ()
    parameters = steps.parameters
    cov, independent = covariance(solution, target, parameters)
    sd = np.sqrt(np.diag(cov))
    correlation = cov / np.outer(sd, sd)
    known = sd / steps.inflation(solution)
    sd[:tuned] *= _walked(steps, solution, cov, tuned)
    shift = None if finer is None else _shift_by_step(finer, solution, target, parameters)
    rough = [_moved_by(bend, solution, target, parameters) for bend in solution.bends]
    # Factor on the variance of white noise in them: 1 + 4 + 1
    wide = np.hypot(sd, np.sqrt(np.mean(np.square(rough), axis=0) / 6.0))
    effects = _omitted_effects(omitted, steps, solution, wide)
    wide = np.sqrt(wide**2 + sum((size * by) ** 2 for by, size in effects))
    inflation = wide / known
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
    ends = np.stack([solution.values - half95, solution.values + half95])
    if shift is not None:  # from what this step needs to what an infinitely short one would
        ends += np.stack([np.minimum(shift, 0.0), np.maximum(shift, 0.0)])
        half95 += np.abs(shift)
    low, high = np.array([one.bounds for one in parameters]).T
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
        None if shift is None else np.abs(shift) / _STEP_ORDER,
        held_out,
        correlation,
        inflation,
        np.ones(len(which))
        if shots or steps.is_met(solution.residuals)
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
            return Gap(column.label, motion, False, column.unit, (np.nan, np.nan), None, None)
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
    moves = column.spread > 3 * column.noise
    is_told = moves and bool(np.isfinite(delay_s).all())
    left = rms[1] / column.spread if moves else None
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
        reach, seen = np.sqrt(CONTRADICTS / curvature), 0.0
        for _ in range(8):
            reach = min(reach, ranges[number])
            rises = [steps.follow(solution, number, side * reach, along) for side in (-1.0, 1.0)]
            moved = [(cost - start, far) for cost, far in rises if far > reach / 2]
            rise, far = min(moved, default=(0.0, reach))
            seen = max(rise, 0.0) / far**2
            if rise > CONTRADICTS / 2 or reach >= ranges[number]:
                break
            reach *= 3.0
        if seen < curvature / 2:
            factors[number] = np.sqrt(curvature / max(seen, 1e-12 * curvature))
    return factors


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
            most = np.maximum.accumulate(grown)[bins_of(own)]
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
    return (weighed, found) if weighed.is_met(found.residuals) else (steps, solution)


def _followed(
    steps: RolloutLeastSquares, start: Array, which: NDArray[np.intp], anew: Anew | None
) -> tuple[RolloutLeastSquares, Solution, Shots]:
    """Fit from the log's start, or begun anew where no start leads to its end; `start` is (T,)."""
    target, parameters, tuned = steps.target, steps.parameters, len(start)
    begins = [one.initial for one in parameters[tuned:]]
    solution = _looked(steps, steps.solve(np.concatenate([start, begins])))
    shots: Shots = ()
    if not steps.is_met(solution.residuals) and anew is not None:
        spreads = [max(one.spread, 1e-12) if one.is_place else np.inf for one in target.columns]
        left = steps.left(solution.residuals) / spreads
        grows = _predictable(steps, solution, which)[1].min() < (GROWTH / GROWN) ** 2
        if grows or np.any(left > _LOST):
            shots = anew(solution.values[:tuned]) or anew(start)
    if not shots:
        if not steps.is_met(solution.residuals):
            steps, solution = _where_predictable(steps, solution, which)
        steps, solution = _loosened(steps, solution)
        if not steps.is_met(solution.residuals):
            solution = _from_elsewhere(steps, solution, tuned)
        return steps, solution, shots
    steps = _shooting(shots, target, parameters[:tuned])
    begins = [one.initial for one in steps.parameters[tuned:]]
    solution = steps.solve(np.concatenate([start, begins]))
    logs = len(np.unique(which))
    few = min(_FEW_SHOTS * logs, _MOST_SHOTS)
    if len(shots) <= few and not steps.is_met(solution.residuals):
        solution = _from_elsewhere(steps, solution, tuned, is_rough=True)
    steps, solution = _loosened(steps, solution)
    return steps, solution, shots


def _looked(steps: RolloutLeastSquares, solution: Solution) -> Solution:
    """Look along each parameter whose cost has many minima, and descend from a lower one."""
    wavy = [number for number, one in enumerate(steps.parameters) if one.looks]
    for _ in range(_LOOKS * len(wavy)):
        best = None
        least = steps.cost(solution.residuals, solution.values, solution.noise) - CONTRADICTS
        for number in wavy:
            one = steps.parameters[number]
            rows = np.repeat(solution.values[None], one.looks, axis=0)
            rows[:, number] = np.linspace(*one.training_range, one.looks)
            for row, off in zip(rows, steps.residuals(rows), strict=True):
                if (cost := steps.cost(off, row, solution.noise)) < least:
                    best, least = row, cost
        if best is None:
            break
        again = steps.solve(best)
        if steps.unlikely(again) >= steps.unlikely(solution):
            break
        solution = replace(again, path=(*solution.path, *again.path))
    return solution


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
        if steps.is_met(solution.residuals):
            break
    return solution


def _shift_by_step(
    finer: Run, solution: Solution, target: ComparedColumns, parameters: tuple[Parameter, ...]
) -> Array:
    """Return how far an infinitely short time step would move values, about, shape (P,)."""
    moved = finer(solution.values[None])[0] - (target.values + solution.residuals)
    moved = np.where(np.isfinite(moved), moved, 0.0)
    return -_STEP_ORDER * _moved_by(moved, solution, target, parameters)


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


def _omitted_effects(
    omitted: Sequence[Run], steps: RolloutLeastSquares, solution: Solution, sd: Array
) -> list[tuple[Array, float]]:
    """Return how each effect that is left out would move values, (P,), and its size by the log, sd.

    It is there or not, as likely either way before (Bayesian model averaging; Hoeting et al. 1999);
    if so, between none and the usual size, 1, with variance 1. What a refit with it leaves is seen.
    """
    from scipy.special import ndtri

    target, found = steps.target, list[tuple[Array, float]]()
    weights = solution.chosen / target.per_value(solution.noise) ** 2 / solution.together
    for run in omitted:
        with_it = replace(steps, run=run)
        left = with_it.residuals(solution.values[None])[0] - solution.residuals
        by = -_moved_by(left, solution, target, steps.parameters)
        left = left + solution.slopes @ by
        if np.sum(weights * left**2) < _SURELY_SEEN and np.any(np.abs(by) > sd):
            values, residuals = with_it.descended(solution)
            by, left = values - solution.values, residuals - solution.residuals
        variance = 1.0 / (1.0 + float(np.sum(weights * left**2)))
        mean = -variance * float(np.sum(weights * left * solution.residuals))
        odds = np.sqrt(variance) * np.exp(min(mean**2 / variance / 2, 100.0))  # Laplace's
        there = float(odds / (1.0 + odds))
        reach95 = abs(mean) - np.sqrt(variance) * ndtri(min(0.025 / there, 0.5))
        rms = np.sqrt(there * (variance + mean**2))
        found.append((by, float(max(rms, reach95 / 1.96 * (there > 0.05)))))
    return found


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
