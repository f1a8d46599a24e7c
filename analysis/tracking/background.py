"""Background of a fixed camera: what it shows where nothing moves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.arrays import Array, Picture

# Pixels that have been computed with: (height, width, 3), or (height, width).
FloatPicture = NDArray[np.float32]

# Of 255: compression changes a still pixel by less, however quiet its samples are.
_MIN_DIFFERENCE = 14

_NOISE_FACTOR = 5.0  # standard deviations: of a million pixels, one differs by so much by noise
# Standard deviation of a normal distribution over its median absolute deviation.
_SD_OF_MAD = 1.4826

# About so many pixels, on a grid, say how bright a picture is to a fraction of a level.
_LIT_PX = 1500

# Of 255: outside, a pixel is clipped or mostly noise, and does not follow the light.
_DARK, _BRIGHT = 20, 235

# Pixels between the two that make a median; with fewer, the light is taken for constant.
_MIN_LIT = 100

_BLOCK = (3, 3)  # pixels that make one of a smooth picture
_SAME_LIGHT = 0.5  # of 255: light that changes the brightest pixel by less has not changed
_STRIP_ROWS = 32  # of all samples at once: the whole stack would take much memory
_SMOOTHER = 2.0  # by about as much is noise less in a smooth picture


@dataclass(frozen=True, eq=False)
class Background:
    """Still picture, and how far a pixel must be from it to count as something else.

    Attributes:
        picture: uint8, shape (H, W, 3).
        smooth: the same, each pixel the mean of three by three.
        threshold: uint8, shape (H, W): noise, flicker and the shaking of a hand-held camera, of
            smooth pictures.
        later: how the second half of the recording looks, smooth, where `smooth` is of the first
            half; None where one picture is good for all.
    """

    picture: Picture
    smooth: Picture
    threshold: Picture
    later: Picture | None = None

    def difference(self, picture: Picture) -> Picture:
        """Compute the largest difference of the three smooth colours, the light's changes undone.

        Returns:
            Shape (H, W); it is the same array, overwritten, for the next picture.
        """
        import cv2

        work = self._scratch
        cv2.blur(picture, _BLOCK, dst=work.smooth)
        gain = self.gain(picture)
        if abs(gain - 1) * 255 > _SAME_LIGHT:
            cv2.convertScaleAbs(work.smooth, dst=work.smooth, alpha=gain)
        if self.later is None:
            return work.largest_difference(self.smooth)
        first = work.largest_difference(self.smooth).copy()
        return np.asarray(cv2.min(first, work.largest_difference(self.later)), np.uint8)

    @cached_property
    def _scratch(self) -> _Scratch:
        return _Scratch.of(self.smooth)

    def gain(self, picture: Picture) -> float:
        """Return how much brighter the still picture is, by the median of its pixels."""
        height, width = picture.shape[:2]
        every = max(1, math.isqrt(height * width // _LIT_PX))
        mine = self.picture[::every, ::every].astype(np.float32)
        theirs = picture[::every, ::every].astype(np.float32)
        lit = (theirs > _DARK) & (theirs < _BRIGHT) & (mine > _DARK) & (mine < _BRIGHT)
        return float(np.median(mine[lit] / theirs[lit])) if lit.sum() > _MIN_LIT else 1.0


@dataclass(frozen=True, eq=False)
class _Scratch:
    """Arrays that are written to again and again: new ones take longer to get than to fill.

    Attributes:
        smooth: the picture, shape (H, W, 3).
        apart: its difference, likewise.
        planes: of that difference, three of shape (H, W).
    """

    smooth: Picture
    apart: Picture
    planes: tuple[Picture, ...]

    @classmethod
    def of(cls, picture: Picture) -> _Scratch:
        """Allocate arrays for pictures of this one's shape."""
        planes = tuple(np.empty(picture.shape[:2], np.uint8) for _ in range(3))
        return cls(np.empty_like(picture), np.empty_like(picture), planes)

    def largest_difference(self, still: Picture) -> Picture:
        """Return the largest difference of the three colours; NumPy takes ten times as long."""
        import cv2

        cv2.absdiff(self.smooth, still, dst=self.apart)
        cv2.split(self.apart, self.planes)
        red, green, blue = self.planes
        cv2.max(red, green, dst=green)
        return np.asarray(cv2.max(green, blue, dst=blue), np.uint8)


