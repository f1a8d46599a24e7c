"""The longest free flight among the candidates: what no hand, shadow or person does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.tracking.candidates import Candidates
from analysis.tracking.triples import (
    AREA_RATIO,
    COLOUR_APART,
    LEAST_BEND_PX,
    accelerated_triples,
    tolerance_px,
)
from tunenet_logs.arrays import Array

Index = NDArray[np.intp]

_MOST_SEEDS = 500
_FINALISTS = 60
_LEAST_GROWN = 5
LEAST_FRAMES = 6
_ENOUGH_FRAMES = 16
_FALLEN = 5.0
_LOOSE_PX, _LOOSE = 0.3, 0.15
_SMALLEST_BALL = 2500.0
"""Most acceleration [ball radii/s²]: a ball of 4 mm radius, falling on Earth, filmed at most at
its true rate."""

_WAYS = (((0.0, 1.0), 2.0), ((0.0, -1.0), 1.0), ((1.0, 0.0), 1.0), ((-1.0, 0.0), 1.0))
"""Where down may be in a picture, and how much that is favoured."""


@dataclass(frozen=True, eq=False)
class Arc:
    """One flight.

    Attributes:
        frames: numbers of the pictures it was seen in, increasing, shape (N,).
        chosen: which candidate of each it is, shape (N,).
        gravity_px: acceleration [px/s²], shape (2,).
    """

    frames: Index
    chosen: Index
    gravity_px: Array


def longest_arc(table: Candidates, least_frames: int = LEAST_FRAMES) -> Arc | None:
    """The free flight that goes farthest; down the picture unless another is far better.

    A video without its rotation flag falls sideways. And a bounce, seen upside down, looks a little
    like a flight.

    Args:
        table: what moves in each picture.
        least_frames: in how many pictures it must be seen.
    """
    seeds, bends = accelerated_triples(table)
    found = [
        (_longest_towards(table, seeds, bends, np.array(way), least_frames), more)
        for way, more in _WAYS
    ]
    scored = [(more * _score(table, arc), arc) for arc, more in found if arc is not None]
    return max(scored, key=lambda one: one[0])[1] if scored else None


def _longest_towards(
    table: Candidates, seeds: Index, bends: Array, down: Array, least_frames: int
) -> Arc | None:
    towards = bends @ down
    sideways = np.abs(bends @ np.array([down[1], -down[0]]))
    seeds = seeds[(towards > LEAST_BEND_PX) & (towards > sideways)]
    tried: dict[bytes, tuple[float, int]] = {}
    for index, seed in enumerate(seeds[:_MOST_SEEDS]):
        arc = _grow(table, seed, 1)
        if arc is not None and len(arc.frames) >= _LEAST_GROWN:
            tried[arc.frames.tobytes() + arc.chosen.tobytes()] = (_score(table, arc), index)
    best, best_score = None, 0.0
    for _, index in sorted(tried.values(), reverse=True)[:_FINALISTS]:
        arc = _grow(table, seeds[index], 4)
        if arc and _is_flight(table, arc, down, least_frames) and _score(table, arc) > best_score:
            best, best_score = arc, _score(table, arc)
    return best


def _grow(table: Candidates, seed: Index, rounds: int) -> Arc | None:
    """Extend a triple to all pictures around it that lie on its parabola."""
    frames, chosen = seed[:3], seed[3:]
    area = float(np.median(table.areas_px[frames, chosen]))
    colour = np.median(table.colours[frames, chosen], axis=0)
    tolerance = tolerance_px(area)
    curve = np.zeros((3, 2))
    for _ in range(rounds):
        middle = table.seconds[frames].mean()
        clock = table.seconds[frames] - middle
        curve = np.polyfit(clock, table.places_px[frames, chosen], 2)
        reach = 1.2 * float(np.ptp(clock)) if len(frames) > 3 else 2.5 * float(np.ptp(clock))
        low, high = np.searchsorted(table.seconds, [middle - reach, middle + reach])
        window = np.arange(low, high)
        times = (table.seconds[window] - middle)[:, None]
        expected = curve[0] * times**2 + curve[1] * times + curve[2]
        off = np.linalg.norm(table.places_px[window] - expected[:, None], axis=2)
        alike = np.linalg.norm(table.colours[window] - colour, axis=2) < COLOUR_APART
        alike &= np.abs(np.log(table.areas_px[window] / area)) < np.log(2 * AREA_RATIO)
        off = np.where(alike & np.isfinite(off), off, np.inf)
        nearest = off.argmin(axis=1)
        hit = off[np.arange(len(window)), nearest] < tolerance
        begin, end = _run(hit, int(np.searchsorted(window, frames[len(frames) // 2])))
        kept = np.arange(begin, end)[hit[begin:end]]
        if len(kept) < 3:
            return None
        frames, chosen = window[kept], nearest[kept]
    return Arc(frames, chosen, 2 * curve[0])


def _score(table: Candidates, arc: Arc) -> float:
    """How far it flies in its own sizes, by how many pictures say so.

    What is carried goes far without falling. A fall from rest goes four times as far as it sags
    below the straight line between its ends. Loose ends of a hand lie about a parabola, not on it.
    """
    places = table.places_px[arc.frames, arc.chosen]
    area = float(np.median(table.areas_px[arc.frames, arc.chosen]))
    travel = float(np.linalg.norm(np.ptp(places, axis=0)))
    clock = table.seconds[arc.frames]
    sag = float(np.linalg.norm(arc.gravity_px)) * float(np.ptp(clock)) ** 2 / 8
    curve = np.polyfit(clock - clock.mean(), places, 2)
    when = (clock - clock.mean())[:, None]
    off = places - (curve[0] * when**2 + curve[1] * when + curve[2])
    loose = np.sqrt((off**2).sum(axis=1).mean()) / (_LOOSE_PX + _LOOSE * np.sqrt(area / np.pi))
    return (
        min(travel, _FALLEN * sag)
        / (1 + loose**2)
        / (2 + np.sqrt(area))
        * min(len(arc.frames), _ENOUGH_FRAMES)
    )


def _run(hit: NDArray[np.bool_], at: int) -> tuple[int, int]:
    """The stretch around `at` without three misses in a row."""
    begin, misses = at, 0
    while begin > 0 and misses < 3:
        begin -= 1
        misses = 0 if hit[begin] else misses + 1
    end, misses = at, 0
    while end < len(hit) and misses < 3:
        misses = 0 if hit[end] else misses + 1
        end += 1
    return begin, end


def _is_flight(table: Candidates, arc: Arc, down: Array, least_frames: int) -> bool:
    if len(arc.frames) < least_frames:
        return False
    clock = table.seconds[arc.frames]
    area = float(np.median(table.areas_px[arc.frames, arc.chosen]))
    radius = float(np.sqrt(area / np.pi))
    if np.linalg.norm(arc.gravity_px) > _SMALLEST_BALL * (radius + 2):
        return False
    sag = float(arc.gravity_px @ down) * float(np.ptp(clock)) ** 2 / 8
    sideways = abs(float(arc.gravity_px @ np.array([down[1], -down[0]])))
    return sag > 2 + 0.3 * radius and sideways < 0.7 * float(arc.gravity_px @ down)
