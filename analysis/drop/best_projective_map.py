"""The best projective map of a curve of heights onto a track: the camera that suits it most.

A height u [drop heights] appears at A + B phi(u), phi(u) = e^k u / (1 + (e^k - 1) u). Given the
perspective k, the contact's place A and the span B follow in closed form; k is found by a search
over a line, with a prior that keeps it to cameras that people use. So an uncalibrated camera costs
nothing to a comparison: what is left of a track without its best map is what the curve has wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tunenet_logs.arrays import Array

PERSPECTIVE_SD = 0.7
"""Prior of k: from the camera poses that people use."""

_COARSE = np.arange(-2.0, 2.01, 0.25)
_FINE = np.arange(-0.25, 0.26, 0.0625)
_LEAST_DEPTH = 0.05
_LEAST_NOISE = 1e-9


@dataclass(frozen=True)
class ProjectiveMap:
    """From heights to places.

    Attributes:
        contact: A, where height 0 is.
        span: B, from there to where height 1 is.
        perspective: k.
    """

    contact: float
    span: float
    perspective: float

    def places(self, heights: Array) -> Array:
        """Where heights [drop heights] appear."""
        return self.contact + self.span * _seen(heights, np.array(self.perspective))


def best_map(heights: Array, places: Array, noise: float) -> ProjectiveMap:
    """The map that puts a curve of heights nearest to a track.

    Args:
        heights: of the curve [drop heights], shape (T,); NaN is left out.
        places: of the track at the same times, shape (T,); NaN is left out. At least three of both.
        noise: standard deviation of a place: how much the track may say against the prior of k.
    """
    known = np.isfinite(heights) & np.isfinite(places)
    heights, places = heights[known], places[known]
    noise = max(noise, _LEAST_NOISE)
    best = 0.0
    for grid in (_COARSE, _FINE):
        tried = best + grid
        costs = _left(heights, places, tried) / noise**2 + (tried / PERSPECTIVE_SD) ** 2
        best = _lowest(tried, costs)
    curve = _seen(heights, np.array(best))
    off = curve - curve.mean()
    span = float(off @ places / max(off @ off, _LEAST_NOISE))
    return ProjectiveMap(float(places.mean() - span * curve.mean()), span, best)


def _seen(heights: Array, perspective: Array) -> Array:
    grow = np.exp(perspective)
    return grow * heights / np.maximum(1 + (grow - 1) * heights, _LEAST_DEPTH)


def _left(heights: Array, places: Array, perspectives: Array) -> Array:
    """Squares that the best A and B leave of the track for each k, shape (K,)."""
    curves = _seen(heights, perspectives[:, None])
    curves = curves - curves.mean(axis=1, keepdims=True)
    off = places - places.mean()
    power = np.maximum(np.einsum("kt,kt->k", curves, curves), _LEAST_NOISE)
    return off @ off - (curves @ off) ** 2 / power


def _lowest(places: Array, costs: Array) -> float:
    """Where the parabola through the lowest of evenly spaced points and its neighbours turns."""
    at = int(np.argmin(costs))
    if not 0 < at < len(costs) - 1:
        return float(places[at])
    before, here, after = costs[at - 1 : at + 2]
    bend = before - 2 * here + after
    share = 0.0 if bend <= 0 else 0.5 * (before - after) / bend
    return float(places[at] + share * (places[at + 1] - places[at]))
