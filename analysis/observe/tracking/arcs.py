"""The longest free flight among the candidates: what no hand, shadow or person does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.observe.tracking.blobs import Blobs

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_STRIDES_S = (0.016, 0.033, 0.06)
_STRIDES = (1, 2, 4, 7)
"""In pictures: how fast a film plays need not be how fast it was filmed."""

_MOST_SEEDS = 1500
_FINALISTS = 60
_LEAST_GROWN = 5
_LEAST_FRAMES = 6
_ENOUGH_FRAMES = 30
_COLOUR_APART = 70.0
_AREA_RATIO = 2.2
_WAYS = (((0.0, 1.0), 1.5), ((0.0, -1.0), 1.0), ((1.0, 0.0), 1.0), ((-1.0, 0.0), 1.0))
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


@dataclass(frozen=True, eq=False)
class Candidates:
    """The blobs of all pictures as one table, NaN where a picture has fewer.

    Attributes:
        seconds: shape (T,).
        places_px: shape (T, M, 2).
        areas_px: shape (T, M).
        colours: shape (T, M, 3).
        whole: shape (T, M).
        misfits: shape (T, M).
    """

    seconds: Array
    places_px: Array
    areas_px: Array
    colours: Array
    whole: NDArray[np.bool_]
    misfits: Array


def tabulate(seconds: Array, blobs: Sequence[Blobs]) -> Candidates:
    """Put the blobs of T pictures into one table."""
    most = max((len(one) for one in blobs), default=0)
    places = np.full((len(blobs), most, 2), np.nan)
    areas = np.full((len(blobs), most), np.nan)
    colours = np.full((len(blobs), most, 3), np.nan)
    whole = np.zeros((len(blobs), most), dtype=bool)
    misfits = np.zeros((len(blobs), most))
    for index, one in enumerate(blobs):
        places[index, : len(one)] = one.places_px
        areas[index, : len(one)] = one.areas_px
        colours[index, : len(one)] = one.colours
        whole[index, : len(one)] = one.whole
        misfits[index, : len(one)] = one.misfits
    return Candidates(seconds, places, areas, colours, whole, misfits)


def longest_arc(table: Candidates) -> Arc | None:
    """The free flight that goes farthest; down the picture unless another is far better.

    A video without its rotation flag falls sideways. And a bounce, seen upside down, looks a little
    like a flight.
    """
    found = [(_longest_towards(table, np.array(way)), favour) for way, favour in _WAYS]
    scored = [(favour * _score(table, arc), arc) for arc, favour in found if arc is not None]
    return max(scored, key=lambda one: one[0])[1] if scored else None


def _longest_towards(table: Candidates, down: Array) -> Arc | None:
    seeds = _seeds(table, down)
    if not len(seeds):
        return None
    if len(seeds) > _MOST_SEEDS:
        seeds = seeds[np.linspace(0, len(seeds) - 1, _MOST_SEEDS).astype(int)]
    tried = []
    for index, seed in enumerate(seeds):
        arc = _grow(table, seed, 1)
        if arc is not None and len(arc.frames) >= _LEAST_GROWN:
            tried.append((_score(table, arc), index))
    best, best_score = None, 0.0
    for _, index in sorted(tried, reverse=True)[:_FINALISTS]:
        arc = _grow(table, seeds[index], 4)
        if arc and _is_flight(table, arc, down) and _score(table, arc) > best_score:
            best, best_score = arc, _score(table, arc)
    return best


def _seeds(table: Candidates, down: Array) -> Index:
    """Triples of alike candidates that accelerate downward: rows of 3 frames, 3 candidates."""
    period = float(np.median(np.diff(table.seconds)))
    strides = sorted({*_STRIDES, *(max(1, round(stride / period)) for stride in _STRIDES_S)})
    rows: list[Index] = []
    for stride in strides:
        for first in range(len(table.seconds) - 2 * stride):
            frames = np.array([first, first + stride, first + 2 * stride])
            rows.append(_alike(table, frames, down))
    return np.concatenate(rows) if rows else np.empty((0, 6), np.intp)


def _alike(table: Candidates, frames: Index, down: Array) -> Index:
    early, middle, late = table.seconds[frames]
    places, areas, colours = (
        part[frames] for part in (table.places_px, table.areas_px, table.colours)
    )
    a, b, c = np.meshgrid(*[np.flatnonzero(np.isfinite(one)) for one in areas], indexing="ij")
    a, b, c = a.ravel(), b.ravel(), c.ravel()
    ratio = np.log(np.stack([areas[0][a], areas[1][b], areas[2][c]]))
    alike = np.ptp(ratio, axis=0) < np.log(_AREA_RATIO)
    for one, other in ((colours[0][a], colours[1][b]), (colours[1][b], colours[2][c])):
        alike &= np.linalg.norm(one - other, axis=1) < _COLOUR_APART
    a, b, c = a[alike], b[alike], c[alike]
    before = (places[1][b] - places[0][a]) / (middle - early)
    after = (places[2][c] - places[1][b]) / (late - middle)
    bend = (after - before) * (late - early) / 2  # over the triple [px]
    towards = bend @ down
    sideways = np.abs(bend @ np.array([down[1], -down[0]]))
    travel = np.linalg.norm(places[2][c] - places[0][a], axis=1)
    good = (towards > 0.25) & (towards > sideways) & (travel > 2)
    chosen = np.stack([a, b, c], axis=1)[good]
    return np.hstack([np.broadcast_to(frames, chosen.shape), chosen])


def _grow(table: Candidates, seed: Index, rounds: int) -> Arc | None:
    """Extend a triple to all pictures around it that lie on its parabola."""
    frames, chosen = seed[:3], seed[3:]
    area = float(np.median(table.areas_px[frames, chosen]))
    colour = np.median(table.colours[frames, chosen], axis=0)
    tolerance = 1.0 + 0.35 * np.sqrt(area / np.pi)
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
        alike = np.linalg.norm(table.colours[window] - colour, axis=2) < _COLOUR_APART
        alike &= np.abs(np.log(table.areas_px[window] / area)) < np.log(2 * _AREA_RATIO)
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
    """How far it flies in its own sizes, by how many pictures say so."""
    places = table.places_px[arc.frames, arc.chosen]
    area = float(np.median(table.areas_px[arc.frames, arc.chosen]))
    travel = float(np.linalg.norm(np.ptp(places, axis=0)))
    return travel / (2 + np.sqrt(area)) * min(len(arc.frames), _ENOUGH_FRAMES)


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


def _is_flight(table: Candidates, arc: Arc, down: Array) -> bool:
    if len(arc.frames) < _LEAST_FRAMES:
        return False
    clock = table.seconds[arc.frames]
    area = float(np.median(table.areas_px[arc.frames, arc.chosen]))
    sag = float(arc.gravity_px @ down) * float(np.ptp(clock)) ** 2 / 8
    sideways = abs(float(arc.gravity_px @ np.array([down[1], -down[0]])))
    return sag > 2 + 0.3 * np.sqrt(area / np.pi) and sideways < 0.7 * float(arc.gravity_px @ down)
