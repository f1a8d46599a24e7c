"""The ball drawn into a small part of a picture, and fitted to it.

A pixel is background B and ball P in the fractions that the outline gives: (1 - a) B + a P. The
ball's picture moves, grows and takes more or less light until that is what is seen: Lucas and
Kanade's alignment by Gauss-Newton steps. A ball that looks like a part of what is behind it, its
shadow, its reflection and a hand that holds it hardly move its centre: they are residuals, and
large ones count little (Geman and McClure's weights, at first wide).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.tracking.background import Background, FloatPicture
from tunenet_logs.arrays import Array, Picture

_REACH = 1.6
"""Ball radii from a patch's middle to its edge: the ball may be off by half of one."""

_ENTIRELY = 0.99
"""Of a patch's pixel that is in the picture: the rest is rounding of its reduction."""

_NOISE = 4.0
"""Standard deviation of a pixel (0 to 255): that of compressed films, no misfit of the ball."""

_MARGIN_PX = 4
"""Around the ball: its edge is soft, and grows with it."""

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

_LARGE, _LARGE_FRACTION, _STRICTER = 30.0, 0.35, 0.65
"""Residuals that count little: above 30 (of 255) or that fraction of the ball's contrast, whichever
is more. At first only larger ones, the bound times 0.65 a step, or the edge would have no
gradient."""

_PRIOR = np.diag([0.0, 0.0, 0.25**-2, 0.2**-2, 0.2**-2, 0.2**-2])
"""Inverse variances of the values that are fitted. Standard deviations: .25 of the logarithm of the
size, .2 of the light, as a whole, to the right and downward; of x and y nothing is known."""

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

_WIDE, NARROW = 4.0, 1.6
"""Factors of that bound at first: from a start that may be far off, and from one about right."""


@dataclass(frozen=True, eq=False)
class Patch:
    """A part of a picture and of the background, N by N pixels, reduced where the ball is large.

    Attributes:
        seen, behind: colours (0 to 255), shape (N, N, 3).
        inside: 1 where it is in the picture, shape (N, N).
        bare: mean squared difference of the two, shape (N, N); 0 out of the picture.
        left, top: of its first pixel, in the picture [px].
        zoom: its pixels per pixel of the picture.
    """

    seen: FloatPicture
    behind: FloatPicture
    inside: FloatPicture
    bare: FloatPicture
    left: int
    top: int
    zoom: float

    def here(self, x: float, y: float) -> tuple[float, float]:
        """A position in the picture, in the patch's pixels."""
        z = self.zoom
        return (x - self.left + 0.5) * z - 0.5, (y - self.top + 0.5) * z - 0.5

    def there(self, x: float, y: float) -> tuple[float, float]:
        """A position in the patch, in the picture's pixels."""
        z = self.zoom
        return (x + 0.5) / z - 0.5 + self.left, (y + 0.5) / z - 0.5 + self.top


def cut_patch(
    picture: Picture,
    background: Background,
    gain: float,
    position_px: tuple[float, float],
    radius_px: float,
    zoom: float,
) -> Patch | None:
    """What is within 1.6 ball radii of a position; None out of the picture.

    Args:
        picture: RGB, shape (H, W, 3).
        background: behind it.
        gain: how much brighter that is.
        position_px: x and y.
        radius_px: of the ball.
        zoom: about the patch's pixels per pixel of the picture, at most 1.
    """
    import cv2

    half = int(np.ceil(_REACH * radius_px)) + 3
    height, width = picture.shape[:2]
    left, top = round(position_px[0]) - half, round(position_px[1]) - half
    side = 2 * half + 1
    if left + side <= 0 or top + side <= 0 or left >= width or top >= height:
        return None
    box = slice(max(top, 0), min(top + side, height)), slice(max(left, 0), min(left + side, width))
    outside = (
        box[0].start - top,
        top + side - box[0].stop,
        box[1].start - left,
        left + side - box[1].stop,
    )
    small = max(5, round(side * zoom))
    inside = np.ones((box[0].stop - box[0].start, box[1].stop - box[1].start), np.float32)
    reduced: list[FloatPicture] = []
    for part in (picture[box] * np.float32(gain), background.picture[box], inside):
        fine = part.astype(np.float32)
        if max(outside):
            fine = cv2.copyMakeBorder(fine, *outside, cv2.BORDER_CONSTANT)
        if fine.shape[0] != small:
            fine = cv2.resize(fine, (small, small), interpolation=cv2.INTER_AREA)
        reduced.append(np.asarray(fine, np.float32))
    seen, behind, shown = reduced
    known = (shown > _ENTIRELY).astype(np.float32)
    bare = np.square(seen - behind).mean(axis=2) * known
    return Patch(seen, behind, known, bare, left, top, small / side)


