"""What a fixed camera shows where nothing moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
Array = NDArray[np.float32]

_LEAST_DIFFERENCE = 14
_NOISE_FACTOR = 5.0
_GRID = 7


@dataclass(frozen=True, eq=False)
class Background:
    """The still picture, and how far a pixel must be from it to count as something else.

    Attributes:
        picture: uint8, shape (H, W, 3).
        threshold: uint8, shape (H, W): noise, flicker and the shaking of a hand-held camera.
    """

    picture: Picture
    threshold: Picture

    def difference(self, picture: Picture) -> Picture:
        """Largest difference of the three colours, the light's changes taken out, shape (H, W)."""
        import cv2

        same = cv2.convertScaleAbs(picture, alpha=self._gain(picture))
        return _strongest(np.asarray(cv2.absdiff(same, self.picture), np.uint8))

    def _gain(self, picture: Picture) -> float:
        """How much brighter the still picture is, by most of its pixels."""
        mine = self.picture[::_GRID, ::_GRID].astype(np.float32)
        theirs = picture[::_GRID, ::_GRID].astype(np.float32)
        lit = (theirs > 20) & (theirs < 235) & (mine > 20) & (mine < 235)
        return float(np.median(mine[lit] / theirs[lit])) if lit.sum() > 100 else 1.0


def still_background(samples: Sequence[Picture]) -> Background:
    """The median of pictures from all over the recording.

    Args:
        samples: uint8, shape (H, W, 3) each.
    """
    picture, spread = _median_and_spread(samples)
    return Background(picture, _threshold(spread))


def _median_and_spread(samples: Sequence[Picture]) -> tuple[Picture, Array]:
    stack = np.stack(samples)
    median = np.median(stack, axis=0).astype(np.uint8)
    spread = np.empty(median.shape[:2], np.float32)
    for row in range(len(median)):  # the whole stack at once would take much memory
        off = np.abs(stack[:, row].astype(np.int16) - median[row].astype(np.int16))
        spread[row] = np.median(
            np.maximum(np.maximum(off[..., 0], off[..., 1]), off[..., 2]), axis=0
        )
    return median, spread


def without_ball(
    samples: Sequence[Picture], places_px: NDArray[np.float64], radius_px: float
) -> Background:
    """The background with the ball left out of each sample: it may rest in one place for long.

    Args:
        samples: uint8, shape (H, W, 3) each.
        places_px: where the ball is in each, shape (N, 2).
        radius_px: of what to leave out.
    """
    picture, spread = _median_and_spread(samples)
    rows, columns = np.mgrid[: picture.shape[0], : picture.shape[1]]
    hidden = np.zeros((len(samples), *picture.shape[:2]), dtype=bool)
    for at, (x, y) in enumerate(places_px):
        if np.isfinite(x):
            hidden[at] = (columns - x) ** 2 + (rows - y) ** 2 < radius_px**2
    touched = hidden.any(axis=0) & ~hidden.all(axis=0)
    if touched.any():
        values = np.stack([sample[touched] for sample in samples]).astype(np.float32)
        values[hidden[:, touched]] = np.nan
        middle = np.nanmedian(values, axis=0)
        picture[touched] = middle.astype(np.uint8)
        spread[touched] = np.nanmedian(np.abs(values - middle).max(axis=2), axis=0)
    return Background(picture, _threshold(spread))


def _strongest(colours: Picture) -> Picture:
    """The largest of the three channels, shape (H, W); NumPy takes ten times as long for it."""
    import cv2

    red, green, blue = cv2.split(colours)
    return np.asarray(cv2.max(cv2.max(red, green), blue), np.uint8)


def _threshold(spread: Array) -> Picture:
    import cv2

    widened = np.asarray(cv2.dilate(spread, np.ones((3, 3), np.uint8)))
    wanted = np.maximum(_NOISE_FACTOR * 1.4826 * widened, _LEAST_DIFFERENCE)
    return np.minimum(wanted, 255).astype(np.uint8)
