"""Render the static scene of a clip: a textured floor, a wall behind it, a light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.evaluation.clips.view import View
from tunenet_logs.arrays import Array, Picture

_TEXTURE_PX = 512  # side of a texture, which is repeated
_WALL_FALLS = (0.3, 1.5)  # from the ball to the wall behind it [drop heights]
_WALL_TURN_RAD = 0.6  # most that the wall is turned about the vertical
_FINER = 2  # points along each side of a pixel, whose mean is its colour (antialiasing)


@dataclass(frozen=True, eq=False)
class Stage:
    """Static part of a scene.

    Attributes:
        picture: RGB, uint8, shape (H, W, 3).
        floor_m: x and y of the floor that each pixel shows, float32, shape (H, W, 2); NaN where it
            shows the wall.
    """

    picture: Picture
    floor_m: NDArray[np.float32]


def draw_stage(view: View, drop_m: float, rng: np.random.Generator) -> Stage:
    """Render a floor and a wall of random colour, texture and light, as the camera sees them."""
    import cv2

    wall_m = drop_m * rng.uniform(*_WALL_FALLS)
    turn = rng.uniform(-_WALL_TURN_RAD, _WALL_TURN_RAD)
    floor, wall = _texture(rng), _texture(rng)
    floor_scale, wall_scale = (drop_m * rng.uniform(0.3, 1.5) / _TEXTURE_PX for _ in range(2))
    width, height = view.size_px
    looks = _fine_directions(view) @ view.camera_from_world.astype(np.float32)
    along, at_m, is_floor = _surfaces(view, looks, wall_m, turn)
    scale = np.where(is_floor, floor_scale, wall_scale)
    columns, rows = ((along[:, :, axis] / scale).astype(np.float32) for axis in (0, 1))
    picked = [
        cv2.remap(one, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        for one in (wall, floor)
    ]
    fine = np.where(is_floor[:, :, None], picked[1], picked[0]).astype(np.float32)
    fine *= _light(fine.shape[:2], rng)
    small = cv2.resize(np.clip(fine, 0, 255), (width, height), interpolation=cv2.INTER_AREA)
    middle = at_m[_FINER // 2 :: _FINER, _FINER // 2 :: _FINER, :2]
    shown = np.where(is_floor[_FINER // 2 :: _FINER, _FINER // 2 :: _FINER, None], middle, np.nan)
    picture = np.round(np.asarray(small)).astype(np.uint8)
    return Stage(picture, shown.astype(np.float32))


def _fine_directions(view: View) -> NDArray[np.float32]:
    """Return the directions of `_FINER` by `_FINER` points of each pixel."""
    width, height = view.size_px
    x, y = view.middle_px
    offsets = (np.arange(_FINER) + 0.5) / _FINER - 0.5
    looks = np.ones((height * _FINER, width * _FINER, 3), np.float32)
    columns = (np.arange(width)[:, None] + offsets).ravel()
    rows = (np.arange(height)[:, None] + offsets).ravel()
    looks[:, :, 0] = (columns - x) / view.camera.focal_px
    looks[:, :, 1] = ((rows - y) / view.camera.focal_px)[:, None]
    return looks


def _surfaces(
    view: View, looks: NDArray[np.float32], wall_m: float, turn: float
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return coordinates on the surface seen [m], world places [m], and whether it is the floor."""
    position = np.array(view.camera.position_m, np.float32)
    normal = np.array([-np.cos(turn), np.sin(turn), 0.0], np.float32)  # towards the camera
    sideways = np.array([normal[1], -normal[0], 0.0], np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        to_floor = np.where(looks[:, :, 2] < 0, -position[2] / looks[:, :, 2], np.inf)
        facing = looks @ normal
        to_wall = np.where(facing < 0, -(wall_m + position @ normal) / facing, np.inf)
    to_wall = np.where(to_wall > 0, to_wall, np.inf)
    is_floor = to_floor < to_wall
    reach = np.minimum(np.minimum(to_floor, to_wall), 1e3)
    at_m = position + reach[:, :, None] * looks
    on_wall = np.stack([at_m @ sideways, -at_m[:, :, 2]], axis=2)
    along = np.where(is_floor[:, :, None], at_m[:, :, :2], on_wall)
    return along.astype(np.float64), at_m.astype(np.float64), is_floor


def _texture(rng: np.random.Generator) -> Picture:
    """Draw a texture, plain, rough, striped or chequered, of a dull, dark or light colour."""
    import cv2

    side = _TEXTURE_PX
    colour = np.array(_room_colour(rng))
    pattern = np.zeros((side, side))
    for cells, strength in ((6, 0.05), (24, 0.05), (96, 0.05), (256, 0.05)):
        rough = rng.normal(0.0, strength * rng.random(), (cells, cells))
        pattern += cv2.resize(rough, (side, side), interpolation=cv2.INTER_CUBIC)
    kind = rng.choice(["plain", "plain", "boards", "tiles"])
    y, x = np.mgrid[:side, :side]
    lines = side // int(rng.choice([4, 8, 16]))
    if kind == "boards":
        pattern += rng.normal(0, 0.08, side // lines)[(x // lines) % (side // lines)]
        pattern -= 0.25 * (x % lines < 2)
    elif kind == "tiles":
        pattern += rng.uniform(0, 0.35) * ((x // lines + y // lines) % 2 - 0.5)
    tinted = colour * (1 + pattern[:, :, None])
    return np.clip(tinted, 0, 255).astype(np.uint8)


def _room_colour(rng: np.random.Generator) -> list[float]:
    import colorsys

    saturation = rng.choice([rng.uniform(0.0, 0.2), rng.uniform(0.0, 0.6)])
    return [255 * c for c in colorsys.hsv_to_rgb(rng.random(), saturation, rng.uniform(0.2, 0.95))]


def _light(shape: tuple[int, int], rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw a light that falls off to one side and to the corners, shape (H, W, 1)."""
    y = np.linspace(-1, 1, shape[0], dtype=np.float32)[:, None]
    x = np.linspace(-1, 1, shape[1], dtype=np.float32)[None]
    slope_x, slope_y = rng.uniform(-0.2, 0.2, 2)
    corners = rng.uniform(0.0, 0.15)
    light = 1 + slope_x * x + slope_y * y - corners * (x**2 + y**2)
    return (rng.uniform(0.75, 1.05) * light)[:, :, None].astype(np.float32)
