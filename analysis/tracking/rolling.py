"""Detection of steady motion along a straight line: a ball that rolls, and never falls."""

from __future__ import annotations

import numpy as np

from analysis.tracking.candidates import Candidates
from tunenet_logs.arrays import Array
from tunenet_logs.errors import NotFoundError

_STARTS = 48  # pictures, evenly over the recording, from which candidates are followed
_MAX_MISSES = 3  # pictures in a row without it that end its way
_MIN_COUNT = 8  # pictures of a way
_NEAR_PX, _NEAR = 2.0, 0.5  # from where it is expected, in px and in radii, added
_FARTHEST = 4.0  # radii that it moves from one picture to the next at most
_COLOUR_APART, _AREA_RATIO = 70.0, 2.2  # from one picture to the next, as of what flies
# Fractions of the way: rms distance from a parabola, how far that may bend or get ahead of a steady
# speed, and how far it may fall behind: balls that roll come to rest.
_LOOSE, _STEADY, _SLOWER = 0.04, 0.06, 0.2

# Way, in the reduced picture, below which what was found may be nothing; and how many times as far
# something has to roll.
_SHORT_PX, _FARTHER = 40.0, 3.0

# A way's least length, in radii, and as a fraction of what candidates are spread over.
_MIN_RADII, _MIN_SHARE = 6.0, 0.15


def refuse_roll(
    table: Candidates, scale: int, way_px: float, error: NotFoundError | None = None
) -> None:
    """Raise if something rolls through the pictures while what was found hardly moves.

    What was found moves by `way_px` in pictures of full size; `scale` is how much they are reduced.

    Raises:
        NotFoundError: something goes farther, and never falls.
    """
    if way_px > _SHORT_PX * scale:
        return
    roll_px = longest_roll_px(table) * scale
    if roll_px > _FARTHER * way_px:
        raise NotFoundError(
            f"nothing falls: what moves goes {roll_px:.0f} px along a straight line without "
            "gaining speed, as a ball that rolls; at the next drop: let the ball fall onto the "
            "table, filmed from the side"
        ) from error


def longest_roll_px(table: Candidates) -> float:
    """Measure the longest straight and steady path of one candidate [px]; 0 for none."""
    if not table.areas_px.size or not np.isfinite(table.areas_px).any():
        return 0.0
    low, high = np.nanmin(table.places_px, (0, 1)), np.nanmax(table.places_px, (0, 1))
    spread = float(np.linalg.norm(high - low))
    count = len(table.seconds)
    longest = 0.0
    for first in np.unique(np.linspace(0, count - 1, _STARTS).astype(int)):
        for one in np.flatnonzero(np.isfinite(table.areas_px[first])):
            frames, places = _way(table, int(first), int(one))
            length = _length_px(table.seconds[frames], places)
            radius = float(np.sqrt(table.areas_px[first, one] / np.pi))
            if length > max(_MIN_RADII * radius, _MIN_SHARE * spread):
                longest = max(longest, length)
    return longest


def _followed(table: Candidates, first: int, one: int, step: int) -> tuple[list[int], list[Array]]:
    """Follow a candidate from one picture on, or back: the pictures after it, and where."""
    frames, places = [first], [table.places_px[first, one]]
    area, colour = float(table.areas_px[first, one]), table.colours[first, one]
    radius = float(np.sqrt(area / np.pi))
    velocity: Array | None = None
    for frame in range(first + step, len(table.seconds) if step > 0 else -1, step):
        if abs(frame - frames[-1]) > _MAX_MISSES:
            break
        dt = float(table.seconds[frame] - table.seconds[frames[-1]])
        expected = places[-1] + (velocity * dt if velocity is not None else 0.0)
        reach = _NEAR_PX + _NEAR * radius if velocity is not None else _FARTHEST * radius
        off = np.linalg.norm(table.places_px[frame] - expected, axis=1)
        unlike = np.linalg.norm(table.colours[frame] - colour, axis=1) > _COLOUR_APART
        unlike |= np.abs(np.log(table.areas_px[frame] / area)) > np.log(_AREA_RATIO)
        off = np.where(np.isfinite(off) & ~unlike, off, np.inf)
        best = int(off.argmin())
        if off[best] > reach:
            continue
        frames.append(frame)
        places.append(table.places_px[frame, best])
        back = max(len(frames) - _MIN_COUNT, 0)
        span = float(table.seconds[frame] - table.seconds[frames[back]])
        velocity = (places[-1] - places[back]) / span
    return frames[1:], places[1:]


def _way(table: Candidates, middle: int, one: int) -> tuple[list[int], Array]:
    """Return all of a candidate's path through a picture: the pictures, and where, shape (N, 2)."""
    before, came = _followed(table, middle, one, -1)
    after, went = _followed(table, middle, one, 1)
    places = [*came[::-1], table.places_px[middle, one], *went]
    return [*before[::-1], middle, *after], np.array(places)


def _length_px(seconds: Array, places: Array) -> float:
    """Return the end-to-end length of a path that is straight and steady; else 0."""
    if len(seconds) < _MIN_COUNT:
        return 0.0
    way = places[-1] - places[0]
    length = float(np.linalg.norm(way))
    clock = seconds - seconds.mean()
    curve = np.polyfit(clock, places, 2)
    fitted = curve[0] * clock[:, None] ** 2 + curve[1] * clock[:, None] + curve[2]
    loose = float(np.sqrt(((places - fitted) ** 2).sum(axis=1).mean()))
    bend = curve[0] * float(np.ptp(clock)) ** 2 / 4
    onward = float(bend @ way) / max(length, 1e-9)
    aside = float(np.sqrt(max(bend @ bend - onward**2, 0.0)))
    straight = loose < _LOOSE * length and aside < _STEADY * length
    return length if straight and -_SLOWER * length < onward < _STEADY * length else 0.0
