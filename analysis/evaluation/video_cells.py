"""What `tunenet-eval video` measures of tracks: which are drawn, and what each is tuned to."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.evaluation.fault_tracks import BAD_BALLS, BAD_CLASSES, BAD_SET
from analysis.evaluation.tracks import (
    NARROW,
    NOISES_PX,
    TABLE_TENNIS_DRAG_1_M,
    TABLE_TENNIS_RADIUS_M,
    TRACK_SETS,
    WIDE,
    B,
    Balls,
    TrackSet,
    draw_shot,
    film,
)
from analysis.experiment import Selection
from analysis.tuning import Options, tune_track
from recorders.simulators.balls import BALLS
from tunenet_logs.arrays import Array

VERDICTS = ("ok", "suspect", "rejected")
COLUMNS = ("truth", "value", "low", "high", "shown", "verdict")
"""Of a row of outcomes: `shown` is 1 where the tuning tells its interval."""

TABLE_TENNIS = "table-tennis"

_SLOPES = Balls((0.3, 0.9), slope=(0.05, 0.2))
_LIGHT = Balls((0.3, 0.95), drag_1_m=TABLE_TENNIS_DRAG_1_M)
_LIGHT_SET = TrackSet("light", (0.3, 2.0), TABLE_TENNIS_RADIUS_M)


@dataclass(frozen=True)
class Cell:
    """Tracks of one kind.

    Attributes:
        label: in tables.
        noises_px: one for each track, in turn.
        bad: name of the `BadClass`, "" for good tracks.
        told: name of the ball that the tuning is told of, "" where it is told nothing.
    """

    label: str
    tracks: TrackSet
    balls: Balls
    noises_px: tuple[float, ...]
    bad: str = ""
    told: str = ""


@dataclass(frozen=True)
class Section:
    """One table.

    Attributes:
        name: in JSON and CSV.
    """

    name: str
    title: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class Portion:
    """Some of a seed's tracks of a cell: what one process does in one go."""

    cell: Cell
    seed: int
    numbers: range


def outcomes_of(portion: Portion) -> Array:
    """What `tunenet-tune` makes of each track: see `COLUMNS`, shape (N, 6).

    Without a bounce the truth is NaN; without a value that is too, without an interval its ends.
    """
    return np.array([_outcome(portion.cell, portion.seed, at) for at in portion.numbers])


def _outcome(cell: Cell, seed: int, number: int) -> list[float]:
    noise_px = cell.noises_px[number % len(cell.noises_px)]
    shot = draw_shot(cell.tracks, cell.balls, noise_px, seed, number)
    truth, track = shot.ball.restitution, None
    if cell.bad:
        bad = next(one for one in BAD_CLASSES if one.name == cell.bad)
        truth, track = truth if bad.bounces else np.nan, bad.track(shot)
    options = Options(selection=Selection(ball=BALLS[cell.told]) if cell.told else Selection())
    tuning = tune_track(film(shot) if track is None else track, options)
    value, low, high = np.nan, np.nan, np.nan
    if tuning.estimate is not None:
        value = tuning.estimate[0]
        if tuning.refined is not None:
            low, high = tuning.refined.interval95[0]
    shown = tuning.interval95 is not None
    return [truth, value, low, high, shown, VERDICTS.index(tuning.verdict)]


def _good(tracks: TrackSet) -> tuple[Cell, ...]:
    return tuple(
        Cell(
            f"{tracks.name}, {noise:g} px, {low:g} to {high:g}",
            tracks,
            Balls((low, high)),
            (noise,),
        )
        for low, high in (NARROW, WIDE)
        for noise in NOISES_PX
    )


def _light(told: str, noise_px: float) -> Cell:
    return Cell(
        f"{'told' if told else 'not told'}, {noise_px:g} px",
        _LIGHT_SET,
        _LIGHT,
        (noise_px,),
        told=told,
    )


SETS = tuple(
    Section(f"set-{one.name}", title, _good(one))
    for one, title in zip(
        TRACK_SETS,
        (
            "Set A: the paper's rig; set, noise, restitution",
            "Set B: falls of 0.2 to 5 m before any camera, 60 Hz",
            "Set C: as B, 6 to 150 frames a fall, releases unseen, gaps",
        ),
        strict=True,
    )
)
SLOPE = Section(
    "slope",
    "Restitution that falls with speed (p .05 to .2), set B, .3 to .9 at the first impact",
    tuple(
        Cell(f"{noise:g} px", replace(B, name="slope"), _SLOPES, (noise,)) for noise in NOISES_PX
    ),
)
DRAG = Section(
    "drag",
    "Table-tennis ball in air, its mass and size told or not, falls of 0.3 to 2 m, .3 to .95",
    (*(_light(TABLE_TENNIS, noise) for noise in NOISES_PX), _light("", NOISES_PX[0])),
)
BAD = Section(
    "bad",
    "Bad tracks: falls of 0.2 to 5 m, .3 to .9, 0.3 and 1 px in turn",
    tuple(Cell(one.label, BAD_SET, BAD_BALLS, NOISES_PX, bad=one.name) for one in BAD_CLASSES),
)
TRACK_SECTIONS = (*SETS, SLOPE, DRAG, BAD)
"""In the order in which they are run and printed."""