def still_background(
    samples: Sequence[Picture], maybe_px: Sequence[Array] = (), radius_px: float = 0.0
) -> Background:
    """Take the median of pictures from all over the recording, and thresholds from their spread.

    Of each pixel the spread is the median absolute deviation of its smooth colours, the largest of
    three by three pixels: the camera may shake.

    Args:
        samples: uint8, shape (H, W, 3) each.
        maybe_px: where the ball may be in each sample, shape (K, 2), NaN for nowhere: it is left
            out there, for it may rest in one place for long. Empty to leave out nothing.
        radius_px: of what is left out.
    """
    import cv2

    median = np.empty(samples[0].shape, np.uint8)
    spread = np.empty(median.shape[:2], np.float32)
    work: _Scratch | None = None
    for top in range(0, len(median), _STRIP_ROWS):
        strip = slice(top, top + _STRIP_ROWS)
        values = [sample[strip] for sample in samples]
        median[strip] = middle = middle_of(values)
        still = _smooth(middle)
        if work is None or work.smooth.shape != middle.shape:
            work = _Scratch.of(middle)
        apart: list[Picture] = []
        for part in values:
            cv2.blur(part, _BLOCK, dst=work.smooth)
            apart.append(work.largest_difference(still).copy())
        spread[strip] = middle_of(apart)
    if any(np.isfinite(where[:, 0]).any() for where in maybe_px):
        _leave_out(median, spread, samples, maybe_px, radius_px)
    widened = np.asarray(cv2.dilate(spread, np.ones((3, 3), np.uint8)))
    wanted = np.maximum(_NOISE_FACTOR * _SD_OF_MAD * widened, _MIN_DIFFERENCE)
    threshold = np.minimum(wanted, 255).astype(np.uint8)
    return Background(median, _smooth(median), threshold)


def halved_background(samples: Sequence[Picture]) -> Background:
    """Compute the same with the medians of the recording's two halves in place of one for all.

    A hand that holds the ball is still for most of the first half, a ball that lies for most of the
    second. What stands out of both halves moves; out of one alone, it may be the place that a hand
    has left, or one where the ball will lie. But a ball that lingers in one place, too, is lost
    there: so this is for where one picture shows nothing that flies.
    """
    whole = still_background(samples)
    middle = len(samples) // 2
    first, second = (_smooth(middle_of(half)) for half in (samples[:middle], samples[middle:]))
    return replace(whole, smooth=first, later=second)


def middle_of(stack: Sequence[Picture]) -> Picture:
    """Take the median, pixel by pixel, of N pictures, the lower one of an even N.

    Batcher's odd-even merge sort, each comparison made for all pixels at once (Knuth 1998, 5.2.2,
    algorithm M): many times as quick as sorting pixel by pixel.
    """
    count = len(stack)
    rows = list(stack)
    power = 1 << max(count - 1, 0).bit_length()
    step = power // 2
    while step:
        apart, mask, least = step, power // 2, 0
        while True:
            for at in range(count - apart):
                if at & step == least:
                    low, high = rows[at], rows[at + apart]
                    rows[at], rows[at + apart] = np.minimum(low, high), np.maximum(low, high)
            if mask == step:
                break
            apart, mask, least = mask - step, mask // 2, step
        step //= 2
    return rows[(count - 1) // 2]


def _leave_out(
    picture: Picture,
    spread: FloatPicture,
    samples: Sequence[Picture],
    maybe_px: Sequence[Array],
    radius_px: float,
) -> None:
    """Replace median and spread where the ball may be in a sample by those of the other samples."""
    height, width = picture.shape[:2]
    known = np.concatenate([where[np.isfinite(where[:, 0])] for where in maybe_px])
    left, top = np.clip(np.floor(known.min(axis=0) - radius_px).astype(int), 0, [width, height])
    right, bottom = np.clip(
        np.ceil(known.max(axis=0) + radius_px).astype(int) + 1, 0, [width, height]
    )
    rows, columns = np.mgrid[top:bottom, left:right]
    hidden = np.zeros((len(samples), *rows.shape), dtype=bool)
    reach = math.ceil(radius_px) + 1
    for at, where in enumerate(maybe_px):
        for x, y in where[np.isfinite(where[:, 0])]:
            first_row, first_column = round(y) - reach - top, round(x) - reach - left
            near = (
                slice(max(first_row, 0), max(first_row + 2 * reach + 1, 0)),
                slice(max(first_column, 0), max(first_column + 2 * reach + 1, 0)),
            )
            hidden[at][near] |= (columns[near] - x) ** 2 + (rows[near] - y) ** 2 < radius_px**2
    often = hidden.sum(axis=0)
    touched = (often > 0) & (often < len(samples))
    if touched.any():
        pixels = rows[touched], columns[touched]
        values = np.stack([sample[pixels] for sample in samples]).astype(np.float32)
        values[hidden[:, touched]] = np.inf  # sorted to the end, and not counted
        values.sort(axis=0)
        median_row = (len(samples) - often[touched] - 1) // 2
        middle = np.take_along_axis(values, median_row[None, :, None], 0)[0]
        picture[pixels] = middle.astype(np.uint8)
        off = np.abs(values - middle).max(axis=2) / _SMOOTHER
        off.sort(axis=0)
        spread[pixels] = np.take_along_axis(off, median_row[None], 0)[0]


def _smooth(picture: Picture) -> Picture:
    """Average each pixel over three by three."""
    import cv2

    return np.asarray(cv2.blur(picture, _BLOCK), np.uint8)
