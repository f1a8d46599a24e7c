"""Put cameras before falling balls, and make the tracks that a tracker would find, good and faulty.

Balls are integrated (`worlds.ball`) and projected by nothing that the fit uses. What a tracker adds
is noise, whole pixels, gaps, and pictures before the ball is let go.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.evaluation.worlds.ball import (
    DROP_M,
    GRAVITY_M_S2,
    RADIUS_M,
    TEST_SEEDS,
    Fall,
    Range,
    RealBall,
    RecordedDrop,
    drop_ball,
)
from tunenet_logs.analysis.tracking.track import Track, new_pictures
from tunenet_logs.episode import Array

Mask = NDArray[np.bool_]

# ---- A pinhole: of clips, of films in the hidden world, and of tracks that are not rendered.

SIZE_PX = (320, 240)  # width and height of a picture


@dataclass(frozen=True)
class View:
    """Pinhole camera without distortion, which may be turned about its optical axis."""

    position_m: tuple[float, float, float]  # where it stands
    aim_m: tuple[float, float, float]  # the point in the middle of its picture
    focal_px: float
    size_px: tuple[int, int] = SIZE_PX
    roll_rad: float = 0.0  # clockwise turn of the picture

    @property
    def middle_px(self) -> Array:
        """Principal point, shape (2,); the first pixel's centre is 0, 0."""
        return (np.array(self.size_px) - 1) / 2

    @property
    def camera_from_world(self) -> Array:
        """Rotation whose rows are the image's right and down, and forward, shape (3, 3)."""
        forward = np.subtract(self.aim_m, self.position_m)
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        image = _turn(self.roll_rad) @ np.array([right, np.cross(forward, right)])
        return np.vstack([image, forward])

    def seen_from_camera(self, points_m: Array) -> Array:
        """Transform points to camera axes [m], shape (N, 3)."""
        return (points_m - np.array(self.position_m)) @ self.camera_from_world.T

    def depths_m(self, points_m: Array) -> Array:
        """Return how far points, (N, 3), are along the optical axis, NaN behind; shape (N,)."""
        depth = self.seen_from_camera(points_m)[:, 2]
        return np.where(depth > 0, depth, np.nan)

    def image_from_world(self, points_m: Array) -> Array:
        """Project points, (N, 3), to pixels, shape (N, 2); NaN behind."""
        seen = self.seen_from_camera(points_m)[:, :2]
        return self.middle_px + self.focal_px * seen / self.depths_m(points_m)[:, None]

    def radius_px(self, points_m: Array, radius_m: float) -> Array:
        """Return a ball's approximate image radius at points, (N, 3), NaN behind; shape (N,)."""
        return self.focal_px * radius_m / self.depths_m(points_m)

    def shows(self, points_m: Array, radius_m: float) -> NDArray[np.bool_]:
        """Check whether a ball is wholly in view at these points, of shape (N, 3); shape (N,)."""
        pixels, margin = (
            self.image_from_world(points_m),
            self.radius_px(points_m, radius_m)[:, None],
        )
        far = np.array(self.size_px) - 1 - margin
        return np.all((pixels >= margin) & (pixels <= far), axis=1)  # NaN is not

    def plumb_px(self, drop_m: float) -> Array:
        """Return the image vector from the start of a fall to its end at height 0, (2,)."""
        top, low = self.image_from_world(upright(np.array([drop_m, 0.0])))
        return low - top

    def directions(self, columns: NDArray[Any], rows: NDArray[Any]) -> NDArray[np.float32]:
        """Return viewing directions of pixels, camera axes, (H, W, 3); 1 forward."""
        looks = np.ones((len(rows), len(columns), 3), np.float32)
        x, y = self.middle_px
        looks[:, :, 0] = (columns - x) / self.focal_px
        looks[:, :, 1] = ((rows - y) / self.focal_px)[:, None]
        return looks


def upright(heights_m: Array) -> Array:
    """Return points straight over the contact, shape (T, 3) [m], of heights, shape (T,)."""
    nothing = np.zeros_like(heights_m)
    return np.column_stack([nothing, nothing, heights_m])


