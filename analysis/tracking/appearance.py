"""Where the ball is to a small part of a pixel: its own picture over the background, fitted.

A pixel is background B and ball P in the fractions that the outline gives: (1 - a) B + a P. The
ball's picture moves, grows and takes more or less light until that is what is seen: Lucas and
Kanade's alignment by Gauss-Newton steps. A ball that looks like a part of what is behind it, its
shadow, its reflection and a hand that holds it hardly move its centre: they are residuals, and
large ones count little (Geman and McClure's weights, at first wide).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.tracking.background import Background, FloatPicture
from analysis.tracking.drawn_ball import DrawnBall, Patch, cut_patch, draw_ball
from tunenet_logs.arrays import Array, Picture

FINE_PX = 9.0
"""A larger ball is reduced to that radius before it is fitted."""

_MOST_STEPS = 10
_ENOUGH_PX = 0.03
"""Most Gauss-Newton steps, and one that ends them: OpenCV moves pictures by whole 32nds of a
pixel."""

_LONGEST_STEP, _MOST_GROWTH = 0.4, 0.1
"""Of one step: in ball radii, and in the logarithm of its size. Farther off, the Jacobian is
different."""

_LEAST_CURVATURE = 1e-3
"""Added to the normal matrix for x and y, so that a ball without contrast does not make it
singular."""

_NEAR_START = 0.25
"""Ball radii: a fit that moved farther is run once more from where it ended, at first wide."""

_NEAR = 0.3
"""Ball radii between two fits of the same ball."""

_FAR_WORSE = 1.5
"""Misfit over that of another fit: one that is as much worse is not looked into."""

_MOST_MOVED, _MOST_MOVED_PX = 1.2, 2.0
"""Ball radii, and px more, from a start to its fit: what is farther off has another start."""

_LARGE, _LARGE_FRACTION, _STRICTER = 30.0, 0.35, 0.65
"""Residuals that count little: above 30 (of 255) or that fraction of the ball's contrast, whichever
is more. At first only larger ones, the bound times 0.65 a step, or the edge would have no
gradient."""

_WIDE, _NARROW = 4.0, 1.6
"""Factors of that bound at first: from a start that may be far off, and from one about right."""

_SURE = 0.12
"""Misfit up to which the start was about right."""

_PRIOR = np.diag([0.0, 0.0, 0.25**-2, 0.2**-2, 0.2**-2, 0.2**-2])
"""Inverse variances of the values that are fitted. Standard deviations: .25 of the logarithm of the
size, .2 of the light, as a whole, to the right and downward; of x and y nothing is known."""

_SURROUNDINGS = 5.0
"""Ball radii around a position in which to look for what is like the ball."""

_COARSE_PX = 4.0
"""Radius to which a larger ball is reduced to look there; also, in reduced pixels, how far
apart the places are that are found."""

_LIKELIEST = 2
"""Places there: a shadow or a reflection may be more like the ball than the ball."""

_STARTS = (
    (0, 0, 0.0),
    (1, 0, 0.0),
    (-1, 0, 0.0),
    (0, 1, 0.0),
    (0, -1, 0.0),
    (0, 0, 0.2),
    (0, 0, -0.2),
)
_START_STEP = 0.45
"""Starts around a given one: steps right and down, each .45 ball radii, and growth (logarithm)."""


@dataclass(frozen=True)
class Placing:
    """A fit of the ball's appearance to one picture.

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
        """Whether a position [px] is about this one."""
        return math.hypot(x - self.x, y - self.y) < _NEAR * self.radius_px


