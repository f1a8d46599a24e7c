"""Simulate tracks of bouncing balls as uncalibrated cameras show them.

The ball is integrated (`bouncing_ball`) and projected (`viewpoint`) by nothing that the fit uses.
What a tracker adds is noise, whole pixels, gaps, and pictures before the ball is let go.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.evaluation.drop.targets import TEST_SEEDS
from analysis.evaluation.video.bouncing_ball import GRAVITY_M_S2, DroppedBall, Fall, drop_ball
from analysis.evaluation.video.viewpoint import (
    PAPER_RADIUS_M,
    SIZE_PX,
    Viewpoint,
    any_viewpoint,
    paper_viewpoint,
)
from analysis.tracking.track import Track
from tunenet_logs.arrays import Array

Mask = NDArray[np.bool_]
Range = tuple[float, float]

NOISES_PX = (0.3, 1.0)  # standard deviations of a coordinate: of a good tracker, and of a poor one
NARROW: Range = (0.3, 0.7)
WIDE: Range = (0.1, 0.95)  # restitutions: the paper's, and nearly all
TABLE_TENNIS_RADIUS_M = 0.020
# Air of 1.2 kg/m3 on a ball of 2.7 g, Cd 0.47.
TABLE_TENNIS_DRAG_1_M = 0.5 * 1.2 * 0.47 * np.pi * TABLE_TENNIS_RADIUS_M**2 / 0.0027

_RADII = (0.015, 0.06)  # of balls, over the drop height
_HELD_S = (0.0, 0.6)  # from the first picture to the release, where the rig is not free
_FROM_FALLS = (-0.6, 0.4)
# Of free rigs, in fall times: the first picture is up to the one before the release or up to the
# other after it; and how many pictures a fall has.
_FRAMES_A_FALL = (6.0, 150.0)

_MAX_LOST = 0.1
_GAPS = 0.3
# Up to a tenth of the pictures lack the ball; 30 % of the tracks have a gap, of so many fall times.
_GAP_FALLS = (0.05, 0.3)

_EARLY_ENDS = 0.1
_EARLY_FALLS = (2.0, 4.0)  # a tenth of the tracks end this many fall times after the release
# Least fraction of the first flight's pictures that show the ball: it is what is measured.
_SEEN_OF_FLIGHT = 0.6

_RADIUS_NOISE = 0.05  # standard deviation of a radius, over it
# Standard deviation of the vertical's direction: an arc shows it to about a degree.
_PLUMB_DEG = 1.0


@dataclass(frozen=True)
class TrackSet:
    """Kind of rig.

    Attributes:
        name: in tables; what is drawn depends on it.
        drop_m: range of the fall.
        radius_m: of the ball; None for 1.5 to 6 % of the fall.
        lasts: range of what is filmed after the release [fall times].
        paper: before the paper's camera; else before any.
        free: any frame rate, release held or unseen, pictures without the ball, early ends; else
            60 Hz from before the release on.
    """

    name: str
    drop_m: Range
    radius_m: float | None = None
    lasts: Range = (4.0, 8.0)
    paper: bool = False
    free: bool = False


A = TrackSet("A", (3.5, 4.5), PAPER_RADIUS_M, paper=True)
B = TrackSet("B", (0.2, 5.0))
C = TrackSet("C", (0.2, 5.0), free=True)
TRACK_SETS = (A, B, C)


@dataclass(frozen=True)
class BallRanges:
    """Ranges of the ball's parameters, each drawn uniformly.

    Attributes:
        restitution: at the first impact.
        slope: see `DroppedBall`.
        drag_1_m: likewise, of every ball.
    """

    restitution: Range
    slope: Range = (0.0, 0.0)
    drag_1_m: float = 0.0


@dataclass(frozen=True, eq=False)
class TrackScene:
    """All that determines a track: a fault changes one thing of it.

    Attributes:
        ball: its restitution is the truth.
        radius_m: of the ball.
        view: the camera.
        seconds: of the pictures, after the release, shape (T,).
        lost: pictures in which the tracker does not find the ball, shape (T,).
        noise_px: standard deviation of a coordinate, before it is rounded.
        seed: of that noise.
    """

    ball: DroppedBall
    radius_m: float
    view: Viewpoint
    seconds: Array
    lost: Mask
    noise_px: float
    seed: int

    def fall(self) -> Fall:
        """Return the ball's motion if nothing goes wrong."""
        return drop_ball(self.ball, self.seconds)


