"""A bounce fitted to a track: the ball in closed form, the camera a projective map.

Unknown are the restitution e, the first impact, the fall time T0, the contact's place A, the span
B, the perspective k, and, where asked for, the slope p of the restitution or the air's drag.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.drop.projection import Projection, projected
from recorders.simulators.bounce import Bounce
from tunenet_logs.arrays import Array

RESTITUTION, IMPACT, FALL, CONTACT, SPAN, PERSPECTIVE, SLOPE, DRAG = range(8)
"""Places of the unknowns: e, t1 [s], log T0, A [px], B [px], k, p, drag times drop height."""

IDEAL = (RESTITUTION, IMPACT, FALL, CONTACT, SPAN, PERSPECTIVE)
SLOPED = (*IDEAL, SLOPE)
DRAGGED = (*IDEAL, DRAG)
"""What is fitted of a ball that keeps its restitution, that does not, that the air slows."""

PRIORS_SD = {PERSPECTIVE: 0.7, SLOPE: 0.1, DRAG: 0.2}
"""Of k, from the camera poses that people use; of p and of the drag, from the balls."""

_FREEDOM = 8.0
_LOW = np.array([0.005, -np.inf, -np.inf, -np.inf, 1.0, -2.5, -0.5, 0.0])
_HIGH = np.array([1.0, np.inf, np.inf, np.inf, np.inf, 2.5, 0.5, 2.0])
_BENDS = 16
"""Pieces of a drop in each of which what a lens bends is much the same."""

_OF_THE_BALL = (RESTITUTION, SLOPE, DRAG)
_SHORT = 1e-5
_FARTHEST = 1.5
"""How far from its start a fall time or an impact may go: a factor e^1.5, 1.5 fall times."""

_LEAST_DAMPING, _MOST_TRIES = 1e-9, 6


@dataclass(frozen=True, eq=False)
class Samples:
    """What a fit is to explain.

    Attributes:
        seconds: shape (T,).
        places_px: along the image's vertical, up positive, shape (T,).
        noise_px: standard deviation of a place, at least.
        bent: share of its square that is no noise but what a lens may bend.
        drag_1_s2: drag [1/m] that is known, times half the gravity: with T0^2 times it, the drag
            times the drop height.
        exposure_s: for which a shutter may have been open, around the time of a sample.
    """

    seconds: Array
    places_px: Array
    noise_px: float
    bent: float = 0.0
    drag_1_s2: float = 0.0
    exposure_s: float = 0.0

    def bounce(self, unknowns: Array) -> Bounce:
        """The ball of these unknowns."""
        known = self.drag_1_s2 * np.exp(2 * unknowns[FALL])
        drag = float(unknowns[DRAG] + known)
        return Bounce(float(unknowns[RESTITUTION]), float(unknowns[SLOPE]), drag)

    def left_px(self, unknowns: Array) -> Array:
        """What the ball and the camera of these unknowns leave, shape (T,)."""
        heights = self.bounce(unknowns).heights(self.times(unknowns))
        shape = projected(heights, float(unknowns[PERSPECTIVE]))
        return unknowns[CONTACT] + unknowns[SPAN] * shape - self.places_px

    def slopes(self, unknowns: Array, free: tuple[int, ...]) -> Array:
        """How what is left changes with each of the free unknowns, shape (T, len(free))."""
        times = self.times(unknowns)
        heights = self.bounce(unknowns).heights(times)
        grow = float(np.exp(unknowns[PERSPECTIVE]))
        depth = np.maximum(1 + (grow - 1) * heights, 1e-3)
        px_per_height = unknowns[SPAN] * grow / depth**2
        columns = {
            CONTACT: np.ones(len(times)),
            SPAN: grow * heights / depth,
            PERSPECTIVE: px_per_height * heights * (1 - heights),
        }
        for one in free:
            if one in _OF_THE_BALL:
                moved = unknowns.copy()
                moved[one] += _SHORT if unknowns[one] < _HIGH[one] - _SHORT else -_SHORT
                rise = self.bounce(moved).heights(times) - heights
                columns[one] = px_per_height * rise / (moved[one] - unknowns[one])
        if IMPACT in free or FALL in free:
            speeds = (self.bounce(unknowns).heights(times + _SHORT) - heights) / _SHORT
            columns[IMPACT] = -px_per_height * speeds / np.exp(unknowns[FALL])
            columns[FALL] = -px_per_height * speeds * times
        return np.column_stack([columns[one] for one in free])

    def times(self, unknowns: Array) -> Array:
        """Of the samples [fall times after the first impact]."""
        return (self.seconds - unknowns[IMPACT]) / np.exp(unknowns[FALL])


@dataclass(frozen=True, eq=False)
class FilmFit:
    """A fitted track.

    Attributes:
        unknowns: shape (8,), see `RESTITUTION`.
        free: which of them were fitted.
        left_px: what is left, shape (T,).
        scale_px: robust standard deviation of it, not below the samples' noise.
    """

    samples: Samples
    unknowns: Array
    free: tuple[int, ...]
    left_px: Array
    scale_px: float

    @property
    def worth(self) -> float:
        """How many samples are worth one where a lens bends the picture: that is no noise."""
        return 1 + self.samples.bent * max(len(self.left_px) / _BENDS - 1, 0.0)

    @property
    def nearly_worst_px(self) -> float:
        """What 9 of 10 samples lie within, as a standard deviation."""
        return float(np.quantile(np.abs(self.left_px), 0.9)) / 1.645

    def cost(self, scale_px: float) -> float:
        """Minus the log posterior density, but for what all fits to the samples share."""
        return _cost(self.left_px, self.unknowns, scale_px, self.free)

    def projection(self) -> Projection:
        """In words."""
        values = [float(one) for one in self.unknowns]
        return Projection(
            contact_px=values[CONTACT],
            span_px=values[SPAN],
            perspective=values[PERSPECTIVE],
            impact_s=values[IMPACT],
            fall_time_s=float(np.exp(values[FALL])),
            bounce=self.samples.bounce(self.unknowns),
            residual_px=float(np.sqrt(np.mean(self.left_px**2))),
            worst_px=float(np.abs(self.left_px).max()),
        )


def fit_film(
    samples: Samples,
    start: Array,
    free: tuple[int, ...],
    most: int = 30,
    gain: float = 1e-6,
    scale_px: float | None = None,
) -> FilmFit:
    """Robust least squares (Student's t of 8) by Levenberg and Marquardt's steps.

    Args:
        samples: what to explain.
        start: all unknowns, shape (8,).
        free: which of them to fit.
        most: steps.
        gain: in cost that ends them.
        scale_px: standard deviation of a place; None to find it as well.
    """
    low, high = _bounds(start)
    unknowns = np.clip(start, low, high)
    left = samples.left_px(unknowns)
    scale = scale_px or _scale(left, samples.noise_px)
    cost = _cost(left, unknowns, scale, free)
    damping = 1e-3
    for _ in range(most):
        normal, pull = _normal(samples, unknowns, left, scale, free)
        before = cost
        for _ in range(_MOST_TRIES):
            tried = unknowns.copy()
            held = normal + damping * np.diag(np.diag(normal) + 1e-12)
            tried[list(free)] += np.linalg.lstsq(held, pull, rcond=None)[0]
            tried = np.clip(tried, low, high)
            tried_left = samples.left_px(tried)
            tried_cost = _cost(tried_left, tried, scale, free)
            if tried_cost < cost:
                unknowns, left, cost = tried, tried_left, tried_cost
                damping = max(damping / 10, _LEAST_DAMPING)
                break
            damping *= 10
        gained = before - cost
        new = scale_px or _scale(left, samples.noise_px)
        settled = gained < gain * len(left) and abs(new / scale - 1) < 0.01
        scale, cost = new, _cost(left, unknowns, new, free)
        if settled:
            break
    return FilmFit(samples, unknowns, free, left, scale)


def _bounds(start: Array) -> tuple[Array, Array]:
    low, high = _LOW.copy(), _HIGH.copy()
    reach = {FALL: _FARTHEST, IMPACT: _FARTHEST * float(np.exp(start[FALL]))}
    for one, far in reach.items():
        low[one], high[one] = start[one] - far, start[one] + far
    return low, high


def _normal(
    samples: Samples, unknowns: Array, left: Array, scale: float, free: tuple[int, ...]
) -> tuple[Array, Array]:
    slopes = samples.slopes(unknowns, free)
    weights = (_FREEDOM + 1) / (_FREEDOM + (left / scale) ** 2) / scale**2
    normal = slopes.T @ (weights[:, None] * slopes)
    pull = -slopes.T @ (weights * left)
    for at, one in enumerate(free):
        if one in PRIORS_SD:
            normal[at, at] += PRIORS_SD[one] ** -2
            pull[at] -= unknowns[one] * PRIORS_SD[one] ** -2
    return normal, pull


def _scale(left: Array, noise_px: float) -> float:
    return max(noise_px, 1.4826 * float(np.median(np.abs(left))))


def _cost(left: Array, unknowns: Array, scale: float, free: tuple[int, ...]) -> float:
    robust = 0.5 * (_FREEDOM + 1) * np.log1p((left / scale) ** 2 / _FREEDOM).sum()
    prior = sum((unknowns[one] / PRIORS_SD[one]) ** 2 for one in free if one in PRIORS_SD)
    return float(robust + len(left) * np.log(scale) + 0.5 * prior)
