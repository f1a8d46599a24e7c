"""Template alignment of the ball to a small part of a picture (Lucas-Kanade).

A pixel is background B and ball P in the fractions that the outline gives: (1 - a) B + a P. The
ball's template moves, grows and takes more or less light until that is what is seen, by
Gauss-Newton steps. A ball that looks like a part of what is behind it, its shadow, its reflection
and a hand that holds it hardly move its centre: they are residuals, and large ones count little
(Geman-McClure weights, at first wide).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from analysis.tracking.background import Background, FloatPicture
from tunenet_logs.arrays import Array, Picture

_REACH = 1.6  # ball radii from a patch's middle to its edge: the ball may be off by half of one
_ENTIRELY = 0.99  # of a patch's pixel that is in the picture: the rest is rounding of its reduction
# Standard deviation of a pixel (0 to 255): that of compressed films, no misfit of the ball.
_NOISE = 4.0

_MARGIN_PX = 4  # around the ball: its edge is soft, and grows with it
_MAX_STEPS = 10
# Most Gauss-Newton steps, and one that ends them: OpenCV moves pictures by whole 32nds of a pixel.
_ENOUGH_PX = 0.03

# Of one step: in ball radii, and in the logarithm of its size. Farther off, the Jacobian is
# different.
_MAX_STEP, _MAX_GROWTH = 0.4, 0.1

# Added to the normal matrix's diagonal, so that a ball without contrast does not make it singular.
_MIN_CURVATURE = np.array([1e-3, 1e-3, 0.0, 0.0, 0.0, 0.0])

# Residuals that count little: above 30 (of 255) or that fraction of the ball's contrast, whichever
# is more. At first only larger ones, the bound times 0.65 a step, or the edge would have no
# gradient.
_LARGE, _LARGE_FRACTION, _STRICTER = 30.0, 0.35, 0.65

# Inverse variances of the values that are fitted. Standard deviations: .25 of the logarithm of the
# size, .2 of the light, as a whole, to the right and downward; of x and y nothing is known.
_PRIOR = np.array([0.0, 0.0, 0.25**-2, 0.2**-2, 0.2**-2, 0.2**-2])

_STARTS = (
    (0, 0, 0.0),
    (1, 0, 0.0),
    (-1, 0, 0.0),
    (0, 1, 0.0),
    (0, -1, 0.0),
    (0, 0, 0.2),
    (0, 0, -0.2),
)
# Starts around a given one: steps right and down, each .45 ball radii, and growth (logarithm).
_START_STEP = 0.45

# Factors of that bound at first: from a start that may be far off, and from one about right.
_WIDE, NARROW = 4.0, 1.6


@dataclass(frozen=True, eq=False)
class Patch:
    """Part of a picture and of the background, N by N pixels, reduced where the ball is large.

    Attributes:
        seen, behind: colours (0 to 255), a plane for each, shape (3, N, N).
        apart: what is seen less what is behind, 0 out of the picture, shape (3, N, N).
        inside: 1 where it is in the picture, shape (N, N).
        bare: mean square of `apart` over the colours, shape (N, N).
        left, top: of its first pixel, in the picture [px].
        zoom: its pixels per pixel of the picture.
    """

    seen: FloatPicture
    behind: FloatPicture
    apart: FloatPicture
    inside: FloatPicture
    bare: FloatPicture
    left: int
    top: int
    zoom: float

    @cached_property
    def is_cut(self) -> bool:
        """Whether a part of the patch is out of the picture."""
        return not self.inside.all()

    def here(self, x: float, y: float) -> tuple[float, float]:
        """Convert a position in the picture to the patch's pixels."""
        z = self.zoom
        return (x - self.left + 0.5) * z - 0.5, (y - self.top + 0.5) * z - 0.5

    def there(self, x: float, y: float) -> tuple[float, float]:
        """Convert a position in the patch to the picture's pixels."""
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
    """Cut what is within 1.6 ball radii of a position; None out of the picture.

    `gain` is how much brighter the background is, `zoom` about patch pixels per pixel, at most 1.
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
    for part in (picture[box], background.picture[box], inside):
        fine = part.astype(np.float32)
        if max(outside):
            fine = cv2.copyMakeBorder(fine, *outside, cv2.BORDER_CONSTANT)
        if fine.shape[0] != small:
            fine = cv2.resize(fine, (small, small), interpolation=cv2.INTER_AREA)
        reduced.append(np.asarray(fine, np.float32))
    seen, behind = (np.ascontiguousarray(one.transpose(2, 0, 1)) for one in reduced[:2])
    seen *= np.float32(gain)
    known = (reduced[2] > _ENTIRELY).astype(np.float32)
    apart = (seen - behind) * known
    return Patch(seen, behind, apart, known, _mean_square(apart), left, top, small / side)


def _mean_square(planes: FloatPicture) -> FloatPicture:
    """Average the squares over the three colours, shape (N, M) of (3, N, M)."""
    return np.einsum("kij,kij->ij", planes, planes) * np.float32(1 / 3)


@dataclass(frozen=True, eq=False)
class DrawnBall:
    """Ball rendered in a patch, in the box around it.

    Attributes:
        box: rows and columns of the patch, N of them by M.
        layers: planes of the ball's colours times its fraction of each pixel, and of that fraction,
            shape (4, N, M).
        behind: the background, shape (3, N, M).
        off: residual, what is seen beyond what would be, shape (3, N, M).
        x, y: from the ball's middle, in its radii, shapes (1, M) and (N, 1).
    """

    box: tuple[slice, slice]
    layers: FloatPicture
    behind: FloatPicture
    off: FloatPicture
    x: FloatPicture
    y: FloatPicture

    def squared(self, patch: Patch) -> FloatPicture:
        """Return the mean squared residual of each pixel of the patch, shape of the patch."""
        whole = patch.bare.copy()
        whole[self.box] = _mean_square(self.off)
        return whole

    def inside(self, patch: Patch) -> NDArray[np.bool_]:
        """Return which pixels are mostly ball and in the picture, shape (N, M)."""
        return (self.layers[3] > 0.5) & (patch.inside[self.box] > 0)

    def misfit(self, patch: Patch) -> float:
        """Return the misfit, see `Placing`; infinite where no ball is in the picture."""
        inside = self.inside(patch)
        if not inside.any():
            return np.inf
        beyond_noise = max(float(_mean_square(self.off)[inside].mean()) - _NOISE**2, 0.0)
        return math.sqrt(beyond_noise) / self.contrast(inside)

    def contrast(self, inside: NDArray[np.bool_]) -> float:
        """Return how far the ball stands out of the background (0 to 255), rms, at least 1."""
        stands_out = (self.layers[:3] - self.behind * self.layers[3])[:, inside]
        return math.sqrt(float(np.square(stands_out).mean()) + 1.0) if stands_out.size else 1.0

    def jacobian(self, radius: float) -> FloatPicture:
        """Differentiate by the values of `draw_ball`, (6, 3, N, M); `radius` in patch px."""
        layers, colours = self.layers, self.layers[:3]
        slopes = np.zeros((2, *layers.shape), np.float32)  # central differences, doubled
        np.subtract(layers[:, :, 2:], layers[:, :, :-2], out=slopes[0, :, :, 1:-1])
        np.subtract(layers[:, 2:], layers[:, :-2], out=slopes[1, :, 1:-1])
        rows = np.empty((6, *self.off.shape), np.float32)
        np.multiply(self.behind, slopes[:, 3:], out=rows[:2])
        rows[:2] -= slopes[:, :3]
        rows[:2] *= np.float32(0.5)
        np.multiply(rows[0], self.x * np.float32(radius), out=rows[2])
        rows[2] += rows[1] * (self.y * np.float32(radius))
        rows[3] = colours
        np.multiply(colours, self.x, out=rows[4])
        np.multiply(colours, self.y, out=rows[5])
        return rows


def draw_ball(layers: FloatPicture, radius: float, patch: Patch, values: Array) -> DrawnBall | None:
    """Render the ball as it would be seen; None out of the patch.

    What the patch shows beyond a box around the ball does not depend on it.

    Args:
        layers: see `Appearance`.
        radius: of its outline, in pixels of the patch.
        patch: where.
        values: x, y [px of the patch], logarithm of its growth, and the light on it: more of it on
            the whole, to the right and downward; shape (6,).
    """
    import cv2

    x_px, y_px, growth, light, sideways, downward = values.tolist()
    side = patch.bare.shape[0]
    grow = math.exp(growth)
    size = radius * grow
    half = math.ceil(size) + _MARGIN_PX
    left, right = max(round(x_px) - half, 0), min(round(x_px) + half + 1, side)
    top, bottom = max(round(y_px) - half, 0), min(round(y_px) + half + 1, side)
    if left >= right or top >= bottom:
        return None
    box = slice(top, bottom), slice(left, right)
    middle = grow * (layers.shape[0] - 1) / 2
    move = np.array([[grow, 0.0, x_px - middle - left], [0.0, grow, y_px - middle - top]])
    warped = cv2.warpAffine(layers, move, (right - left, bottom - top), flags=cv2.INTER_LINEAR)
    drawn = np.ascontiguousarray(np.asarray(warped, np.float32).transpose(2, 0, 1))
    x = np.arange(left - x_px, right - x_px - 0.5, dtype=np.float32)[None] / np.float32(size)
    y = np.arange(top - y_px, bottom - y_px - 0.5, dtype=np.float32)[:, None] / np.float32(size)
    drawn[:3] *= np.float32(1 + light) + np.float32(sideways) * x + np.float32(downward) * y
    behind = patch.behind[:, box[0], box[1]]
    off = behind * drawn[3]
    off -= drawn[:3]
    off += patch.apart[:, box[0], box[1]]
    if patch.is_cut:
        off *= patch.inside[box]
    return DrawnBall(box, drawn, behind, off, x, y)


def unlike(layers: FloatPicture, radius: float, patch: Patch, values: Array) -> float:
    """Return how much of what is seen a drawn ball leaves, each residual counting 1 at most."""
    drawn = draw_ball(layers, radius, patch, values)
    off = patch.bare if drawn is None else drawn.squared(patch)
    return float((off / (off + _LARGE**2)).sum())


def best_start(layers: FloatPicture, radius: float, patch: Patch, start: Array) -> Array:
    """Return the best by `unlike` of a few starts around one that is off by a part of the ball."""
    step = _START_STEP * radius
    tried = [
        start + np.array([right * step, down * step, growth, 0.0, 0.0, 0.0])
        for right, down, growth in _STARTS
    ]
    return min(tried, key=lambda values: unlike(layers, radius, patch, values))


def fit_ball(
    layers: FloatPicture,
    radius: float,
    patch: Patch,
    start: Array,
    growth: float,
    at_first: float = _WIDE,
) -> tuple[Array, float]:
    """Fit position, log size and light on the ball by reweighted Gauss-Newton steps.

    Each step re-estimates the noise, and weighs residuals by Geman and McClure's function. The
    arguments are those of `draw_ball`; `growth` is the prior mean of the log size, `at_first` a
    factor on the residuals that count little, before the first step.

    Returns:
        The values, shape (6,), and their misfit (see `Placing`).
    """
    import cv2

    values = start.copy()
    expected = np.array([0.0, 0.0, growth, 0.0, 0.0, 0.0])
    drawn = draw_ball(layers, radius, patch, values)
    if drawn is None:
        return values, np.inf
    strict = max(_LARGE, _LARGE_FRACTION * drawn.contrast(drawn.inside(patch)))
    for turn in range(_MAX_STEPS):
        squared = drawn.squared(patch)
        large = strict * max(1.0, at_first * _STRICTER**turn)
        weight = patch.inside / np.square(1 + squared * np.float32(large**-2))
        noise = max(float(np.vdot(weight, squared)) / (float(weight.sum()) + 1e-9), 1.0)
        jacobian = drawn.jacobian(radius)
        weighted = (jacobian * weight[drawn.box]).reshape(6, -1)
        normal = (weighted @ jacobian.reshape(6, -1).T).astype(np.float64)
        towards = (weighted @ drawn.off.reshape(-1)).astype(np.float64)
        prior = 3 * noise * _PRIOR  # a pixel's three colours err alike: as one
        normal.flat[::7] += prior + _MIN_CURVATURE  # its diagonal
        towards -= prior * (values - expected)
        step = cv2.solve(normal, towards[:, None], flags=cv2.DECOMP_CHOLESKY)[1][:, 0]
        moved = math.hypot(step[0], step[1])
        step[:2] *= min(1.0, _MAX_STEP * radius / (moved + 1e-9))
        step[2] = min(max(step[2], -_MAX_GROWTH), _MAX_GROWTH)
        values = values + step
        drawn = draw_ball(layers, radius, patch, values)
        if drawn is None:
            return values, np.inf
        if large == strict and max(abs(step[0]), abs(step[1])) < _ENOUGH_PX:
            break
    return values, drawn.misfit(patch)
