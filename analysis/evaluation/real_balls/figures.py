"""Compute a line's figures: errors with the worst beside the mean, intervals, verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.evaluation.real_balls.outcomes import LIGHT, Compared, FilmedBall, Moved
from analysis.evaluation.real_balls.tuned import PARAMETERS, VERDICTS, Found
from tunenet_logs.arrays import Array

PATH = "path"
# Quantities beside the parameters; see `Found` and `Moved`.
MOTION = ("ours", "paper", "first_rebound", "best_airless")


Shares = tuple[float | None, float | None, float | None]  # of the verdicts, in their order


@dataclass(frozen=True)
class Spread:
    """Statistics of absolute errors; None where there is none.

    Attributes:
        mean: over all that were answered.
        median: likewise.
        p99: 99th percentile.
        worst: largest.
    """

    mean: float | None
    median: float | None
    p99: float | None
    worst: float | None


@dataclass(frozen=True)
class RealLine:
    """Results of drops of one kind, for one quantity. Fractions; None where there is none.

    Attributes:
        section: of the evaluation.
        label: the kind.
        quantity: one of `PARAMETERS`, `PATH`, or one of `MOTION`.
        drops: how many there were.
        answered: how many got a value.
        ok: share of that verdict; `suspect` and `rejected` likewise.
        ours: errors: of a path or a motion over the drop height, of a drag in 1/m.
        reference: those of the fit that knows the model.
        intervals: how many 95 % intervals are given.
        covered: of these, how many hold the truth.
        reference_covered: of the reference's.
        width: median of an interval's width over the reference's.
        widest: the largest of these.
    """

    section: str
    label: str
    quantity: str
    drops: int
    answered: int
    ok: float | None
    suspect: float | None
    rejected: float | None
    ours: Spread
    reference: Spread
    intervals: int = 0
    covered: float | None = None
    reference_covered: float | None = None
    width: float | None = None
    widest: float | None = None


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
