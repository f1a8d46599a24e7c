"""A bounce fitted to a track: the ball in closed form, the camera a projective map.

Unknown are the restitution e, the first impact, the fall time T0, the contact's position A, the
span B, the perspective k, and, where asked for, the slope p of the restitution or the air's drag.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.drop.bounce_fit import SLOPE_SD
from analysis.drop.projection import PERSPECTIVE_SD, Projection, projected
from recorders.simulators.closed_form.bounce import Bounce
from tunenet_logs.arrays import Array

RESTITUTION, IMPACT, FALL, CONTACT, SPAN, PERSPECTIVE, SLOPE, DRAG = range(8)
"""Indices of the unknowns: e, t1 [s], log T0, A [px], B [px], k, p, drag times drop height."""

IDEAL = (RESTITUTION, IMPACT, FALL, CONTACT, SPAN, PERSPECTIVE)
SLOPED = (*IDEAL, SLOPE)
DRAGGED = (*IDEAL, DRAG)
"""What is fitted of a ball that keeps its restitution, that does not, that the air slows."""

PRIORS_SD = {PERSPECTIVE: PERSPECTIVE_SD, SLOPE: SLOPE_SD, DRAG: 0.2}
"""Normal about 0. Of the drag times drop height: a table-tennis ball has .2 from 1.5 m."""

_FREEDOM = 8.0
"""Degrees of freedom of Student's t: nearly normal; 10 standard deviations off, a tenth counts."""

_LOW = np.array([0.005, -np.inf, -np.inf, -np.inf, 1.0, -2.5, -0.5, 0.0])
_HIGH = np.array([1.0, np.inf, np.inf, np.inf, np.inf, 2.5, 0.5, 2.0])
"""Of the unknowns, beyond what any ball or camera has."""

_BENDS = 16
"""Pieces of a drop in each of which a lens's distortion is much the same."""

_OF_THE_BALL = (RESTITUTION, SLOPE, DRAG)
_SHORT = 1e-5
"""Of an unknown of the ball, or of time [fall times], by which it is differentiated."""

_FARTHEST = 1.5
"""How far from its start a fall time or an impact may go: a factor e^1.5, 1.5 fall times."""

_LEAST_DAMPING, _MOST_TRIES = 1e-9, 6
"""Of Levenberg and Marquardt: damping below which a step is Gauss-Newton's, and dampings a step."""

_RESTITUTIONS = np.linspace(0.02, 0.995, 40)
_STRETCHES = np.exp(np.linspace(np.log(0.92), np.log(3.2), 22))
_PERSPECTIVES = np.array([-0.8, -0.25, 0.3, 0.9])
"""The grid of a fit's starts: its cost has dozens of local minima. Fall times in durations of the
part of the fall that is seen; perspectives within about one standard deviation of their prior."""

_MOST_SAMPLES = 96
"""Of a track that the 3520 points of the grid are compared with: more cost more than they gain."""

_COMPARED = 5.0
"""Fall durations after the impact that are looked at."""


@dataclass(frozen=True, eq=False)
class TrackSamples:
    """What a fit is to explain.

    Attributes:
        seconds: shape (T,).
        positions_px: along the image's vertical, up positive, shape (T,).
        noise_px: standard deviation of a position, at least.
        distortion_variance_fraction: of its square, what is no noise but a lens's distortion.
        drag_1_s2: drag [1/m] that is known, times half the gravity: with T0^2 times it, the drag
            times the drop height.
        exposure_s: for which a shutter may have been open, around the time of a sample.
    """

    seconds: Array
    positions_px: Array
    noise_px: float
    distortion_variance_fraction: float = 0.0
    drag_1_s2: float = 0.0
    exposure_s: float = 0.0

    def part(self, first: int, last: int) -> TrackSamples:
        """The samples from index `first` on, before `last`."""
        seconds, positions_px = self.seconds[first:last], self.positions_px[first:last]
        return replace(self, seconds=seconds, positions_px=positions_px)

    def bounce(self, unknowns: Array) -> Bounce:
        """The ball of these unknowns, shape (8,)."""
        known = self.drag_1_s2 * np.exp(2 * unknowns[FALL])
        drag = float(unknowns[DRAG] + known)
        return Bounce(float(unknowns[RESTITUTION]), float(unknowns[SLOPE]), drag)

    def residuals_px(self, unknowns: Array) -> Array:
        """Positions of the ball in the camera of these unknowns less those seen, shape (T,)."""
        heights = self.bounce(unknowns).heights(self.times(unknowns))
        shape = projected(heights, float(unknowns[PERSPECTIVE]))
        return unknowns[CONTACT] + unknowns[SPAN] * shape - self.positions_px

    def jacobian(self, unknowns: Array, free: tuple[int, ...]) -> Array:
        """Of the residuals over the free unknowns, shape (T, len(free))."""
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
        for index in set(free).intersection(_OF_THE_BALL):
            moved = unknowns.copy()
            moved[index] += _SHORT if unknowns[index] < _HIGH[index] - _SHORT else -_SHORT
            rise = self.bounce(moved).heights(times) - heights
            columns[index] = px_per_height * rise / (moved[index] - unknowns[index])
        if IMPACT in free or FALL in free:
            speeds = (self.bounce(unknowns).heights(times + _SHORT) - heights) / _SHORT
            columns[IMPACT] = -px_per_height * speeds / np.exp(unknowns[FALL])
            columns[FALL] = -px_per_height * speeds * times
        return np.column_stack([columns[index] for index in free])

    def times(self, unknowns: Array) -> Array:
        """Of the samples [fall times after the first impact], shape (T,)."""
        return (self.seconds - unknowns[IMPACT]) / np.exp(unknowns[FALL])


