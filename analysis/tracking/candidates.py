"""Ball candidates: what stands out of the background of a fixed camera.

The background is what the camera shows where nothing moves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Array, Picture

# ---- Background: the median of pictures from all over the recording

# Pixels that have been computed with: (height, width, 3), or (height, width).
FloatPicture = NDArray[np.float32]
_BLOCK = (3, 3)  # pixels that make one of a smooth picture


@dataclass(frozen=True, eq=False)
class Background:
    """Still picture, and how far a pixel must be from it to count as something else."""

    picture: Picture  # uint8, shape (H, W, 3)
    smooth: Picture  # the same, each pixel the mean of three by three
    # uint8, shape (H, W): noise, flicker and the shaking of a hand-held camera, of smooth pictures.
    threshold: Picture
    work: _Scratch  # for pictures of this shape
    # How the second half of the recording looks, smooth, where `smooth` is of the first half; None
    # where one picture is good for all.
    later: Picture | None = None

    def difference(self, picture: Picture, gain: float | None = None) -> Picture:
        """Compute the largest difference of the three smooth colours, the light's changes undone.

        Shape (H, W); it is the same array, overwritten, for the next picture. `gain` is the
        picture's, where it is known.
        """
        import cv2

        work = self.work
        cv2.blur(picture, _BLOCK, dst=work.smooth)
        gain = self.gain(picture) if gain is None else gain
        # Light that changes the brightest pixel by less than half a level has not changed.
        if abs(gain - 1) * 255 > 0.5:
            cv2.convertScaleAbs(work.smooth, dst=work.smooth, alpha=gain)
        if self.later is None:
            return work.largest_difference(self.smooth)
        first = work.largest_difference(self.smooth).copy()
        return np.asarray(cv2.min(first, work.largest_difference(self.later)), np.uint8)

    def gain(self, picture: Picture) -> float:
        """Return how much brighter the still picture is, by the median of its pixels."""
        every, where, mine = self._lit
        theirs = picture[::every, ::every].reshape(-1)[where].astype(np.float32)
        lit = (theirs > 20) & (theirs < 235)
        # With fewer pixels between the two the light is taken for constant.
        return float(np.median(mine[lit] / theirs[lit])) if lit.sum() > 100 else 1.0

    @cached_property
    def low_threshold(self) -> Picture:
        """About half of the threshold."""
        return self.threshold // 2 + 3

    @cached_property
    def _lit(self) -> tuple[int, NDArray[np.intp], FloatPicture]:
        """Colours on a grid that follow the light: its step, which of its values, and those."""
        height, width = self.picture.shape[:2]
        # So many pixels, on a grid, say how bright a picture is to a fraction of a level.
        every = max(1, math.isqrt(height * width // 1500))
        mine = self.picture[::every, ::every].reshape(-1)
        # Beyond 20 to 235 a pixel is clipped or mostly noise, and does not follow the light.
        where = np.flatnonzero((mine > 20) & (mine < 235))
        return every, where, mine[where].astype(np.float32)


class _Scratch:
    """Arrays that are written to again and again: new ones take longer to get than to fill."""

    def __init__(self, like: Picture) -> None:
        self.smooth = np.empty_like(like)  # the picture, shape (H, W, 3)
        self._apart = np.empty_like(like)  # its difference, likewise, and planes of that
        self._planes = [np.empty(like.shape[:2], np.uint8) for _ in range(3)]

    def largest_difference(self, still: Picture) -> Picture:
        """Return the largest difference of the three colours; NumPy takes ten times as long."""
        import cv2

        cv2.absdiff(self.smooth, still, dst=self._apart)
        cv2.split(self._apart, self._planes)
        red, green, blue = self._planes
        cv2.max(red, green, dst=green)
        return np.asarray(cv2.max(green, blue, dst=blue), np.uint8)


def still_background(
    samples: Sequence[Picture], maybe_px: Sequence[Array] = (), radius_px: float = 0.0
) -> Background:
    """Take the median of pictures from all over the recording, and thresholds from their spread.

    Of each pixel the spread is the median absolute deviation of its smooth colours, the largest of
    three by three pixels: the camera may shake. `samples` (H, W, 3), `maybe_px` (K, 2).
    """
    import cv2

    median = np.empty(samples[0].shape, np.uint8)
    spread = np.empty(median.shape[:2], np.float32)
    work: _Scratch | None = None
    for top in range(0, len(median), 32):  # the whole stack at once would take much memory
        strip = slice(top, top + 32)
        values = [sample[strip] for sample in samples]
        median[strip] = middle = middle_of(values)
        still = _smooth(middle)
        if work is None or work.smooth.shape != middle.shape:
            work = _Scratch(middle)
        apart: list[Picture] = []
        for part in values:
            cv2.blur(part, _BLOCK, dst=work.smooth)
            apart.append(work.largest_difference(still).copy())
        spread[strip] = middle_of(apart)
    if any(np.isfinite(where[:, 0]).any() for where in maybe_px):
        _leave_out(median, spread, samples, maybe_px, radius_px)
    widened = np.asarray(cv2.dilate(spread, np.ones((3, 3), np.uint8)))
    # Of a million pixels, one differs by five standard deviations (1.4826 median deviations) by
    # noise; compression changes a still pixel by up to 14 of 255, however quiet its samples are.
    wanted = np.maximum(5.0 * 1.4826 * widened, 14)
    threshold = np.minimum(wanted, 255).astype(np.uint8)
    return Background(median, _smooth(median), threshold, _Scratch(median))


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
    """Take the median, pixel by pixel, of N pictures, the lower one of an even N."""
    middle = (len(stack) - 1) // 2
    return _sorted_rows(stack, frozenset([middle]))[middle]


def _sorted_rows(stack: Sequence[Picture], asked: frozenset[int]) -> list[Picture]:
    """Sort N arrays value by value; those of the ranks that are asked for are right.

    Each comparison is made for all pixels at once: many times as quick as pixel by pixel.
    """
    rows = list(stack)
    for at, to, needs_low, needs_high in _comparisons(len(rows), asked):
        low, high = rows[at], rows[to]
        if needs_low:
            rows[at] = np.minimum(low, high)
        if needs_high:
            rows[to] = np.maximum(low, high)
    return rows


@cache
def _comparisons(count: int, asked: frozenset[int]) -> list[tuple[int, int, bool, bool]]:
    """List the comparisons of Batcher's odd-even merge sort that the ranks asked for need.

    Knuth 1998, 5.2.2, algorithm M: of two rows, and whether the lower and the higher are needed.
    """
    pairs: list[tuple[int, int]] = []
    power = 1 << max(count - 1, 0).bit_length()
    step = power // 2
    while step:
        apart, mask, least = step, power // 2, 0
        while True:
            pairs += [(at, at + apart) for at in range(count - apart) if at & step == least]
            if mask == step:
                break
            apart, mask, least = mask - step, mask // 2, step
        step //= 2
    needed, kept = set(asked), list[tuple[int, int, bool, bool]]()
    for at, to in reversed(pairs):
        if at in needed or to in needed:
            kept.append((at, to, at in needed, to in needed))
            needed |= {at, to}
    return kept[::-1]


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
    every = frozenset(range(len(samples)))
    reach, high = math.ceil(radius_px) + 1, max(1, (1 << 16) // max(right - left, 1))
    for begin in range(top, bottom, high):  # all at once would take much memory
        rows, columns = np.mgrid[begin : min(begin + high, bottom), left:right]
        hidden = np.zeros((len(samples), *rows.shape), dtype=bool)
        for at, where in enumerate(maybe_px):
            for x, y in where[np.isfinite(where[:, 0])]:
                first_row, first_column = round(y) - reach - begin, round(x) - reach - left
                near = (
                    slice(max(first_row, 0), max(first_row + 2 * reach + 1, 0)),
                    slice(max(first_column, 0), max(first_column + 2 * reach + 1, 0)),
                )
                apart = (columns[near] - x) ** 2 + (rows[near] - y) ** 2
                hidden[at][near] |= apart < radius_px**2
        seen = np.count_nonzero(~hidden, axis=0)
        touched = (seen > 0) & (seen < len(samples))
        if not touched.any():
            continue
        pixels = (rows[touched] * width + columns[touched]).astype(np.intp)
        stack = [sample.reshape(-1, 3)[pixels] for sample in samples]
        for values, out in zip(stack, hidden[:, touched], strict=True):
            values[out] = 255  # sorted to the end, and not counted
        values = np.stack(_sorted_rows(stack, every))
        median_row = (seen[touched][None] - 1) // 2
        middle = np.take_along_axis(values, median_row[:, :, None], 0)[0]
        picture.reshape(-1, 3)[pixels] = middle
        off = (np.maximum(values, middle) - np.minimum(values, middle)).max(axis=2)
        off[np.arange(len(samples))[:, None] >= seen[touched]] = 255
        off = np.stack(_sorted_rows([*off], every))
        # Noise is about half as much in a smooth picture.
        spread.reshape(-1)[pixels] = np.take_along_axis(off, median_row, 0)[0] / 2.0


def _smooth(picture: Picture) -> Picture:
    """Average each pixel over three by three."""
    import cv2

    return np.asarray(cv2.blur(picture, _BLOCK), np.uint8)


# ---- Candidates in one picture, and in all of them


@dataclass(frozen=True, eq=False)
class Blobs:
    """Candidates in one picture, N of them, the strongest first."""

    places_px: Array  # x right, y down; the first pixel's centre is 0, 0; shape (N, 2)
    areas_px: Array  # [px²], shape (N,)
    colours: Array  # mean RGB, 0 to 255, shape (N, 3)
    whole: NDArray[np.bool_]  # whether it ends inside the picture, shape (N,)
    misfits: Array  # see `Placing`; 0 where the ball's appearance is not known; shape (N,)


@dataclass(frozen=True, eq=False)
class Candidates:
    """Blobs of T pictures as one table of M columns, NaN where a picture has fewer."""

    seconds: Array  # since the first picture, shape (T,)
    places_px: Array  # see `Blobs`; shape (T, M, 2)
    areas_px: Array  # [px²], shape (T, M)
    colours: Array  # mean RGB, shape (T, M, 3)
    whole: NDArray[np.bool_]  # shape (T, M)
    misfits: Array  # shape (T, M)

    @classmethod
    def of(cls, seconds: Array, blobs: Sequence[Blobs]) -> Candidates:
        """Put the blobs of T pictures, taken at `seconds` (shape (T,)), into one table."""
        shape = len(blobs), max((len(found.areas_px) for found in blobs), default=0)
        columns: dict[str, NDArray[Any]] = {
            "places_px": np.full((*shape, 2), np.nan),
            "areas_px": np.full(shape, np.nan),
            "colours": np.full((*shape, 3), np.nan),
            "whole": np.zeros(shape, dtype=bool),
            "misfits": np.zeros(shape),
        }
        for name, column in columns.items():
            for row, found in zip(column, blobs, strict=True):
                row[: len(found.areas_px)] = getattr(found, name)
        return cls(seconds, **columns)

    def inside(self) -> Candidates:
        """Remove those that the picture's edge cuts: arms and people, not balls."""
        positions = np.where(self.whole[:, :, None], self.places_px, np.nan)
        areas = np.where(self.whole, self.areas_px, np.nan)
        return replace(self, places_px=positions, areas_px=areas)

    def some(self, frames: NDArray[np.intp]) -> Candidates:
        """Return the candidates of the pictures with these numbers."""
        return Candidates(*(getattr(self, one.name)[frames] for one in fields(self)))


