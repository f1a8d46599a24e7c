"""The ball drawn into a small part of a picture: what would be seen, the residual, its Jacobian."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

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
    seen, behind, shown = (
        _reduced(part, outside, small)
        for part in (picture[box] * np.float32(gain), background.picture[box], inside)
    )
    known = (shown > _ENTIRELY).astype(np.float32)
    bare = np.square(seen - behind).mean(axis=2) * known
    return Patch(seen, behind, known, bare, left, top, small / side)


def _reduced(part: NDArray[Any], outside: tuple[int, int, int, int], side: int) -> FloatPicture:
    """A part of a picture with nothing around it, as `side` by `side` pixels."""
    import cv2

    fine = part.astype(np.float32)
    if max(outside):
        fine = cv2.copyMakeBorder(fine, *outside, cv2.BORDER_CONSTANT)
    if fine.shape[0] != side:
        fine = cv2.resize(fine, (side, side), interpolation=cv2.INTER_AREA)
    return np.asarray(fine, np.float32)


def straightened(picture: FloatPicture, values: Array, side: int) -> FloatPicture:
    """A patch with the ball in its middle and at its usual size.

    Args:
        picture: `seen` or `behind` of a patch, shape (N, N, 3).
        values: where the ball is, see `draw_ball`; shape (6,).
        side: pixels of the result, shape (side, side, 3).
    """
    import cv2

    x, y, growth = values[:3]
    grow = float(np.exp(growth))
    middle = (side - 1) / 2
    turn = np.array([[grow, 0.0, x - grow * middle], [0.0, grow, y - grow * middle]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    straight = cv2.warpAffine(
        picture, turn, (side, side), flags=flags, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(straight, np.float32)


@dataclass(frozen=True, eq=False)
class DrawnBall:
    """The ball in a patch, in the box around it.

    Attributes:
        box: rows and columns of the patch, N of them by M.
        layers: the ball's colours times its fraction of each pixel, and that fraction, shape
            (N, M, 4).
        behind: the background, shape (N, M, 3).
        off: residual, what is seen beyond what would be, shape (N, M, 3).
        x, y: from the ball's middle, in its radii, shapes (1, M, 1) and (N, 1, 1).
    """

    box: tuple[slice, slice]
    layers: FloatPicture
    behind: FloatPicture
    off: FloatPicture
    x: FloatPicture
    y: FloatPicture

    def squared(self, patch: Patch) -> FloatPicture:
        """Mean squared residual of each pixel of the patch, shape of the patch."""
        whole = patch.bare.copy()
        whole[self.box] = _mean_square(self.off)
        return whole

    def misfit(self, patch: Patch) -> float:
        """See `Placing`; infinite where nothing of the ball is in the picture."""
        inside = self._inside(patch)
        if not inside.any():
            return np.inf
        beyond_noise = max(float(_mean_square(self.off)[inside].mean()) - _NOISE**2, 0.0)
        return float(np.sqrt(beyond_noise)) / self.contrast(patch)

    def contrast(self, patch: Patch) -> float:
        """How far the ball stands out of the background (0 to 255), rms, at least 1."""
        fraction = self.layers[:, :, 3:]
        stands_out = (self.layers[:, :, :3] - self.behind * fraction)[self._inside(patch)]
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

    def _inside(self, patch: Patch) -> NDArray[np.bool_]:
        """Pixels of the box that are mostly ball and in the picture."""
        return (self.layers[:, :, 3] > 0.5) & (patch.inside[self.box] > 0)


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
    return DrawnBall(box, drawn, behind, off, x, y)


def _mean_square(off: FloatPicture) -> FloatPicture:
    """Of the three colours."""
    return np.einsum("ijk,ijk->ij", off, off) / np.float32(3)
