"""Make faulty tracks: what goes wrong at drops, before cameras and in trackers.

Each class is a good scene with one thing changed. What must not happen is that its restitution is
wrong and looks right.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.evaluation.video import fault_paths
from analysis.evaluation.video.tracks import B, BallRanges, TrackScene, film, track_from_pixels
from analysis.evaluation.video.viewpoint import SIZE_PX
from analysis.tracking.track import Track
from tunenet_logs.arrays import Array

Maker = Callable[[TrackScene, np.random.Generator], Track]

# As B, and long enough that what goes wrong is filmed.
FAULT_SET = replace(B, name="bad", lasts=(6.0, 8.0))

FAULT_BALLS = BallRanges((0.3, 0.9))

_FRAMES = 20  # that a camera freezes for or loses
_LOST_FRACTION = 0.1  # of frames that are lost here and there
_FAR_PX = 30.0  # from the ball to what a tracker jumps to: more than a ball's width
_EDGE_PX = 8.0  # from the frame to where other objects are


@dataclass(frozen=True)
class TrackFault:
    """Kind of fault of a track.

    Attributes:
        name: for files.
        label: for tables.
        make: the faulty track of a scene.
        bounces: whether its first impact is one of the ball; where it is not, no restitution is
            right.
    """

    name: str
    label: str
    make: Maker
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
    walk = [
        np.cumsum(fault_paths.smooth_noise(scene.seconds, slow_s, rng)) * period for _ in range(2)
    ]
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


def _loses_frames(scene: TrackScene, rng: np.random.Generator) -> Track:
    """Drop 20 frames silently."""
    start = _in_flight(scene, rng)
    kept = np.ones(len(scene.seconds), dtype=bool)
    kept[start : start + _FRAMES] = False
    return _closed_up(film(scene), kept)


def _loses_some(scene: TrackScene, rng: np.random.Generator) -> Track:
    """Drop a tenth of all frames silently, here and there."""
    return _closed_up(film(scene), rng.random(len(scene.seconds)) >= _LOST_FRACTION)


def _slows_down(scene: TrackScene, rng: np.random.Generator) -> Track:
    """Drop every second frame silently from some moment on."""
    numbers = np.arange(len(scene.seconds))
    since = numbers - _in_flight(scene, rng)
    return _closed_up(film(scene), (since < 0) | (since % 2 == 0))


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
    while np.linalg.norm(ball.places_px[away] - place, axis=1).min() < _FAR_PX:
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


def _closed_up(track: Track, kept: NDArray[np.bool_]) -> Track:
    return replace(
        track,
        stamps_ns=track.stamps_ns[: kept.sum()],
        places_px=track.places_px[kept],
        radius_px=track.radius_px[kept],
        confidence=track.confidence[kept],
    )


def _anywhere(rng: np.random.Generator) -> Array:
    return rng.uniform(_EDGE_PX, np.array(SIZE_PX) - 1 - _EDGE_PX)


def _object(scene: TrackScene, places_px: Array) -> Track:
    """Make the track of something as large as the ball."""
    _, depth = scene.view.image_from_world(np.array([[0.0, 0.0, scene.ball.drop_m / 2]]))
    radii = np.full(len(places_px), scene.view.radius_px(depth, scene.radius_m)[0])
    return track_from_pixels(scene, places_px, radii, np.zeros(len(places_px), dtype=bool))


# Those of docs/experiments.md, in its order.
TRACK_FAULTS = (
    TrackFault("still", "something that lies still", _still, bounces=False),
    TrackFault("wandering", "something that wanders about", _wandering, bounces=False),
    TrackFault("leaves", "leaves the view", _leaves),
    TrackFault("rolls-off", "rolls off the table", _path(fault_paths.rolls_off)),
    TrackFault("edge-first", "hits an edge, first impact", _path(fault_paths.edge_first)),
    TrackFault("edge-second", "hits an edge, second impact", _path(fault_paths.edge_second)),
    TrackFault("thrown", "thrown and caught", _path(fault_paths.thrown), bounces=False),
    TrackFault("held", "held in a hand", _path(fault_paths.held), bounces=False),
    TrackFault("caught", "caught after the first bounce", _path(fault_paths.caught)),
    TrackFault("drifts", "drifts towards the camera or away", _path(fault_paths.drifts)),
    TrackFault("freezes", "camera freezes, 20 frames", _freezes),
    TrackFault("loses-20", "20 frames lost, no stamps", _loses_frames),
    TrackFault("loses-tenth", "10 % of frames lost, no stamps", _loses_some),
    TrackFault("slows", "60 fps turn to 30, no stamps", _slows_down),
    TrackFault("jumps", "tracker on something else in flight", _jumps),
)