@dataclass(frozen=True, eq=False)
class Appearance:
    """The ball's own picture.

    Attributes:
        layers: its colours (0 to 255) times its fraction of each pixel, and that fraction, shape
            (N, N, 4).
        radius_px: of its outline, in the pictures.
        zoom: its pixels per pixel of the pictures.
    """

    layers: FloatPicture
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
        """The ball near a position; None where there is none in view, or none that is not known.

        Args:
            picture: RGB, shape (H, W, 3).
            background: behind it.
            gain: how much brighter the background is than the picture.
            x: near its centre [px].
            y: likewise.
            grown: about its radius over `radius_px`.
            known: found from other starts; what comes to one of them, or is far worse, is dropped.
        """
        patch = cut_patch(picture, background, gain, (x, y), self.radius_px * grown, self.zoom)
        if patch is None:
            return None
        start = np.array([*patch.here(x, y), np.log(grown), 0.0, 0.0, 0.0])
        values, misfit = self.fit(patch, start, np.log(grown), _NARROW)
        if misfit > _SURE:
            here = patch.there(values[0], values[1])
            if any(misfit > _FAR_WORSE * fit.misfit or fit.is_near(*here) for fit in known):
                return None
            start = self.nearest(patch, start)
            values, misfit = self.fit(patch, start, np.log(grown))
        if np.hypot(*(values - start)[:2]) > _NEAR_START * self.radius_px * self.zoom:
            values, misfit = self.fit(patch, values, np.log(grown))  # it was a long way
        px, py = patch.there(values[0], values[1])
        if np.hypot(px - x, py - y) > _MOST_MOVED * self.radius_px * grown + _MOST_MOVED_PX:
            return None
        return Placing(px, py, self.radius_px * float(np.exp(values[2])), misfit)

    def alike(self, picture: Picture, x: float, y: float) -> list[tuple[float, float]]:
        """Where near a position the picture is most like the ball, the best first: x and y [px].

        By template matching of the masked ball, squared differences, in a reduced picture.
        """
        import cv2

        half = int(np.ceil(_SURROUNDINGS * self.radius_px)) + 2
        left, top = max(round(x) - half, 0), max(round(y) - half, 0)
        part = picture[top : max(round(y) + half + 1, 0), left : max(round(x) + half + 1, 0)]
        coarse = min(1.0, _COARSE_PX / self.radius_px)
        own = self.layers
        side = max(3, round(own.shape[0] * (coarse / self.zoom)))
        if side < own.shape[0]:
            reduced = cv2.resize(own, (side, side), interpolation=cv2.INTER_AREA)
            own = np.asarray(reduced, np.float32)
        size = (round(part.shape[1] * coarse), round(part.shape[0] * coarse))
        if min(size) <= own.shape[0]:
            return []
        small = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), np.float32)
        fraction = np.repeat(own[:, :, 3:], 3, axis=2)
        colours = own[:, :, :3] / np.maximum(fraction, 1e-3)
        off = np.array(cv2.matchTemplate(small, colours, cv2.TM_SQDIFF, mask=fraction))
        found = []
        middle = (own.shape[0] - 1) / 2
        near = int(_COARSE_PX)
        for _ in range(_LIKELIEST):
            row, column = np.unravel_index(int(off.argmin()), off.shape)
            x_px = (column + middle + 0.5) / coarse - 0.5 + left
            y_px = (row + middle + 0.5) / coarse - 0.5 + top
            found.append((x_px, y_px))
            rows = slice(max(row - near, 0), row + near + 1)
            off[rows, max(column - near, 0) : column + near + 1] = np.inf
        return found

    def nearest(self, patch: Patch, start: Array) -> Array:
        """The best of a few starts around, for one that is off by a part of the ball.

        Args:
            patch: where.
            start: see `draw_ball`, shape (6,).
        """
        step = _START_STEP * self.radius_px * self.zoom
        tried = []
        for right, down, growth in _STARTS:
            values = start + np.array([right * step, down * step, growth, 0.0, 0.0, 0.0])
            drawn = self._drawn(patch, values)
            off = patch.bare if drawn is None else drawn.squared(patch)
            tried.append((float((off / (off + _LARGE**2)).sum()), values))
        return min(tried, key=lambda pair: pair[0])[1]

    def _drawn(self, patch: Patch, values: Array) -> DrawnBall | None:
        return draw_ball(self.layers, self.radius_px * self.zoom, patch, values)

    def fit(
        self, patch: Patch, start: Array, growth: float, at_first: float = _WIDE
    ) -> tuple[Array, float]:
        """Runs Gauss-Newton steps in x, y, the logarithm of the size, and the light on the ball.

        Each re-estimates the noise, and weighs residuals by Geman and McClure's function.

        Args:
            patch: where.
            start: values as `draw_ball` takes them, shape (6,).
            growth: mean of the prior on the logarithm of the size.
            at_first: factor of the residuals that count little, before the first step.

        Returns:
            The values, shape (6,), and their misfit (see `Placing`).
        """
        values = start.copy()
        expected = np.array([0.0, 0.0, growth, 0.0, 0.0, 0.0])
        radius = self.radius_px * self.zoom
        drawn = self._drawn(patch, values)
        if drawn is None:
            return values, np.inf
        strict = max(_LARGE, _LARGE_FRACTION * drawn.contrast(patch))
        for turn in range(_MOST_STEPS):
            squared = drawn.squared(patch)
            large = strict * max(1.0, at_first * _STRICTER**turn)
            weight = patch.inside / (1 + squared / np.float32(large**2)) ** 2
            jacobian = drawn.jacobian(radius)
            weighted = (jacobian * weight[drawn.box][:, :, None]).reshape(6, -1)
            normal = (weighted @ jacobian.reshape(6, -1).T).astype(np.float64)
            towards = (weighted @ drawn.off.reshape(-1)).astype(np.float64)
            noise = max(float((weight * squared).sum() / (weight.sum() + 1e-9)), 1.0)
            normal += 3 * noise * _PRIOR  # a pixel's three colours err alike: as one
            towards -= 3 * noise * _PRIOR @ (values - expected)
            normal[0, 0] += _LEAST_CURVATURE
            normal[1, 1] += _LEAST_CURVATURE
            step = np.linalg.solve(normal, towards)
            step[:2] *= min(1.0, _LONGEST_STEP * radius / (float(np.hypot(*step[:2])) + 1e-9))
            step[2] = min(max(step[2], -_MOST_GROWTH), _MOST_GROWTH)
            values = values + step
            drawn = self._drawn(patch, values)
            if drawn is None:
                return values, np.inf
            if large == strict and np.abs(step[:2]).max() < _ENOUGH_PX:
                break
        return values, drawn.misfit(patch)
