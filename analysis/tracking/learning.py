"""How the ball looks, learnt from pictures in which it is about known where it is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from analysis.tracking.background import Background
from analysis.tracking.patches import Patch, cut_patch, straightened
from analysis.tracking.placing import FINE_PX, Appearance
from tunenet_logs.arrays import Array, Picture

Fine = NDArray[np.float32]

_LEAST_SAMPLES = 3
_ROUNDS = 4
_SETTLED = 0.01
_TELLING = 400.0
"""Squared difference of two colours that tells how much of a pixel is ball."""


def learn_appearance(
    samples: Sequence[Picture], background: Background, places_px: Array, areas_px: Array
) -> Appearance | None:
    """The ball's picture, from pictures in which it is about known where it is.

    Args:
        samples: uint8, shape (H, W, 3) each.
        background: without the ball.
        places_px: where the ball is in each, shape (N, 2); NaN where that is not known.
        areas_px: how large it is there, shape (N,).

    Returns:
        None where it is seen too seldom.
    """
    known = np.flatnonzero(np.isfinite(places_px[:, 0]) & np.isfinite(areas_px))
    if len(known) < _LEAST_SAMPLES:
        return None
    radius = float(np.quantile(np.sqrt(areas_px[known] / np.pi), 0.7))
    places = {int(at): (float(places_px[at, 0]), float(places_px[at, 1]), 0.0) for at in known}
    gains = {at: background.gain(samples[at]) for at in places}
    ball: Appearance | None = None
    for turn in range(_ROUNDS):
        zoom = min(1.0, FINE_PX / radius)
        patches, starts, used = [], [], []
        for at, (x, y, growth) in places.items():
            patch = cut_patch(samples[at], background, gains[at], (x, y), 1.3 * radius, zoom)
            if patch is not None:
                patches.append(patch)
                starts.append(np.array([*patch.here(x, y), growth, 0.0, 0.0, 0.0]))
                used.append(at)
        if len(patches) < _LEAST_SAMPLES:
            return None
        before, ball = ball, Appearance(_layers(patches, starts, radius * zoom), radius, zoom)
        if before is not None and abs(before.radius_px / radius - 1) < _SETTLED:
            return ball
        fitted = [
            ball.fit(one, start if turn > 1 else ball.nearest(one, start), 0.0)[0]
            for one, start in zip(patches, starts, strict=True)
        ]
        middle = float(np.median([values[2] for values in fitted]))
        for values in fitted:
            values[2] -= middle
        radius = _outline(patches, fitted, radius * zoom) * float(np.exp(middle)) / zoom
        for at, patch, values in zip(used, patches, fitted, strict=True):
            places[at] = (*patch.there(values[0], values[1]), float(values[2]))
    return ball


def _layers(patches: Sequence[Patch], places: Sequence[Array], radius: float) -> Fine:
    """The median of what is seen, inside a disc with smooth edges."""
    side = 2 * int(np.ceil(radius + 2)) + 1
    seen = np.stack(
        [straightened(one.seen, at, side) for one, at in zip(patches, places, strict=True)]
    )
    colours = np.median(seen, axis=0)
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    apart = np.hypot(x, y)
    share = np.clip(radius + 0.5 - apart, 0, 1)[:, :, None]
    # The colour at the edge is half background's: that of the ring within goes on to the edge.
    ring = np.maximum(apart, 1e-6)
    inward = np.minimum(1.0, max(radius - 1.2, 0.5) / ring)
    rows = np.clip(np.round(y * inward + (side - 1) / 2).astype(int), 0, side - 1)
    columns = np.clip(np.round(x * inward + (side - 1) / 2).astype(int), 0, side - 1)
    return np.concatenate([colours[rows, columns] * share, share], axis=2).astype(np.float32)


def _outline(patches: Sequence[Patch], places: Sequence[Array], radius: float) -> float:
    """The ball's radius in its own pixels: to where as often as not it is what differs."""
    side = 2 * int(np.ceil(1.6 * radius + 3)) + 1
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    apart = np.hypot(x, y)
    inner = np.median(
        [
            straightened(one.seen, at, side)[apart < 0.8 * radius]
            for one, at in zip(patches, places, strict=True)
        ],
        axis=0,
    ).mean(axis=0)
    shares = []
    for one, at in zip(patches, places, strict=True):
        seen, behind = straightened(one.seen, at, side), straightened(one.behind, at, side)
        towards = inner - behind
        size = (towards**2).sum(axis=2)
        share = ((seen - behind) * towards).sum(axis=2) / (size + 1.0)
        shares.append(np.where(size > _TELLING, np.clip(share, 0, 1), np.nan))
    with np.errstate(invalid="ignore"):
        stack = np.array(shares)
        enough = np.isfinite(stack).sum(axis=0) >= min(3, len(stack))
        middle = np.where(enough, np.nanmedian(np.where(enough, stack, 0.0), axis=0), np.nan)
    rings = np.arange(0.5 * radius, 1.5 * radius + 1, 0.5)
    profile = []
    for ring in rings:
        values = middle[np.abs(apart - ring) < 0.5]
        values = values[np.isfinite(values)]
        profile.append(float(np.median(values)) if len(values) > 3 else np.nan)
    known = np.isfinite(profile)
    below = np.flatnonzero(known & (np.array(profile) < 0.5))
    if not len(below) or below[0] == 0:
        return radius
    at = int(below[0])
    high, low = profile[at - 1], profile[at]
    part = (high - 0.5) / (high - low) if np.isfinite(high) and high > low else 0.5
    return float(np.clip(rings[at - 1] + 0.5 * part, 0.75 * radius, 1.35 * radius))
