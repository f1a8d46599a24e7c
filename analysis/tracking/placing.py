"""Where the ball is to a small part of a pixel: its own picture over the background, fitted.

A pixel is background B and ball P in the shares that the outline gives: (1 - a) B + a P. The
ball's picture moves, grows and takes more or less light until that is what is seen. So a ball that
looks like a part of what is behind it, its shadow, its reflection and a hand that holds it do not
pull its centre: they are residuals, and large ones count little (Geman and McClure's weights, at
first wide).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.tracking.background import Background
from analysis.tracking.drawn_ball import DrawnBall, draw_ball
from analysis.tracking.patches import Patch, cut_patch
from tunenet_logs.arrays import Array, Picture

Fine = NDArray[np.float32]

FINE_PX = 9.0
"""A larger ball is reduced to that radius before it is fitted."""

_MOST_STEPS = 10
_ENOUGH_PX = 0.03
"""OpenCV moves pictures by whole 32nds of a pixel."""

_NEAR_START = 0.25
_NEAR = 0.3
_FAR_WORSE = 1.5
_LARGE, _LARGE_SHARE, _STRICTER = 30.0, 0.35, 0.65
"""Residuals that count little: at first only the largest, or there would be no pull to the edge."""

_WIDE, _NARROW, _SURE = 4.0, 1.6, 0.12
"""By how much at first, from a start that may be far off or is about right; and when it was."""

_PRIOR = np.diag([0.0, 0.0, 0.25**-2, 0.2**-2, 0.2**-2, 0.2**-2])
"""Of the growth, and of the light: as a whole, to the right and downward."""

_SURROUNDINGS = 5.0
_STARTS = (
    (0, 0, 0.0),
    (1, 0, 0.0),
    (-1, 0, 0.0),
    (0, 1, 0.0),
    (0, -1, 0.0),
    (0, 0, 0.2),
    (0, 0, -0.2),
)
_COARSE_PX = 4.0


@dataclass(frozen=True)
class Placing:
    """A place of the ball in one picture.

    Attributes:
        x, y: of its centre [px].
        radius_px: of its outline.
        misfit: rms residual inside it, but for noise, over how far it stands out; 0 is perfect.
    """

    x: float
    y: float
    radius_px: float
    misfit: float

    def is_near(self, x: float, y: float) -> bool:
        """Whether a place [px] is about this one."""
        return math.hypot(x - self.x, y - self.y) < _NEAR * self.radius_px


@dataclass(frozen=True, eq=False)
class Appearance:
    """The ball's own picture.

    Attributes:
        layers: its colours times its share of each pixel, and that share, shape (N, N, 4).
        radius_px: of its outline, in the pictures.
        zoom: its pixels for one of the pictures.
    """

    layers: Fine
    radius_px: float
    zoom: float

    def place(
        self,
        picture: Picture,
        background: Background,
        gain: float,
        x: float,
        y: float,
        grown: float = 1.0,
        known: Sequence[Placing] = (),
    ) -> Placing | None:
        """The ball near a place; None where there is none in view, or none that is not known.

        Args:
            picture: where it is looked for.
            background: behind it.
            gain: how much brighter the background is than the picture.
            x: near its centre [px].
            y: likewise.
            grown: about its radius over `radius_px`.
            known: found from other starts; what comes to one of them, or is far worse, is left.
        """
        patch = cut_patch(picture, background, gain, (x, y), self.radius_px * grown, self.zoom)
        if patch is None:
            return None
        start = np.array([*patch.here(x, y), np.log(grown), 0.0, 0.0, 0.0])
        values, misfit = self.fit(patch, start, np.log(grown), _NARROW)
        if misfit > _SURE:
            here = patch.there(values[0], values[1])
            if any(misfit > _FAR_WORSE * it.misfit or it.is_near(*here) for it in known):
                return None
            start = self.nearest(patch, start)
            values, misfit = self.fit(patch, start, np.log(grown))
        if np.hypot(*(values - start)[:2]) > _NEAR_START * self.radius_px * self.zoom:
            values, misfit = self.fit(patch, values, np.log(grown))  # it was a long way
        px, py = patch.there(values[0], values[1])
        if np.hypot(px - x, py - y) > 1.2 * self.radius_px * grown + 2:
            return None
        return Placing(px, py, self.radius_px * float(np.exp(values[2])), misfit)

    def alike(self, picture: Picture, x: float, y: float) -> list[tuple[float, float]]:
        """Where near a place the picture is most like the ball, the best first."""
        import cv2

        half = int(np.ceil(_SURROUNDINGS * self.radius_px)) + 2
        left, top = max(round(x) - half, 0), max(round(y) - half, 0)
        part = picture[top : max(round(y) + half + 1, 0), left : max(round(x) + half + 1, 0)]
        coarse = min(1.0, _COARSE_PX / self.radius_px)
        own = self._reduced(coarse / self.zoom)
        size = (round(part.shape[1] * coarse), round(part.shape[0] * coarse))
        if min(size) <= own.shape[0]:
            return []
        small = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), np.float32)
        share = np.repeat(own[:, :, 3:], 3, axis=2)
        colours = own[:, :, :3] / np.maximum(share, 1e-3)
        off = np.array(cv2.matchTemplate(small, colours, cv2.TM_SQDIFF, mask=share))
        found = []
        for _ in range(2):
            row, column = np.unravel_index(int(off.argmin()), off.shape)
            middle = (own.shape[0] - 1) / 2
            found.append(
                (
                    (column + middle + 0.5) / coarse - 0.5 + left,
                    (row + middle + 0.5) / coarse - 0.5 + top,
                )
            )
            near = int(_COARSE_PX)
            off[max(row - near, 0) : row + near + 1, max(column - near, 0) : column + near + 1] = (
                np.inf
            )
        return found

    def _reduced(self, zoom: float) -> Fine:
        import cv2

        side = self.layers.shape[0]
        small = max(3, round(side * zoom))
        if small >= side:
            return self.layers
        resized = cv2.resize(self.layers, (small, small), interpolation=cv2.INTER_AREA)
        return np.asarray(resized, np.float32)

    def nearest(self, patch: Patch, start: Array) -> Array:
        """The best of a few places around, for a start that is off by a part of the ball."""
        step = 0.45 * self.radius_px * self.zoom
        tried = []
        for right, down, growth in _STARTS:
            values = start + np.array([right * step, down * step, growth, 0.0, 0.0, 0.0])
            drawn = self._drawn(patch, values)
            off = patch.bare if drawn is None else drawn.squared(patch)
            tried.append((float((off / (off + _LARGE**2)).sum()), values))
        return min(tried, key=lambda one: one[0])[1]

    def _drawn(self, patch: Patch, values: Array) -> DrawnBall | None:
        return draw_ball(self.layers, self.radius_px * self.zoom, patch, values)

    def fit(
        self, patch: Patch, start: Array, growth: float, at_first: float = _WIDE
    ) -> tuple[Array, float]:
        """Gauss-Newton steps in x, y, the logarithm of the size, and the light on the ball."""
        values = start.copy()
        expected = np.array([0.0, 0.0, growth, 0.0, 0.0, 0.0])
        radius = self.radius_px * self.zoom
        drawn = self._drawn(patch, values)
        if drawn is None:
            return values, np.inf
        strict = max(_LARGE, _LARGE_SHARE * drawn.contrast(patch))
        for turn in range(_MOST_STEPS):
            squared = drawn.squared(patch)
            large = strict * max(1.0, at_first * _STRICTER**turn)
            weight = patch.inside / (1 + squared / np.float32(large**2)) ** 2
            jacobian = drawn.jacobian(radius)
            weighted = (jacobian * weight[drawn.box][:, :, None]).reshape(6, -1)
            normal = (weighted @ jacobian.reshape(6, -1).T).astype(np.float64)
            towards = (weighted @ drawn.off.reshape(-1)).astype(np.float64)
            noise = max(float((weight * squared).sum() / (weight.sum() + 1e-9)), 1.0)
            normal += 3 * noise * _PRIOR
            towards -= 3 * noise * _PRIOR @ (values - expected)
            normal[0, 0] += 1e-3
            normal[1, 1] += 1e-3
            step = np.linalg.solve(normal, towards)
            step[:2] *= min(1.0, 0.4 * radius / (float(np.hypot(*step[:2])) + 1e-9))
            step[2] = min(max(step[2], -0.1), 0.1)
            values = values + step
            drawn = self._drawn(patch, values)
            if drawn is None:
                return values, np.inf
            if large == strict and np.abs(step[:2]).max() < _ENOUGH_PX:
                break
        return values, drawn.misfit(patch)