def _turn(angle: float) -> Array:
    """Return the rotation by an angle [rad], shape (2, 2)."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin], [sin, cos]])


def _focal_px(fov_deg: float, height_px: int = SIZE_PX[1]) -> float:
    return float(height_px / 2 / np.tan(np.radians(fov_deg) / 2))


# ---- Cameras before a clip's ball, whose contact with the floor is its radius over it.

# Width and height: webcams and phones, upright ones too.
SIZES_PX = (
    *((320, 240), (480, 270), (480, 640), (640, 360), (640, 480)),
    *((720, 1280), (848, 480), (960, 540), (1280, 720), (1280, 960)),
)

_ROLL_DEG = 3.0  # standard deviation of a camera's

_MIN_SPAN = 0.35  # of the fall, over the picture's height


def random_view(
    rng: np.random.Generator,
    drop_m: float,
    radius_m: float,
    sizes_px: Sequence[tuple[int, int]] = SIZES_PX,
) -> View | None:
    """Draw a camera where people stand, the whole fall in view at a fair size; None if too hard."""
    size = sizes_px[int(rng.integers(len(sizes_px)))]
    path = upright(radius_m + np.array([0.0, drop_m]))
    for _ in range(60):
        distance = drop_m * rng.uniform(1.2, 4.0) + 4 * radius_m
        elevation = np.radians(rng.uniform(-5.0, 45.0))
        aim = radius_m + drop_m * rng.uniform(0.35, 0.6)
        position = (-distance * np.cos(elevation), 0.0, aim + distance * np.sin(elevation))
        target = (0.0, drop_m * rng.normal(0.0, 0.15), aim)
        focal = _focal_px(rng.uniform(35.0, 65.0), size[1])
        view = View(position, target, focal, size, float(np.radians(rng.normal(0.0, _ROLL_DEG))))
        if position[2] <= max(0.05, 1.5 * radius_m):  # an eye on the floor
            continue
        pixels, radius_px = view.image_from_world(path), view.radius_px(path, radius_m)
        margin = 3.0 + 1.2 * radius_px.max()
        inside = (pixels > margin) & (pixels < np.array(size) - 1 - margin)
        # a smaller ball is a speck, a larger one fills the picture
        fair = radius_px.min() > 2.5 and radius_px.max() < min(60.0, 0.08 * max(size))
        if inside.all() and fair and np.ptp(pixels[:, 1]) > _MIN_SPAN * size[1]:
            return view
    return None


# ---- Cameras before the hidden world's drops.

HIDDEN_SIZE_PX = (640, 480)
_HIDDEN_MARGIN_PX = 20.0


def drop_view(rng: np.random.Generator) -> View:
    """Draw a camera 1.5 to 3 m away with the whole fall in view, at a fair size."""
    fall_m = upright(RADIUS_M + np.array([0.0, DROP_M]))
    while True:
        distance = rng.uniform(1.5, 3.0)
        elevation = np.radians(rng.uniform(-5.0, 35.0))
        aim = DROP_M * rng.uniform(0.35, 0.6)
        up = max(aim + distance * np.sin(elevation), 0.1)
        position = (float(-distance * np.cos(elevation)), 0.0, float(up))
        target = (0.0, float(rng.normal(0.0, 0.1)), float(aim))
        focal = _focal_px(rng.uniform(36.0, 62.0), HIDDEN_SIZE_PX[1])
        roll = float(np.radians(rng.normal(0.0, 2.0)))
        view = View(position, target, focal, HIDDEN_SIZE_PX, roll)
        span_px = np.ptp(view.image_from_world(fall_m)[:, 1])
        if is_well_inside(view, fall_m) and span_px > _MIN_SPAN * HIDDEN_SIZE_PX[1]:
            return view


def is_well_inside(view: View, points_m: Array) -> bool:
    """Check whether points, shape (N, 3), are some way from the picture's edge."""
    pixels = view.image_from_world(points_m)
    far = np.array(view.size_px) - 1 - _HIDDEN_MARGIN_PX
    return bool(np.all((pixels > _HIDDEN_MARGIN_PX) & (pixels < far)))


# ---- Track of a recorded drop before a camera, without rendering it.
# A pinhole stands anywhere from which a person films a drop. Places have noise and are not rounded.

NOISE_PX = 0.3  # standard deviation of a coordinate


_PLUMB_DEG = 1.0  # standard deviation of a tracker's vertical


