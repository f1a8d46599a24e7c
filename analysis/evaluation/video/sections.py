"""Tables of `tunenet-eval video` on tracks: which are drawn, and what each is tuned to."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.evaluation.track_tuning import tune_track
from analysis.evaluation.video.fault_tracks import FAULT_BALLS, FAULT_SET, TRACK_FAULTS
from analysis.evaluation.video.tracks import (
    NARROW,
    NOISES_PX,
    TABLE_TENNIS_DRAG_1_M,
    TABLE_TENNIS_RADIUS_M,
    TRACK_SETS,
    WIDE,
    B,
    BallRanges,
    TrackSet,
    draw_scene,
    film,
)
from analysis.selection import Options, Selection
from recorders.simulators.balls import BALLS
from tunenet_logs.arrays import Array

VERDICTS = ("ok", "suspect", "rejected")
# Of a row of outcomes: `shown` is 1 where the tuning tells its interval.
COLUMNS = ("truth", "value", "low", "high", "shown", "verdict")

TABLE_TENNIS = "table-tennis"  # its name among `recorders.simulators.balls.BALLS`
_SLOPES = BallRanges((0.3, 0.9), slope=(0.05, 0.2))
_LIGHT = BallRanges((0.3, 0.95), drag_1_m=TABLE_TENNIS_DRAG_1_M)
_LIGHT_SET = TrackSet("light", (0.3, 2.0), TABLE_TENNIS_RADIUS_M)


@dataclass(frozen=True)
class TrackKind:
    """Tracks of one kind: a line of a table.

    Attributes:
        label: in tables.
        tracks: the rig.
        balls: what is dropped.
        noises_px: standard deviations of a coordinate, one for each track, in turn.
        fault: name of the `TrackFault`, "" for good tracks.
        given_ball: name of the ball that the tuning is given, "" for none.
    """

    label: str
    tracks: TrackSet
    balls: BallRanges
    noises_px: tuple[float, ...]
    fault: str = ""
    given_ball: str = ""


@dataclass(frozen=True)
class Section:
    """One table.

    Attributes:
        name: in JSON and CSV.
        title: above the table.
        kinds: its lines.
    """

    name: str
    title: str
    kinds: tuple[TrackKind, ...]


@dataclass(frozen=True)
class Portion:
    """Some of a seed's tracks of a kind: what one process does in one go."""

    kind: TrackKind
    seed: int
    numbers: range


def outcomes_of(portion: Portion) -> Array:
    """Tune each track: see `COLUMNS`, shape (N, 6).

    NaN stands for the truth of a track without a bounce, and for a value or an interval that the
    tuning does not give.
    """
    return np.array([_outcome(portion.kind, portion.seed, at) for at in portion.numbers])


def _outcome(kind: TrackKind, seed: int, number: int) -> list[float]:
    noise_px = kind.noises_px[number % len(kind.noises_px)]
    scene = draw_scene(kind.tracks, kind.balls, noise_px, seed, number)
    truth, track = scene.ball.restitution, None
    if kind.fault:
        fault = next(one for one in TRACK_FAULTS if one.name == kind.fault)
        truth, track = truth if fault.bounces else np.nan, fault.track(scene)
    selection = Selection(ball=BALLS[kind.given_ball]) if kind.given_ball else Selection()
    options = Options(selection=selection)
    tuning = tune_track(film(scene) if track is None else track, options)
    value, low, high = np.nan, np.nan, np.nan
    if tuning.estimate is not None:
        value = tuning.estimate[0]
        if tuning.trace is not None and tuning.trace.fit is not None:
            low, high = tuning.trace.fit.interval95[0]
    shown = tuning.interval95 is not None
    return [truth, value, low, high, shown, VERDICTS.index(tuning.verdict)]


def _good(tracks: TrackSet) -> tuple[TrackKind, ...]:
    return tuple(
        TrackKind(
            f"{tracks.name}, {noise:g} px, {low:g} to {high:g}",
            tracks,
            BallRanges((low, high)),
            (noise,),
        )
        for low, high in (NARROW, WIDE)
        for noise in NOISES_PX
    )


def _light(given_ball: str, noise_px: float) -> TrackKind:
    return TrackKind(
        f"{'given' if given_ball else 'not given'}, {noise_px:g} px",
        _LIGHT_SET,
        _LIGHT,
        (noise_px,),
        given_ball=given_ball,
    )


SETS = tuple(
    Section(f"set-{tracks.name}", title, _good(tracks))
    for tracks, title in zip(
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
        TrackKind(f"{noise:g} px", replace(B, name="slope"), _SLOPES, (noise,))
        for noise in NOISES_PX
    ),
)
DRAG = Section(
    "drag",
    "Table-tennis ball in air, its mass and size given or not, falls of 0.3 to 2 m, .3 to .95",
    (*(_light(TABLE_TENNIS, noise) for noise in NOISES_PX), _light("", NOISES_PX[0])),
)
BAD = Section(
    "bad",
    "Bad tracks: falls of 0.2 to 5 m, .3 to .9, 0.3 and 1 px in turn",
    tuple(
        TrackKind(fault.label, FAULT_SET, FAULT_BALLS, NOISES_PX, fault=fault.name)
        for fault in TRACK_FAULTS
    ),
)
TRACK_SECTIONS = (*SETS, SLOPE, DRAG, BAD)  # in the order in which they are run and printed
