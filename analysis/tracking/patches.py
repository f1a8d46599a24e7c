"""Small parts of pictures around the ball, reduced where the ball is large."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.tracking.background import Background
from tunenet_logs.arrays import Array, Picture

Fine = NDArray[np.float32]

_REACH = 1.6


@dataclass(frozen=True, eq=False)
class Patch:
    """A part of a picture and of the background, reduced.

    Attributes:
        seen, behind: shape (N, N, 3).
        inside: 1 where it is in the picture, shape (N, N).
        bare: mean squared difference of the two, shape (N, N); 0 out of the picture.
        left, top: of its first pixel, in the picture.
        zoom: its pixels for one of the picture.
    """

    seen: Fine
    behind: Fine
    inside: Fine
    bare: Fine
    left: int
    top: int
    zoom: float

    def here(self, x: float, y: float) -> tuple[float, float]:
        """A place of the picture in the patch."""
        z = self.zoom
        return (x - self.left + 0.5) * z - 0.5, (y - self.top + 0.5) * z - 0.5

    def there(self, x: float, y: float) -> tuple[float, float]:
        """A place of the patch in the picture."""
        z = self.zoom
        return (x + 0.5) / z - 0.5 + self.left, (y + 0.5) / z - 0.5 + self.top


def cut_patch(
    picture: Picture,
    background: Background,
    gain: float,
    place: tuple[float, float],
    radius_px: float,
    zoom: float,
) -> Patch | None:
    """What is within 1.6 radii of a place; None out of the picture.

    Args:
        picture: whole.
        background: behind it.
        gain: how much brighter that is.
        place: x and y [px].
        radius_px: of the ball.
        zoom: at most so many pixels for one of the picture.
    """
    half = int(np.ceil(_REACH * radius_px)) + 3
    height, width = picture.shape[:2]
    left, top = round(place[0]) - half, round(place[1]) - half
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
    known = (shown > 0.99).astype(np.float32)
    bare = np.square(seen - behind).mean(axis=2) * known
    return Patch(seen, behind, known, bare, left, top, small / side)


def _reduced(part: NDArray[Any], outside: tuple[int, int, int, int], side: int) -> Fine:
    """A part of a picture with nothing around it, as `side` by `side` pixels."""
    import cv2

    fine = part.astype(np.float32)
    if max(outside):
        fine = cv2.copyMakeBorder(fine, *outside, cv2.BORDER_CONSTANT)
    if fine.shape[0] != side:
        fine = cv2.resize(fine, (side, side), interpolation=cv2.INTER_AREA)
    return np.asarray(fine, np.float32)


def moved(layers: Fine, values: Array, box: tuple[slice, slice]) -> Fine:
    """The ball's layers with its middle at x, y, grown, in the rows and columns of a patch."""
    import cv2

    x, y, growth = values[:3]
    grow = float(np.exp(growth))
    middle = grow * (layers.shape[0] - 1) / 2
    rows, columns = box
    turn = np.array([[grow, 0.0, x - middle - columns.start], [0.0, grow, y - middle - rows.start]])
    size = (columns.stop - columns.start, rows.stop - rows.start)
    return np.asarray(cv2.warpAffine(layers, turn, size, flags=cv2.INTER_LINEAR), np.float32)


def straightened(picture: Fine, values: Array, side: int) -> Fine:
    """A patch with the ball in its middle and at its usual size."""
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
