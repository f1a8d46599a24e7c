"""What `tunenet-tune` takes bad drops for, and good ones: their tracks, without pictures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.evaluation.shots.campaign import draw_trials
from analysis.evaluation.shots.ground_truth_drop import MISHAPS, drop_of
from analysis.evaluation.shots.ground_truth_film import film_of, track_of
from analysis.evaluation.shots.ground_truth_sim import MASS_KG, RADIUS_M
from analysis.experiment import Selection
from analysis.processes import Piece, parallel_map
from analysis.tuning import Options, tune_track
from recorders.simulators.balls import Ball
from tunenet_logs.progress import Progress

DROPS = 500
VERDICTS = ("ok", "suspect", "rejected")
_PORTION = 5
_WRONG = 0.02
"""An error that costs a shot about its room."""


@dataclass(frozen=True)
class Judged:
    """A drop.

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
    """A line of the table: shares of the drops.

    Attributes:
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
) -> tuple[tuple[Judged, ...], tuple[Judged, ...]]:
    """`count` drops that leave the table, and as many that do not."""
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
    return _joined(done[:half]), _joined(done[half:])


def acceptance_rows(bad: Sequence[Judged], good: Sequence[Judged]) -> tuple[AcceptanceRow, ...]:
    """All that leave the table, each kind of them, and the good ones."""
    kinds = [(f"  {name}", [one for one in bad if one.mishap == name]) for name in MISHAPS]
    return tuple(
        _row(label, drops)
        for label, drops in (
            ("off the table", list(bad)),
            *kinds,
            ("good", list(good)),
            ("  round balls", [one for one in good if one.is_round]),
            ("  balls out of round", [one for one in good if not one.is_round]),
        )
        if drops
    )


def _joined(parts: list[list[Judged]]) -> tuple[Judged, ...]:
    return tuple(one for part in parts for one in part)


def _row(label: str, drops: list[Judged]) -> AcceptanceRow:
    told = Counter(one.verdict for one in drops)
    wrong = sum(one.verdict == "ok" and abs(one.off or 0.0) > _WRONG for one in drops)
    ok, suspect, rejected = (told[verdict] / len(drops) for verdict in VERDICTS)
    return AcceptanceRow(label, len(drops), ok, suspect, rejected, wrong / len(drops))


def _judge(portion: _Portion) -> list[Judged]:
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
        judged.append(Judged(mishap, ball.is_round, tuning.verdict, off))
    return judged
