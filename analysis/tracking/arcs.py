"""RANSAC for the longest free flight among the candidates: what no hand or shadow does.

Triples of candidates at even strides that bend as a fall does are seeds, those first whose
parabola most others lie on; each seed grows to the pictures around it, by least squares in turn
with a new choice of what lies near; the flight with the best score is the ball's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from analysis.tracking.candidates import Candidates
from analysis.tracking.triples import (
    AREA_RATIO,
    COLOUR_APART,
    MIN_BEND_PX,
    Index,
    accelerated_triples,
    tolerance_px,
)
from tunenet_logs.arrays import Array
from tunenet_logs.errors import NotFoundError

MIN_FRAMES = 6  # pictures of a flight: three lie on a parabola by themselves, three more must agree
_MAX_SEEDS = 500
# Triples that grow once, and arcs that grow to the end: they bound the time of a busy film.
_FINALISTS = 60

_CAMOUFLAGED = (
    "the ball looks like what is behind it",
    "mark it with --hsv; at the next drop: film it before a plain background of another colour",
)

_MIN_GROWN = 5  # pictures of a triple that has grown once: with fewer it is not grown to the end
_MIN_POINTS = 3  # pictures that define a parabola
# Pictures in a row without the ball that end a flight: a bounce or a hand comes between.
_MAX_MISSES = 3

_ENOUGH_FRAMES = 16  # more of them do not make a flight likelier
_FALLEN = 5.0  # sags that a flight's travel may count: a fall from rest travels 4
# Rms distance from the parabola that halves a score: the sum of .3 px and .15 ball radii.
_LOOSE_PX, _LOOSE = 0.3, 0.15

# Most acceleration [ball radii/s²]: a ball of 4 mm radius, falling on Earth, filmed at most at its
# true rate.
_MAX_RADII_S2 = 2500.0

# Px and ball radii, added: a flight sags more below the straight line between its ends.
_MIN_SAG_PX, _MIN_SAG = 2.0, 0.3

# Of the acceleration downward: a camera is turned by less than 35° from one of four directions.
_MAX_SIDEWAYS = 0.7

# Added to distances that a small ball's radius bounds: its position is no better than that.
SLACK_PX = 2.0

_MIN_NEAR = 3  # pictures of a flight in which the ball is found again: they define a parabola
# Where down may be in a picture (x, y), and how much that is favoured: films are seldom turned.
_DIRECTIONS = (((0.0, 1.0), 2.0), ((0.0, -1.0), 1.0), ((1.0, 0.0), 1.0), ((-1.0, 0.0), 1.0))


@dataclass(frozen=True, eq=False)
class Arc:
    """One free flight.

    Attributes:
        frames: numbers of the N pictures it was seen in, increasing, shape (N,).
        chosen: which candidate of each it is, shape (N,).
        gravity_px: acceleration [px/s²], shape (2,).
    """

    frames: Index
    chosen: Index
    gravity_px: Array


def longest_arc(table: Candidates, least_frames: int = MIN_FRAMES) -> Arc | None:
    """Find the free flight that goes farthest; down the picture unless another is far better.

    A video without its rotation flag falls sideways. And a bounce, seen upside down, looks a little
    like a flight.
    """
    if not table.areas_px.size:
        return None
    seeds, bends = accelerated_triples(table)
    best, best_score = None, 0.0
    for down, factor in _DIRECTIONS:
        down_px = np.array(down)
        towards = bends @ down_px
        sideways = np.abs(bends @ np.array([down_px[1], -down_px[0]]))
        falling = seeds[(towards > MIN_BEND_PX) & (towards > sideways)]
        for arc in _grown_arcs(table, falling[:_MAX_SEEDS]):
            if _is_flight(table, arc, down_px, least_frames):
                score = factor * _score(table, arc)
                if score > best_score:
                    best, best_score = arc, score
    return best


def _grown_arcs(table: Candidates, seeds: Index) -> Iterator[Arc]:
    """Yield the arcs that triples grow to, of the best scores after one round of growing."""
    tried: dict[bytes, tuple[float, int]] = {}
    for index, seed in enumerate(seeds):
        arc = _grow(table, seed, 1)
        if arc is not None and len(arc.frames) >= _MIN_GROWN:
            same = arc.frames.tobytes() + arc.chosen.tobytes()
            score = tried[same][0] if same in tried else _score(table, arc)
            tried[same] = (score, index)
    for _, index in sorted(tried.values(), reverse=True)[:_FINALISTS]:
        arc = _grow(table, seeds[index], 4)
        if arc is not None:
            yield arc


def _grow(table: Candidates, seed: Index, rounds: int) -> Arc | None:
    """Extend a triple to the pictures around it that lie on its parabola, refitted each round."""
    frames, chosen = seed[:3], seed[3:]
    area = float(np.median(table.areas_px[frames, chosen]))
    colour = np.median(table.colours[frames, chosen], axis=0)
    tolerance = tolerance_px(area)
    curve = np.zeros((3, 2))
    for _ in range(rounds):
        middle = table.seconds[frames].mean()
        clock = table.seconds[frames] - middle
        curve = _parabola(clock, table.places_px[frames, chosen])
        # A triple may be a short part of a flight; a longer arc about doubles in a round.
        reach = (1.2 if len(frames) > _MIN_POINTS else 2.5) * float(np.ptp(clock))
        low, high = np.searchsorted(table.seconds, [middle - reach, middle + reach])
        window = np.arange(low, high)
        times = (table.seconds[window] - middle)[:, None]
        expected = curve[0] * times**2 + curve[1] * times + curve[2]
        apart = table.places_px[low:high] - expected[:, None]
        off = np.hypot(apart[:, :, 0], apart[:, :, 1])
        row, one = np.nonzero(off < tolerance)  # NaN is not
        there = window[row], one
        alike = np.linalg.norm(table.colours[there] - colour, axis=1) < COLOUR_APART
        alike &= np.abs(np.log(table.areas_px[there] / area)) < np.log(2 * AREA_RATIO)
        near = np.full(off.shape, np.inf)
        near[row[alike], one[alike]] = off[row[alike], one[alike]]
        nearest = near.argmin(axis=1)
        hit = np.isfinite(near[np.arange(len(window)), nearest])
        begin = end = int(np.searchsorted(window, frames[len(frames) // 2]))
        misses = 0
        while begin > 0 and misses < _MAX_MISSES:
            begin -= 1
            misses = 0 if hit[begin] else misses + 1
        misses = 0
        while end < len(hit) and misses < _MAX_MISSES:
            misses = 0 if hit[end] else misses + 1
            end += 1
        kept = np.arange(begin, end)[hit[begin:end]]
        if len(kept) < _MIN_POINTS:
            return None
        frames, chosen = window[kept], nearest[kept]
    return Arc(frames, chosen, 2 * curve[0])


def _parabola(clock: Array, positions: Array) -> Array:
    """Fit a parabola: factors of square, time and 1, shape (3, 2); much faster than `polyfit`."""
    span = float(np.abs(clock).max())
    when = clock / span
    design = np.column_stack([when * when, when, np.ones(len(when))])
    curve = np.linalg.lstsq(design, positions)[0]  # stamps may be as good as equal
    return curve / np.array([[span**2], [span], [1.0]])


def _score(table: Candidates, arc: Arc) -> float:
    """Return how far it flies in its own sizes, by how many pictures say so.

    What is carried goes far without falling. A fall from rest goes four times as far as it sags
    below the straight line between its ends. Loose ends of a hand lie about a parabola, not on it.
    """
    positions = table.places_px[arc.frames, arc.chosen]
    area = float(np.median(table.areas_px[arc.frames, arc.chosen]))
    travel = float(np.linalg.norm(np.ptp(positions, axis=0)))
    clock = table.seconds[arc.frames]
    sag = float(np.linalg.norm(arc.gravity_px)) * float(np.ptp(clock)) ** 2 / 8
    curve = _parabola(clock - clock.mean(), positions)
    when = (clock - clock.mean())[:, None]
    off = positions - (curve[0] * when**2 + curve[1] * when + curve[2])
    loose = np.sqrt((off**2).sum(axis=1).mean()) / (_LOOSE_PX + _LOOSE * np.sqrt(area / np.pi))
    return (
        min(travel, _FALLEN * sag)
        / (1 + loose**2)
        / (2 + np.sqrt(area))
        * min(len(arc.frames), _ENOUGH_FRAMES)
    )


def _is_flight(table: Candidates, arc: Arc, down: Array, least_frames: int) -> bool:
    """Return whether it falls: no faster than a ball of its size, far enough, nearly downward."""
    if len(arc.frames) < least_frames:
        return False
    clock = table.seconds[arc.frames]
    area = float(np.median(table.areas_px[arc.frames, arc.chosen]))
    radius = float(np.sqrt(area / np.pi))
    if np.linalg.norm(arc.gravity_px) > _MAX_RADII_S2 * (radius + 2):
        return False
    sag = float(arc.gravity_px @ down) * float(np.ptp(clock)) ** 2 / 8
    sideways = abs(float(arc.gravity_px @ np.array([down[1], -down[0]])))
    return sag > _MIN_SAG_PX + _MIN_SAG * radius and (
        sideways < _MAX_SIDEWAYS * float(arc.gravity_px @ down)
    )


def same_arc(table: Candidates, frames: Index, gravity_px: Array, positions_px: Array) -> Arc:
    """Find a known flight again among new candidates.

    Args:
        table: those of T pictures.
        frames: the pictures that it was seen in, shape (N,).
        gravity_px: its acceleration [px/s²], shape (2,).
        positions_px: where the ball was seen before, shape (T, 2).

    Raises:
        NotFoundError: they do not follow it.
    """
    apart = np.linalg.norm(table.places_px[frames] - positions_px[frames][:, None], axis=2)
    apart = np.where(np.isfinite(apart), apart, np.inf)
    if not apart.size:
        raise NotFoundError(*_CAMOUFLAGED)
    nearest = apart.argmin(axis=1)
    area = float(np.nanmedian(table.areas_px[frames, nearest]))
    near = apart[np.arange(len(nearest)), nearest] < SLACK_PX + np.sqrt(area / np.pi)
    if near.sum() < _MIN_NEAR:
        raise NotFoundError(*_CAMOUFLAGED)
    return Arc(frames[near], nearest[near], gravity_px)
