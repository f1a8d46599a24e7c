"""Tabulate what `tests.bench.network_worth` measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tunenet_logs.analysis.evaluation.study import short
from tunenet_logs.episode import Array

SAME = 0.1  # of an interval's half width: a smaller difference of two values tells nobody anything


@dataclass(frozen=True)
class Pair:
    """Results of `LOG_METHODS` on one log, in that order; NaN where nothing was answered."""

    kind: str
    truth: float
    values: tuple[float, ...]
    half_width: float  # of the exact fit's 95 % interval, shown or not
    rollouts: tuple[float, ...]  # of the whole tuning, the one that checks the answer among them
    seconds: tuple[float, ...]  # of the stage "tune"

    @property
    def apart(self) -> float:
        """Difference of the two values, in half widths."""
        return abs(self.values[0] - self.values[1]) / self.half_width

    @property
    def failed(self) -> bool:
        """Whether a user would notice which of them it was."""
        first, second = np.isfinite(self.values)
        return bool(first != second or self.apart > SAME)


def _failures(pairs: Sequence[Pair]) -> str:
    """Count failures, and in how many each method is nearer to the truth, or alone answers."""
    off = np.array([np.abs(np.array(pair.values) - pair.truth) for pair in pairs if pair.failed])
    if not len(off):
        return "0"
    first, second = np.nan_to_num(off, nan=np.inf).T
    return f"{len(off)} ({np.sum(first < second)} / {np.sum(second < first)})"


def log_table(pairs: Sequence[Pair]) -> str:
    """Tabulate table 1."""
    lines = head(
        "logs",
        "answered",
        "values apart, median; most [half widths]",
        "failures (nearer to the truth)",
        "mean error where both answer",
        "rollouts",
        "seconds to tune",
    )
    for kind in dict.fromkeys(pair.kind for pair in pairs):
        own = [pair for pair in pairs if pair.kind == kind]
        values = np.array([pair.values for pair in own])
        errors = np.abs(values - np.array([pair.truth for pair in own])[:, None])
        errors = errors[np.isfinite(errors).all(axis=1)]
        apart = np.array([pair.apart for pair in own])
        rollouts = np.nanmedian([pair.rollouts for pair in own], axis=0)
        seconds = np.nanmedian([pair.seconds for pair in own], axis=0)
        lines += row(
            f"{len(own)} {kind}",
            "{} / {}".format(*np.isfinite(values).sum(axis=0)),
            f"{np.nanmedian(apart):.1g}; {np.nanmax(apart):.1g}",
            _failures(own),
            " / ".join(f"{error:.5f}" for error in errors.mean(axis=0)),
            "{:g} / {:g}".format(*rollouts),
            "{:.3f} / {:.3f}, ratio {:.1f}".format(*seconds, seconds[0] / seconds[1]),
        )
    return "\n".join(lines)


def summary(errors: Array, failure: float) -> str:
    """Format mean; median; share of failures."""
    share = 100 * float(np.mean(errors > failure))
    return f"{short(float(errors.mean()))}; {short(float(np.median(errors)))}; {share:.3g} %"


def head(*cells: str) -> list[str]:
    return [*row(*cells), *row(*["---"] * len(cells))]


def row(*cells: str) -> list[str]:
    return [f"| {' | '.join(cells)} |"]
