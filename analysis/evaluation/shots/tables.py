"""Tabulate the bounce shot's results for a terminal, the paper's beside them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from analysis.evaluation.shots.acceptance import AcceptanceRow, JudgedDrop, acceptance_rows
from analysis.evaluation.shots.campaign import TrialResult
from recorders.simulators.shot.rig import ShotRig

_LABEL, _CELL = 46, 12  # of the columns [characters]


@dataclass(frozen=True)
class SuccessRate:
    """Success rate: how many shots of how many went through the hoop."""

    count: int
    of: int

    @property
    def percent(self) -> float:
        """100 count / of; NaN where there was no shot."""
        return 100 * self.count / self.of if self.of else float("nan")

    @property
    def words(self) -> str:
        """Words such as "87 % (33 of 38)"."""
        return f"{self.percent:.0f} % ({self.count} of {self.of})" if self.of else "-"


def success_rates(results: Sequence[TrialResult]) -> dict[str, SuccessRate]:
    """Compute success rates by policy and trials."""

    def rate(
        success: Callable[[TrialResult], bool], where: Callable[[TrialResult], bool]
    ) -> SuccessRate:
        chosen = [result for result in results if where(result)]
        return SuccessRate(sum(success(result) for result in chosen), len(chosen))

    def papers(result: TrialResult) -> bool:
        return result.papers.success

    def ours(result: TrialResult) -> bool:
        return result.success

    def is_round(result: TrialResult) -> bool:
        return result.trial.ball.is_round

    return {
        "paper's, all": rate(papers, lambda _: True),
        "paper's, on the table": rate(papers, lambda result: result.is_on_table),
        "paper's, off the table": rate(papers, lambda result: not result.is_on_table),
        "ours, all": rate(ours, lambda _: True),
        "ours, on the table, round": rate(
            ours, lambda result: result.is_on_table and is_round(result)
        ),
        "ours, on the table": rate(ours, lambda result: result.is_on_table),
        "ours, first drop off the table": rate(ours, lambda result: not result.is_on_table),
        "ours, round": rate(ours, is_round),
        "ours, out of round": rate(ours, lambda result: not is_round(result)),
    }


# The paper's third experiment.
_PUBLISHED = {
    "paper's, all": "62 %",
    "paper's, on the table": "87 %",
    "paper's, off the table": "18 %",
}


def relative_misses(results: Sequence[TrialResult]) -> np.ndarray:
    """Return misses of our shots of round balls, without release error, over the free radius.

    Shape (N,); infinite where the ball never came down at the hoop's height.
    """
    free_m = ShotRig().hoop.free_radius_m
    return np.array(
        [
            np.inf if one.ours.exact_miss_m is None else abs(one.ours.exact_miss_m) / free_m
            for one in results
            if one.ours is not None and one.trial.ball.is_round
        ]
    )


def campaign_table(results: Sequence[TrialResult]) -> str:
    """Tabulate success rates of both policies by seed and over all, then further figures."""
    seeds = sorted({one.trial.seed for one in results})
    by_seed = [success_rates([one for one in results if one.trial.seed == seed]) for seed in seeds]
    heads = [f"seed {seed}" for seed in seeds]
    lines = [
        f"Bounce shots in the hidden world, {len(results)} trials.",
        "",
        _line("shots through the hoop", [*heads, "all", "paper"]),
    ]
    for name, overall in success_rates(results).items():
        cells = [f"{one[name].percent:.0f} %" if one[name].of else "-" for one in by_seed]
        lines.append(_line(name, [*cells, overall.words, _PUBLISHED.get(name, "")]))
    return "\n".join([*lines, "", *_further(results)])


def _further(results: Sequence[TrialResult]) -> list[str]:
    misses = relative_misses(results)
    drops = [len(one.drops) for one in results]
    abandoned = sum(one.ours is None for one in results)
    planned = [one.ours.plan_s for one in results if one.ours is not None]
    off = [
        abs(one.ours.restitution - one.truth)
        for one in results
        if one.ours is not None and one.truth is not None and one.trial.ball.is_round
    ]
    lines = [
        f"ours: {np.mean(drops):.2f} drops a trial, {abandoned} of {len(results)} abandoned",
    ]
    if len(misses):
        lines.append(
            f"round balls, no release error: misses of {np.median(misses):.3f} of the hoop's free "
            f"radius (median), {np.quantile(misses, 0.95):.3f} (95 %)"
        )
    if off:
        lines.append(
            f"round balls: restitution at the shot's impact off by {np.median(off):.4f} (median), "
            f"{np.quantile(off, 0.95):.4f} (95 %)"
        )
    if planned:
        lines.append(f"a plan of 100 shots: {np.median(planned):.2f} s (median)")
    return lines


def acceptance_table(bad: Sequence[JudgedDrop], good: Sequence[JudgedDrop]) -> str:
    """Tabulate verdicts on drops that leave the table and on good ones."""
    lines = [
        "What drops in the hidden world are taken for (tracks without pictures), in %.",
        "wrong: ok, and off by more than .02 at the first impact.",
        "",
        _line("drops", ["count", "ok", "suspect", "rejected", "wrong"]),
    ]
    return "\n".join([*lines, *(_acceptance_line(row) for row in acceptance_rows(bad, good))])


def _acceptance_line(row: AcceptanceRow) -> str:
    figures = (row.ok, row.suspect, row.rejected, row.wrong)
    return _line(row.label, [str(row.drops), *(f"{100 * one:.1f}" for one in figures)])


def _line(label: str, cells: Sequence[str]) -> str:
    fitted = "  ".join(cell.ljust(_CELL) for cell in cells)
    return f"{label.ljust(_LABEL)}{fitted}".rstrip()