@dataclass(frozen=True, eq=False)
class ColorAndSize:
    """Mean colour of the ball, and its size."""

    colour: Array  # RGB, 0 to 255, shape (3,)
    area_px: float  # of its disc in the picture [px²]

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
    picture: Picture,
    background: Background,
    ball: ColorAndSize,
    allowed: Picture | None,
    gain: float | None = None,
) -> Blobs:
    """Find candidates by the fraction of each pixel that is ball; see `moving_blobs`.

    A pixel is part background B, part ball C, part shadow: I - B = a (C - B) - b B, a, b >= 0.
    `gain` is the picture's, where it is known.
    """
    difference = background.difference(picture, gain)
    mask = difference > background.low_threshold  # the colour decides: noise may pass
    if allowed is not None:
        mask &= allowed.astype(bool)
    there = np.flatnonzero(mask)  # several times as quick as the mask itself
    still = background.picture.reshape(-1, 3)[there].astype(np.float32)
    off = picture.reshape(-1, 3)[there].astype(np.float32) - still
    fraction = np.zeros(mask.shape, np.float32)
    towards = ball.colour.astype(np.float32) - still
    fraction.reshape(-1)[there] = _ball_fraction(off, towards, -still)
    # A pixel that is ball by less than a quarter may be noise.
    solid = (fraction > 0.25).astype(np.uint8)
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
    pairs = (towards, towards), (shade, shade), (towards, shade), (off, towards), (off, shade)
    aa, bb, ab, ya, yb = (np.einsum("ij,ij->i", *pair) for pair in pairs)
    aa += np.float32(1.0)
    bb += np.float32(1.0)
    determinant = np.maximum(aa * bb - ab**2, 1e-3 * aa * bb)
    fraction = (ya * bb - yb * ab) / determinant
    shadow = (yb * aa - ya * ab) / determinant
    fraction = np.where(shadow < 0, ya / aa, fraction)
    # A dark ball differs from what is behind it as a shadow does, only by more: a shadow may make
    # .3 of it. Squared sine of the angle between two differences that cannot be told apart: .06.
    fraction = np.where(determinant < 0.06 * aa * bb, (ya / aa - 0.3) / (1 - 0.3), fraction)
    # Squared difference of two colours (0 to 255, summed over RGB): background that is nearer to
    # the ball's colour, about 10 in each channel, cannot say how much of a pixel is ball
    fraction = np.where(aa < 300.0, 0.0, fraction)
    return np.clip(fraction, 0.0, 1.0)


