"""Ray-trace pictures of a ball over a floor: exact in position and shape, without an engine.

A ray through each part of a pixel meets the floor's plane or the ball's sphere, so a ball far from
the picture's centre is the ellipse that a lens without distortion makes of it. The floor is drawn
once, and the ball only where it is.
"""

from __future__ import annotations

import colorsys
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Array
from tunenet_logs.errors import UsageError

# ---- Pinhole camera: project world points

Point = tuple[float, float, float]


@dataclass(frozen=True)
class PinholeCamera:
    """A pinhole camera without distortion, upright (world z up)."""

    position_m: Point
    target_m: Point  # the point in the centre of its picture
    size_px: tuple[int, int] = (320, 240)  # (width, height)
    fov_deg: float = 60.0  # vertical field of view

    def __post_init__(self) -> None:
        for name in ("position_m", "target_m"):
            if not all(abs(value) < 1e4 for value in getattr(self, name)):
                raise UsageError(f"camera: {name} {getattr(self, name)} is out of range")
        # A scene holds three pictures in memory, of 24 bytes a pixel.
        if not all(16 <= value <= 8192 for value in self.size_px):
            raise UsageError(f"camera: size {self.size_px} is not from 16 to 8192 px")
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
        """Project points, (N, 3), to pixels, (N, 2): x right, y down; NaN behind the camera."""
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
    """Draw the paper's random camera, in drop heights, so that it fits any drop."""
    # The paper draws r ~ U(5, 10) m, theta ~ U(0, 2 pi), z ~ U(5, 8) m and aims at (0, 0, 2) m for
    # drops from about 4.5 m. A camera that does not see the whole drop is drawn again.
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


# ---- Scene: a ball of one colour over a textured floor

_OVERSAMPLING = 4  # rays per pixel along each side: 16 grey levels of an edge
_MAX_RAYS = 2**17  # that are followed at once: it bounds the memory of a picture of any size
_LAID_PX = 128  # side of the part of the texture that covers the floor
# Direction to the light, of any length: from above and a little aside, as lamps are.
_LIGHT = np.array([0.35, -0.5, 2.5])

# Parts of the light: from everywhere, by Lambert's law, and mirrored upwards as a soft gloss.
_AMBIENT, _DIFFUSE, _SPECULAR = 0.6, 0.35, 0.05

Box = tuple[int, int, int, int]  # left, top, right, bottom [px]; the last two are outside


@dataclass(frozen=True)
class BallPicture:
    """The part of a picture that shows the ball, H x W pixels."""

    box: Box  # where it lies
    cover: Array  # fraction of each pixel that is ball, shape (H, W)
    intensity: Array  # light from that fraction, 0 to 1, averaged over it, shape (H, W)


class BallScene:
    """A ball of one colour over a textured floor, as one camera sees it."""

    def __init__(self, camera: PinholeCamera, radius_m: float, rng: np.random.Generator) -> None:
        self._camera = camera
        self._radius_m = radius_m
        floor_colour = np.clip(rng.uniform(0.7, 0.95) + rng.uniform(-0.08, 0.08, 3), 0, 1)
        # Draw the floor's texture, grey, 0 to 255.
        import cv2

        side = (512, 512)
        rough = cv2.resize(rng.normal(0, 12, (48, 48)), side, interpolation=cv2.INTER_CUBIC)
        fine = cv2.GaussianBlur(rng.normal(0, 10, side), (0, 0), 1.5)
        grey = np.clip(190 + rough + fine, 0, 255)
        laid = grey[-_LAID_PX:, -_LAID_PX:].astype(np.float32)
        self._ground = _ground(camera, floor_colour, laid)
        # A saturated colour, as sold balls have.
        hue, saturation, value = rng.random(), rng.uniform(0.6, 1.0), rng.uniform(0.5, 1.0)
        self._ball_colour = 255 * np.array(colorsys.hsv_to_rgb(hue, saturation, value))

    def picture(self, centers_m: Array) -> Array:
        """Draw the ball equally long at each centre, (S, 3); RGB, 0 to 255, shape (H, W, 3)."""
        fraction = 1 / len(centers_m)
        floor = self._ground.copy()
        for center in centers_m:
            box, dark = _shadow(self._camera, center, self._radius_m)
            floor[_inside(box)] -= self._ground[_inside(box)] * (fraction * dark[:, :, None])
        frame = floor.copy()
        for center in centers_m:
            ball = draw_ball(self._camera, center, self._radius_m)
            seen = ball.intensity[:, :, None] * self._ball_colour
            hidden = floor[_inside(ball.box)]
            frame[_inside(ball.box)] += (seen - hidden) * (fraction * ball.cover[:, :, None])
        return frame