def filmed(drop: RecordedDrop, radius_m: float, rng: np.random.Generator) -> Track:
    """Simulate the track of the ball; `drop` says when a picture is taken."""
    fall_m = drop.ball.drop_m
    # of the release and the contact, then of the ball in each picture
    heights = np.concatenate([[fall_m, 0.0], drop.truth_m(drop.seconds)])
    # the camera's distance and elevation are seen from the middle of the drop
    away = fall_m * rng.uniform(1.5, 5.0)
    elevation = np.radians(rng.uniform(-10.0, 35.0))
    elevation = max(elevation, -np.arctan2(0.4 * fall_m, away))  # not from under the table
    up = heights - fall_m / 2
    depth_m = away - up * np.sin(elevation)
    rows = -up * np.cos(elevation) / depth_m
    focal_px = rng.uniform(0.5, 0.85) * SIZE_PX[1] / float(rows[1] - rows[0])
    down = focal_px * (rows - (rows[0] + rows[1]) / 2)
    across = np.full_like(down, rng.uniform(-40.0, 40.0)) * away / depth_m
    pixels = np.column_stack([across, down]) @ _turn(np.radians(rng.normal(0.0, _ROLL_DEG))).T
    pixels += (np.array(SIZE_PX) - 1) / 2
    noise = rng.normal(0.0, 1.0, (len(pixels), 3))
    places = pixels[2:] + NOISE_PX * noise[2:, :2]
    radii = focal_px * radius_m / depth_m[2:] * (1 + 0.03 * noise[2:, 2])
    lost = ~np.all((places > 0) & (places < np.array(SIZE_PX) - 1), axis=1)
    plumb = (pixels[1] - pixels[0]) * GRAVITY_M_S2 / drop.ball.drop_m
    gravity_px = _turn(np.radians(rng.normal(0.0, _PLUMB_DEG))) @ plumb
    return found_track(drop.stamps_ns, places, radii, lost, gravity_px)


def found_track(
    stamps_ns: NDArray[np.int64],
    places_px: Array,
    radius_px: Array,
    lost: Mask,
    gravity_px: Array,
    size_px: tuple[int, int] = SIZE_PX,
) -> Track:
    """Make a track of a grey ball, which is not found where it is lost, shape (T,)."""
    return Track(
        stamps_ns=stamps_ns,
        places_px=np.where(lost[:, None], np.nan, places_px),
        radius_px=np.where(lost, np.nan, radius_px),
        confidence=(~lost).astype(np.float64),
        size_px=size_px,
        gravity_px=gravity_px,
        colour=(128, 128, 128),
    )


# ---- Viewpoints before a falling ball: the paper's rig, and anywhere.
# The world's origin is the middle of the ball where it touches the table, z is up.

PAPER_RADIUS_M = 0.5


def paper_viewpoint(rng: np.random.Generator, drop_m: float, radius_m: float) -> View:
    """Draw the paper's camera (Allevato et al. 2019, experiment 3), with all of the drop in view.

    r ~ U(5, 10) m, theta ~ U(0, 2 pi), z ~ U(5, 8) m, aimed at (0, 0, 2) m over the table. Its lens
    is of 40 degrees, at which a fifth of its drops are cut off by the frame; here of up to 60.
    """
    while True:
        reach, theta = rng.uniform(5.0, 10.0), rng.uniform(0.0, 2 * np.pi)
        up = rng.uniform(5.0, 8.0)
        position = (reach * np.cos(theta), reach * np.sin(theta), up - radius_m)
        view = View(position, (0.0, 0.0, 2.0 - radius_m), _focal_px(rng.uniform(40.0, 60.0)))
        if _shows_the_drop(view, drop_m, radius_m):
            return view


