"""Project world points with a pinhole camera."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tunenet_logs.arrays import Array
from tunenet_logs.errors import UsageError

Point = tuple[float, float, float]

_FARTHEST_M = 1e4  # of a camera or its target from the origin: beyond it, a coordinate is a mistake
# Smallest and largest side of a picture: a scene holds three in memory, of 24 bytes a pixel.
_SIZES_PX = (16, 8192)


@dataclass(frozen=True)
class PinholeCamera:
    """A pinhole camera without distortion, upright (world z up).

    Attributes:
        target_m: the point in the centre of its picture.
        size_px: (width, height).
        fov_deg: vertical field of view.

    Raises:
        UsageError: a value is not finite or out of range, or the camera looks straight up or down.
    """

    position_m: Point
    target_m: Point
    size_px: tuple[int, int] = (320, 240)
    fov_deg: float = 60.0

    def __post_init__(self) -> None:
        for name in ("position_m", "target_m"):
            if not all(abs(value) < _FARTHEST_M for value in getattr(self, name)):
                raise UsageError(f"camera: {name} {getattr(self, name)} is out of range")
        low, high = _SIZES_PX
        if not all(low <= value <= high for value in self.size_px):
            raise UsageError(f"camera: size {self.size_px} is not from {low} to {high} px")
        if not 1 <= self.fov_deg <= 150:
            raise UsageError(f"camera: field of view {self.fov_deg:g} is not from 1 to 150 degrees")
        sideways = math.dist(self.position_m[:2], self.target_m[:2])
        if sideways < 1e-3 * math.dist(self.position_m, self.target_m) or not sideways:
            raise UsageError("camera: it must not look straight up or down; move it sideways")

    @property
    def focal_px(self) -> float:
        """Focal length [px]."""
        return self.size_px[1] / 2 / math.tan(math.radians(self.fov_deg) / 2)

    @property
    def camera_from_world(self) -> Array:
        """Rotation from world to camera axes: rows are right, down and forward, shape (3, 3)."""
        forward = np.subtract(self.target_m, self.position_m)
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(forward, right), forward])

    def image_from_world(self, points_m: Array) -> Array:
        """Project points into the picture.

        Args:
            points_m: in the world, shape (N, 3).

        Returns:
            Shape (N, 2) [px], x right, y down, the first pixel's centre at 0, 0; NaN for a point
            behind the camera.
        """
        seen = (points_m - np.array(self.position_m)) @ self.camera_from_world.T
        depth = np.where(seen[:, 2] > 0, seen[:, 2], np.nan)
        middle = (np.array(self.size_px) - 1) / 2
        return middle + self.focal_px * seen[:, :2] / depth[:, None]

    def radius_px(self, points_m: Array, radius_m: float) -> Array:
        """Compute balls' apparent radii [px], shape (N,), at (N, 3); exact on axis."""
        depth = (points_m - np.array(self.position_m)) @ self.camera_from_world[2]
        return self.focal_px * radius_m / depth

    def sees(self, points_m: Array, margin_px: float) -> bool:
        """Return whether all points, shape (N, 3), lie inside a margin of the picture."""
        pixels = self.image_from_world(points_m)
        far = np.array(self.size_px) - 1 - margin_px
        return bool(np.all((pixels >= margin_px) & (pixels <= far)))  # NaN is not


def random_camera(
    rng: np.random.Generator,
    gap_m: float,
    radius_m: float,
    size_px: tuple[int, int] = (320, 240),
    fov_deg: float = 60.0,
) -> PinholeCamera:
    """Draw the paper's random camera, in drop heights, so that it fits any drop.

    The paper draws r ~ U(5, 10) m, theta ~ U(0, 2 pi), z ~ U(5, 8) m and aims at (0, 0, 2) m for
    drops from about 4.5 m. A camera that does not see the whole drop is drawn again.

    Raises:
        UsageError: no camera of this view has the whole drop in its picture.
    """
    scale = gap_m / 4.5
    path = np.array([[0.0, 0.0, radius_m], [0.0, 0.0, radius_m + gap_m]])
    for _ in range(200):
        distance = scale * rng.uniform(5.0, 10.0) + 2 * radius_m
        angle = rng.uniform(0.0, 2 * math.pi)
        height = scale * rng.uniform(5.0, 8.0) + 2 * radius_m
        position = (distance * math.cos(angle), distance * math.sin(angle), height)
        camera = PinholeCamera(position, (0.0, 0.0, 2 * scale), size_px, fov_deg)
        if camera.sees(path, 2 + float(camera.radius_px(path, radius_m).max())):
            return camera
    raise UsageError(f"no random camera of {fov_deg:g} degrees sees the whole drop; widen --fov")
