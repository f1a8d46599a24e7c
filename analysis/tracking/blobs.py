"""What stands out of the background in one picture: candidates for the ball."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.tracking.background import Background
from tunenet_logs.arrays import Array, Picture

_MOST = 12
_LEAST_AREA_PX = 5
_LEAST_OUTLINE = 4
_MOST_LOOKED_AT = 40
_ALIKE = 0.06
"""Squared sine of the angle between two differences of colour that cannot be told apart."""

_SHADOW_SHARE = 0.3
"""As much of a dark ball's own darkness may be a shadow."""

_BIG = 0.05
"""Share of the picture that no ball takes."""


@dataclass(frozen=True, eq=False)
class Blobs:
    """The N candidates in one picture, the strongest first.

    Attributes:
        places_px: x right, y down; the first pixel's centre is 0, 0; shape (N, 2).
        areas_px: shape (N,).
        colours: mean RGB, shape (N, 3).
        whole: whether it ends inside the picture, shape (N,).
        misfits: what speaks against each being the ball, where its picture is known; shape (N,).
    """

    places_px: Array
    areas_px: Array
    colours: Array
    whole: NDArray[np.bool_]
    misfits: Array

    def __len__(self) -> int:
        return len(self.areas_px)


@dataclass(frozen=True, eq=False)
class BallColor:
    """How the ball looks.

    Attributes:
        colour: RGB, shape (3,).
        area_px: of its picture.
        inside: also searched where it does not differ from the background by its threshold.
    """

    colour: Array
    area_px: float

    @property
    def radius_px(self) -> float:
        """Of a disc of that area."""
        return float(np.sqrt(self.area_px / np.pi))


def moving_blobs(picture: Picture, background: Background, allowed: Picture | None) -> Blobs:
    """Candidates by their difference from the background alone."""
    difference = background.difference(picture)
    mask = difference > background.threshold
    if allowed is not None:
        mask &= allowed.astype(bool)
    return _components(picture, mask.astype(np.uint8), difference)


def coloured_blobs(
    picture: Picture, background: Background, look: BallColor, allowed: Picture | None
) -> Blobs:
    """Candidates by how much of each pixel is ball.

    A pixel is part background B, part ball C, part shadow: I - B = a (C - B) - b B, a, b >= 0.
    """
    difference = background.difference(picture)
    mask = difference > background.threshold // 2 + 3
    if allowed is not None:
        mask &= allowed.astype(bool)
    still = background.picture[mask].astype(np.float32)
    off = picture[mask].astype(np.float32) - still
    share = np.zeros(mask.shape, np.float32)
    share[mask] = _ball_share(off, look.colour.astype(np.float32) - still, -still)
    solid = (share > 0.25).astype(np.uint8)
    return _components(picture, solid, share)


def hsv_blobs(picture: Picture, low: Array, high: Array, allowed: Picture | None) -> Blobs:
    """Candidates by a range of hue (0 to 179, may wrap), saturation and value (0 to 255)."""
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


def _ball_share(
    off: NDArray[np.float32], towards: NDArray[np.float32], shade: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Non-negative least squares of two columns, pixel by pixel, clipped to [0, 1]."""
    aa = (towards**2).sum(axis=1) + 1.0
    bb = (shade**2).sum(axis=1) + 1.0
    ab = (towards * shade).sum(axis=1)
    ya, yb = (off * towards).sum(axis=1), (off * shade).sum(axis=1)
    apart = np.maximum(aa * bb - ab**2, 1e-3 * aa * bb)
    share = (ya * bb - yb * ab) / apart
    shadow = (yb * aa - ya * ab) / apart
    share = np.where(shadow < 0, ya / aa, share)
    # A dark ball differs from what is behind it as a shadow does, only by more.
    alike = apart < _ALIKE * aa * bb
    share = np.where(alike, (ya / aa - _SHADOW_SHARE) / (1 - _SHADOW_SHARE), share)
    share = np.where(aa < 300, 0.0, share)  # background of the ball's own colour tells nothing
    return np.clip(share, 0.0, 1.0)


def _components(picture: Picture, mask: Picture, weight: NDArray[np.float32] | Picture) -> Blobs:
    import cv2

    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    outlines, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    boxes = [(cv2.boundingRect(one), one) for one in outlines if len(one) >= _LEAST_OUTLINE]
    boxes.sort(key=lambda one: one[0][2] * one[0][3], reverse=True)
    height, width = mask.shape
    rows: list[tuple[float, ...]] = []
    for (left, top, wide, tall), outline in boxes[:_MOST_LOOKED_AT]:
        box = slice(top, top + tall), slice(left, left + wide)
        filled = np.zeros((tall, wide), np.uint8)
        cv2.drawContours(filled, [outline], 0, 1, -1, offset=(-left, -top))
        part = np.asarray(closed)[box].astype(bool) & filled.astype(bool)
        if not _LEAST_AREA_PX <= part.sum() <= _BIG * mask.size:
            continue
        mass = np.where(part, weight[box], 0).astype(np.float32)
        total = float(mass.sum())
        if total <= 0:
            continue
        x = float(mass.sum(axis=0) @ np.arange(left, left + wide)) / total
        y = float(mass.sum(axis=1) @ np.arange(top, top + tall)) / total
        core = mass > 0.6 * mass.max()
        colour = picture[box][core].mean(axis=0)
        whole = left > 0 and top > 0 and left + wide < width and top + tall < height
        soft = total / float(mass.max()) if weight.dtype == np.uint8 else total
        rows.append((total, x, y, max(soft, 1.0), *colour, float(whole)))
    rows.sort(reverse=True)
    table = np.array(rows[:_MOST], np.float64).reshape(-1, 8)
    none = np.zeros(len(table))
    return Blobs(table[:, 1:3], table[:, 3], table[:, 4:7], table[:, 7] > 0, none)
