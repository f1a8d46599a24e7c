"""Separate samples of one channel that come from two sources by turns: publishers or objects.

Nothing in a message says who sent it. But two series that take turns jump to and fro, and each of
them alone does not: each sample goes to the series whose last one is nearest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.arrays import Array

# Samples that show two series, and of more, those that are looked at first: it takes long.
_MIN_COUNT, _LOOKED_AT = 40, 20_000

_SEEDS = 16  # samples at the beginning, the two farthest apart of which begin the series
_CALMER = 0.3  # of the way that the samples make in their order: two series make less
# Of the way to the other series: so near to its own nearly every sample is.
_NEAR, _MOSTLY = 0.25, 0.98

# Of the samples, in the smaller series at least, and of these, how often the other follows.
_SHARE, _TURNS = 0.1, 0.1

# Mean steps of a series: one of the two goes over more, and both are farther from each other.
_MOVES = 10.0

_LEVELS = 20.0  # smallest changes: those that are not farther apart are what a value was rounded to


def two_sources(values: Array) -> NDArray[np.bool_] | None:
    """Separate two interleaved series by nearest neighbour.

    Args:
        values: in the order of their arrival, shape (T, C); NaN where one is missing.

    Returns:
        Which samples are of the second series, shape (T,): the one that never moves, else the one
        that comes later; None where there is but one, or two that are not clearly apart.
    """
    first = values[:_LOOKED_AT]
    is_known = np.isfinite(first).all(axis=0)
    first = first[:, is_known]
    if len(first) < _MIN_COUNT or not first.shape[1] or not _jumps(first):
        return None
    found = _told_apart(first)
    if found is None or len(values) <= _LOOKED_AT:
        return found
    values = values[:, is_known]
    return _told_apart(values) if np.isfinite(values).all() else None


def two_sources_words(name: str, second: NDArray[np.bool_], other: str) -> str:
    """Describe two interleaved series.

    Args:
        name: what both came by.
        second: which samples are of the second, shape (T,).
        other: what that goes by.
    """
    more = np.count_nonzero(second)
    return (
        f"two publishers on {name}, or two objects: its samples are of two series by turns "
        f"({len(second) - more} and {more}); the second goes by {other} (--topic)"
    )


def take_turns(first_ns: NDArray[np.int64], second_ns: NDArray[np.int64]) -> bool:
    """Check whether two sorted series of times are interleaved, not one after the other."""
    if not len(first_ns) or not len(second_ns):
        return False
    places = np.searchsorted(np.sort(first_ns), second_ns)
    turns = len(np.unique(places[(places > 0) & (places < len(first_ns))]))
    return bool(turns > _TURNS * min(len(first_ns), len(second_ns)))


def disagree(
    first: tuple[NDArray[np.int64], Array], second: tuple[NDArray[np.int64], Array]
) -> bool:
    """Check whether two series of one quantity are not of the same motion.

    Args:
        first: times, in order, shape (T,) [ns], and values, shape (T, C).
        second: the same.
    """
    (first_ns, ours), (second_ns, theirs) = first, second
    for column in range(ours.shape[1]):
        one, other = ours[:, column], theirs[:, column]
        known, told = np.isfinite(one), np.isfinite(other)
        if np.count_nonzero(known) < 2 or np.count_nonzero(told) < 2:
            continue
        at = np.interp(second_ns[told], first_ns[known], one[known])
        steps = np.mean(np.abs(np.diff(one[known]))) + np.mean(np.abs(np.diff(other[told])))
        if np.median(np.abs(other[told] - at)) > _MOVES * steps:
            return True
    return False


def _jumps(values: Array) -> bool:
    """Check whether most samples are near one of the few before, but not near the last."""
    steps = np.linalg.norm(values[1:] - values[:-1], axis=1)
    nearest = steps.copy()
    for back in range(2, 6):
        nearest[back - 1 :] = np.minimum(
            nearest[back - 1 :], np.linalg.norm(values[back:] - values[:-back], axis=1)
        )
    return float(nearest.sum()) < _CALMER * float(steps.sum())


def _told_apart(values: Array) -> NDArray[np.bool_] | None:
    seeds = values[:_SEEDS]
    ways = np.linalg.norm(seeds[:, None] - seeds[None], axis=2)
    first, second = np.unravel_index(int(ways.argmax()), ways.shape)
    lasts = [values[min(first, second)].tolist(), values[max(first, second)].tolist()]
    of_second: list[bool] = []
    nears: list[float] = []
    fars: list[float] = []
    for row in values.tolist():
        ways_2 = [sum((a - b) ** 2 for a, b in zip(row, last, strict=True)) for last in lasts]
        is_second = ways_2[1] < ways_2[0]
        lasts[is_second] = row
        of_second.append(is_second)
        nears.append(ways_2[is_second])
        fars.append(ways_2[not is_second])
    rows = np.array(of_second)
    near, far = np.sqrt(nears), np.sqrt(fars)
    fewest = min(np.count_nonzero(rows), np.count_nonzero(~rows))
    turns = np.count_nonzero(rows[1:] != rows[:-1])
    if fewest < _SHARE * len(rows) or turns < _TURNS * fewest:
        return None
    if np.mean(near <= _NEAR * far) < _MOSTLY:
        return None
    if near.sum() > _CALMER * np.linalg.norm(np.diff(values, axis=0), axis=1).sum():
        return None
    steps, spans = zip(*(_step_and_span(values[one]) for one in (rows, ~rows)), strict=True)
    moves = any(span > _MOVES * step for step, span in zip(steps, spans, strict=True))
    changes = np.abs(np.diff(np.sort(values, axis=0), axis=0))
    smallest = float(changes[changes > 0].min(initial=np.inf))
    apart = float(np.median(far))
    if not moves or apart < _MOVES * max(steps) or apart < _LEVELS * smallest:
        return None
    if spans[0] == 0 or spans[1] == 0:  # what never moves is the second
        return rows if spans[0] == 0 else ~rows
    return rows if not rows[0] else ~rows


def _step_and_span(values: Array) -> tuple[float, float]:
    """Return the mean distance between consecutive samples, and the largest range along an axis."""
    steps = np.linalg.norm(np.diff(values, axis=0), axis=1)
    return float(steps.mean()), float(np.ptp(values, axis=0).max())