def any_viewpoint(rng: np.random.Generator, drop_m: float, radius_m: float) -> View:
    """Draw a camera from which a person films a drop, so that it takes U(.4, .85) of the view.

    0.8 to 4 drop heights away (evenly in the logarithm), 25 degrees below to 50 above the middle of
    the drop but not below the table, turned by a few degrees, aimed at about that middle, with any
    lens of 15 to 90 degrees that does so.
    """
    while True:
        away = drop_m * float(np.exp(rng.uniform(*np.log((0.8, 4.0)))))
        above, theta = np.radians(rng.uniform(-25.0, 50.0)), rng.uniform(0.0, 2 * np.pi)
        aside, up = drop_m * rng.normal(0.0, 0.1, 2), drop_m * rng.uniform(0.35, 0.6)
        flat = away * np.cos(above)
        position = (flat * np.cos(theta), flat * np.sin(theta), up + away * np.sin(above))
        aim = (float(aside[0]), float(aside[1]), up)
        roll = float(np.radians(rng.normal(0.0, 4.0)))
        wanted = rng.uniform(0.4, 0.85) * SIZE_PX[1]
        focal = float(wanted / np.linalg.norm(View(position, aim, 1.0).plumb_px(drop_m)))
        view = View(position, aim, focal, roll_rad=roll)
        fits = _focal_px(90.0) <= focal <= _focal_px(15.0) and position[2] > 0
        if fits and _shows_the_drop(view, drop_m, radius_m):
            return view


def _shows_the_drop(view: View, drop_m: float, radius_m: float) -> bool:
    """Check whether the start and the contact are in the frame, with 2 px to spare."""
    path = upright(np.array([0.0, drop_m]))
    spare_m = 2.0 * float(view.depths_m(path).max()) / view.focal_px
    return bool(view.shows(path, radius_m + spare_m).all())


# ---- Sets of tracks: rigs, balls, and what a tracker makes of a scene.

NOISES_PX = (0.3, 1.0)  # standard deviations of a coordinate: of a good tracker, and of a poor one
NARROW: Range = (0.3, 0.7)
WIDE: Range = (0.1, 0.95)  # restitutions: the paper's, and nearly all
TABLE_TENNIS_RADIUS_M = 0.020
# Air of 1.2 kg/m3 on a ball of 2.7 g, Cd 0.47.
TABLE_TENNIS_DRAG_1_M = 0.5 * 1.2 * 0.47 * np.pi * TABLE_TENNIS_RADIUS_M**2 / 0.0027


@dataclass(frozen=True)
class TrackSet:
    """Kind of rig."""

    name: str  # in tables; what is drawn depends on it
    drop_m: Range  # range of the fall
    radius_m: float | None = None  # of the ball; None for 1.5 to 6 % of the fall
    lasts: Range = (4.0, 8.0)  # range of what is filmed after the release [fall times]
    paper: bool = False  # before the paper's camera; else before any
    # any frame rate, release held or unseen, pictures without the ball, early ends; else 60 Hz from
    # before the release on
    free: bool = False


A = TrackSet("A", (3.5, 4.5), PAPER_RADIUS_M, paper=True)
B = TrackSet("B", (0.2, 5.0))
C = TrackSet("C", (0.2, 5.0), free=True)
TRACK_SETS = (A, B, C)


@dataclass(frozen=True)
class BallRanges:
    """Ranges of the ball's parameters, each drawn uniformly."""

    restitution: Range  # at the first impact
    slope: Range = (0.0, 0.0)  # see `RealBall`
    drag_1_m: float = 0.0  # likewise, of every ball


@dataclass(frozen=True, eq=False)
class TrackScene:
    """All that determines a track: a fault changes one thing of it."""

    ball: RealBall  # its restitution is the truth
    radius_m: float  # of the ball
    view: View
    seconds: Array  # of the pictures, after the release, shape (T,)
    lost: Mask  # pictures in which the tracker does not find the ball, shape (T,)
    noise_px: float  # standard deviation of a coordinate, before it is rounded
    seed: int  # of that noise

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
    ball = RealBall(float(restitution), float(slope), balls.drag_1_m, drop_m)
    radius_m = which.radius_m or drop_m * float(rng.uniform(0.015, 0.06))
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
    places_px = scene.view.image_from_world(points_m)
    radii = scene.view.radius_px(points_m, scene.radius_m)
    lost = scene.lost | ~scene.view.shows(points_m, scene.radius_m)
    return track_from_pixels(scene, places_px, radii, lost)


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
    turn = _turn(np.radians(rng.normal(0.0, _PLUMB_DEG)))
    places_px = np.round(centers_px + scene.noise_px * noise[:, :2])
    radii = np.maximum(np.round(2 * radius_px * (1 + 0.05 * noise[:, 2])) / 2, 0.5)
    plumb = scene.view.plumb_px(scene.ball.drop_m) * GRAVITY_M_S2 / scene.ball.drop_m
    stamps_ns = np.round((scene.seconds - scene.seconds[0]) * 1e9).astype(np.int64)
    return found_track(stamps_ns, places_px, radii, lost, turn @ plumb)


