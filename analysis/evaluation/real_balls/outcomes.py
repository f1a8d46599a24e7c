"""Work of one process: drops of a cell, of a ball of the table, or videos."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.evaluation.real_balls.airless import airless_off, best_of_all, first_rebound
from analysis.evaluation.real_balls.balls import TableBall, table_drops
from analysis.evaluation.real_balls.drops import (
    DROPS_M,
    RESTITUTIONS,
    SLOPES,
    RecordedDrop,
    WorldCell,
    draw_drop,
    record_drop,
)
from analysis.evaluation.real_balls.films import filmed
from analysis.evaluation.real_balls.physics import RealBall
from analysis.evaluation.real_balls.reference import fit_reference
from analysis.evaluation.real_balls.tuned import Found, found_by, off_motion, off_path
from analysis.evaluation.track_tuning import tune_track
from analysis.selection import Options
from analysis.tuning import tune_episode
from tunenet_logs.arrays import Array

SEEN = 0.6  # of the time from the release to the last bounce in view: what a prediction is tuned on
LIGHT_DRAGS_1_M = (0.1, 0.14)
LIGHT_RADIUS_M = 0.02  # of light balls whose kind is not named, about a table-tennis ball's
LIGHT = ("light, no slope", "light, slope")  # their names in tables
_FILM_HZ = 60.0


@dataclass(frozen=True)
class CellPortion:
    """Some of a seed's drops of a cell."""

    cell: WorldCell
    seed: int
    numbers: range


@dataclass(frozen=True, eq=False)
class Compared:
    """Results of the product and of the reference on a drop of a cell."""

    ours: Found
    reference: Found


@dataclass(frozen=True, eq=False)
class Moved:
    """Errors of each tuning's motion on a drop of the table.

    Every error is the mean distance from the release to the last bounce in view, over the drop; NaN
    where there is no answer.

    Attributes:
        ball: its name.
        drop_m: that it fell.
        ours: tuned on the first `SEEN` of the time.
        verdict: of that tuning.
        paper: the preset "paper", tuned on all that it asks for, for any verdict.
        first_rebound: no air, the restitution that gives the first rebound's height.
        best_airless: no air, the restitution that is best on the first `SEEN`.
        whole: what a tuning on all that is in view finds.
    """

    ball: str
    drop_m: float
    ours: float
    verdict: str
    paper: float
    first_rebound: float
    best_airless: float
    whole: Found


@dataclass(frozen=True, eq=False)
class FilmedBall:
    """Video of a ball.

    Attributes:
        ball: its name.
        found: by a tuning on the whole film.
        ahead: mean error of the motion as in `Moved.ours`; NaN where it was not asked for.
    """

    ball: str
    found: Found
    ahead: float


def compared_drops(portion: CellPortion) -> list[Compared]:
    """Tune each drop, and fit it by the reference."""
    found: list[Compared] = []
    for number in portion.numbers:
        drop = draw_drop(portion.cell, portion.seed, number)
        ours = found_by(tune_episode(drop.episode(), Options()), drop)
        found.append(Compared(ours, reference_found(drop, portion.cell)))
    return found


def reference_found(drop: RecordedDrop, cell: WorldCell) -> Found:
    """Fit a drop by the reference."""
    fit = fit_reference(drop, cell)
    seconds = drop.seconds[(drop.seconds >= 0) & (drop.seconds <= drop.last_bounce_s)]
    off = (fit.heights_m(seconds) - drop.truth_m(seconds)) / drop.ball.drop_m
    path = float(np.sqrt(np.mean(off**2)))
    return Found(drop.ball.values[:3], fit.values, fit.interval95, "", path)


def moved_drops(asked: tuple[TableBall, int, int]) -> list[Moved]:
    """Measure the motion of a ball, for a seed and a number of drops from each height."""
    ball, seed, count = asked
    found: list[Moved] = []
    for drop in table_drops(ball, seed, count):
        view = drop.view
        seen = view.until(SEEN * view.last_bounce_s)
        ahead = tune_episode(seen.episode(), Options())
        paper = tune_episode(drop.whole.episode(), Options(preset="paper"))
        found.append(
            Moved(
                ball=ball.name,
                drop_m=view.ball.drop_m,
                ours=_mean(off_motion(ahead, view)),
                verdict=ahead.verdict,
                paper=_mean(off_path(paper, drop.whole.until(view.last_bounce_s))),
                first_rebound=_mean(airless_off(first_rebound(view), view)),
                best_airless=_mean(airless_off(best_of_all(seen), view)),
                whole=found_by(tune_episode(view.episode(), Options()), view),
            )
        )
    return found


def filmed_table(asked: tuple[TableBall, int, int]) -> list[FilmedBall]:
    """Measure as `moved_drops`, on videos."""
    ball, seed, count = asked
    found: list[FilmedBall] = []
    for at, drop in enumerate(table_drops(ball, seed, count)):
        view = drop.view
        rng = np.random.default_rng([seed, at, *b"film", *ball.name.encode()])
        track = filmed(view, ball.diameter_m / 2, rng)
        rng = np.random.default_rng([seed, at, *b"film", *ball.name.encode()])
        seen = filmed(view.until(SEEN * view.last_bounce_s), ball.diameter_m / 2, rng)
        ahead = tune_track(seen, Options())
        whole = found_by(tune_track(track, Options()), view)
        found.append(FilmedBall(ball.name, whole, _mean(off_motion(ahead, view))))
    return found


def filmed_light(asked: tuple[bool, int, range]) -> list[FilmedBall]:
    """Tune videos of light balls that are not named: with a slope or none, of a seed."""
    slopes, seed, numbers = asked
    found: list[FilmedBall] = []
    for number in numbers:
        rng = np.random.default_rng([seed, number, *b"light"])
        ball = RealBall(
            rng.uniform(*RESTITUTIONS),
            rng.uniform(*SLOPES) * slopes,
            rng.uniform(*LIGHT_DRAGS_1_M),
            rng.uniform(*DROPS_M),
        )
        drop = record_drop(ball, _FILM_HZ, 0.0, rng)
        tuning = tune_track(filmed(drop, LIGHT_RADIUS_M, rng), Options())
        found.append(FilmedBall(LIGHT[slopes], found_by(tuning, drop), np.nan))
    return found


def _mean(off: Array | None) -> float:
    return np.nan if off is None or not len(off) else float(np.mean(np.abs(off)))
