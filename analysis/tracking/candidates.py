"""Ball candidates: what stands out of the background in one picture, and in all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.tracking.background import Background
from tunenet_logs.arrays import Array, Picture

_MAX = 12  # candidates kept of each picture: people and shadows make many, and many more triples
_MIN_AREA_PX = 5
_MIN_OUTLINE_PX = 4  # pixels: what has a smaller area, or a shorter outline, is noise
# Outlines of a picture whose pixels are looked at, by the size of their boxes: bounds the time.
_MAX_INSPECTED = 40

# Squared sine of the angle between two differences of colour that cannot be told apart.
_INDISTINCT = 0.06

# Of the difference between a dark ball and what is behind it: a shadow may make as much of it.
_SHADOW_FRACTION = 0.3

_BIG_FRACTION = 0.05  # of the picture's area: no ball that is filmed with its whole drop takes more
_SOLID_FRACTION = 0.25  # of a pixel that must be ball to count: less may be noise
# Squared difference of two colours (0 to 255, summed over RGB): background that is nearer to the
# ball's colour, about 10 in each channel, cannot say how much of a pixel is ball.
_OWN_COLOUR = 300.0

_CORE = 0.6  # of the largest difference: pixels above it are wholly ball, and give its colour


@dataclass(frozen=True, eq=False)
class Blobs:
    """Candidates in one picture, N of them, the strongest first.

    Attributes:
        places_px: x right, y down; the first pixel's centre is 0, 0; shape (N, 2).
        areas_px: [px²], shape (N,).
        colours: mean RGB, 0 to 255, shape (N, 3).
        whole: whether it ends inside the picture, shape (N,).
        misfits: see `Placing`; 0 where the ball's appearance is not known; shape (N,).
    """

    places_px: Array
    areas_px: Array
    colours: Array
    whole: NDArray[np.bool_]
    misfits: Array


@dataclass(frozen=True, eq=False)
class Candidates:
    """Blobs of T pictures as one table of M columns, NaN where a picture has fewer.

    Attributes:
        seconds: since the first picture, shape (T,).
        places_px: see `Blobs`; shape (T, M, 2).
        areas_px: [px²], shape (T, M).
        colours: mean RGB, shape (T, M, 3).
        whole: shape (T, M).
        misfits: shape (T, M).
    """

    seconds: Array
    places_px: Array
    areas_px: Array
    colours: Array
    whole: NDArray[np.bool_]
    misfits: Array

    @classmethod
    def of(cls, seconds: Array, blobs: Sequence[Blobs]) -> Candidates:
        """Put the blobs of T pictures, taken at `seconds` (shape (T,)), into one table."""
        most = max((len(found.areas_px) for found in blobs), default=0)
        positions = np.full((len(blobs), most, 2), np.nan)
        areas = np.full((len(blobs), most), np.nan)
        colours = np.full((len(blobs), most, 3), np.nan)
        whole = np.zeros((len(blobs), most), dtype=bool)
        misfits = np.zeros((len(blobs), most))
        for row, found in enumerate(blobs):
            count = len(found.areas_px)
            positions[row, :count] = found.places_px
            areas[row, :count] = found.areas_px
            colours[row, :count] = found.colours
            whole[row, :count] = found.whole
            misfits[row, :count] = found.misfits
        return cls(seconds, positions, areas, colours, whole, misfits)

    def inside(self) -> Candidates:
        """Remove those that the picture's edge cuts: arms and people, not balls."""
        positions = np.where(self.whole[:, :, None], self.places_px, np.nan)
        areas = np.where(self.whole, self.areas_px, np.nan)
        return replace(self, places_px=positions, areas_px=areas)

    def some(self, frames: NDArray[np.intp]) -> Candidates:
        """Return the candidates of the pictures with these numbers."""
        return Candidates(
            self.seconds[frames],
            self.places_px[frames],
            self.areas_px[frames],
            self.colours[frames],
            self.whole[frames],
            self.misfits[frames],
        )


@dataclass(frozen=True, eq=False)
class ColorAndSize:
    """Mean colour of the ball, and its size.

    Attributes:
        colour: RGB, 0 to 255, shape (3,).
        area_px: of its disc in the picture [px²].
    """

    colour: Array
    area_px: float

    @property
    def radius_px(self) -> float:
        """Radius of a disc of that area."""
        return float(np.sqrt(self.area_px / np.pi))


def moving_blobs(picture: Picture, background: Background, allowed: Picture | None) -> Blobs:
    """Find candidates by their difference from the background alone.

    `allowed` is 1 where the ball may be, shape (H, W); None for everywhere.
    """
    difference = background.difference(picture)
    mask = difference > background.threshold
    if allowed is not None:
        mask &= allowed.astype(bool)
    return _components(picture, mask.astype(np.uint8), difference)