def _seconds(which: TrackSet, ball: RealBall, rng: np.random.Generator) -> Array:
    lasts = rng.uniform(*which.lasts) * ball.fall_s
    if not which.free:
        return np.arange(-rng.uniform(0.0, 0.6), lasts, 1 / 60)
    if rng.random() < 0.1:  # ends early
        lasts = rng.uniform(2.0, 4.0) * ball.fall_s
    # The first picture is up to .6 fall times before the release, or up to .4 after it.
    seen = rng.choice((-0.6, 0.4)) * rng.random() * ball.fall_s
    return np.arange(seen, lasts, ball.fall_s / rng.uniform(6.0, 150.0))


def _lost(ball: RealBall, seconds: Array, rng: np.random.Generator) -> Mask:
    """Draw lost pictures, up to a tenth, in 3 of 10 tracks a gap too."""
    impacts = drop_ball(ball, np.append(seconds, 4 * ball.fall_s)).impacts_s
    flight = (seconds > impacts[0]) & (seconds < impacts[1])
    while True:
        lost = rng.random(len(seconds)) < rng.uniform(0.0, 0.1)
        if rng.random() < 0.3:
            start = rng.uniform(-0.5, 3.0) * ball.fall_s
            end = start + rng.uniform(0.05, 0.3) * ball.fall_s
            lost |= (seconds > start) & (seconds < end)
        # most of the first flight is seen: it is what is measured
        if not flight.any() or np.mean(~lost[flight]) >= 0.6:
            return lost


# ---- Paths of balls that spoil a drop, each in place of the good one's.
# Made from a scene that lasts for six fall times at least, and a random generator: points [m],
# shape (T, 3), at the times of the scene's pictures.

_BELOW = (0.3, 1.5)  # from the table down to the next thing that a ball hits [drop heights]


def rolls_off(scene: TrackScene, rng: np.random.Generator) -> Array:
    """Roll or fly over the edge after the first or second bounce, and fall."""
    fall = scene.fall()
    bounces = int(rng.integers(1, 3))
    landed_s, speed = fall.impacts_s[bounces], fall.impact_speeds_m_s[bounces]
    off_s = landed_s
    if rng.random() < 0.5:
        off_s, speed = landed_s + scene.ball.fall_s * rng.uniform(0.0, 1.0), 0.0
    below = _from_above(scene, off_s, scene.ball.drop_m * rng.uniform(*_BELOW), -speed)
    heights = np.where(scene.seconds < landed_s, fall.heights_m, below)
    sideways_m_s = rng.uniform(0.05, 0.25) * fall.impact_speeds_m_s[0]
    return _moving(scene, heights, fall.impacts_s[0], sideways_m_s, rng)


def edge(scene: TrackScene, rng: np.random.Generator, hit: int) -> Array:
    """Rebound from an edge of a table or tile about a tilted normal, and go on beside it."""
    fall = scene.fall()
    at_s, speed = fall.impacts_s[hit], fall.impact_speeds_m_s[hit]
    tilt = np.radians(rng.uniform(10.0, 45.0))
    kept = (1 + scene.ball.restitution) * speed * np.cos(tilt)
    up_m_s, sideways_m_s = kept * np.cos(tilt) - speed, kept * np.sin(tilt)
    is_table = rng.random() < 0.5
    below_m = scene.ball.drop_m * rng.uniform(*_BELOW) if is_table else 0.0
    after = _from_above(scene, at_s, below_m, up_m_s if is_table else max(up_m_s, 0.0))
    heights = np.where(scene.seconds < at_s, fall.heights_m, after)
    return _moving(scene, heights, at_s, sideways_m_s, rng)


def thrown(scene: TrackScene, rng: np.random.Generator) -> Array:
    """Throw up and catch, once or twice, without an impact."""
    heights = np.zeros(len(scene.seconds))
    start_s, top_m = 0.0, scene.ball.drop_m * rng.uniform(0.6, 1.0)
    for _ in range(int(rng.integers(1, 3))):
        speed = np.sqrt(2 * GRAVITY_M_S2 * top_m)
        lasts_s = 2 * speed / GRAVITY_M_S2 * rng.uniform(0.9, 1.0)
        since = np.maximum(scene.seconds - start_s, 0.0)
        flight = np.minimum(since, lasts_s)
        heights += speed * flight - GRAVITY_M_S2 / 2 * flight**2
        caught_m_s = speed - GRAVITY_M_S2 * lasts_s
        heights += _given_way(scene, since - lasts_s, caught_m_s, rng)
        start_s += lasts_s + scene.ball.fall_s * rng.uniform(0.5, 1.2)
        top_m *= rng.uniform(0.3, 0.9)
    return upright(heights)


