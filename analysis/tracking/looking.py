"""The ball in one picture, once it is known how it looks and about where it is."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from analysis.tracking.background import Background
from analysis.tracking.blobs import BallColor, Blobs, coloured_blobs
from analysis.tracking.placing import Appearance, Placing
from tunenet_logs.arrays import Array, Picture

_GOOD = 0.3
"""With less misfit than that, nothing better is looked for."""

_MOST_PLACED = 3
_GROWN = (0.65, 1.5)


@dataclass(frozen=True, eq=False)
class Eye:
    """Looks for the ball.

    Attributes:
        background: without it.
        look: its colour and size.
        ball: its own picture; None where that could not be learnt.
        allowed: see `Pictures.allowed`.
    """

    background: Background
    look: BallColor
    ball: Appearance | None
    allowed: Picture | None

    def find(self, picture: Picture, expected_px: Array, still_px: Array) -> Blobs:
        """Candidates: the ball where it is expected, else all that looks like it.

        Args:
            picture: to look at.
            expected_px: where it was found before its picture was known, shape (2,).
            still_px: where it may be held or lie, shape (2,); NaN where it is known to fly.
        """
        if self.ball is None:
            return coloured_blobs(picture, self.background, self.look, self.allowed)
        gain = self.background.gain(picture)
        placed: list[Placing] = []
        for x, y, grown in self._starts(picture, expected_px, still_px):
            one = self.ball.place(picture, self.background, gain, x, y, grown, placed)
            if one is None or not self._is_allowed(one) or _known(one, placed):
                continue
            placed.append(one)
            if one.misfit < _GOOD:
                break
        return self._blobs(picture, placed)

    def _starts(
        self, picture: Picture, expected_px: Array, still_px: Array
    ) -> Iterator[tuple[float, float, float]]:
        """Where it may be, the likeliest first: x, y, and how much it has grown."""
        assert self.ball is not None
        around = [(float(x), float(y)) for x, y in (expected_px, still_px) if np.isfinite(x)]
        if len(around) > 1 and math.dist(*around) < self.ball.radius_px:
            del around[1]
        for x, y in around:
            yield x, y, 1.0
        for x, y in around:
            for near in self.ball.alike(picture, x, y):
                yield *near, 1.0
        found = coloured_blobs(picture, self.background, self.look, self.allowed)
        unlike = np.linalg.norm(found.colours - self.look.colour, axis=1) / 45
        unlike += np.abs(np.log(found.areas_px / self.look.area_px))
        for at in np.argsort(unlike)[:_MOST_PLACED]:
            grown = float(np.clip(np.sqrt(found.areas_px[at] / self.look.area_px), *_GROWN))
            yield float(found.places_px[at, 0]), float(found.places_px[at, 1]), grown

    def _is_allowed(self, one: Placing) -> bool:
        if self.allowed is None:
            return True
        height, width = self.allowed.shape
        row, column = round(one.y), round(one.x)
        return 0 <= row < height and 0 <= column < width and bool(self.allowed[row, column])

    def _blobs(self, picture: Picture, placed: list[Placing]) -> Blobs:
        places = np.array([(one.x, one.y) for one in placed]).reshape(-1, 2)
        radii = np.array([one.radius_px for one in placed])
        colours = np.array([_colour(picture, one) for one in placed]).reshape(-1, 3)
        height, width = picture.shape[:2]
        far = np.array([width, height]) - 1 - radii[:, None]
        whole = np.array(np.all((places >= radii[:, None]) & (places <= far), axis=1))
        misfits = np.array([one.misfit for one in placed])
        return Blobs(places, np.pi * radii**2, colours, whole, misfits)


def _known(one: Placing, placed: list[Placing]) -> bool:
    return any(it.is_near(one.x, one.y) for it in placed)


def _colour(picture: Picture, one: Placing) -> Array:
    """Mean of the middle of the ball."""
    half = max(1, round(0.6 * one.radius_px))
    row, column = round(one.y), round(one.x)
    part = picture[max(row - half, 0) : row + half + 1, max(column - half, 0) : column + half + 1]
    return part.reshape(-1, 3).mean(axis=0) if part.size else np.zeros(3)
