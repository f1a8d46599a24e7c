"""Pinhole camera of a synthetic clip, which may be rolled, and where it may stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recorders.simulators.pinhole import PinholeCamera
from tunenet_logs.arrays import Array

# Width and height: webcams and phones, upright ones too.
SIZES_PX = (
    (320, 240),
    (480, 270),
    (480, 640),
    (640, 360),
    (640, 480),
    (720, 1280),
    (848, 480),
    (960, 540),
    (1280, 720),
    (1280, 960),
)

_FOV_DEG = (35.0, 65.0)
_DISTANCE = (1.2, 4.0)
_ELEVATION_DEG = (-5.0, 45.0)
# Where people stand: lens, distance [drop heights], elevation, and standard deviation of the roll.
_ROLL_DEG = 3.0

_MIN_SPAN = 0.35  # of the fall, over the picture's height
_RADIUS_PX = (2.5, 60.0)  # of the ball: smaller is a speck, larger fills the picture
_MARGIN_PX = 3.0  # between the ball and the frame
_MIN_EYE_M = 0.05  # height of the camera over the floor
_TRIES = 60  # before a ball of another size is drawn


@dataclass(frozen=True)
class View:
    """Pinhole camera turned about its optical axis.

    Attributes:
        camera: where from, upright.
        roll_rad: clockwise turn of the picture.
    """

    camera: PinholeCamera
    roll_rad: float

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height."""
        return self.camera.size_px

    @property
    def middle_px(self) -> Array:
        """Principal point, shape (2,)."""
        return (np.array(self.size_px) - 1) / 2

    @property
    def camera_from_world(self) -> Array:
        """Rotation whose rows are the image's right and down, and forward, shape (3, 3)."""
        cos, sin = np.cos(self.roll_rad), np.sin(self.roll_rad)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return turn @ self.camera.camera_from_world

    def seen_from_camera(self, points_m: Array) -> Array:
        """Transform points to camera axes [m], shape (N, 3)."""
        return (points_m - np.array(self.camera.position_m)) @ self.camera_from_world.T

    def image_from_world(self, points_m: Array) -> Array:
        """Project points to pixels, shape (N, 2); the first pixel's centre is 0, 0."""
        seen = self.seen_from_camera(points_m)
        return self.middle_px + self.camera.focal_px * seen[:, :2] / seen[:, 2:]

    def directions(self, box: tuple[int, int, int, int]) -> NDArray[np.float32]:
        """Return viewing directions of a box's pixels, camera axes, (H, W, 3); 1 forward."""
        left, top, right, bottom = box
        looks = np.ones((bottom - top, right - left, 3), np.float32)
        x, y = self.middle_px
        looks[:, :, 0] = (np.arange(left, right) - x) / self.camera.focal_px
        looks[:, :, 1] = ((np.arange(top, bottom) - y) / self.camera.focal_px)[:, None]
        return looks


def random_view(
    rng: np.random.Generator,
    drop_m: float,
    radius_m: float,
    sizes_px: Sequence[tuple[int, int]] = SIZES_PX,
) -> View | None:
    """Draw a camera with the whole fall in view, at a fair size; None after `_TRIES`."""
    size = sizes_px[int(rng.integers(len(sizes_px)))]
    path = np.array([[0.0, 0.0, radius_m], [0.0, 0.0, radius_m + drop_m]])
    for _ in range(_TRIES):
        distance = drop_m * rng.uniform(*_DISTANCE) + 4 * radius_m
        elevation = np.radians(rng.uniform(*_ELEVATION_DEG))
        aim = radius_m + drop_m * rng.uniform(0.35, 0.6)
        position = (-distance * np.cos(elevation), 0.0, aim + distance * np.sin(elevation))
        target = (0.0, drop_m * rng.normal(0.0, 0.15), aim)
        camera = PinholeCamera(position, target, size, rng.uniform(*_FOV_DEG))
        view = View(camera, float(np.radians(rng.normal(0.0, _ROLL_DEG))))
        if position[2] > max(_MIN_EYE_M, 1.5 * radius_m) and _shows(view, path, radius_m):
            return view
    return None


def _shows(view: View, path_m: Array, radius_m: float) -> bool:
    pixels = view.image_from_world(path_m)
    radius_px = view.camera.radius_px(path_m, radius_m)
    margin = _MARGIN_PX + 1.2 * radius_px.max()
    inside = (pixels > margin) & (pixels < np.array(view.size_px) - 1 - margin)
    least, most = _RADIUS_PX
    fair = least < radius_px.min() and radius_px.max() < min(most, 0.08 * max(view.size_px))
    return bool(inside.all() and fair and np.ptp(pixels[:, 1]) > _MIN_SPAN * view.size_px[1])