def held(scene: TrackScene, rng: np.random.Generator) -> Array:
    """Hold in a hand that is not still."""
    drop_m, fall_s = scene.ball.drop_m, scene.ball.fall_s
    reach_m = drop_m * rng.uniform(0.02, 0.15)
    slow_s = fall_s * rng.uniform(0.3, 1.0)
    hand = [smooth_noise(scene.seconds, slow_s, rng) for _ in range(3)]
    return np.array([0.0, 0.0, drop_m * rng.uniform(0.4, 0.9)]) + reach_m * np.column_stack(hand)


def caught(scene: TrackScene, rng: np.random.Generator) -> Array:
    """Catch in the flight after the first bounce, and carry on."""
    fall, ball = scene.fall(), scene.ball
    up_m_s = ball.restitution * fall.impact_speeds_m_s[0]
    flown_s = 2 * up_m_s / GRAVITY_M_S2 * rng.uniform(0.3, 0.95)
    at_m = up_m_s * flown_s - GRAVITY_M_S2 / 2 * flown_s**2
    since = scene.seconds - fall.impacts_s[0] - flown_s
    hand = _given_way(scene, since, up_m_s - GRAVITY_M_S2 * flown_s, rng)
    way = np.clip(since / (ball.fall_s * rng.uniform(1.0, 3.0)), 0.0, 1.0)
    carried_m = rng.uniform(0.0, 0.8) * ball.drop_m * (3 * way**2 - 2 * way**3)
    return upright(np.where(since < 0, fall.heights_m, at_m + hand + carried_m))


def drifts(scene: TrackScene, rng: np.random.Generator) -> Array:
    """Drift towards the camera or away from the release on."""
    towards = np.array([*scene.view.position_m[:2], 0.0])
    rate = rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.15)
    gone = np.maximum(scene.seconds, 0.0) / scene.ball.fall_s * rate
    return upright(scene.fall().heights_m) + gone[:, None] * towards


def smooth_noise(seconds: Array, slow_s: float, rng: np.random.Generator) -> Array:
    """Draw a random function of mean 0 and deviation 1 that changes over `slow_s`, (T,)."""
    waves = 40
    rates = rng.normal(0.0, 1.0, waves) / slow_s
    phases = rng.uniform(0.0, 2 * np.pi, waves)
    return np.sqrt(2 / waves) * np.cos(seconds[:, None] * rates + phases).sum(axis=1)


def _from_above(scene: TrackScene, start_s: float, below_m: float, up_m_s: float) -> Array:
    """Return heights from `start_s` on, where what is hit next lies that far below.

    The first flight is that of a ball let go at its apex, which may lie before the start.
    """
    since_apex = scene.seconds - start_s - up_m_s / GRAVITY_M_S2
    apex_m = max(below_m + up_m_s**2 / (2 * GRAVITY_M_S2), 1e-9)
    after = drop_ball(RealBall(scene.ball.restitution, 0.0, 0.0, apex_m), since_apex).heights_m
    rising = apex_m - GRAVITY_M_S2 / 2 * since_apex**2
    heights = np.where(since_apex < 0, rising, after) - below_m
    return np.where(scene.seconds > start_s, heights, 0.0)


def _moving(
    scene: TrackScene, heights: Array, start_s: float, speed_m_s: float, rng: np.random.Generator
) -> Array:
    """Move sideways in any direction, from `start_s` on."""
    way = rng.uniform(0.0, 2 * np.pi)
    gone = speed_m_s * np.maximum(scene.seconds - start_s, 0.0)
    return np.column_stack([gone * np.cos(way), gone * np.sin(way), heights])


def _given_way(scene: TrackScene, since: Array, speed: float, rng: np.random.Generator) -> Array:
    """Return how far a hand that catches at that upward speed goes with it."""
    slow_s = scene.ball.fall_s * rng.uniform(0.05, 0.15)
    after = np.maximum(since, 0.0)
    return speed * after * np.exp(-after / slow_s)