@dataclass(frozen=True, eq=False)
class FilmFit:
    """A fitted track.

    Attributes:
        samples: what was fitted.
        unknowns: shape (8,), see `RESTITUTION`.
        free: which of them were fitted.
        residuals_px: shape (T,).
        scale_px: robust standard deviation of them, not below the samples' noise.
    """

    samples: TrackSamples
    unknowns: Array
    free: tuple[int, ...]
    residuals_px: Array
    scale_px: float

    @property
    def effective_sample_factor(self) -> float:
        """How many samples count as one where a lens distorts the picture: that is no noise."""
        most = max(len(self.residuals_px) / _BENDS - 1, 0.0)
        return 1 + self.samples.distortion_variance_fraction * most

    @property
    def tail_sd_px(self) -> float:
        """Standard deviation by what 9 of 10 residuals lie within."""
        return float(np.quantile(np.abs(self.residuals_px), 0.9)) / 1.645

    def cost(self, scale_px: float) -> float:
        """Minus the log posterior density: Student's t and normal priors, without constants.

        Args:
            scale_px: standard deviation of a position.
        """
        squares = (self.residuals_px / scale_px) ** 2
        robust = 0.5 * (_FREEDOM + 1) * np.log1p(squares / _FREEDOM).sum()
        free_priors = [(index, sd) for index, sd in PRIORS_SD.items() if index in self.free]
        prior = sum((self.unknowns[index] / sd) ** 2 for index, sd in free_priors)
        return float(robust + len(self.residuals_px) * np.log(scale_px) + 0.5 * prior)

    def projection(self) -> Projection:
        """The unknowns by their names."""
        values = self.unknowns.tolist()
        return Projection(
            contact_px=values[CONTACT],
            span_px=values[SPAN],
            perspective=values[PERSPECTIVE],
            impact_s=values[IMPACT],
            fall_time_s=float(np.exp(values[FALL])),
            bounce=self.samples.bounce(self.unknowns),
            residual_rms_px=float(np.sqrt(np.mean(self.residuals_px**2))),
            residual_max_px=float(np.abs(self.residuals_px).max()),
        )


def fit_film(
    samples: TrackSamples,
    start: Array,
    free: tuple[int, ...],
    most: int = 30,
    gain: float = 1e-6,
    scale_px: float | None = None,
) -> FilmFit:
    """Robust least squares: Student's t by reweighting (Lange et al. 1989), Levenberg-Marquardt.

    The priors of `PRIORS_SD` are part of the cost: what is found is the posterior's mode.

    Args:
        samples: what to explain.
        start: all unknowns, shape (8,).
        free: which of them to fit.
        most: iterations.
        gain: in cost a sample that ends them.
        scale_px: standard deviation of a position; None to estimate it after each iteration.
    """
    low, high = _LOW.copy(), _HIGH.copy()
    for index, reach in ((FALL, _FARTHEST), (IMPACT, _FARTHEST * float(np.exp(start[FALL])))):
        low[index], high[index] = start[index] - reach, start[index] + reach
    unknowns = np.clip(start, low, high)
    residuals = samples.residuals_px(unknowns)
    scale = scale_px or _scale(residuals, samples.noise_px)
    fit = FilmFit(samples, unknowns, free, residuals, scale)
    cost, damping = fit.cost(scale), 1e-3
    for _ in range(most):
        normal, gradient = _normal_equations(fit)
        before = cost
        for _ in range(_MOST_TRIES):
            unknowns = fit.unknowns.copy()
            damped = normal + damping * np.diag(np.diag(normal) + 1e-12)
            unknowns[list(free)] += np.linalg.lstsq(damped, gradient, rcond=None)[0]
            unknowns = np.clip(unknowns, low, high)
            tried = FilmFit(samples, unknowns, free, samples.residuals_px(unknowns), scale)
            tried_cost = tried.cost(scale)
            if tried_cost < cost:
                fit, cost = tried, tried_cost
                damping = max(damping / 10, _LEAST_DAMPING)
                break
            damping *= 10
        gained = before - cost
        new = scale_px or _scale(fit.residuals_px, samples.noise_px)
        settled = gained < gain * len(samples.seconds) and abs(new / scale - 1) < 0.01
        scale, fit = new, replace(fit, scale_px=new)
        cost = fit.cost(scale)
        if settled:
            break
    return fit