def draw_ball(camera: PinholeCamera, center_m: Array, radius_m: float) -> BallPicture:
    """Render a sphere at `center_m`, (3,); the box is empty if unseen or around the camera."""
    turn = camera.camera_from_world
    center = turn @ (center_m - np.array(camera.position_m))
    light = turn @ _LIGHT / np.linalg.norm(_LIGHT)
    gap = center @ center - radius_m**2
    left, top, right, bottom = box = _ball_box(camera, center, radius_m)
    cover = np.zeros((bottom - top, right - left))
    intensity = np.zeros_like(cover)
    for strip in _strips(box):
        x, y = _rays(camera, strip)
        # The ray's point s (x, y, 1) is on the sphere: a s² - 2 b s + gap = 0.
        a = x**2 + y**2 + 1
        b = x * center[0] + y * center[1] + center[2]
        within = b**2 - a * gap
        hit = (within > 0) & (b > 0)
        s = (b - np.sqrt(np.where(hit, within, 0.0))) / a
        to_light, up = (
            (s * (x * axis[0] + y * axis[1] + axis[2]) - center @ axis) / radius_m
            for axis in (light, turn[:, 2])
        )
        lit = np.where(hit, _intensity(to_light, up), 0.0)
        rows = slice(strip[1] - top, strip[3] - top)
        cover[rows] = hit.mean(axis=0)
        intensity[rows] = lit.mean(axis=0) / np.maximum(cover[rows], 1e-9)
    return BallPicture(box, cover, intensity)


