"""Collect verdicts of `tunenet-tune` on bad and good drops, on tracks without pictures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.evaluation.shots.campaign import draw_trials
from analysis.evaluation.shots.ground_truth_drop import MISHAPS, drop_of
from analysis.evaluation.shots.ground_truth_film import film_of, track_of
from analysis.evaluation.shots.ground_truth_sim import MASS_KG, RADIUS_M
from analysis.evaluation.track_tuning import tune_track
from analysis.processes import Piece, parallel_map
from analysis.selection import Options, Selection
from recorders.simulators.balls import Ball
from tunenet_logs.terminal import Progress

DROPS = 500  # of each kind: a fraction of 1 % has a standard error of .45 %
VERDICTS = ("ok", "suspect", "rejected")
_PORTION = 5  # drops in a piece of work: few, so that the processes end together
_WRONG = 0.02  # of restitution: such an error uses up about what the hoop leaves a shot


@dataclass(frozen=True)
class JudgedDrop:
    """Drop and its verdict.

    Attributes:
        mishap: None for a good one.
        is_round: whether its ball is.
        off: estimate less truth at the first impact's speed; None where it was rejected.
    """

    mishap: str | None
    is_round: bool
    verdict: str
    off: float | None


@dataclass(frozen=True)
class AcceptanceRow:
    """Line of the table: fractions of the drops.

    Attributes:
        label: which drops.
        drops: how many.
        wrong: `ok` and off by more than .02.
    """

    label: str
    drops: int
    ok: float
    suspect: float
    rejected: float
    wrong: float


@dataclass(frozen=True)
class _Portion:
    seed: int
    numbers: range
    is_good: bool


def judged_drops(
    seed: int, count: int, jobs: int | None, progress: Progress
) -> tuple[tuple[JudgedDrop, ...], tuple[JudgedDrop, ...]]:
    """Tune `count` drops that leave the table, and as many that do not."""
    pieces = [
        Piece(
            _Portion(seed, range(at, min(at + _PORTION, count)), is_good),
            min(_PORTION, count - at),
            "good" if is_good else "bad",
        )
        for is_good in (False, True)
        for at in range(0, count, _PORTION)
    ]
    done = parallel_map(_judge, pieces, jobs, progress, ("drops", "drop"))
    half = len(done) // 2
    bad, good = (
        tuple(drop for part in parts for drop in part) for parts in (done[:half], done[half:])
    )
    return bad, good


def acceptance_rows(
    bad: Sequence[JudgedDrop], good: Sequence[JudgedDrop]
) -> tuple[AcceptanceRow, ...]:
    """Return the rows of all that leave the table, of each kind, and of the good ones."""
    kinds = [(f"  {name}", [drop for drop in bad if drop.mishap == name]) for name in MISHAPS]
    return tuple(
        _row(label, drops)
        for label, drops in (
            ("off the table", list(bad)),
            *kinds,
            ("good", list(good)),
            ("  round balls", [drop for drop in good if drop.is_round]),
            ("  balls out of round", [drop for drop in good if not drop.is_round]),
        )
        if drops
    )


def _row(label: str, drops: list[JudgedDrop]) -> AcceptanceRow:
    counts = Counter(drop.verdict for drop in drops)
    wrong = sum(drop.verdict == "ok" and abs(drop.off or 0.0) > _WRONG for drop in drops)
    ok, suspect, rejected = (counts[verdict] / len(drops) for verdict in VERDICTS)
    return AcceptanceRow(label, len(drops), ok, suspect, rejected, wrong / len(drops))


def _judge(portion: _Portion) -> list[JudgedDrop]:
    options = Options(selection=Selection(ball=Ball(2 * RADIUS_M, MASS_KG)))
    judged = []
    for number in portion.numbers:
        rng = np.random.default_rng([portion.seed, number, int(portion.is_good), 0xACC])
        balls = draw_trials(portion.seed + number // 60)
        ball = balls[int(rng.integers(len(balls)))].ball
        mishap = None if portion.is_good else MISHAPS[number % len(MISHAPS)]
        drop = drop_of(ball, mishap, rng)
        tuning = tune_track(track_of(film_of(drop, rng)), options)
        off = None
        if tuning.estimate is not None:
            off = float(tuning.estimate[0]) - ball.restitution_at(drop.impact_m_s)
        judged.append(JudgedDrop(mishap, ball.is_round, tuning.verdict, off))
    return judged
