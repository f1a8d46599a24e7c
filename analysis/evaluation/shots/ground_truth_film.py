"""Film a hidden drop with a camera of unknown pose: as pictures in a log, or as a track."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from analysis.evaluation.clips.ball import BallLook, add_ball
from analysis.evaluation.clips.film import SensorNoise
from analysis.evaluation.clips.scene import Stage, draw_stage
from analysis.evaluation.clips.view import View
from analysis.evaluation.shots.ground_truth_drop import DROP_M, FILMED_S, HELD_S, HiddenDrop
from analysis.evaluation.shots.ground_truth_sim import MASS_KG, RADIUS_M
from analysis.tracking.track import Track
from recorders.simulators.pinhole import PinholeCamera
from tunenet_logs.arrays import Array, Picture
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.messages import CAMERA_TOPIC
from tunenet_logs.writer import EpisodeWriter

SIZE_PX = (640, 480)
FRAME_HZ = 60.0
EXPOSURE_S = 0.004
NOISE = 4.0
TRACK_NOISE_PX = 0.15  # of a projected track: what the tracker has on such films
_DISTANCE_M = (1.5, 3.0)
_ELEVATION_DEG = (-5.0, 35.0)
_FOV_DEG = (36.0, 62.0)
_ROLL_DEG = 2.0
_MIN_SHARE = 0.35
_MARGIN_PX = 20.0
_SUBFRAMES = 6
_QUALITY = 85
_MIN_CONTRAST = 35.0
_COLOURS = {
    "red gel": (205, 40, 50),
    "racquetball": (40, 70, 190),
    "tennis": (200, 220, 60),
    "foam": (240, 130, 30),
    "lacrosse": (235, 235, 230),
    "super": (120, 40, 150),
}
_GREY = (128, 128, 128)
_LOWEST_M = 0.1
_TURNS = 4  # until a camera is turned as it should: each gets nearer
_FALL_M = np.array([[0.0, 0.0, RADIUS_M], [0.0, 0.0, RADIUS_M + DROP_M]])
_START_M = _FALL_M[1:]


@dataclass(frozen=True, eq=False)
class DropFilm:
    """Drop and its camera.

    Attributes:
        drop: what happens.
        view: the camera.
        seed: of the room and the noise.
    """

    drop: HiddenDrop
    view: View
    seed: int

    @property
    def seconds(self) -> Array:
        """Frame times after the release, shape (T,)."""
        return np.arange(int((HELD_S + FILMED_S) * FRAME_HZ)) / FRAME_HZ - HELD_S


def film_of(drop: HiddenDrop, rng: np.random.Generator) -> DropFilm:
    """Draw a camera with the whole fall in view; of a ball that will leave it, most of it."""
    while True:
        view = random_view(rng)
        seed = int(rng.integers(2**31))
        if drop.leaves_s is None:
            return DropFilm(drop, view, seed)
        turned = view
        for _ in range(_TURNS):
            turned = _turned_away(turned, drop)
        if _is_inside(turned.image_from_world(_START_M)):
            return DropFilm(drop, turned, seed)


def random_view(rng: np.random.Generator) -> View:
    """Draw a camera 1.5 to 3 m away with the whole fall in view, at a fair size."""
    while True:
        distance, elevation = rng.uniform(*_DISTANCE_M), np.radians(rng.uniform(*_ELEVATION_DEG))
        aim = DROP_M * rng.uniform(0.35, 0.6)
        up = max(aim + distance * np.sin(elevation), _LOWEST_M)
        position = (float(-distance * np.cos(elevation)), 0.0, float(up))
        target = (0.0, float(rng.normal(0.0, 0.1)), float(aim))
        camera = PinholeCamera(position, target, SIZE_PX, float(rng.uniform(*_FOV_DEG)))
        view = View(camera, float(np.radians(rng.normal(0.0, _ROLL_DEG))))
        pixels = view.image_from_world(_FALL_M)
        if _is_inside(pixels) and np.ptp(pixels[:, 1]) > _MIN_SHARE * SIZE_PX[1]:
            return view


def record_film(film: DropFilm, path: Path) -> None:
    """Write the film as the recorder does: JPEGs in a log, and what is known of the ball."""
    import cv2

    ball = film.drop.ball
    info = EpisodeInfo(
        kind="drop",
        source="hidden world, drawn",
        rig={"ball_diameter_m": 2 * RADIUS_M, "ball_mass_kg": MASS_KG, "drop_height_m": DROP_M},
        truth={"restitution": ball.restitution_at(film.drop.impact_m_s)},
        notes={"ball": ball.name},
    )
    options = [cv2.IMWRITE_JPEG_QUALITY, _QUALITY]
    with EpisodeWriter(path, info, live=False) as writer:
        for second, picture in zip(film.seconds + HELD_S, _frames(film), strict=True):
            _, data = cv2.imencode(".jpg", picture[:, :, ::-1], options)
            frame = Frame(round(float(second) * 1e9), "jpeg", data.tobytes())
            writer.write_frame(CAMERA_TOPIC, frame)


def track_of(film: DropFilm) -> Track:
    """Simulate the track that a tracker would find, without pictures."""
    rng = np.random.default_rng(film.seed)
    centers = film.drop.centers_m(film.seconds)
    places = film.view.image_from_world(centers)
    radii = film.view.camera.radius_px(centers, RADIUS_M)
    places += rng.normal(0.0, TRACK_NOISE_PX, places.shape)
    room = np.array(SIZE_PX) - 1 - radii[:, None]
    seen = np.all((places > radii[:, None]) & (places < room), axis=1)
    seen &= centers[:, 0] > film.view.camera.position_m[0] + 0.2
    top, low = film.view.image_from_world(np.array([[0, 0, DROP_M + RADIUS_M], [0, 0, RADIUS_M]]))
    places[~seen] = np.nan
    return Track(
        stamps_ns=np.round((film.seconds + HELD_S) * 1e9).astype(np.int64),
        places_px=places,
        radius_px=np.where(seen, radii, np.nan),
        confidence=seen.astype(np.float64),
        size_px=SIZE_PX,
        gravity_px=low - top,
        colour=_GREY,
    )


def _is_inside(pixels: Array) -> bool:
    far = np.array(SIZE_PX) - 1 - _MARGIN_PX
    return bool(np.all((pixels > _MARGIN_PX) & (pixels < far)))


def _turned_away(view: View, drop: HiddenDrop) -> View:
    """Turn the camera so that a ball that is to leave crosses the image's edge."""
    assert drop.leaves_s is not None
    camera = view.camera
    at = drop.centers_m(np.array([drop.leaves_s]))
    to_right = math.sin(drop.heading_rad) < 0  # y is to the left of a camera that looks along x
    edge = SIZE_PX[0] + 5.0 if to_right else -5.0
    off_px = float(view.image_from_world(at)[0, 0]) - edge
    angle = math.atan2(off_px, camera.focal_px)
    x, y = camera.target_m[0] - camera.position_m[0], camera.target_m[1] - camera.position_m[1]
    cos, sin = math.cos(-angle), math.sin(-angle)
    target = (
        camera.position_m[0] + cos * x - sin * y,
        camera.position_m[1] + sin * x + cos * y,
        camera.target_m[2],
    )
    turned = PinholeCamera(camera.position_m, target, camera.size_px, camera.fov_deg)
    return View(turned, view.roll_rad)