def _ground(camera: PinholeCamera, colour: Array, texture: NDArray[np.float32]) -> Array:
    """Render the floor alone, shape (H, W, 3); it is seen from above only."""
    import cv2

    turn = camera.camera_from_world
    x_m, y_m, z_m = camera.position_m
    half_m = 4.0 * math.dist(camera.position_m, camera.target_m)
    upright = _LIGHT[2] / np.linalg.norm(_LIGHT)
    lit = colour * float(_intensity(upright, 1.0))
    width, height = camera.size_px
    ground = np.empty((height, width, 3))
    for strip in _strips((0, 0, width, height)):
        x, y = _rays(camera, strip)
        down = -(x * turn[0, 2] + y * turn[1, 2] + turn[2, 2])
        s = z_m / np.where(down > 0, down, np.inf)
        u = (x_m + s * (x * turn[0, 0] + y * turn[1, 0] + turn[2, 0])) / half_m
        v = (y_m + s * (x * turn[0, 1] + y * turn[1, 1] + turn[2, 1])) / half_m
        hit = (s > 0) & (np.abs(u) < 1) & (np.abs(v) < 1)
        columns, rows = (
            ((1 + np.where(hit, at, 0.0)) * (_LAID_PX / 2) - 0.5).astype(np.float32)
            for at in (u, v)
        )
        x, y = (one.reshape(-1, columns.shape[-1]) for one in (columns, rows))
        grey = cv2.remap(texture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        grey = grey.reshape(columns.shape)
        floor = np.where(hit, grey, 0.0).mean(axis=0)[:, :, None] * lit
        # What is neither floor nor ball is white: an overexposed wall or sky.
        ground[_inside(strip)] = floor + 255.0 * (1 - hit.mean(axis=0))[:, :, None]
    return ground


def _shadow(camera: PinholeCamera, center_m: Array, radius_m: float) -> tuple[Box, Array]:
    """Render the ball's shadow: its box, and the fraction of light lost, shape (H, W)."""
    import cv2

    ground = center_m - _LIGHT / _LIGHT[2] * center_m[2]
    turns = np.linspace(0, 2 * math.pi, 24, endpoint=False)
    blur = 0.15 * center_m[2]  # a shadow is softer the higher the ball
    rim = ground + (radius_m + blur) * np.column_stack([np.cos(turns), np.sin(turns), np.zeros(24)])
    rim[:, 2] = 0.0
    pixels = camera.image_from_world(rim)
    if not np.isfinite(pixels).all():
        return (0, 0, 0, 0), np.zeros((0, 0))
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    left, top, right, bottom = box = _box(camera, (low[0], high[0]), (low[1], high[1]))
    dark = np.zeros((bottom - top, right - left), np.uint8)
    if dark.size:
        corners = np.clip(np.round(16 * (pixels - (left, top))), -(2**20), 2**20).astype(np.int32)
        # 55 % of the light remains in the middle of the ball's shadow.
        strength = 255 * (1 - 0.55) * (radius_m / (radius_m + blur)) ** 2
        cv2.fillPoly(dark, [corners], round(strength), cv2.LINE_AA, 4)
    return box, dark / 255.0


def _ball_box(camera: PinholeCamera, center: Array, radius_m: float) -> Box:
    """Return the bounding box of a sphere at a point in camera axes."""
    # Planes through the camera that touch the sphere bound it, two in each direction.
    if math.hypot(*center) <= radius_m:
        return (0, 0, 0, 0)
    spans = []
    for middle_px, across in zip((np.array(camera.size_px) - 1) / 2, center[:2], strict=True):
        distance = math.hypot(across, center[2])
        angle = math.atan2(across, center[2])
        half = math.asin(radius_m / distance) if distance > radius_m else math.pi
        low, high = max(angle - half, -math.pi / 2), min(angle + half, math.pi / 2)
        if low >= high:
            return (0, 0, 0, 0)
        spans.append([middle_px + camera.focal_px * math.tan(edge) for edge in (low, high)])
    return _box(camera, *spans)


def _box(camera: PinholeCamera, columns: tuple[float, float], rows: tuple[float, float]) -> Box:
    """Return the pixels that column and row spans touch, plus a margin of one."""
    (left, right), (top, bottom) = (
        np.clip((math.floor(low - 0.5), math.ceil(high + 0.5) + 1), 0, size).tolist()
        for (low, high), size in zip((columns, rows), camera.size_px, strict=True)
    )
    return left, top, right, bottom


def _strips(box: Box) -> Iterator[Box]:
    """Split the box into horizontal strips of at most `_MAX_RAYS` rays."""
    left, top, right, bottom = box
    rows = max(1, _MAX_RAYS // (_OVERSAMPLING**2 * max(1, right - left)))
    for first in range(top, bottom, rows):
        yield left, first, right, min(first + rows, bottom)


def _rays(camera: PinholeCamera, box: Box) -> tuple[Array, Array]:
    """Return P rays per pixel: x right and y down, in camera axes at depth 1."""
    left, top, right, bottom = box
    parts = (np.arange(_OVERSAMPLING) + 0.5) / _OVERSAMPLING - 0.5
    down, across = (part.reshape(-1, 1) for part in np.meshgrid(parts, parts, indexing="ij"))
    width, height = camera.size_px
    x = (np.arange(left, right) + across - (width - 1) / 2) / camera.focal_px
    y = (np.arange(top, bottom) + down - (height - 1) / 2) / camera.focal_px
    return x[:, None, :], y[:, :, None]


def _intensity(to_light: Array | float, up: Array | float) -> Array:
    """Shade a surface, 0 to 1, by its normal's components towards the light and up."""
    lit = np.maximum(to_light, 0)
    gloss = np.maximum(2 * lit * up - _LIGHT[2] / np.linalg.norm(_LIGHT), 0) ** 2
    direct = _DIFFUSE * lit + _SPECULAR * gloss
    return _AMBIENT + np.minimum(direct, 1 - _AMBIENT)


def _inside(box: Box) -> tuple[slice, slice]:
    """Return the rows and columns of a box as slices."""
    left, top, right, bottom = box
    return slice(top, bottom), slice(left, right)