# ---- Faulty tracks: what goes wrong at drops, before cameras and in trackers.
# Each class is a good scene with one thing changed. What must not happen is that its restitution is
# wrong and looks right.

Maker = Callable[[TrackScene, np.random.Generator], Track]

# As B, and long enough that what goes wrong is filmed.
FAULT_SET = replace(B, name="bad", lasts=(6.0, 8.0))

FAULT_BALLS = BallRanges((0.3, 0.9))

_FRAMES = 20  # that a camera freezes for or loses
_EDGE_PX = 8.0  # from the frame to where other objects are


@dataclass(frozen=True)
class TrackFault:
    """Kind of fault of a track."""

    name: str  # for files
    label: str  # for tables
    make: Maker  # the faulty track of a scene
    # whether its first impact is one of the ball; where it is not, no restitution is right
    bounces: bool = True

    def track(self, scene: TrackScene) -> Track:
        """Make the faulty track, the same for the same scene."""
        return self.make(scene, np.random.default_rng([scene.seed, *self.name.encode()]))


def _path(points: Callable[[TrackScene, np.random.Generator], Array]) -> Maker:
    return lambda scene, rng: film(scene, points(scene, rng))


def _still(scene: TrackScene, rng: np.random.Generator) -> Track:
    """Track something that does not move."""
    return _object(scene, np.tile(_anywhere(rng), (len(scene.seconds), 1)))


def _wandering(scene: TrackScene, rng: np.random.Generator) -> Track:
    """Track something that wanders about smoothly."""
    slow_s = rng.uniform(0.2, 1.0)
    period = scene.seconds[1] - scene.seconds[0]
    walk = [np.cumsum(smooth_noise(scene.seconds, slow_s, rng)) * period for _ in range(2)]
    places = np.column_stack(walk)
    room = np.array(SIZE_PX) - 1 - 2 * _EDGE_PX
    places *= rng.uniform(0.2, 1.0) * np.min(room / np.ptp(places, axis=0))
    places -= places.min(axis=0)
    return _object(scene, places + _EDGE_PX + rng.random(2) * (room - np.ptp(places, axis=0)))


def _leaves(scene: TrackScene, rng: np.random.Generator) -> Track:
    """Lose the ball between mid-fall and the end of the first flight."""
    first, second = scene.fall().impacts_s[:2]
    leaves_s = rng.uniform(first / 2, second)
    return film(replace(scene, lost=scene.lost | (scene.seconds > leaves_s)))


def _freezes(scene: TrackScene, rng: np.random.Generator) -> Track:
    """Repeat one picture 20 times while the stamps go on."""
    track = film(scene)
    start = _in_flight(scene, rng)
    numbers = np.arange(len(scene.seconds))
    numbers[start : start + _FRAMES] = start
    return replace(track, places_px=track.places_px[numbers], radius_px=track.radius_px[numbers])


def _dropping(kept: Callable[[TrackScene, np.random.Generator], Mask]) -> Maker:
    """Drop frames silently: those that are kept close up."""

    def make(scene: TrackScene, rng: np.random.Generator) -> Track:
        track, shown = film(scene), kept(scene, rng)
        shown_track = track.some(np.flatnonzero(shown))
        return replace(shown_track, stamps_ns=track.stamps_ns[: shown.sum()])

    return make


def _all_but_20(scene: TrackScene, rng: np.random.Generator) -> Mask:
    since = np.arange(len(scene.seconds)) - _in_flight(scene, rng)
    return (since < 0) | (since >= _FRAMES)


def _some(scene: TrackScene, rng: np.random.Generator) -> Mask:
    return rng.random(len(scene.seconds)) >= 0.1


def _every_second(scene: TrackScene, rng: np.random.Generator) -> Mask:
    since = np.arange(len(scene.seconds)) - _in_flight(scene, rng)
    return (since < 0) | (since % 2 == 0)