def _frames(film: DropFilm) -> Iterator[Picture]:
    rng = np.random.default_rng(film.seed)
    stage, look = _room(film, rng)
    noise = SensorNoise(rng, SIZE_PX, NOISE)
    offsets = ((np.arange(_SUBFRAMES) + 0.5) / _SUBFRAMES - 0.5) * EXPOSURE_S
    seconds = film.seconds
    centers = film.drop.centers_m((seconds[:, None] + offsets).ravel())
    above = look, BallLook(**{**vars(look), "shadow": 0.0, "mirror": 0.0})
    for places in centers.reshape(len(seconds), _SUBFRAMES, 3):
        frame = stage.picture.copy()
        moves = np.linalg.norm(places[-1] - places[0]) > 5e-4
        shown = places if moves else places[:1]
        add_ball(frame, film.view, stage, above[int(places[0, 2] < 0)], shown)
        yield noise.added_to(frame)


def _room(film: DropFilm, rng: np.random.Generator) -> tuple[Stage, BallLook]:
    """Draw a room before which a person could follow the ball."""
    heights = RADIUS_M + DROP_M * np.linspace(0.0, 1.0, 9)
    places = film.view.image_from_world(np.column_stack([np.zeros((9, 2)), heights]))
    far = np.array(SIZE_PX) - 1
    columns, rows = np.clip(np.round(places), 0, far).astype(int).T
    colour = _COLOURS.get(film.drop.ball.name, _COLOURS["foam"])
    light = np.array([rng.uniform(-0.9, 0.4), rng.uniform(-0.6, 0.6), 1.0])
    light /= np.linalg.norm(light)
    look = BallLook(
        radius_m=RADIUS_M,
        colour=colour,
        light=(float(light[0]), float(light[1]), float(light[2])),
        ambient=float(rng.uniform(0.4, 0.8)),
        gloss=float(rng.uniform(0.0, 0.6)),
        shadow=float(rng.choice([0.0, rng.uniform(0.1, 0.6)])),
        softness=float(rng.uniform(0.02, 0.3)),
        mirror=0.0,
    )
    while True:
        stage = draw_stage(film.view, DROP_M, rng)
        behind = stage.picture[rows, columns].astype(np.float64)
        mean = np.array(colour) * (look.ambient + 0.5 * (1 - look.ambient))
        if np.quantile(np.abs(behind - mean).max(axis=1), 0.15) > _MIN_CONTRAST:
            return stage, look
