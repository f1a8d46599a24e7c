"""The bounce in closed form, fitted to a recorded drop: restitution and its 95 % interval.

The network finds the right basin of a cost that has dozens; from there least squares over all
samples is efficient, and its profile likelihood says how sure the value is. What else is unknown
of a recording is fitted with it: the impact's time, the fall time, the drop height, the level of
the table.

No real ball is ideal: its restitution falls with speed, and the air slows it. Beside the ideal ball
stands one that does both, and the answer is the average of the two, weighted by how well each
explains the samples (Bayesian model averaging, linear about the ideal fit). So the interval tells
of what the samples cannot exclude, not only of their noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.drop.free_fall import Drop
from analysis.model_averaging import TWO_SIDED, ModelEstimate, average, correlation_time
from recorders.simulators.bounce import Bounce
from tunenet_logs.arrays import Array

Residual = Callable[[Array], Array]

_FALL_SEEN = 0.95
_REST_SEEN = 1.0
_FLIGHTS = (1, 2, 4, 8, 400)
_SLOPE_SD = 0.1
_DRAG_SD_1_M = 0.03
_REAL = 0.5
"""Priors: of p; of the deceleration over speed squared; of a ball that shows either."""

_EXACT = 1e-4
"""Of the drop height: what no recording, and no model of a ball, is held to."""

_LEAST_HALF_WIDTH = 2e-5
_STEP = 1e-3
_FIT_SD = 4.0
_FEWEST = 12
_UNKNOWNS = 5
_AT_IMPACT = 1.5
"""Samples to either side of an impact that a filter rounds."""


@dataclass(frozen=True)
class BounceFit:
    """A fitted drop.

    Attributes:
        restitution: at the first impact.
        interval95: of the restitution.
        real: probability that the ball shows drag or a restitution that depends on speed.
        flights: most that were fitted.
        residual_m: root mean square of what the fit leaves.
        samples: how many it was fitted to.
    """

    restitution: float
    interval95: tuple[float, float]
    real: float
    flights: int
    residual_m: float
    samples: int


def fit_bounce(drop: Drop, initial: float) -> BounceFit | None:
    """Fit the drop from `initial`, the network's restitution; None where too little is seen."""
    start = np.array(
        [
            float(np.clip(initial, 0.02, 1.0)),
            drop.impact_s,
            drop.fall_time_s,
            drop.drop_height_m,
            drop.contact_m,
        ]
    )
    best: _Fit | None = None
    for count in _FLIGHTS:
        begin = best.unknowns if best else start
        window = _window(drop, begin, count)
        if np.count_nonzero(window) < _FEWEST:
            continue
        if best is not None and np.count_nonzero(window) == len(best.seconds):
            continue
        noise_m = max(drop.noise_m, best.sd) if best else drop.noise_m
        fit = _Fit.to(drop.seconds[window], drop.heights_m[window], begin, count)
        if best is not None and not fit.within(noise_m):
            break
        best = fit
    if best is None:
        return None
    best = best.without_rounded_impacts()
    opinions = best.opinions()
    restitution, interval95 = average(opinions)
    return BounceFit(
        restitution=restitution,
        interval95=interval95,
        real=opinions[1].weight,
        flights=best.flights,
        residual_m=best.sd,
        samples=len(best.seconds),
    )


