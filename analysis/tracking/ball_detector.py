"""Detection of the ball in one picture: where it is expected, else anywhere."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from analysis.tracking.appearance import Appearance, Placing
from analysis.tracking.background import Background
from analysis.tracking.candidates import Blobs, ColorAndSize, coloured_blobs
from analysis.tracking.following import COLOUR_OFF
from tunenet_logs.arrays import Array, Picture

_SURE = 0.3  # misfit of a `Placing` below which nothing better is looked for
_MAX_BLOBS = 3  # of the ball's colour, that a fit may start from
# Of what looks like the ball anywhere, that a fit starts from: each costs some milliseconds.
_MAX_STARTS = 5

# Least and most of such a start's radius over the ball's: a blob may be cut, or have grown together
# with something else.
_GROWN = (0.65, 1.5)

_MIDDLE = 0.6  # of the radius: half the side of a square that lies within the ball
_SURROUNDINGS = 5.0  # ball radii around a position in which to look for what is like the ball
# Radius to which a larger ball is reduced to look there; also, in reduced pixels, how far apart the
# places are that are found.
_COARSE_PX = 4.0

_LIKELIEST = 2  # places there: a shadow or a reflection may be more like the ball than the ball


@dataclass(frozen=True, eq=False)
class BallDetector:
    """Detector of a ball whose appearance and approximate position are known.

    Attributes:
        background: without it.
        ball: its colour and size.
        appearance: None where that could not be learnt.
        allowed: see `Pictures.allowed`.
    """

    background: Background
    ball: ColorAndSize
    appearance: Appearance | None
    allowed: Picture | None

    def find(self, picture: Picture, expected_px: Array, still_px: Array) -> Blobs:
        """Find candidates in a picture: the ball where it is expected, else all like it.

        Args:
            picture: RGB, shape (H, W, 3).
            expected_px: where it was found before its appearance was known, shape (2,).
            still_px: where it may be held or lie, shape (2,); NaN where it is known to fly.
        """
        if self.appearance is None:
            return coloured_blobs(picture, self.background, self.ball, self.allowed)
        placer = _Placer(picture, self.background, self.appearance, self.allowed)
        around = [(float(x), float(y)) for x, y in (expected_px, still_px) if np.isfinite(x)]
        if len(around) > 1 and math.dist(*around) < self.appearance.radius_px:
            del around[1]
        placer.fit_from([(x, y, 1.0) for x, y in around])
        if not placer.is_sure:
            like = [(*at, 1.0) for near in around for at in _alike(self.appearance, picture, *near)]
            placer.fit_from([*like, *self._coloured(picture)], _MAX_STARTS)
        return placer.blobs()

    def _coloured(self, picture: Picture) -> list[tuple[float, float, float]]:
        """Return blobs of its colour, the most alike first: x, y [px], and how much grown."""
        found = coloured_blobs(picture, self.background, self.ball, self.allowed)
        unlike = np.linalg.norm(found.colours - self.ball.colour, axis=1) / COLOUR_OFF
        unlike += np.abs(np.log(found.areas_px / self.ball.area_px))
        best = np.argsort(unlike)[:_MAX_BLOBS]
        grown = np.clip(np.sqrt(found.areas_px[best] / self.ball.area_px), *_GROWN)
        return np.column_stack([found.places_px[best], grown]).tolist()


class _Placer:
    """Fits of the ball to one picture.

    Attributes:
        placed: each place once.
    """

    def __init__(
        self,
        picture: Picture,
        background: Background,
        appearance: Appearance,
        allowed: Picture | None,
    ) -> None:
        self._picture, self._background, self._allowed = picture, background, allowed
        self._appearance = appearance
        self._gain = background.gain(picture)
        self.placed: list[Placing] = []

    @property
    def is_sure(self) -> bool:
        """Whether nothing better need be looked for."""
        return any(fit.misfit < _SURE for fit in self.placed)

    def fit_from(
        self, places: Sequence[tuple[float, float, float]], most: int | None = None
    ) -> None:
        """Fit the ball near places (x, y [px], growth), or near the `most` that are most alike."""
        begin = partial(self._appearance.start, self._picture, self._background, self._gain)
        starts = [start for place in places if (start := begin(*place)) is not None]
        if most is not None:
            starts = sorted(starts, key=self._appearance.unlikeness)[:most]
        for start in starts:
            fit = self._appearance.place(start, self.placed)
            if fit is None or not self._is_allowed(fit):
                continue
            if not any(other.is_near(fit.x, fit.y) for other in self.placed):
                self.placed.append(fit)
            if self.is_sure:
                break

    def _is_allowed(self, fit: Placing) -> bool:
        if self._allowed is None:
            return True
        height, width = self._allowed.shape
        row, column = round(fit.y), round(fit.x)
        return 0 <= row < height and 0 <= column < width and bool(self._allowed[row, column])

    def blobs(self) -> Blobs:
        """Return what was placed, as candidates."""
        height, width = self._picture.shape[:2]
        positions = np.array([(fit.x, fit.y) for fit in self.placed]).reshape(-1, 2)
        radii = np.array([fit.radius_px for fit in self.placed])
        colours = np.zeros((len(self.placed), 3))
        for at, fit in enumerate(self.placed):
            half = max(1, round(_MIDDLE * fit.radius_px))
            rows = slice(max(round(fit.y) - half, 0), round(fit.y) + half + 1)
            columns = slice(max(round(fit.x) - half, 0), round(fit.x) + half + 1)
            part = self._picture[rows, columns]
            if part.size:
                colours[at] = part.reshape(-1, 3).mean(axis=0)
        far = np.array([width, height]) - 1 - radii[:, None]
        whole = np.array(np.all((positions >= radii[:, None]) & (positions <= far), axis=1))
        misfits = np.array([fit.misfit for fit in self.placed])
        return Blobs(positions, np.pi * radii**2, colours, whole, misfits)


def _alike(ball: Appearance, picture: Picture, x: float, y: float) -> list[tuple[float, float]]:
    """Match the masked ball near a position, in a reduced picture: x and y [px], best first."""
    import cv2

    half = int(np.ceil(_SURROUNDINGS * ball.radius_px)) + 2
    left, top = max(round(x) - half, 0), max(round(y) - half, 0)
    part = picture[top : max(round(y) + half + 1, 0), left : max(round(x) + half + 1, 0)]
    coarse = min(1.0, _COARSE_PX / ball.radius_px)
    own = ball.layers
    side = max(3, round(own.shape[0] * (coarse / ball.zoom)))
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