def draw_scene(
    which: TrackSet, balls: BallRanges, noise_px: float, seed: int, number: int
) -> TrackScene:
    """Draw scene `number` of a seed: the same for any noise and number drawn.

    Negative seeds are for choosing, positive ones for reporting.
    """
    low, high = balls.restitution
    rng = np.random.default_rng(
        [TEST_SEEDS + seed, number, *f"{which.name} {low:g} {high:g}".encode()]
    )
    drop_m = float(rng.uniform(*which.drop_m))
    restitution, slope = rng.uniform(*balls.restitution), rng.uniform(*balls.slope)
    ball = DroppedBall(drop_m, float(restitution), float(slope), balls.drag_1_m)
    radius_m = which.radius_m or drop_m * float(rng.uniform(*_RADII))
    view = (paper_viewpoint if which.paper else any_viewpoint)(rng, drop_m, radius_m)
    seconds = _seconds(which, ball, rng)
    lost = _lost(ball, seconds, rng) if which.free else np.zeros(len(seconds), dtype=bool)
    return TrackScene(ball, radius_m, view, seconds, lost, noise_px, int(rng.integers(2**31)))


def film(scene: TrackScene, points_m: Array | None = None) -> Track:
    """Simulate the track of the ball, or of one at `points_m` (shape (T, 3)) instead.

    It is lost where it is not wholly in the picture.
    """
    if points_m is None:
        points_m = upright(scene.fall().heights_m)
    centers_px, depth_m = scene.view.image_from_world(points_m)
    radii = scene.view.radius_px(depth_m, scene.radius_m)
    return track_from_pixels(
        scene, centers_px, radii, scene.lost | ~scene.view.shows(points_m, scene.radius_m)
    )


def track_from_pixels(scene: TrackScene, centers_px: Array, radius_px: Array, lost: Mask) -> Track:
    """Make a track from pixels: with noise, rounded, its radius to halves.

    Args:
        scene: the stamps, the noise, the camera's vertical.
        centers_px: shape (T, 2).
        radius_px: shape (T,).
        lost: pictures in which it is not found, shape (T,).
    """
    rng = np.random.default_rng(scene.seed)
    noise = rng.normal(0.0, 1.0, (len(scene.seconds), 3))
    turn = np.radians(rng.normal(0.0, _PLUMB_DEG))
    rounded = np.round(centers_px + scene.noise_px * noise[:, :2])
    radii = np.maximum(np.round(2 * radius_px * (1 + _RADIUS_NOISE * noise[:, 2])) / 2, 0.5)
    rounded[lost], radii[lost] = np.nan, np.nan
    plumb = scene.view.plumb_px(scene.ball.drop_m) * GRAVITY_M_S2 / scene.ball.drop_m
    turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ plumb
    return Track(
        stamps_ns=np.round((scene.seconds - scene.seconds[0]) * 1e9).astype(np.int64),
        places_px=rounded,
        radius_px=radii,
        confidence=(~lost).astype(np.float64),
        size_px=SIZE_PX,
        gravity_px=turned,
        colour=(128, 128, 128),
    )


def upright(heights_m: Array) -> Array:
    """Return points straight over the contact, shape (T, 3) [m], of heights, shape (T,)."""
    nothing = np.zeros_like(heights_m)
    return np.column_stack([nothing, nothing, heights_m])


def _seconds(which: TrackSet, ball: DroppedBall, rng: np.random.Generator) -> Array:
    lasts = rng.uniform(*which.lasts) * ball.fall_s
    if not which.free:
        return np.arange(-rng.uniform(*_HELD_S), lasts, 1 / 60)
    if rng.random() < _EARLY_ENDS:
        lasts = rng.uniform(*_EARLY_FALLS) * ball.fall_s
    seen = rng.choice(_FROM_FALLS) * rng.random() * ball.fall_s
    return np.arange(seen, lasts, ball.fall_s / rng.uniform(*_FRAMES_A_FALL))


def _lost(ball: DroppedBall, seconds: Array, rng: np.random.Generator) -> Mask:
    """Draw lost pictures, at times a gap too; most of the first flight is seen."""
    impacts = drop_ball(ball, np.append(seconds, 4 * ball.fall_s)).impacts_s
    flight = (seconds > impacts[0]) & (seconds < impacts[1])
    while True:
        lost = rng.random(len(seconds)) < rng.uniform(0.0, _MAX_LOST)
        if rng.random() < _GAPS:
            start = rng.uniform(-0.5, 3.0) * ball.fall_s
            end = start + rng.uniform(*_GAP_FALLS) * ball.fall_s
            lost |= (seconds > start) & (seconds < end)
        if not flight.any() or np.mean(~lost[flight]) >= _SEEN_OF_FLIGHT:
            return lost
