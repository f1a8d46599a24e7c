"""Three candidates at a time that may be one thing that falls: where flights are looked for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from analysis.tracking.candidates import Candidates
from tunenet_logs.arrays import Array

Index = NDArray[np.intp]

COLOUR_APART = 70.0
AREA_RATIO = 2.2
LEAST_BEND_PX = 0.25

_STRIDES_S = (0.016, 0.033, 0.06)
_STRIDES = (1, 2, 4, 7)
"""In pictures: how fast a film plays need not be how fast it was filmed."""

_LEAST_TRAVEL_PX = 2.0
_LEAST_WITNESSES = 2


def tolerance_px(area_px: Array | float) -> Array | float:
    """How far from a parabola a candidate of that size may be."""
    return 1.0 + 0.35 * np.sqrt(np.asarray(area_px) / np.pi)


def accelerated_triples(table: Candidates) -> tuple[Index, Array]:
    """Triples of alike candidates on a parabola that others lie on, too, those with most first.

    Returns:
        Rows of 3 frames and 3 candidates, shape (S, 6); and how far each bends [px], shape (S, 2).
    """
    period = float(np.median(np.diff(table.seconds)))
    strides = sorted({*_STRIDES, *(max(1, round(stride / period)) for stride in _STRIDES_S)})
    seeds, bends, witnesses = [], [], []
    for stride in strides:
        firsts = range(len(table.seconds) - 2 * stride)
        rows = [_alike(table, first + stride * np.arange(3)) for first in firsts]
        triples = np.concatenate([np.empty((0, 6), np.intp), *rows])
        bend, travel = _bend_and_travel(table, triples)
        moving = (np.abs(bend).max(axis=1) > LEAST_BEND_PX) & (travel > _LEAST_TRAVEL_PX)
        triples, bend = triples[moving], bend[moving]
        seen = sum(
            (_witnessed(table, triples, step * stride) for step in (-2, -1, 3, 4)),
            np.zeros(len(triples), int),
        )
        kept = seen >= _LEAST_WITNESSES
        seeds.append(triples[kept])
        bends.append(bend[kept])
        witnesses.append(seen[kept])
    order = np.argsort(-np.concatenate(witnesses), kind="stable")
    return np.concatenate(seeds)[order], np.concatenate(bends)[order]


def _alike(table: Candidates, frames: Index) -> Index:
    """Every candidate of three pictures with every one that looks like it."""
    areas, colours = table.areas_px[frames], table.colours[frames]
    a, b, c = (np.flatnonzero(np.isfinite(one)) for one in areas)
    same = [
        _look_alike(areas[i][one], colours[i][one], areas[i + 1][two], colours[i + 1][two])
        for i, one, two in ((0, a, b), (1, b, c))
    ]
    first, second, third = np.nonzero(same[0][:, :, None] & same[1][None])
    chosen = np.stack([a[first], b[second], c[third]], axis=1)
    return np.hstack([np.broadcast_to(frames, chosen.shape), chosen])


def _look_alike(areas: Array, colours: Array, others: Array, theirs: Array) -> NDArray[np.bool_]:
    """Shape (N, M)."""
    ratio = np.abs(np.log(areas[:, None] / others))
    apart = np.linalg.norm(colours[:, None] - theirs, axis=2)
    return (ratio < np.log(AREA_RATIO)) & (apart < COLOUR_APART)


def _bend_and_travel(table: Candidates, triples: Index) -> tuple[Array, Array]:
    early, middle, late = (table.seconds[triples[:, one]] for one in range(3))
    one, two, three = (table.places_px[triples[:, at], triples[:, at + 3]] for at in range(3))
    before = (two - one) / (middle - early)[:, None]
    after = (three - two) / (late - middle)[:, None]
    bend = (after - before) * (late - early)[:, None] / 2  # over the triple [px]
    return bend, np.linalg.norm(three - one, axis=1)


def _witnessed(table: Candidates, triples: Index, step: int) -> NDArray[np.intp]:
    """Whether one that looks alike lies on the parabola so many pictures after its first."""
    frames = triples[:, 0] + step
    there = np.clip(frames, 0, len(table.seconds) - 1)
    times = [table.seconds[triples[:, one]] for one in range(3)]
    places = [table.places_px[triples[:, at], triples[:, at + 3]] for at in range(3)]
    when = table.seconds[there]
    expected = np.zeros((len(triples), 2))
    for one in range(3):  # Lagrange's parabola
        share = np.ones(len(triples))
        for other in {0, 1, 2} - {one}:
            share *= (when - times[other]) / (times[one] - times[other])
        expected += share[:, None] * places[one]
    area = table.areas_px[triples[:, 1], triples[:, 4]]
    colour = table.colours[triples[:, 1], triples[:, 4]]
    off = np.linalg.norm(table.places_px[there] - expected[:, None], axis=2)
    near = off < 2 * np.asarray(tolerance_px(area))[:, None]  # NaN is not
    near &= np.linalg.norm(table.colours[there] - colour[:, None], axis=2) < COLOUR_APART
    near &= np.abs(np.log(table.areas_px[there] / area[:, None])) < np.log(2 * AREA_RATIO)
    return (near.any(axis=1) & (frames == there)).astype(np.intp)
