"""Pictures of a ball over a floor, by PyBullet's software renderer.

The renderer has no smooth edges, so it draws each pixel several times over; and it is slow, so the
floor is drawn once and the ball only where it is.
"""

from __future__ import annotations

import math
import tempfile
import weakref
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recorders.simulators.pinhole import PinholeCamera
from recorders.simulators.pybullet.engine import pybullet
from tunenet_logs.arrays import Array

_OVERSAMPLING = 4
"""Drawn pixels per pixel along each side: 16 grey levels of an edge."""

_NEAR = 0.02
"""Near plane, as a fraction of the camera's distance."""

_NO_BODY = -2
"""No number of a body, nor -1, the renderer's mark of the background."""

_LIGHT = np.array([0.35, -0.5, 2.5])
"""Direction to the light, of any length: from above and a little aside, as lamps are."""

_SHADOW = 0.55
"""Fraction of the light that remains in the middle of the ball's shadow."""


class BallScene:
    """A ball of one colour over a textured floor, as one camera sees it.

    Args:
        camera: where from.
        radius_m: of the ball.
        rng: draws colours and texture.
    """

    def __init__(self, camera: PinholeCamera, radius_m: float, rng: np.random.Generator) -> None:
        self._camera = camera
        self._radius_m = radius_m
        self._engine = engine = pybullet()
        self._client = client = engine.connect(engine.DIRECT)
        weakref.finalize(self, engine.disconnect, client)
        reach = math.dist(camera.position_m, camera.target_m)
        self._near_m, self._far_m = _NEAR * reach, 20 * reach
        self._view = engine.computeViewMatrix(camera.position_m, camera.target_m, [0, 0, 1])
        self._ball = _NO_BODY
        self._add_floor(reach, rng)
        self._ground = self._drawn((0, 0, *camera.size_px))[0]
        colour = _ball_colour(rng)
        shape = engine.createVisualShape(
            engine.GEOM_MESH, **_sphere(radius_m), rgbaColor=[*colour, 1], physicsClientId=client
        )
        self._ball = engine.createMultiBody(0, -1, shape, physicsClientId=client)

    def picture(self, centers_m: Array) -> Array:
        """What the camera shows of a ball at these positions while the shutter was open.

        Args:
            centers_m: of the ball, equally long at each, shape (S, 3).

        Returns:
            RGB, 0 to 255, shape (H, W, 3), not rounded.
        """
        frame = self._ground.copy()
        for center in centers_m:
            frame -= self._ground * self._shadow(center) / len(centers_m)
        cover = np.zeros(frame.shape[:2])
        light = np.zeros_like(frame)
        for center in centers_m:
            self._add_ball(center, cover, light, 1 / len(centers_m))
        return frame * (1 - cover[:, :, None]) + light

    def _add_ball(self, center: Array, cover: Array, light: Array, fraction: float) -> None:
        camera = self._camera
        middle = camera.image_from_world(center[None])[0]
        half = 1.3 * float(camera.radius_px(center[None], self._radius_m)[0]) + 2
        if not np.isfinite(middle).all():
            return
        left, top = np.maximum(np.floor(middle - half).astype(int), 0)
        right, bottom = np.minimum(np.ceil(middle + half).astype(int) + 1, camera.size_px)
        if left >= right or top >= bottom:
            return
        self._engine.resetBasePositionAndOrientation(
            self._ball, center.tolist(), [0, 0, 0, 1], physicsClientId=self._client
        )
        colours, alpha = self._drawn((left, top, right, bottom))
        cover[top:bottom, left:right] += fraction * alpha
        light[top:bottom, left:right] += fraction * colours * alpha[:, :, None]

    def _drawn(self, box: tuple[int, int, int, int]) -> tuple[Array, Array]:
        """Part of the picture: its colours, and the fraction of each pixel that is ball.

        Args:
            box: left, top, right, bottom [px].

        Returns:
            Shapes (H, W, 3) and (H, W); where there is ball, the colour is the ball's alone.
        """
        left, top, right, bottom = box
        width, height = self._camera.size_px
        tall = self._near_m * math.tan(math.radians(self._camera.fov_deg) / 2)
        per_px = 2 * tall / height
        projection = self._engine.computeProjectionMatrix(
            (left - width / 2) * per_px,
            (right - width / 2) * per_px,
            (height / 2 - bottom) * per_px,
            (height / 2 - top) * per_px,
            self._near_m,
            self._far_m,
        )
        columns, rows = (right - left) * _OVERSAMPLING, (bottom - top) * _OVERSAMPLING
        *_, colours, _, bodies = self._engine.getCameraImage(
            columns,
            rows,
            self._view,
            projection,
            lightDirection=_LIGHT.tolist(),
            renderer=self._engine.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        fine = np.asarray(colours, np.float64).reshape(rows, columns, 4)[:, :, :3]
        is_ball = np.asarray(bodies).reshape(rows, columns) == self._ball
        alpha = _averaged(is_ball[:, :, None].astype(np.float64))
        chosen = _averaged(np.where(is_ball[:, :, None], fine, 0.0)) / np.maximum(alpha, 1e-9)
        colours = np.where(alpha > 0, chosen, _averaged(fine))
        return colours, alpha[:, :, 0]

    def _shadow(self, center: Array) -> Array:
        """Fraction of the light that the ball takes from each pixel's floor, shape (H, W, 1)."""
        import cv2

        ground = center - _LIGHT / _LIGHT[2] * center[2]
        turns = np.linspace(0, 2 * math.pi, 24, endpoint=False)
        blur = 0.15 * center[2]  # a shadow is softer the higher the ball
        rim = ground + (self._radius_m + blur) * np.column_stack(
            [np.cos(turns), np.sin(turns), np.zeros(24)]
        )
        rim[:, 2] = 0.0
        pixels = self._camera.image_from_world(rim)
        width, height = self._camera.size_px
        dark = np.zeros((height, width), np.uint8)
        if np.isfinite(pixels).all():
            corners = np.clip(np.round(16 * pixels), -(2**20), 2**20).astype(np.int32)
            strength = 255 * (1 - _SHADOW) * (self._radius_m / (self._radius_m + blur)) ** 2
            cv2.fillPoly(dark, [corners], round(strength), cv2.LINE_AA, 4)
        return dark[:, :, None] / 255.0

    def _add_floor(self, reach_m: float, rng: np.random.Generator) -> None:
        engine, client = self._engine, self._client
        half = 4 * reach_m
        floor = engine.createVisualShape(
            engine.GEOM_BOX,
            halfExtents=[half, half, 0.05 * reach_m],
            rgbaColor=[*np.clip(rng.uniform(0.7, 0.95) + rng.uniform(-0.08, 0.08, 3), 0, 1), 1],
            physicsClientId=client,
        )
        body = engine.createMultiBody(0, -1, floor, [0, 0, -0.05 * reach_m], physicsClientId=client)
        import cv2

        with tempfile.TemporaryDirectory() as folder:
            path = str(Path(folder) / "floor.png")
            cv2.imwrite(path, _floor_texture(rng))
            texture = engine.loadTexture(path, physicsClientId=client)
        engine.changeVisualShape(body, -1, textureUniqueId=texture, physicsClientId=client)


def _averaged(fine: Array) -> Array:
    rows, columns, channels = fine.shape
    blocks = (rows // _OVERSAMPLING, _OVERSAMPLING, columns // _OVERSAMPLING, _OVERSAMPLING)
    return fine.reshape(*blocks, channels).mean(axis=(1, 3))


def _floor_texture(rng: np.random.Generator) -> NDArray[np.uint8]:
    import cv2

    rough = cv2.resize(rng.normal(0, 12, (48, 48)), (512, 512), interpolation=cv2.INTER_CUBIC)
    fine = cv2.GaussianBlur(rng.normal(0, 10, (512, 512)), (0, 0), 1.5)
    grey = np.clip(190 + rough + fine, 0, 255)[:, :, None]
    return np.repeat(grey, 3, axis=2).astype(np.uint8)


def _ball_colour(rng: np.random.Generator) -> list[float]:
    """Saturated, as balls are that are sold for playing."""
    import colorsys

    return list(colorsys.hsv_to_rgb(rng.random(), rng.uniform(0.6, 1.0), rng.uniform(0.5, 1.0)))


def _sphere(radius_m: float, turns: int = 32) -> dict[str, list]:
    """A finer mesh than the engine's own sphere, whose edges show."""
    around, along = np.meshgrid(
        np.linspace(0, 2 * math.pi, turns, endpoint=False), np.linspace(0, math.pi, turns // 2 + 1)
    )
    unit = np.stack(
        [np.sin(along) * np.cos(around), np.sin(along) * np.sin(around), np.cos(along)], axis=-1
    ).reshape(-1, 3)
    faces = []
    for ring in range(turns // 2):
        for k in range(turns):
            a, b = ring * turns + k, ring * turns + (k + 1) % turns
            c, d = a + turns, b + turns
            faces += [a, c, b, b, c, d]
    return {
        "vertices": (radius_m * unit).tolist(),
        "normals": unit.tolist(),
        "indices": faces,
    }
