"""Predict a part of a log that was not fitted, horizon by horizon.

What a lightly damped or chaotic machine does long after its start says more of the start than of
the model. So a prediction begins anew inside the part, with the start that the log shows there, and
lasts until a small error of that start would have grown tenfold.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.sysid.columns import BINS, GROWN, GROWTH, ComparedColumns, growth
from tunenet_logs.analysis.sysid.fit import Begun, HeldOut
from tunenet_logs.analysis.sysid.least_squares import RolloutLeastSquares, Run, ranges_of
from tunenet_logs.episode import Array
from tunenet_logs.errors import NotFoundError

_MOST = 10  # horizons in one part of a log
_ASTRAY = 0.5  # of how much a column varies, from which on a rollout is another motion
_SHOTS = 40  # in one log that is fitted so
_MIN_SAMPLES = 10  # of all columns together, for each number of a state


# Begins anew at a time and is compared until another [s]; None where the log does not show the
# state.
Begin = Callable[[float, float], Begun | None]


@dataclass(frozen=True, eq=False)
class Unseen:
    """What of one log is held out, and how the simulator begins in it."""

    target: ComparedColumns  # of that log
    begin: Begin | None  # None if it can begin nowhere but at the log's start
    from_s: float  # where what is held out begins
    name: str = ""  # the log's, where there are several
    place: int | None = 0  # of its first value among all that are compared; None if none is
    whole: Begun | None = None  # begins at the log's start; of a log that is held out whole


def predicted(unseen: Sequence[Unseen], given: Array, tuned: Array, first: Array) -> HeldOut | None:
    """Predict all that is held out with tuned values, shape (T,); None if a part of it cannot be.

    `given` is the tuned parameters as given, `first` what the simulator shows then, shape (M,).
    """
    found: list[HeldOut] = []
    simulated = np.full(len(first), np.nan)
    wholes = list[Array]()  # of runs that are held out as a whole
    for one in unseen:
        here = slice(one.place, (one.place or 0) + len(one.target.values))
        before = first[here]
        if one.place is None:
            assert one.whole is not None
            start = np.array([each.initial for each in one.whole.starts])
            before = one.whole.run(np.concatenate([given, start])[None])[0]
        part = _by_horizons(one, before, tuned)
        if part is None or part.simulated is None:
            return None
        if one.place is not None:
            simulated[here] = part.simulated
        else:
            wholes.append(np.stack([before, part.simulated]))
        prefix = f"{one.name}: " if one.name else ""
        columns = (replace(each, signal=prefix + each.signal) for each in part.columns)
        found.append(replace(part, columns=tuple(columns)))
    if not found:
        return None

    def every(name: str) -> Array:
        return np.concatenate([getattr(one, name) for one in found])

    both = HeldOut(
        tuple(column for one in found for column in one.columns),
        every("from_s"),
        every("rms"),
        every("before"),
        simulated if np.isfinite(simulated).any() else None,
        min(one.horizon_s or 0.0 for one in found),
        max(one.count for one in found),
        every("straight"),
        every("spread"),
        np.concatenate(wholes, axis=1) if wholes else None,
    )
    # Where a machine rests at its end, only a rollout from the log's start says something.
    return both if both.is_told or both.simulated is None else None


def _by_horizons(unseen: Unseen, before: Array, tuned: Array) -> HeldOut | None:
    """Predict one log; `before` is what the simulator as given shows, shape (M,).

    The start of each horizon is fitted to its samples.
    """
    target, from_s = unseen.target, unseen.from_s
    until_s = float(np.nextafter(target.end_s, np.inf))
    simulated, straight = np.full((2, len(target.values)), np.nan)
    horizons = _horizons(unseen, tuned, from_s)
    if horizons is None and unseen.whole is not None:  # it can begin but once
        horizons = [(0.0, until_s, unseen.whole)]
    elif horizons is None:
        return None
    for at_s, end_s, begun in horizons:
        inside = target.between(at_s, end_s)
        simulated[inside] = _followed(begun, tuned)
        straight[inside] = _straight(begun.target)
    seen = np.isfinite(simulated)
    mine = [target.values[seen & (target.which == number)] for number in range(len(target.columns))]
    return HeldOut(
        target.columns,
        np.full(len(mine), from_s),
        target.rms(simulated - target.values),
        target.rms(before - target.values, seen),
        simulated,
        min(end_s - at_s for at_s, end_s, _ in horizons),
        len(horizons),
        target.rms(straight - target.values),
        np.array([float(np.std(one)) if len(one) else 0.0 for one in mine]),
    )


def _horizons(
    unseen: Unseen, tuned: Array, from_s: float, grown: float = GROWTH, most: int = _MOST
) -> list[tuple[float, float, Begun]] | None:
    """Begin anew from a time on whenever a small error of the start has grown so many times.

    Times [s] of each begin and end, `most` at most; None where it cannot begin.
    """
    until_s = float(np.nextafter(unseen.target.end_s, np.inf))
    at_s, found = from_s, list[tuple[float, float, Begun]]()
    while at_s < until_s:
        begun, end_s = _begun(unseen.begin, at_s, until_s), until_s
        if begun is None:
            return None
        span_s = until_s - at_s
        enough = _MIN_SAMPLES * len(begun.starts) / len(begun.target.values)
        least_s = max((until_s - from_s) / most, min(enough, 1.0) * span_s)
        horizon_s = max(_horizon_s(begun, tuned, grown), least_s)
        if span_s - horizon_s >= least_s:  # else what would be left is too short
            end_s = at_s + horizon_s
            begun = _begun(unseen.begin, at_s, end_s)
            if begun is None:
                return None
        found.append((at_s, end_s, begun))
        at_s = end_s
    return found


def anew(unseen: Sequence[Unseen], tuned: Array | None) -> list[tuple[NDArray[np.bool_], Begun]]:
    """Begin a fitted simulator anew in each log: which values, shape (M,), are seen from there on.

    Whenever an error of the start would have grown thirtyfold at tuned values, (T,), or in the
    middle of each log without; none where it cannot.
    """
    count = sum(len(one.target.values) for one in unseen)
    found, later = [list[tuple[NDArray[np.bool_], Begun]]() for _ in range(2)]
    for one in unseen:
        until_s = float(np.nextafter(one.target.end_s, np.inf))
        if tuned is None:
            edges = [0.0, until_s / 2, until_s]
            begins = [
                (at_s, end_s, _begun(one.begin, at_s, end_s)) for at_s, end_s in pairwise(edges)
            ]
        else:
            begins = _horizons(one, tuned, 0.0, GROWN, _SHOTS) or []
        for at_s, end_s, begun in begins:
            if begun is None or one.place is None:
                return []
            which = np.zeros(count, dtype=np.bool_)
            which[one.place : one.place + len(one.target.values)] = one.target.between(at_s, end_s)
            (later if at_s > 0 else found).append((which, begun))
    return [*found, *later] if later else []


def _begun(begin: Begin | None, from_s: float, until_s: float) -> Begun | None:
    try:
        begun = None if begin is None else begin(from_s, until_s)
    except NotFoundError:
        return None
    return begun if begun and len(begun.target.values) > len(begun.starts) else None


def _followed(begun: Begun, tuned: Array) -> Array:
    """Fit the start to what is seen from there on; return what is simulated then, shape (N,)."""
    run, lost = _with(begun.run, tuned), begun.target.values
    if not begun.starts:
        simulated = run(np.zeros((1, 0)))[0]
        spread = begun.target.per_value([3.0 * one.spread for one in begun.target.columns])
        return np.where(np.isfinite(simulated), simulated, lost + spread)
    steps = RolloutLeastSquares(run, begun.target, begun.starts)
    return lost + steps.least_residuals(np.array([one.initial for one in begun.starts]))


def _with(run: Run, tuned: Array) -> Run:
    """Return rollouts at values of the state alone, shape (N, S)."""
    return lambda rows: run(np.column_stack([np.repeat(tuned[None], len(rows), axis=0), rows]))


def _horizon_s(begun: Begun, tuned: Array, grown: float) -> float:
    """Return when a small error of the start has grown so many times; the end if it never does."""
    target, run = begun.target, _with(begun.run, tuned)
    if not begun.starts:
        return target.end_s
    start = np.array([one.initial for one in begun.starts])
    moved = np.diag(ranges_of(begun.starts))
    seen = run(np.concatenate([start[None], start + moved]))
    spread = target.per_value([max(one.spread, 1e-12) for one in target.columns])
    apart = np.where(np.isfinite(seen[1:] - seen[0]), seen[1:] - seen[0], 0.0) / spread
    _, worst = growth(target, apart)
    beyond = worst > grown
    if grown > GROWTH:  # to be fitted: from where it is astray, growth is another motion's
        places = np.array([one.is_place for one in target.columns])[target.which]
        astray = places & (np.abs(seen[0] - target.values) > _ASTRAY * spread)
        first_s = float(target.seconds[astray | ~np.isfinite(seen[0])].min(initial=np.inf))
        beyond |= np.arange(BINS) > BINS * first_s / max(target.end_s, 1e-9)
    return target.end_s * (float(np.argmax(beyond)) / BINS if beyond.any() else 1.0)


def _straight(target: ComparedColumns) -> Array:
    """Fit a straight line to each column, shape (N,)."""
    found: list[Array] = []
    for one in target.columns:
        rows = np.column_stack([np.ones_like(one.seconds), one.seconds])
        found.append(rows @ np.linalg.lstsq(rows, one.values, rcond=None)[0])
    return np.concatenate(found)
