"""Measure errors, coverage and verdicts on tracks of filmed drops."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.evaluation.video.sections import (
    TRACK_SECTIONS,
    VERDICTS,
    Portion,
    Section,
    outcomes_of,
)
from analysis.processes import Piece, parallel_map
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import Progress

WRONG = 0.05  # of restitution: a larger error is one that a user would mind
_PORTION = 10  # tracks in a portion: few, so that the processes end together


@dataclass(frozen=True)
class VideoFigures:
    """Figures of tracks of one kind; of errors and intervals, None where there is none.

    Attributes:
        targets: how many there were.
        answered: fraction that got a value: verdict `ok` or `suspect`.
        ok: fraction with that verdict; `suspect` and `rejected` likewise.
        wrong: fraction of all that are `ok` and off by more than `WRONG`, or have no bounce at all.
        mae: mean absolute error of the answered.
        median: of their absolute errors.
        p95: 95th percentile of these.
        bias: mean error, positive where the value is too high.
        covered: fraction of the answered with an interval whose interval contains the truth, be it
            shown or not.
        shown: fraction of the answered whose interval the tuning shows.
        shown_covered: fraction of those whose interval contains the truth.
        width: median of all intervals' widths.
    """

    targets: int
    answered: float
    ok: float
    suspect: float
    rejected: float
    wrong: float
    mae: float | None
    median: float | None
    p95: float | None
    bias: float | None
    covered: float | None
    shown: float | None
    shown_covered: float | None
    width: float | None


@dataclass(frozen=True)
class VideoRow:
    """Line of a table.

    Attributes:
        section: name of the `Section`.
        label: of the `TrackKind`.
        outcomes: see `sections.COLUMNS`, shape (N, 6).
    """

    section: str
    label: str
    outcomes: Array

    @property
    def figures(self) -> VideoFigures:
        """Figures by `figures_of`."""
        return figures_of(self.outcomes)


@dataclass(frozen=True)
class VideoOrder:
    """Settings of the experiment.

    Attributes:
        seeds: each draws its own tracks.
        targets: tracks of each kind for each seed.
        jobs: processes; None for all cores.
    """

    seeds: tuple[int, ...]
    targets: int
    jobs: int | None = None


def track_sections(
    order: VideoOrder, progress: Progress, sections: tuple[Section, ...] = TRACK_SECTIONS
) -> Iterator[tuple[Section, tuple[VideoRow, ...]]]:
    """Yield each section with its rows, as soon as it is done; the same for any number of jobs."""
    for section in sections:
        yield section, _rows(section, order, progress)


def figures_of(outcomes: Array) -> VideoFigures:
    """Compute the figures of outcomes: see `sections.COLUMNS`, shape (N, 6)."""
    truth, value, low, high, is_shown, verdict = outcomes.T
    answered = np.isfinite(value)
    errors = (value - truth)[answered & np.isfinite(truth)]
    off = np.where(np.isfinite(truth), np.abs(value - truth), np.inf)
    ok, suspect, rejected = (verdict == VERDICTS.index(name) for name in VERDICTS)
    known = np.isfinite(low) & np.isfinite(truth)
    covered, shown = (low <= truth) & (truth <= high), known & (is_shown > 0)
    return VideoFigures(
        targets=len(outcomes),
        answered=float(answered.mean()),
        ok=float(ok.mean()),
        suspect=float(suspect.mean()),
        rejected=float(rejected.mean()),
        wrong=float(np.mean(ok & (off > WRONG))),
        mae=_or_none(np.abs(errors), np.mean),
        median=_or_none(np.abs(errors), np.median),
        p95=_or_none(np.abs(errors), lambda errors: np.percentile(errors, 95)),
        bias=_or_none(errors, np.mean),
        covered=_or_none(covered[known], np.mean),
        shown=_or_none(shown[answered], np.mean),
        shown_covered=_or_none(covered[shown], np.mean),
        width=_or_none((high - low)[known], np.median),
    )


def _or_none(values: NDArray[Any], figure: Callable[[NDArray[Any]], Any]) -> float | None:
    return float(figure(values)) if len(values) else None


def _rows(section: Section, order: VideoOrder, progress: Progress) -> tuple[VideoRow, ...]:
    pieces: list[Piece[Portion]] = []
    rows: list[tuple[str, slice]] = []
    for kind in section.kinds:
        start = len(pieces)
        for seed in order.seeds:
            for at in range(0, order.targets, _PORTION):
                numbers = range(at, min(at + _PORTION, order.targets))
                pieces.append(Piece(Portion(kind, seed, numbers), len(numbers), kind.label))
        rows.append((kind.label, slice(start, len(pieces))))
    done = parallel_map(outcomes_of, pieces, order.jobs, progress, (section.name, "track"))
    return tuple(VideoRow(section.name, label, np.concatenate(done[own])) for label, own in rows)