@dataclass(frozen=True, eq=False)
class DrawnBall:
    """The ball in a patch, in the box around it.

    Attributes:
        box: rows and columns of the patch, N of them by M.
        layers: the ball's colours times its fraction of each pixel, and that fraction, shape
            (N, M, 4).
        behind: the background, shape (N, M, 3).
        off: residual, what is seen beyond what would be, shape (N, M, 3).
        inside: pixels that are mostly ball and in the picture, shape (N, M).
        x, y: from the ball's middle, in its radii, shapes (1, M, 1) and (N, 1, 1).
    """

    box: tuple[slice, slice]
    layers: FloatPicture
    behind: FloatPicture
    off: FloatPicture
    inside: NDArray[np.bool_]
    x: FloatPicture
    y: FloatPicture

    def squared(self, patch: Patch) -> FloatPicture:
        """Mean squared residual of each pixel of the patch, shape of the patch."""
        whole = patch.bare.copy()
        whole[self.box] = np.einsum("ijk,ijk->ij", self.off, self.off) / np.float32(3)
        return whole

    def misfit(self, patch: Patch) -> float:
        """See `Placing`; infinite where nothing of the ball is in the picture."""
        if not self.inside.any():
            return np.inf
        squared = self.squared(patch)[self.box][self.inside]
        beyond_noise = max(float(squared.mean()) - _NOISE**2, 0.0)
        return float(np.sqrt(beyond_noise)) / self.contrast

    @property
    def contrast(self) -> float:
        """How far the ball stands out of the background (0 to 255), rms, at least 1."""
        fraction = self.layers[:, :, 3:]
        stands_out = (self.layers[:, :, :3] - self.behind * fraction)[self.inside]
        return float(np.sqrt((stands_out**2).mean() + 1.0)) if len(stands_out) else 1.0

    def jacobian(self, radius: float) -> FloatPicture:
        """Derivative of what would be seen by each value of `draw_ball`, shape (6, N, M, 3).

        Args:
            radius: of the ball's outline, in pixels of the patch.
        """
        slopes = np.zeros((2, *self.layers.shape), np.float32)  # central differences in x and y
        np.subtract(self.layers[:, 2:], self.layers[:, :-2], out=slopes[0, :, 1:-1])
        np.subtract(self.layers[2:], self.layers[:-2], out=slopes[1, 1:-1])
        slopes *= np.float32(0.5)
        colours = self.layers[:, :, :3]
        rows = np.empty((6, *self.off.shape), np.float32)
        rows[:2] = self.behind * slopes[..., 3:] - slopes[..., :3]
        rows[2] = (self.x * rows[0] + self.y * rows[1]) * np.float32(radius)
        rows[3] = colours
        rows[4] = colours * self.x
        rows[5] = colours * self.y
        return rows


def draw_ball(layers: FloatPicture, radius: float, patch: Patch, values: Array) -> DrawnBall | None:
    """The ball as it would be seen; None out of the patch.

    What the patch shows beyond a box around the ball does not depend on it.

    Args:
        layers: see `Appearance`.
        radius: of its outline, in pixels of the patch.
        patch: where.
        values: x, y [px of the patch], logarithm of its growth, and the light on it: more of it on
            the whole, to the right and downward; shape (6,).
    """
    import cv2

    side = patch.seen.shape[0]
    grow = float(np.exp(values[2]))
    size = radius * grow
    half = int(np.ceil(size)) + _MARGIN_PX
    left, right, top, bottom = (
        min(max(round(float(values[axis])) + end, 0), side)
        for axis in (0, 1)
        for end in (-half, half + 1)
    )
    if left >= right or top >= bottom:
        return None
    box = slice(top, bottom), slice(left, right)
    middle = grow * (layers.shape[0] - 1) / 2
    move = np.array([[grow, 0.0, values[0] - middle - left], [0.0, grow, values[1] - middle - top]])
    warped = cv2.warpAffine(layers, move, (right - left, bottom - top), flags=cv2.INTER_LINEAR)
    drawn = np.asarray(warped, np.float32)
    x = ((np.arange(left, right) - values[0]) / size).astype(np.float32)[None, :, None]
    y = ((np.arange(top, bottom) - values[1]) / size).astype(np.float32)[:, None, None]
    light, sideways, downward = (np.float32(value) for value in values[3:])
    colours, fraction = drawn[:, :, :3], drawn[:, :, 3:]
    colours *= 1 + light + sideways * x + downward * y
    behind = patch.behind[box]
    off = (patch.seen[box] - behind * (1 - fraction) - colours) * patch.inside[box][:, :, None]
    inside = (drawn[:, :, 3] > 0.5) & (patch.inside[box] > 0)
    return DrawnBall(box, drawn, behind, off, inside, x, y)


def best_start(layers: FloatPicture, radius: float, patch: Patch, start: Array) -> Array:
    """The best of a few starts around, for one that is off by a part of the ball.

    Args:
        layers: see `Appearance`.
        radius: of its outline, in pixels of the patch.
        patch: where.
        start: see `draw_ball`, shape (6,).
    """
    step = _START_STEP * radius
    tried = []
    for right, down, growth in _STARTS:
        values = start + np.array([right * step, down * step, growth, 0.0, 0.0, 0.0])
        drawn = draw_ball(layers, radius, patch, values)
        off = patch.bare if drawn is None else drawn.squared(patch)
        tried.append((float((off / (off + _LARGE**2)).sum()), values))
    return min(tried, key=lambda pair: pair[0])[1]


def fit_ball(
    layers: FloatPicture,
    radius: float,
    patch: Patch,
    start: Array,
    growth: float,
    at_first: float = _WIDE,
) -> tuple[Array, float]:
    """Runs Gauss-Newton steps in x, y, the logarithm of the size, and the light on the ball.

    Each re-estimates the noise, and weighs residuals by Geman and McClure's function.

    Args:
        layers: see `Appearance`.
        radius: of its outline, in pixels of the patch.
        patch: where.
        start: values as `draw_ball` takes them, shape (6,).
        growth: mean of the prior on the logarithm of the size.
        at_first: factor of the residuals that count little, before the first step.

    Returns:
        The values, shape (6,), and their misfit (see `Placing`).
    """
    values = start.copy()
    expected = np.array([0.0, 0.0, growth, 0.0, 0.0, 0.0])
    drawn = draw_ball(layers, radius, patch, values)
    if drawn is None:
        return values, np.inf
    strict = max(_LARGE, _LARGE_FRACTION * drawn.contrast)
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
        drawn = draw_ball(layers, radius, patch, values)
        if drawn is None:
            return values, np.inf
        if large == strict and np.abs(step[:2]).max() < _ENOUGH_PX:
            break
    return values, drawn.misfit(patch)
