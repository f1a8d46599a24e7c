"""The ball drawn into a patch: what would be seen, what is left, and how that changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.tracking.patches import Patch, moved
from tunenet_logs.arrays import Array

Fine = NDArray[np.float32]

_NOISE = 4.0
_MARGIN_PX = 4
"""Around the ball: its edge is soft, and grows with it."""


@dataclass(frozen=True, eq=False)
class DrawnBall:
    """The ball in a patch, in the box around it.

    Attributes:
        box: rows and columns of the patch, N of them by M.
        layers: the ball's colours times its share of each pixel, and that share, shape (N, M, 4).
        behind: the background, shape (N, M, 3).
        off: what is seen beyond what would be, shape (N, M, 3).
        x, y: from the ball's middle, in its radii, shapes (1, M, 1) and (N, 1, 1).
    """

    box: tuple[slice, slice]
    layers: Fine
    behind: Fine
    off: Fine
    x: Fine
    y: Fine

    def squared(self, patch: Patch) -> Fine:
        """Mean squared residual of each pixel of the patch."""
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
        """How far the ball stands out, rms, at least 1."""
        share = self.layers[:, :, 3:]
        stands_out = (self.layers[:, :, :3] - self.behind * share)[self._inside(patch)]
        return float(np.sqrt((stands_out**2).mean() + 1.0)) if len(stands_out) else 1.0

    def jacobian(self, radius: float) -> Fine:
        """What each value changes, shape (6, N, M, 3)."""
        rows = np.empty((6, *self.off.shape), np.float32)
        for row, axis in enumerate((1, 0)):
            slope = _slope(self.layers, axis)
            rows[row] = self.behind * slope[:, :, 3:] - slope[:, :, :3]
        colours = self.layers[:, :, :3]
        rows[2] = (self.x * rows[0] + self.y * rows[1]) * np.float32(radius)
        rows[3] = colours
        rows[4] = colours * self.x
        rows[5] = colours * self.y
        return rows

    def _inside(self, patch: Patch) -> NDArray[np.bool_]:
        return (self.layers[:, :, 3] > 0.5) & (patch.inside[self.box] > 0)


def draw_ball(layers: Fine, radius: float, patch: Patch, values: Array) -> DrawnBall | None:
    """The ball as it would be seen; None out of the patch.

    What the patch shows beyond a box around the ball does not depend on it.

    Args:
        layers: see `Appearance`.
        radius: of its outline, in pixels of the patch.
        patch: where.
        values: x, y, logarithm of its growth, and the light on it: more of it on the whole, to the
            right and downward; shape (6,).
    """
    side = patch.seen.shape[0]
    size = radius * float(np.exp(values[2]))
    half = int(np.ceil(size)) + _MARGIN_PX
    left, right, top, bottom = (
        min(max(round(float(values[axis])) + end, 0), side)
        for axis in (0, 1)
        for end in (-half, half + 1)
    )
    if left >= right or top >= bottom:
        return None
    box = slice(top, bottom), slice(left, right)
    drawn = moved(layers, values, box)
    x = ((np.arange(left, right) - values[0]) / size).astype(np.float32)[None, :, None]
    y = ((np.arange(top, bottom) - values[1]) / size).astype(np.float32)[:, None, None]
    light, sideways, downward = (np.float32(one) for one in values[3:])
    colours, share = drawn[:, :, :3], drawn[:, :, 3:]
    colours *= 1 + light + sideways * x + downward * y
    behind = patch.behind[box]
    off = (patch.seen[box] - behind * (1 - share) - colours) * patch.inside[box][:, :, None]
    return DrawnBall(box, drawn, behind, off, x, y)


def _mean_square(off: Fine) -> Fine:
    """Of the three colours."""
    return np.einsum("ijk,ijk->ij", off, off) / np.float32(3)


def _slope(layers: Fine, axis: int) -> Fine:
    """Central differences."""
    slope = np.zeros_like(layers)
    if axis == 0:
        np.subtract(layers[2:], layers[:-2], out=slope[1:-1])
    else:
        np.subtract(layers[:, 2:], layers[:, :-2], out=slope[:, 1:-1])
    slope *= np.float32(0.5)
    return slope
