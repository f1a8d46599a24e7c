"""The bounce shot's figures for a terminal, the paper's beside them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from analysis.evaluation.shots.acceptance import AcceptanceRow, Judged, acceptance_rows
from analysis.evaluation.shots.campaign import TrialResult
from recorders.simulators.shot.rig import ShotRig

_LABEL, _CELL = 46, 12


@dataclass(frozen=True)
class Share:
    """How many of how many."""

    count: int
    of: int

    @property
    def percent(self) -> float:
        """NaN of none."""
        return 100 * self.count / self.of if self.of else float("nan")

    @property
    def words(self) -> str:
        """Such as "87 % (33 of 38)"."""
        return f"{self.percent:.0f} % ({self.count} of {self.of})" if self.of else "-"


def shares(results: Sequence[TrialResult]) -> dict[str, Share]:
    """Success rates by policy and trials."""

    def share(
        success: Callable[[TrialResult], bool], where: Callable[[TrialResult], bool]
    ) -> Share:
        chosen = [one for one in results if where(one)]
        return Share(sum(success(one) for one in chosen), len(chosen))

    def papers(one: TrialResult) -> bool:
        return one.papers.success

    def ours(one: TrialResult) -> bool:
        return one.success

    def is_round(one: TrialResult) -> bool:
        return one.trial.ball.is_round

    return {
        "paper's, all": share(papers, lambda _: True),
        "paper's, on the table": share(papers, lambda one: one.is_on_table),
        "paper's, off the table": share(papers, lambda one: not one.is_on_table),
        "ours, all": share(ours, lambda _: True),
        "ours, on the table, round": share(ours, lambda one: one.is_on_table and is_round(one)),
        "ours, on the table": share(ours, lambda one: one.is_on_table),
        "ours, first drop off the table": share(ours, lambda one: not one.is_on_table),
        "ours, round": share(ours, is_round),
        "ours, out of round": share(ours, lambda one: not is_round(one)),
    }


_PUBLISHED = {
    "paper's, all": "62 %",
    "paper's, on the table": "87 %",
    "paper's, off the table": "18 %",
}


def miss_shares(results: Sequence[TrialResult]) -> np.ndarray:
    """Misses of our shots of round balls without release error, over the hoop's free radius."""
    free_m = ShotRig().hoop.free_radius_m
    return np.array(
        [
            np.inf if one.ours.exact_miss_m is None else abs(one.ours.exact_miss_m) / free_m
            for one in results
            if one.ours is not None and one.trial.ball.is_round
        ]
    )


def campaign_table(results: Sequence[TrialResult]) -> str:
    """Success rates of both policies by seed and over all, then what else is to be shown."""
    seeds = sorted({one.trial.seed for one in results})
    by_seed = [shares([one for one in results if one.trial.seed == seed]) for seed in seeds]
    heads = [f"seed {seed}" for seed in seeds]
    lines = [
        f"Bounce shots in the hidden world, {len(results)} trials.",
        "",
        _line("shots through the hoop", [*heads, "all", "paper"]),
    ]
    for name, overall in shares(results).items():
        cells = [f"{one[name].percent:.0f} %" if one[name].of else "-" for one in by_seed]
        lines.append(_line(name, [*cells, overall.words, _PUBLISHED.get(name, "")]))
    return "\n".join([*lines, "", *_further(results)])


def _further(results: Sequence[TrialResult]) -> list[str]:
    misses = miss_shares(results)
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


def acceptance_table(bad: Sequence[Judged], good: Sequence[Judged]) -> str:
    """Verdicts on drops that leave the table and on good ones."""
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
