"""Bad tracks, class by class: what goes wrong at drops, before cameras and in trackers.

Each class is a good shot with one thing changed. What must not happen is that its restitution is
wrong and looks right.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.evaluation import fault_paths
from analysis.evaluation.tracks import B, Balls, Shot, film, film_places
from analysis.evaluation.viewpoint import SIZE_PX
from analysis.tracking.track import Track
from tunenet_logs.arrays import Array

Maker = Callable[[Shot, np.random.Generator], Track]

BAD_SET = replace(B, name="bad", lasts=(6.0, 8.0))
"""As B, and long enough that what goes wrong is filmed."""

BAD_BALLS = Balls((0.3, 0.9))

_FRAMES = 20
_LOST_SHARE = 0.1
_FAR_PX = 30.0
_EDGE_PX = 8.0


@dataclass(frozen=True)
class BadClass:
    """One way in which a track is bad.

    Attributes:
        name: for files.
        label: for tables.
        make: the bad track of a shot.
        bounces: whether its first impact is one of the ball; where it is not, no restitution is
            right.
    """

    name: str
    label: str
    make: Maker
    bounces: bool = True

    def track(self, shot: Shot) -> Track:
        """The same for the same shot."""
        return self.make(shot, np.random.default_rng([shot.seed, *self.name.encode()]))


def _path(points: Callable[[Shot, np.random.Generator], Array]) -> Maker:
    return lambda shot, rng: film(shot, points(shot, rng))


def _still(shot: Shot, rng: np.random.Generator) -> Track:
    """The tracker holds on to something that does not move."""
    return _object(shot, np.tile(_anywhere(rng), (len(shot.seconds), 1)))


def _wandering(shot: Shot, rng: np.random.Generator) -> Track:
    """The tracker follows something that wanders about, smoothly."""
    slow_s = rng.uniform(0.2, 1.0)
    period = shot.seconds[1] - shot.seconds[0]
    walk = [
        np.cumsum(fault_paths.smooth_noise(shot.seconds, slow_s, rng)) * period for _ in range(2)
    ]
    places = np.column_stack(walk)
    room = np.array(SIZE_PX) - 1 - 2 * _EDGE_PX
    places *= rng.uniform(0.2, 1.0) * np.min(room / np.ptp(places, axis=0))
    places -= places.min(axis=0)
    return _object(shot, places + _EDGE_PX + rng.random(2) * (room - np.ptp(places, axis=0)))


def _leaves(shot: Shot, rng: np.random.Generator) -> Track:
    """From mid-fall at the earliest, the end of the first flight at the latest, it is not seen."""
    first, second = shot.fall().impacts_s[:2]
    leaves_s = rng.uniform(first / 2, second)
    return film(replace(shot, lost=shot.lost | (shot.seconds > leaves_s)))


def _freezes(shot: Shot, rng: np.random.Generator) -> Track:
    """The camera gives one picture 20 times, its stamps go on."""
    track = film(shot)
    start = _in_flight(shot, rng)
    numbers = np.arange(len(shot.seconds))
    numbers[start : start + _FRAMES] = start
    return replace(track, places_px=track.places_px[numbers], radius_px=track.radius_px[numbers])


def _loses_frames(shot: Shot, rng: np.random.Generator) -> Track:
    """20 frames are lost, and nothing tells."""
    start = _in_flight(shot, rng)
    kept = np.ones(len(shot.seconds), dtype=bool)
    kept[start : start + _FRAMES] = False
    return _closed_up(film(shot), kept)


def _loses_some(shot: Shot, rng: np.random.Generator) -> Track:
    """A tenth of all frames is lost, here and there, and nothing tells."""
    return _closed_up(film(shot), rng.random(len(shot.seconds)) >= _LOST_SHARE)


def _slows_down(shot: Shot, rng: np.random.Generator) -> Track:
    """From some moment on the camera gives every second frame, and nothing tells."""
    numbers = np.arange(len(shot.seconds))
    since = numbers - _in_flight(shot, rng)
    return _closed_up(film(shot), (since < 0) | (since % 2 == 0))


def _jumps(shot: Shot, rng: np.random.Generator) -> Track:
    """For a part of the flight the tracker holds on to something else."""
    ball = film(shot)
    start = _in_flight(shot, rng)
    lasts_s = shot.ball.fall_s * rng.uniform(0.2, 0.6)
    away = (shot.seconds >= shot.seconds[start]) & (shot.seconds < shot.seconds[start] + lasts_s)
    away[start : start + 3] = True
    place = _anywhere(rng)
    while np.linalg.norm(ball.places_px[away] - place, axis=1).min() < _FAR_PX:
        place = _anywhere(rng)
    other = _object(replace(shot, seed=shot.seed + 1), np.tile(place, (len(away), 1)))
    return replace(
        ball,
        places_px=np.where(away[:, None], other.places_px, ball.places_px),
        radius_px=np.where(away, other.radius_px, ball.radius_px),
    )


def _in_flight(shot: Shot, rng: np.random.Generator) -> int:
    """A picture between the early fall and the end of the first flight."""
    second_s = float(shot.fall().impacts_s[1])
    start_s = rng.uniform(0.3 * shot.ball.fall_s, second_s)
    return int(np.searchsorted(shot.seconds, start_s))


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


def _object(shot: Shot, places_px: Array) -> Track:
    """Something as large as the ball."""
    _, depth = shot.view.image_from_world(np.array([[0.0, 0.0, shot.ball.drop_m / 2]]))
    radii = np.full(len(places_px), shot.view.radius_px(depth, shot.radius_m)[0])
    return film_places(shot, places_px, radii, np.zeros(len(places_px), dtype=bool))


BAD_CLASSES = (
    BadClass("still", "something that lies still", _still, bounces=False),
    BadClass("wandering", "something that wanders about", _wandering, bounces=False),
    BadClass("leaves", "leaves the view", _leaves),
    BadClass("rolls-off", "rolls off the table", _path(fault_paths.rolls_off)),
    BadClass("edge-first", "hits an edge, first impact", _path(fault_paths.edge_first)),
    BadClass("edge-second", "hits an edge, second impact", _path(fault_paths.edge_second)),
    BadClass("thrown", "thrown and caught", _path(fault_paths.thrown), bounces=False),
    BadClass("held", "held in a hand", _path(fault_paths.held), bounces=False),
    BadClass("caught", "caught after the first bounce", _path(fault_paths.caught)),
    BadClass("drifts", "drifts towards the camera or away", _path(fault_paths.drifts)),
    BadClass("freezes", "camera freezes, 20 frames", _freezes),
    BadClass("loses-20", "20 frames lost, no stamps", _loses_frames),
    BadClass("loses-tenth", "10 % of frames lost, no stamps", _loses_some),
    BadClass("slows", "60 fps turn to 30, no stamps", _slows_down),
    BadClass("jumps", "tracker on something else in flight", _jumps),
)
"""Those of docs/experiments.md, in its order."""