def _normal_equations(fit: FilmFit) -> tuple[Array, Array]:
    """Of the reweighted samples and the priors: the matrix, and minus the cost's gradient."""
    jacobian = fit.samples.jacobian(fit.unknowns, fit.free)
    residuals, scale = fit.residuals_px, fit.scale_px
    weights = (_FREEDOM + 1) / (_FREEDOM + (residuals / scale) ** 2) / scale**2
    normal = jacobian.T @ (weights[:, None] * jacobian)
    gradient = -jacobian.T @ (weights * residuals)
    for at, index in enumerate(fit.free):
        if index in PRIORS_SD:
            normal[at, at] += PRIORS_SD[index] ** -2
            gradient[at] -= fit.unknowns[index] * PRIORS_SD[index] ** -2
    return normal, gradient


def _scale(residuals: Array, noise_px: float) -> float:
    """Standard deviation by the median of the moduli, not below the noise."""
    return max(noise_px, 1.4826 * float(np.median(np.abs(residuals))))


def grid_starts(seconds: Array, along_px: Array, impact_s: float, count: int) -> list[Array]:
    """The best points of a grid over the ideal ball, the fall time and the perspective.

    No two of them are neighbours. The contact's position and the span of the fall are in closed
    form for each point.

    Args:
        seconds: shape (T,): the fall, the bounces, nothing before or after.
        along_px: positions along the image's vertical, up positive, shape (T,).
        impact_s: the first impact, to half a sample.
        count: how many are wanted.

    Returns:
        The unknowns of a `FilmFit`, shape (8,) each, best first.
    """
    seen_s = impact_s - float(seconds[0])
    near = seconds < impact_s + _COMPARED * seen_s
    every = max(1, -(-int(near.sum()) // _MOST_SAMPLES))
    clock, positions = seconds[near][::every] - impact_s, along_px[near][::every]
    falls = seen_s * _STRETCHES
    times, kept = clock / falls[:, None], _RESTITUTIONS[:, None, None]
    after = np.clip(times, 0.0, None)
    bouncing = 1 - after * (1 - kept) / (2 * kept)  # e^n when flight n begins
    speeds = kept ** np.floor(np.log(np.maximum(bouncing, 1e-12)) / np.log(kept))
    since = after - 2 * kept * (1 - speeds) / (1 - kept)
    flying = np.clip(since * (2 * kept * speeds - since), 0.0, None)
    falling = 1 - np.clip(times + 1, 0.0, None) ** 2
    heights = np.where(times < 0, falling, np.where(bouncing > 0, flying, 0.0))
    shapes = projected(heights, _PERSPECTIVES[:, None, None, None])
    middle = shapes.mean(axis=-1, keepdims=True)
    off, about = shapes - middle, positions - positions.mean()
    spread = (off**2).sum(axis=-1)
    spans = (off @ about) / np.maximum(spread, 1e-12)
    squares = float(about @ about) - spans**2 * spread
    squares = np.where(spans > 0, squares, np.inf) + 1e-9
    starts: list[Array] = []
    taken = np.zeros(squares.shape, dtype=bool)
    while len(starts) < count and not taken.all():
        at = np.unravel_index(np.where(taken, np.inf, squares).argmin(), squares.shape)
        if not np.isfinite(squares[at]):
            break
        view, ball, fall = (int(index) for index in at)
        span = float(spans[at])
        contact = float(positions.mean() - span * middle[view, ball, fall, 0])
        law = [_RESTITUTIONS[ball], impact_s, np.log(falls[fall])]
        starts.append(np.array([*law, contact, span, _PERSPECTIVES[view], 0.0, 0.0]))
        taken[:, max(0, ball - 1) : ball + 2, max(0, fall - 2) : fall + 3] = True
    return starts
