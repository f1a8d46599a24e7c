"""Bounce seen by an uncalibrated camera: heights through an unknown projective map.

Along the image of the vertical a height u [drop heights] above contact appears at
p = A + B phi(u), phi(u) = e^k u / (1 + (e^k - 1) u): contact at A, drop height at A + B, and k the
perspective between the two. It is the projective map of a line, which three points fix and which
keeps the cross-ratio of four (Hartley and Zisserman 2004). Time is in fall times T0 after the first
impact. So five numbers and a ball predict a track, for any camera, height and frame rate.

Given k, A and B follow in closed form; k is found by a search over a line. So an uncalibrated
camera costs a comparison of curves nothing: what the best map leaves of a track is the curve's
error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recorders.simulators.closed_form.bounce import Bounce
from tunenet_logs.arrays import Array

PERSPECTIVE_SD = 0.7  # prior of k, normal about 0: from the camera poses that people use
_COARSE = np.arange(-2.0, 2.01, 0.25)
# Perspectives that are tried, and then differences from the best of them.
_FINE = np.arange(-0.25, 0.26, 0.0625)

# Least depth [depth of the contact]: a height above the camera has no image. A best map is for any
# curve, and keeps farther away.
_NEAREST, _NEAREST_OF_MAP = 1e-3, 0.05

_MIN_NOISE = 1e-9  # in place of 0


@dataclass(frozen=True, eq=False)
class Projection:
    """Camera along the image's vertical, and the ball that it sees.

    Attributes:
        contact: A, along the image's vertical, up positive.
        span: B.
        perspective: k.
        bends: from when on [s] A moves by how much a second, each on top of the others: a ball that
            goes sideways comes nearer to the camera or goes away from it, otherwise after each
            bounce.
        impact_s: the first impact [s].
        fall_time_s: T0, without air [s].
        bounce: the ball.
        residual_rms: root mean square of the track's residuals.
        residual_max: the largest of them.
    """

    contact: float
    span: float
    perspective: float
    impact_s: float
    fall_time_s: float
    bounce: Bounce
    residual_rms: float
    residual_max: float
    bends: tuple[tuple[float, float], ...] = ()

    def contacts(self, seconds: Array) -> Array:
        """Return where contact is at these times, shape (T,)."""
        moved = [rate * np.maximum(seconds - since_s, 0.0) for since_s, rate in self.bends]
        return self.contact + np.sum([np.zeros(len(seconds)), *moved], axis=0)

    def heights(self, positions: Array, seconds: Array) -> Array:
        """Convert positions along the vertical at these times to [drop heights], shape (T,)."""
        fraction = (positions - self.contacts(seconds)) / self.span
        grow = np.exp(self.perspective)
        return fraction / np.maximum(grow - (grow - 1) * fraction, _NEAREST)

    def positions(self, heights: Array, seconds: Array) -> Array:
        """Project heights [drop heights] at these times onto the vertical, shape (T,)."""
        return self.contacts(seconds) + self.span * projected(heights, self.perspective)

    def fall_times(self, seconds: Array) -> Array:
        """Convert times [s] to times [fall times after the first impact], shape (T,)."""
        return (seconds - self.impact_s) / self.fall_time_s

    def impacts(self, until_s: float) -> Array:
        """Return all impacts until then, in order [fall times after the first]; the first is 0."""
        last = (until_s - self.impact_s) / self.fall_time_s
        starts, _ = self.bounce.flights(last)
        return starts[starts <= max(last, 0.0)]


@dataclass(frozen=True)
class ProjectiveMap:
    """Projective map from heights to positions in the picture.

    Attributes:
        contact: A, where height 0 is.
        span: B, from there to where height 1 is.
        perspective: k.
    """

    contact: float
    span: float
    perspective: float

    def positions(self, heights: Array) -> Array:
        """Project heights [drop heights] into the picture, in the unit of `contact`, shape (T,)."""
        return self.contact + self.span * projected(heights, self.perspective, _NEAREST_OF_MAP)


def projected(heights: Array, perspective: float | Array, nearest: float = _NEAREST) -> Array:
    """Evaluate phi(u) at heights [drop heights]; k broadcasts with them."""
    grow = np.exp(perspective)
    return grow * heights / np.maximum(1 + (grow - 1) * heights, nearest)


def best_map(heights: Array, positions: Array, noise: float) -> ProjectiveMap:
    """Fit the projective map that puts a curve of heights nearest to a track, by least squares.

    Args:
        heights: of the curve [drop heights], shape (T,); NaN is left out.
        positions: of the track at the same times, in any unit, shape (T,); NaN is left out. At
            least three of both.
        noise: standard deviation of a position: how much the track counts against k's prior.
    """
    known = np.isfinite(heights) & np.isfinite(positions)
    heights, positions = heights[known], positions[known]
    noise = max(noise, _MIN_NOISE)
    off = positions - positions.mean()
    best = 0.0
    for grid in (_COARSE, _FINE):
        tried = best + grid
        curves = projected(heights, tried[:, None], _NEAREST_OF_MAP)
        curves = curves - curves.mean(axis=1, keepdims=True)
        power = np.maximum(np.einsum("kt,kt->k", curves, curves), _MIN_NOISE)
        squares = off @ off - (curves @ off) ** 2 / power  # that the best A and B of each k leave
        best = _lowest(tried, squares / noise**2 + (tried / PERSPECTIVE_SD) ** 2)
    curve = projected(heights, np.array(best), _NEAREST_OF_MAP)
    off_curve = curve - curve.mean()
    span = float(off_curve @ positions / max(off_curve @ off_curve, _MIN_NOISE))
    return ProjectiveMap(float(positions.mean() - span * curve.mean()), span, best)


def _lowest(values: Array, costs: Array) -> float:
    """Locate the vertex of the parabola through the lowest of even points and its neighbours."""
    at = int(np.argmin(costs))
    if not 0 < at < len(costs) - 1:
        return float(values[at])
    before, here, after = costs[at - 1 : at + 2]
    bend = before - 2 * here + after
    fraction = 0.0 if bend <= 0 else 0.5 * (before - after) / bend
    return float(values[at] + fraction * (values[at + 1] - values[at]))