def _jumps(scene: TrackScene, rng: np.random.Generator) -> Track:
    """Track something else for a part of the flight."""
    ball = film(scene)
    start = _in_flight(scene, rng)
    lasts_s = scene.ball.fall_s * rng.uniform(0.2, 0.6)
    away = (scene.seconds >= scene.seconds[start]) & (
        scene.seconds < scene.seconds[start] + lasts_s
    )
    away[start : start + 3] = True
    place = _anywhere(rng)
    while np.linalg.norm(ball.places_px[away] - place, axis=1).min() < 30.0:
        place = _anywhere(rng)
    other = _object(replace(scene, seed=scene.seed + 1), np.tile(place, (len(away), 1)))
    return replace(
        ball,
        places_px=np.where(away[:, None], other.places_px, ball.places_px),
        radius_px=np.where(away, other.radius_px, ball.radius_px),
    )


def _in_flight(scene: TrackScene, rng: np.random.Generator) -> int:
    """Draw a picture between the early fall and the end of the first flight."""
    second_s = float(scene.fall().impacts_s[1])
    start_s = rng.uniform(0.3 * scene.ball.fall_s, second_s)
    return int(np.searchsorted(scene.seconds, start_s))


def _anywhere(rng: np.random.Generator) -> Array:
    return rng.uniform(_EDGE_PX, np.array(SIZE_PX) - 1 - _EDGE_PX)


def _object(scene: TrackScene, places_px: Array) -> Track:
    """Make the track of something as large as the ball."""
    middle = upright(np.array([scene.ball.drop_m / 2]))
    radii = np.full(len(places_px), scene.view.radius_px(middle, scene.radius_m)[0])
    return track_from_pixels(scene, places_px, radii, np.zeros(len(places_px), dtype=bool))


def _converted(source_hz: float, shown_hz: float) -> Maker:
    """Film at one rate and show at another: each moment shows the picture nearest to it.

    A picture that is shown twice is left out once where the ball moves, as a tracker does.
    """

    def make(scene: TrackScene, rng: np.random.Generator) -> Track:
        begin_s, end_s = scene.seconds[[0, -1]].tolist()
        seconds = np.arange(begin_s, end_s, 1 / source_hz)
        track = film(replace(scene, seconds=seconds, lost=np.zeros(len(seconds), dtype=bool)))
        moments = np.arange(int((end_s - begin_s) * shown_hz))
        numbers = np.floor(moments * source_hz / shown_hz + rng.random()).astype(int)
        moments = moments[numbers < len(seconds)]
        numbers = numbers[moments]
        unchanged = np.diff(numbers, prepend=-1) == 0
        kept = new_pictures(track.places_px[numbers], unchanged)
        shown = numbers[kept]
        stamps_ns = np.round(moments[kept] / shown_hz * 1e9).astype(np.int64)
        return replace(track.some(shown), stamps_ns=stamps_ns)

    return make


# What a converter of films makes of them: pictures filmed and shown a second.
CONVERSIONS = tuple(
    TrackFault(
        f"{source_hz}-to-{shown_hz}",
        f"{source_hz} pictures a second converted to {shown_hz}",
        _converted(source_hz, shown_hz),
    )
    for source_hz, shown_hz in ((30, 24), (30, 25), (24, 30), (25, 30), (60, 25))
)

# Those of docs/accuracy.md, in its order.
TRACK_FAULTS = (
    TrackFault("still", "something that lies still", _still, bounces=False),
    TrackFault("wandering", "something that wanders about", _wandering, bounces=False),
    TrackFault("leaves", "leaves the view", _leaves),
    TrackFault("rolls-off", "rolls off the table", _path(rolls_off)),
    TrackFault("edge-first", "hits an edge, first impact", _path(partial(edge, hit=0))),
    TrackFault("edge-second", "hits an edge, second impact", _path(partial(edge, hit=1))),
    TrackFault("thrown", "thrown and caught", _path(thrown), bounces=False),
    TrackFault("held", "held in a hand", _path(held), bounces=False),
    TrackFault("caught", "caught after the first bounce", _path(caught)),
    TrackFault("drifts", "drifts towards the camera or away", _path(drifts)),
    TrackFault("freezes", "camera freezes, 20 frames", _freezes),
    TrackFault("loses-20", "20 frames lost, no stamps", _dropping(_all_but_20)),
    TrackFault("loses-tenth", "10 % of frames lost, no stamps", _dropping(_some)),
    TrackFault("slows", "60 fps turn to 30, no stamps", _dropping(_every_second)),
    TrackFault("jumps", "tracker on something else in flight", _jumps),
)
