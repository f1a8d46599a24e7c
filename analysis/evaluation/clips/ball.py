"""Ray-cast a shaded ball, its shadow and its reflection, only where they are.

A sphere of radius r at c (in the camera's axes) covers a pixel that looks along d where
g(d) = (d c)^2 - d^2 (c^2 - r^2) > 0: its true outline, an ellipse. Edges are smooth: the fraction
of a pixel that is ball is 1/2 + g / |grad g|, the distance from the outline.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.evaluation.clips.scene import Stage
from analysis.evaluation.clips.view import View
from tunenet_logs.arrays import Array, Picture

Box = tuple[int, int, int, int]


@dataclass(frozen=True)
class BallLook:
    """Appearance of the ball.

    Attributes:
        radius_m: of the ball.
        colour: RGB, 0 to 255.
        light: unit vector to the lamp, in the world.
        ambient: fraction of the light that comes from everywhere.
        gloss: strength of the highlight, 0 to 1.
        shadow: fraction of the light that the middle of its shadow lacks.
        softness: width of the shadow's edge over the ball's height.
        mirror: how much of it the floor reflects, 0 to 1.
    """

    radius_m: float
    colour: tuple[float, float, float]
    light: tuple[float, float, float]
    ambient: float
    gloss: float
    shadow: float
    softness: float
    mirror: float


def add_ball(frame: Picture, view: View, stage: Stage, look: BallLook, centers_m: Array) -> None:
    """Render a ball at its positions `centers_m`, shape (S, 3), while the shutter is open."""
    if look.shadow > 0:
        _add_shadow(frame, view, stage, look, centers_m)
    if look.mirror > 0:
        below = centers_m * np.array([1.0, 1.0, -1.0])
        _add_spheres(frame, view, look, below, stage.floor_m)
    _add_spheres(frame, view, look, centers_m, None)


def _add_spheres(
    frame: Picture,
    view: View,
    look: BallLook,
    centers_m: Array,
    through: NDArray[np.float32] | None,
) -> None:
    """Blend in the mean of the spheres; `through` a floor they are faint, and only there."""
    boxes = [_box(view, center, look.radius_m) for center in centers_m]
    left, top = np.min([box[:2] for box in boxes], axis=0)
    right, bottom = np.max([box[2:] for box in boxes], axis=0)
    if left >= right or top >= bottom:
        return
    cover = np.zeros((bottom - top, right - left), np.float32)
    light = np.zeros((bottom - top, right - left, 3), np.float32)
    for center, box in zip(centers_m, boxes, strict=True):
        if box[0] >= box[2] or box[1] >= box[3]:
            continue
        part = slice(box[1] - top, box[3] - top), slice(box[0] - left, box[2] - left)
        covered, colours = _sphere(view, center, look, box)
        cover[part] += covered / len(centers_m)
        light[part] += covered[:, :, None] * colours / len(centers_m)
    where = slice(top, bottom), slice(left, right)
    if through is not None:
        shown = look.mirror * np.isfinite(through[where][:, :, 0])
        cover, light = cover * shown, light * shown[:, :, None]
    behind = frame[where].astype(np.float32)
    frame[where] = np.clip(behind * (1 - cover[:, :, None]) + light + 0.5, 0, 255)


def _box(view: View, center_m: Array, radius_m: float) -> Box:
    """Return the pixels a sphere may touch: left, top, right, bottom; empty out of view."""
    seen = view.seen_from_camera(center_m[None])[0]
    if seen[2] < 2 * radius_m:
        return 0, 0, 0, 0
    x, y = view.image_from_world(center_m[None])[0]
    half = 1.15 * view.camera.focal_px * radius_m / (seen[2] - radius_m) + 2
    width, height = view.size_px
    left, top = max(0, int(x - half)), max(0, int(y - half))
    return left, top, min(width, int(x + half) + 2), min(height, int(y + half) + 2)


def _sphere(
    view: View, center_m: Array, look: BallLook, box: Box
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the ball's coverage of each pixel, shape (H, W), and colour, shape (H, W, 3)."""
    center = view.seen_from_camera(center_m[None])[0].astype(np.float32)
    looks = view.directions(box)
    along = looks @ center
    squared = (looks**2).sum(axis=2)
    rim = np.float32(center @ center - look.radius_m**2)
    inside = along**2 - squared * rim
    slope = 2 * (along[:, :, None] * center[:2] - looks[:, :, :2] * rim) / view.camera.focal_px
    steepness = np.sqrt((slope**2).sum(axis=2)) + 1e-12
    covered = np.clip(0.5 + inside / steepness, 0, 1)
    reach = (along - np.sqrt(np.maximum(inside, 0))) / squared
    normal = (reach[:, :, None] * looks - center) / np.float32(look.radius_m)
    normal /= np.sqrt((normal**2).sum(axis=2, keepdims=True)) + 1e-9
    lamp = (view.camera_from_world @ np.array(look.light)).astype(np.float32)
    facing = normal @ lamp
    bright = look.ambient + (1 - look.ambient) * np.maximum(facing, 0)
    towards = -looks / np.sqrt(squared)[:, :, None]
    bounced = 2 * facing[:, :, None] * normal - lamp
    shine = np.maximum((bounced * towards).sum(axis=2), 0) ** 24
    colours = bright[:, :, None] * np.array(look.colour, np.float32)
    return covered, colours + 255 * look.gloss * shine[:, :, None]


def _add_shadow(frame: Picture, view: View, stage: Stage, look: BallLook, centers_m: Array) -> None:
    """Darken the floor where the ball keeps the lamp's light away, softer the higher it is."""
    middle = centers_m[len(centers_m) // 2]
    lamp = np.array(look.light)
    ground = (middle - lamp / lamp[2] * middle[2])[:2]
    edge = look.softness * (middle[2] - look.radius_m) + 0.1 * look.radius_m
    turns = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    reach = look.radius_m + edge
    rim = np.column_stack([np.cos(turns), np.sin(turns), np.zeros(16)]) * 1.3 * reach
    rim[:, :2] += ground
    if view.seen_from_camera(rim)[:, 2].min() <= 0.02:
        return
    pixels = view.image_from_world(rim)
    width, height = view.size_px
    left, top = np.maximum(np.floor(pixels.min(axis=0)), 0).astype(int)
    right, bottom = np.minimum(np.ceil(pixels.max(axis=0)) + 1, [width, height]).astype(int)
    if left >= right or top >= bottom:
        return
    where = slice(top, bottom), slice(left, right)
    apart = np.linalg.norm(stage.floor_m[where] - ground.astype(np.float32), axis=2)
    apart = np.where(np.isfinite(apart), apart, np.inf)
    depth = look.shadow * (look.radius_m / (look.radius_m + edge / 2)) ** 2
    dark = depth * np.clip((reach - apart) / (2 * edge), 0, 1)
    frame[where] = frame[where] * (1 - dark[:, :, None]) + 0.5