def _components(picture: Picture, mask: Picture, weight: NDArray[np.float32] | Picture) -> Blobs:
    """Find connected components of a mask, filled, each with its centre of mass by `weight`."""
    import cv2

    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    outlines, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    boxes = [(cv2.boundingRect(outline), outline) for outline in outlines if len(outline) >= 4]
    boxes.sort(key=lambda boxed: boxed[0][2] * boxed[0][3], reverse=True)
    height, width = mask.shape
    rows: list[tuple[float, ...]] = []
    # The largest by their boxes: it bounds the time.
    for (left, top, wide, tall), outline in boxes[:40]:
        box = slice(top, top + tall), slice(left, left + wide)
        filled = np.zeros((tall, wide), np.uint8)
        cv2.drawContours(filled, [outline], 0, 1, -1, offset=(-left, -top))
        part = np.asarray(closed)[box].astype(bool) & filled.astype(bool)
        # What is smaller is noise; no ball that is filmed with its whole drop is larger.
        if not 5 <= part.sum() <= 0.05 * mask.size:
            continue
        mass = np.where(part, weight[box], 0).astype(np.float32)
        total = float(mass.sum())
        if total <= 0:
            continue
        x = float(mass.sum(axis=0) @ np.arange(left, left + wide)) / total
        y = float(mass.sum(axis=1) @ np.arange(top, top + tall)) / total
        # Pixels above .6 of the largest difference are wholly ball, and give its colour.
        core = mass > 0.6 * mass.max()
        colour = picture[box][core].mean(axis=0)
        whole = left > 0 and top > 0 and left + wide < width and top + tall < height
        # A difference in grey levels weighs a pixel by its largest; a fraction is an area as it is.
        soft = total / float(mass.max()) if weight.dtype == np.uint8 else total
        rows.append((total, x, y, max(soft, 1.0), *colour, float(whole)))
    rows.sort(reverse=True)
    # Of more candidates (people and shadows make many) there would be many more triples.
    table = np.array(rows[:12], np.float64).reshape(-1, 8)
    none = np.zeros(len(table))
    return Blobs(table[:, 1:3], table[:, 3], table[:, 4:7], table[:, 7] > 0, none)


def picked(values: Array, chosen: NDArray[np.intp]) -> Array:
    """Return the chosen candidate's value in each picture, (T,) or (T, K); NaN for choice -1."""
    found = values[np.arange(len(chosen)), np.maximum(chosen, 0)].astype(np.float64)
    found[chosen < 0] = np.nan
    return found