def _window(drop: Drop, unknowns: Array, flights: int) -> NDArray[np.bool_]:
    """The samples from most of the fall to the end of so many flights, and of a short rest."""
    restitution, impact_s, fall_s = unknowns[:3]
    places = (drop.seconds - impact_s) / fall_s
    starts, speeds = Bounce(float(restitution)).flights(float(places[-1]))
    if flights < len(starts):
        end = starts[flights]
    else:
        end = np.inf if speeds[-1] else starts[-1] + _REST_SEEN
    return (places > -_FALL_SEEN) & (places < end)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Least squares over one window.

    Attributes:
        unknowns: restitution, impact [s], fall time [s], drop height [m], contact [m].
        squares: sum of the squared residuals [m^2].
    """

    seconds: Array
    heights_m: Array
    unknowns: Array
    flights: int
    squares: float

    @classmethod
    def to(cls, seconds: Array, heights_m: Array, start: Array, flights: int) -> _Fit:
        """Fit everything."""
        unknowns, squares = _solve(_residual(seconds, heights_m), start)
        return cls(seconds, heights_m, unknowns, flights, squares)

    @property
    def sd(self) -> float:
        return float(np.sqrt(self.squares / max(len(self.seconds) - _UNKNOWNS, 1)))

    def within(self, noise_m: float) -> bool:
        """Whether what is left is noise: its variance within 4 standard deviations of it."""
        freedom = max(len(self.seconds) - _UNKNOWNS, 1)
        allowed = noise_m**2 * (1 + _FIT_SD * np.sqrt(2 / freedom))
        return self.sd**2 < allowed + (_EXACT * self.unknowns[3]) ** 2

    def without_rounded_impacts(self) -> _Fit:
        """Where neighbours lean the same way a filter was at work: it rounds the impacts."""
        if self._correlation_time() == 1:
            return self
        restitution, impact_s, fall_s = self.unknowns[:3]
        places = (self.seconds - impact_s) / fall_s
        starts, _ = Bounce(float(restitution)).flights(float(places[-1]))
        reach = _AT_IMPACT * float(np.median(np.diff(places)))
        near = np.abs(places[:, None] - starts).min(axis=1) < reach
        if np.count_nonzero(~near) < 2 * _FEWEST:
            return self
        kept = self.seconds[~near], self.heights_m[~near]
        return _Fit.to(*kept, self.unknowns, self.flights)

    def opinions(self) -> tuple[ModelEstimate, ModelEstimate]:
        """The ideal ball and the real one, by how well each explains the samples.

        The real ball's two parameters have normal priors; with them, and linear about the ideal
        fit, both the evidence and what they do to the restitution are in closed form.
        """
        from scipy.stats import t

        worth = self._correlation_time()
        freedom = max(len(self.seconds) / worth - _UNKNOWNS, 3.0)
        variance = self.squares / freedom / worth + (_EXACT / 10 * self.unknowns[3]) ** 2
        residual = _residual(self.seconds, self.heights_m)
        slopes = _slopes(residual, self.unknowns)
        extra = self._real_slopes()
        inverse = np.linalg.pinv(slopes)
        across = extra - slopes @ (inverse @ extra)
        priors = np.array([_SLOPE_SD, _DRAG_SD_1_M * self.unknowns[3]])
        scaled = across * priors / np.sqrt(variance * worth)
        precision = scaled.T @ scaled + np.eye(2)
        pull = -scaled.T @ residual(self.unknowns) / np.sqrt(variance * worth)
        found = np.linalg.solve(precision, pull)
        log_odds = 0.5 * float(pull @ found) - 0.5 * float(np.linalg.slogdet(precision)[1])
        moves = -(inverse @ extra)[0] * priors  # of the restitution, for one prior deviation each
        wider = float(moves @ np.linalg.solve(precision, moves))
        value = float(self.unknowns[0])
        allowed = variance * worth * float(t.ppf(0.975, freedom)) ** 2
        reach = [max(abs(self._end(side, allowed) - value), _LEAST_HALF_WIDTH) for side in (-1, 1)]
        odds = _REAL / (1 - _REAL) * np.exp(min(log_odds, 50.0))
        real = float(odds / (1 + odds))
        below, above = (one / TWO_SIDED for one in reach)
        more = np.hypot((below, above), np.sqrt(wider))
        shifted = value + float(moves @ found)
        ideal = ModelEstimate(value, (below, above), 1 - real)
        return ideal, ModelEstimate(shifted, (float(more[0]), float(more[1])), real)

    def _real_slopes(self) -> Array:
        """What slope and drag do to the heights, shape (samples, 2)."""
        restitution, impact_s, fall_s, drop_m, _ = (float(one) for one in self.unknowns)
        places = (self.seconds - impact_s) / fall_s
        ideal = Bounce(restitution).heights(places)
        slope = (Bounce(restitution, _STEP).heights(places) - ideal) / _STEP
        drag = (Bounce(restitution, 0.0, _STEP).heights(places) - ideal) / _STEP
        return drop_m * np.column_stack([slope, drag])

    def _end(self, side: float, allowed: float) -> float:
        """Where on one side the squares are `allowed` more; their root grows all but straight."""
        residual = _residual(self.seconds, self.heights_m)
        value, others = float(self.unknowns[0]), self.unknowns[1:]
        reach, longest = _LEAST_HALF_WIDTH, 1.0
        for _ in range(12):
            at = float(np.clip(value + side * reach, 0.0, 1.0))
            found, squares = _solve(
                lambda rest, at=at: residual(np.array([at, *rest])), others, free=False
            )
            share = np.sqrt(max(squares - self.squares, 0.0) / max(allowed, 1e-300))
            if 0.95 < share < 1.05 or (at in {0.0, 1.0} and share < 1):
                return at
            if share > 1:
                longest = min(longest, reach)
            else:
                others = found
            reach = min(reach * float(np.clip(1 / max(share, 1e-3), 0.1, 8.0)), 0.98 * longest)
        return float(np.clip(value + side * reach, 0.0, 1.0))

    def _correlation_time(self) -> float:
        left = _residual(self.seconds, self.heights_m)(self.unknowns)
        return correlation_time(left, _UNKNOWNS)


def _residual(seconds: Array, heights_m: Array) -> Residual:
    """What the ideal ball leaves at each sample [m]."""

    def residual(unknowns: Array) -> Array:
        restitution, impact_s, fall_s, drop_m, contact_m = unknowns
        places = (seconds - impact_s) / fall_s
        return contact_m + drop_m * Bounce(float(restitution)).heights(places) - heights_m

    return residual


def _slopes(residual: Residual, values: Array) -> Array:
    left = residual(values)
    moves = np.diag(np.full(len(values), 1e-7))
    return np.column_stack([(residual(values + move) - left) / 1e-7 for move in moves])


def _solve(residual: Residual, start: Array, *, free: bool = True) -> tuple[Array, float]:
    """Gauss-Newton with shortened steps; the solution and its sum of squares.

    Args:
        residual: of the unknowns.
        start: those of a `_Fit`.
        free: whether the restitution is among them.
    """

    def allowed(values: Array) -> Array:
        return np.concatenate([np.clip(values[:1], 0.0, 1.0), values[1:]]) if free else values

    values, left = start, residual(start)
    squares = float(left @ left)
    for _ in range(20):
        whole = np.linalg.lstsq(_slopes(residual, values), -left, rcond=None)[0]
        for share in (1.0, 0.5, 0.2, 0.05):
            tried = allowed(values + share * whole)
            tried_left = residual(tried)
            tried_squares = float(tried_left @ tried_left)
            if tried_squares < squares:
                break
        else:
            break
        gained = squares - tried_squares
        values, left, squares = tried, tried_left, tried_squares
        if gained < 1e-7 * squares:
            break
    return values, squares