def coloured_blobs(
    picture: Picture, background: Background, ball: ColorAndSize, allowed: Picture | None
) -> Blobs:
    """Find candidates by the fraction of each pixel that is ball; see `moving_blobs`.

    A pixel is part background B, part ball C, part shadow: I - B = a (C - B) - b B, a, b >= 0.
    """
    difference = background.difference(picture)
    mask = difference > background.threshold // 2 + 3  # the colour decides: noise may pass
    if allowed is not None:
        mask &= allowed.astype(bool)
    there = np.flatnonzero(mask)  # several times as quick as the mask itself
    still = background.picture.reshape(-1, 3)[there].astype(np.float32)
    off = picture.reshape(-1, 3)[there].astype(np.float32) - still
    fraction = np.zeros(mask.shape, np.float32)
    fraction.reshape(-1)[there] = _ball_fraction(
        off, ball.colour.astype(np.float32) - still, -still
    )
    solid = (fraction > _SOLID_FRACTION).astype(np.uint8)
    return _components(picture, solid, fraction)


def hsv_blobs(picture: Picture, low: Array, high: Array, allowed: Picture | None) -> Blobs:
    """Find candidates by a range of hue (0 to 179, may wrap), saturation and value (0 to 255)."""
    import cv2

    hsv = cv2.cvtColor(picture, cv2.COLOR_RGB2HSV)
    if low[0] <= high[0]:
        inside = cv2.inRange(hsv, low, high)
    else:  # red lies on both sides of hue 0
        inside = cv2.inRange(hsv, low, np.array([179, *high[1:]]))
        inside = cv2.bitwise_or(inside, cv2.inRange(hsv, np.array([0, *low[1:]]), high))
    mask = np.asarray(inside > 0, np.uint8)
    if allowed is not None:
        mask &= allowed
    return _components(picture, mask, mask.astype(np.float32))


def _ball_fraction(
    off: NDArray[np.float32], towards: NDArray[np.float32], shade: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Solve non-negative least squares of two columns, pixel by pixel, clipped to [0, 1]."""
    aa, bb, ab, ya, yb = (
        np.einsum("ij,ij->i", first, second)
        for first, second in (
            (towards, towards),
            (shade, shade),
            (towards, shade),
            (off, towards),
            (off, shade),
        )
    )
    aa += np.float32(1.0)
    bb += np.float32(1.0)
    determinant = np.maximum(aa * bb - ab**2, 1e-3 * aa * bb)
    fraction = (ya * bb - yb * ab) / determinant
    shadow = (yb * aa - ya * ab) / determinant
    fraction = np.where(shadow < 0, ya / aa, fraction)
    # A dark ball differs from what is behind it as a shadow does, only by more.
    indistinct = determinant < _INDISTINCT * aa * bb
    beyond_shadow = (ya / aa - _SHADOW_FRACTION) / (1 - _SHADOW_FRACTION)
    fraction = np.where(indistinct, beyond_shadow, fraction)
    fraction = np.where(aa < _OWN_COLOUR, 0.0, fraction)
    return np.clip(fraction, 0.0, 1.0)


def _components(picture: Picture, mask: Picture, weight: NDArray[np.float32] | Picture) -> Blobs:
    """Find connected components of a mask, filled, each with its centre of mass by `weight`."""
    import cv2

    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    outlines, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    boxes = [
        (cv2.boundingRect(outline), outline)
        for outline in outlines
        if len(outline) >= _MIN_OUTLINE_PX
    ]
    boxes.sort(key=lambda boxed: boxed[0][2] * boxed[0][3], reverse=True)
    height, width = mask.shape
    rows: list[tuple[float, ...]] = []
    for (left, top, wide, tall), outline in boxes[:_MAX_INSPECTED]:
        box = slice(top, top + tall), slice(left, left + wide)
        filled = np.zeros((tall, wide), np.uint8)
        cv2.drawContours(filled, [outline], 0, 1, -1, offset=(-left, -top))
        part = np.asarray(closed)[box].astype(bool) & filled.astype(bool)
        if not _MIN_AREA_PX <= part.sum() <= _BIG_FRACTION * mask.size:
            continue
        mass = np.where(part, weight[box], 0).astype(np.float32)
        total = float(mass.sum())
        if total <= 0:
            continue
        x = float(mass.sum(axis=0) @ np.arange(left, left + wide)) / total
        y = float(mass.sum(axis=1) @ np.arange(top, top + tall)) / total
        core = mass > _CORE * mass.max()
        colour = picture[box][core].mean(axis=0)
        whole = left > 0 and top > 0 and left + wide < width and top + tall < height
        # A difference in grey levels weighs a pixel by its largest; a fraction is an area as it is.
        soft = total / float(mass.max()) if weight.dtype == np.uint8 else total
        rows.append((total, x, y, max(soft, 1.0), *colour, float(whole)))
    rows.sort(reverse=True)
    table = np.array(rows[:_MAX], np.float64).reshape(-1, 8)
    none = np.zeros(len(table))
    return Blobs(table[:, 1:3], table[:, 3], table[:, 4:7], table[:, 7] > 0, none)


def picked(values: Array, chosen: NDArray[np.intp]) -> Array:
    """Return the chosen candidate's value in each picture, (T,) or (T, K); NaN for choice -1."""
    found = values[np.arange(len(chosen)), np.maximum(chosen, 0)].astype(np.float64)
    found[chosen < 0] = np.nan
    return found
