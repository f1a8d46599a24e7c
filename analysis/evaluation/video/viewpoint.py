"""Draw camera poses before a falling ball: the paper's rig, and anywhere.

The world's origin is the middle of the ball where it touches the table, z is up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.arrays import Array

SIZE_PX = (320, 240)  # width and height of a picture: small, so that whole pixels matter
PAPER_RADIUS_M = 0.5
# The paper's is 40 degrees, at which a fifth of its drops are cut off by the frame.
PAPER_FOV_DEG = (40.0, 60.0)

_PAPER_REACH_M = (5.0, 10.0)
_PAPER_HEIGHT_M = (5.0, 8.0)
_PAPER_AIM_M = 2.0  # of its camera, from the plane that the ball hits; see `paper_viewpoint`
_FALLS_AWAY = (0.8, 4.0)
_ELEVATION_DEG = (-25.0, 50.0)
_ROLL_DEG = 4.0
_DROP_IN_PICTURE = (0.4, 0.85)
_FOV_DEG = (15.0, 90.0)  # of any camera: see `any_viewpoint`
_MARGIN_PX = 2.0  # between a ball and the frame, at the start and at the contact


@dataclass(frozen=True)
class Viewpoint:
    """Pinhole camera without distortion.

    Attributes:
        position_m: where it stands.
        aim_m: the point in the middle of its picture.
        focal_px: focal length.
        roll_deg: by which its picture is turned.
    """

    position_m: tuple[float, float, float]
    aim_m: tuple[float, float, float]
    focal_px: float
    roll_deg: float = 0.0

    def image_from_world(self, points_m: Array) -> tuple[Array, Array]:
        """Project points, (N, 3), to pixels, (N, 2), and depths, (N,); NaN behind."""
        ahead = np.subtract(self.aim_m, self.position_m)
        heading = np.arctan2(ahead[1], ahead[0])
        rise = np.arctan2(ahead[2], np.hypot(ahead[0], ahead[1]))
        offset = points_m - np.array(self.position_m)
        along = offset[:, 0] * np.cos(heading) + offset[:, 1] * np.sin(heading)
        right = offset[:, 0] * np.sin(heading) - offset[:, 1] * np.cos(heading)
        depth = along * np.cos(rise) + offset[:, 2] * np.sin(rise)
        down = along * np.sin(rise) - offset[:, 2] * np.cos(rise)
        roll = np.radians(self.roll_deg)
        columns = right * np.cos(roll) - down * np.sin(roll)
        rows = right * np.sin(roll) + down * np.cos(roll)
        scale = self.focal_px / np.where(depth > 0, depth, np.nan)
        middle = (np.array(SIZE_PX) - 1) / 2
        return middle + np.column_stack([columns, rows]) * scale[:, None], depth

    def radius_px(self, depth_m: Array, radius_m: float) -> Array:
        """Return a ball's approximate image radius at these depths [m], NaN behind, (N,)."""
        return self.focal_px * radius_m / np.where(depth_m > 0, depth_m, np.nan)

    def shows(self, points_m: Array, radius_m: float) -> NDArray[np.bool_]:
        """Check whether a ball is wholly in view at these points, of shape (N, 3); shape (N,)."""
        pixels, depth = self.image_from_world(points_m)
        margin = self.radius_px(depth, radius_m)[:, None]
        far = np.array(SIZE_PX) - 1 - margin
        return np.all((pixels >= margin) & (pixels <= far), axis=1)  # NaN is not

    def plumb_px(self, drop_m: float) -> Array:
        """Return the image vector from the start of a fall to the contact, shape (2,) [px]."""
        (top, low), _ = self.image_from_world(np.array([[0.0, 0.0, drop_m], [0.0, 0.0, 0.0]]))
        return low - top


def paper_viewpoint(rng: np.random.Generator, drop_m: float, radius_m: float) -> Viewpoint:
    """Draw the paper's camera, with all of the drop in view.

    r ~ U(5, 10) m, theta ~ U(0, 2 pi), z ~ U(5, 8) m, aimed at (0, 0, 2) m over the table (Allevato
    et al. 2019, experiment 3).
    """
    while True:
        reach, theta = rng.uniform(*_PAPER_REACH_M), rng.uniform(0.0, 2 * np.pi)
        up = rng.uniform(*_PAPER_HEIGHT_M)
        position = (reach * np.cos(theta), reach * np.sin(theta), up - radius_m)
        focal = _focal_px(rng.uniform(*PAPER_FOV_DEG))
        view = Viewpoint(position, (0.0, 0.0, _PAPER_AIM_M - radius_m), focal)
        if _shows_the_drop(view, drop_m, radius_m):
            return view


def any_viewpoint(rng: np.random.Generator, drop_m: float, radius_m: float) -> Viewpoint:
    """Draw a camera from which a person films a drop, so that it takes U(.4, .85) of the view.

    0.8 to 4 drop heights away (evenly in the logarithm), 25 degrees below to 50 above the middle of
    the drop but not below the table, turned by a few degrees, aimed at about that middle, with any
    lens of 15 to 90 degrees that does so.
    """
    while True:
        away = drop_m * float(np.exp(rng.uniform(*np.log(_FALLS_AWAY))))
        above = np.radians(rng.uniform(*_ELEVATION_DEG))
        theta = rng.uniform(0.0, 2 * np.pi)
        aside, up = drop_m * rng.normal(0.0, 0.1, 2), drop_m * rng.uniform(0.35, 0.6)
        position = (
            away * np.cos(above) * np.cos(theta),
            away * np.cos(above) * np.sin(theta),
            up + away * np.sin(above),
        )
        aim = (float(aside[0]), float(aside[1]), up)
        roll = float(rng.normal(0.0, _ROLL_DEG))
        wanted = rng.uniform(*_DROP_IN_PICTURE) * SIZE_PX[1]
        focal = wanted / np.linalg.norm(Viewpoint(position, aim, 1.0).plumb_px(drop_m))
        view = Viewpoint(position, aim, float(focal), roll)
        fits = _focal_px(_FOV_DEG[1]) <= focal <= _focal_px(_FOV_DEG[0]) and position[2] > 0
        if fits and _shows_the_drop(view, drop_m, radius_m):
            return view


def _focal_px(fov_deg: float) -> float:
    return float(SIZE_PX[1] / 2 / np.tan(np.radians(fov_deg) / 2))


def _shows_the_drop(view: Viewpoint, drop_m: float, radius_m: float) -> bool:
    path = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, drop_m]])
    _, depth = view.image_from_world(path)
    spare_m = _MARGIN_PX * float(depth.max()) / view.focal_px
    return bool(view.shows(path, radius_m + spare_m).all())
