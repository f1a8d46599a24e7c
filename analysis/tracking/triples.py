"""Triples of candidates at even strides that bend as a fall does: seeds of a flight."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from analysis.tracking.candidates import Candidates
from tunenet_logs.arrays import Array

Index = NDArray[np.intp]

_STRIDES_S = (0.016, 0.033, 0.06)
# Between the pictures of a triple, in seconds and in pictures: how fast a film plays need not be
# how fast it was filmed.
_STRIDES = (1, 2, 4, 7)

MIN_BEND_PX = 0.25
_MIN_TRAVEL_PX = 2.0  # of a triple: noise bends less, and what stands travels less
# Of four further pictures at the same stride: those on a triple's parabola, if it is a flight.
_MIN_WITNESSES = 2

# Pictures in which triples are looked for at once: it bounds the memory of a long film.
_AT_ONCE = 2048

# Distance in RGB (0 to 255): blur and light change a flying ball's colour by less.
COLOUR_APART = 70.0

# Of one candidate's area to the next one's: blur and a bad outline change it by less.
AREA_RATIO = 2.2


def accelerated_triples(table: Candidates) -> tuple[Index, Array]:
    """Find triples of alike candidates on a parabola that others lie on; those with most first.

    Returns:
        Rows of 3 frames and 3 candidates, shape (S, 6); and how far each bends [px], shape (S, 2).
    """
    period = float(np.median(np.diff(table.seconds)))
    strides = sorted({*_STRIDES, *(max(1, round(stride / period)) for stride in _STRIDES_S)})
    seeds, bends, witnesses = [], [], []
    for stride in strides:
        triples = _alike(table, stride)
        early, middle, late = (table.seconds[triples[:, row]] for row in range(3))
        a, b, c = (table.places_px[triples[:, row], triples[:, row + 3]] for row in range(3))
        before = (b - a) / (middle - early)[:, None]
        after = (c - b) / (late - middle)[:, None]
        bend = (after - before) * (late - early)[:, None] / 2  # over the triple [px]
        travel = np.linalg.norm(c - a, axis=1)
        moving = (np.abs(bend).max(axis=1) > MIN_BEND_PX) & (travel > _MIN_TRAVEL_PX)
        triples, bend = triples[moving], bend[moving]
        seen = sum(
            (_witnessed(table, triples, step * stride) for step in (-2, -1, 3, 4)),
            np.zeros(len(triples), int),
        )
        kept = seen >= _MIN_WITNESSES
        seeds.append(triples[kept])
        bends.append(bend[kept])
        witnesses.append(seen[kept])
    order = np.argsort(-np.concatenate(witnesses), kind="stable")
    return np.concatenate(seeds)[order], np.concatenate(bends)[order]


def _alike(table: Candidates, stride: int) -> Index:
    """Pair every candidate with all that look like it one stride on, and two, shape (K, 6)."""
    count = len(table.seconds)
    parts = [np.empty((0, 6), np.intp)]
    for begin in range(0, count - 2 * stride, _AT_ONCE):
        part = table.some(np.arange(begin, min(begin + _AT_ONCE + 2 * stride, count)))
        areas, colours = np.log(part.areas_px), part.colours
        ratio = np.abs(areas[:-stride, :, None] - areas[stride:, None])
        apart = np.linalg.norm(colours[:-stride, :, None] - colours[stride:, None], axis=3)
        same = (ratio < np.log(AREA_RATIO)) & (apart < COLOUR_APART)  # NaN is not
        first, *chosen = np.nonzero(same[:-stride, :, :, None] & same[stride:, None])
        frames = begin + first[:, None] + stride * np.arange(3)
        parts.append(np.column_stack([frames, *chosen]))
    return np.concatenate(parts)


def _witnessed(table: Candidates, triples: Index, step: int) -> Index:
    """Flag triples whose parabola has a look-alike on it `step` pictures after its first."""
    frames = triples[:, 0] + step
    there = np.clip(frames, 0, len(table.seconds) - 1)
    times = [table.seconds[triples[:, row]] for row in range(3)]
    positions = [table.places_px[triples[:, row], triples[:, row + 3]] for row in range(3)]
    when = table.seconds[there]
    expected = np.zeros((len(triples), 2))
    for row in range(3):  # Lagrange's parabola
        basis = np.ones(len(triples))
        for other in {0, 1, 2} - {row}:
            basis *= (when - times[other]) / (times[row] - times[other])
        expected += basis[:, None] * positions[row]
    area = table.areas_px[triples[:, 1], triples[:, 4]]
    colour = table.colours[triples[:, 1], triples[:, 4]]
    off = np.linalg.norm(table.places_px[there] - expected[:, None], axis=2)
    near, one = np.nonzero(off < 2 * np.asarray(tolerance_px(area))[:, None])  # NaN is not
    alike = np.linalg.norm(table.colours[there[near], one] - colour[near], axis=1) < COLOUR_APART
    alike &= np.abs(np.log(table.areas_px[there[near], one] / area[near])) < np.log(2 * AREA_RATIO)
    seen = np.zeros(len(triples), np.intp)
    seen[near[alike]] = 1
    return np.where(frames == there, seen, 0)


def tolerance_px(area_px: Array | float) -> Array | float:
    """Return how far off a parabola a candidate may be: a third of its radius, and noise."""
    return 1.0 + 0.35 * np.sqrt(np.asarray(area_px) / np.pi)
