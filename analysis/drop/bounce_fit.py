"""The bounce in closed form, fitted to a recorded drop: restitution and its 95 % interval.

The network finds the right basin of a cost that has dozens; from there least squares over all
samples is efficient, and its profile likelihood says how sure the value is. What else is unknown
of a recording is fitted with it: the impact's time, the fall time, the drop height, the level of
the table.

No real ball is ideal: its restitution falls with speed, and the air slows it. Beside the ideal ball
stands one that does both, and the answer is the average of the two, weighted by how well each
explains the samples (Bayesian model averaging, Hoeting et al. 1999; linear about the ideal fit). So
the interval covers what the samples cannot exclude, not only their noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.drop.free_fall import Drop
from analysis.statistics import TWO_SIDED, ModelEstimate, average, correlation_time
from recorders.simulators.closed_form.bounce import Bounce
from tunenet_logs.arrays import Array

SLOPE_SD = 0.1
"""Prior of the slope p of a restitution over the logarithm of speed: real balls show .03 to .22."""

_DRAG_SD_1_M = 0.03
"""Prior of the deceleration over speed squared: a table-tennis ball has .13, others about .02."""

_REAL = 0.5
"""Prior probability of a ball that shows slope or drag: no ball is ideal, many nearly are."""

_FALL_SEEN = 0.95
"""Fall times before the impact that are fitted: earlier a hand may still touch the ball."""

_REST_SEEN = 1.0
"""Fall times of a rest that are fitted: more of them would only repeat the table's level."""

_FLIGHTS = (1, 2, 4, 8, 400)
"""Flights that are fitted in turn, as long as one restitution explains them to within the noise."""

_EXACT = 1e-4
"""Fraction of the drop height that no recording, and no model of a ball, is held to."""

_LEAST_HALF_WIDTH = 2e-5
"""Of an interval of the restitution: a drop of the engine without noise is off by as much."""

_STEP = 1e-3
"""Slope, and drag [1 / drop height], by which they are differentiated."""

_UNKNOWN_STEP = 1e-7
"""Of each unknown in its unit, by which it is differentiated."""

_FIT_SD = 4.0
"""Standard deviations of a residual variance within which it is noise."""

_FEWEST = 12
"""Samples for the five unknowns and a noise."""

_UNKNOWNS = 5

_AT_IMPACT = 1.5
"""Samples to either side of an impact that a filter rounds."""


@dataclass(frozen=True)
class BounceFit:
    """A fitted drop.

    Attributes:
        restitution: at the first impact.
        interval95: of the restitution.
    """

    restitution: float
    interval95: tuple[float, float]


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
    for flights in _FLIGHTS:
        begin = best.unknowns if best else start
        window = _window(drop, begin, flights)
        samples = np.count_nonzero(window)
        if samples < _FEWEST or (best is not None and samples == len(best.seconds)):
            continue
        fit = _Fit.to(drop.seconds[window], drop.heights_m[window], begin, flights)
        if best is not None:
            noise_m = max(drop.noise_m, best.residual_m)
            freedom = max(samples - _UNKNOWNS, 1)
            allowed_m2 = noise_m**2 * (1 + _FIT_SD * np.sqrt(2 / freedom))
            if not fit.residual_m**2 < allowed_m2 + (_EXACT * fit.unknowns[3]) ** 2:
                break
        best = fit
    if best is None:
        return None
    return BounceFit(*average(best.without_rounded_impacts().estimates()))


def _window(drop: Drop, unknowns: Array, flights: int) -> NDArray[np.bool_]:
    """The samples from most of the fall to the end of `flights` flights, and of a short rest."""
    restitution, impact_s, fall_s = unknowns[:3]
    times = (drop.seconds - impact_s) / fall_s
    starts, speeds = Bounce(float(restitution)).flights(float(times[-1]))
    if flights < len(starts):
        end = starts[flights]
    else:
        end = np.inf if speeds[-1] else starts[-1] + _REST_SEEN
    return (times > -_FALL_SEEN) & (times < end)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Least squares of the ideal ball over one window of T samples.

    Attributes:
        seconds: shape (T,).
        heights_m: shape (T,).
        unknowns: restitution, impact [s], fall time [s], drop height [m], contact [m]; shape (5,).
        flights: most that the window holds.
        squares_m2: sum of the squared residuals.
        residual_m: their standard deviation.
    """

    seconds: Array
    heights_m: Array
    unknowns: Array
    flights: int
    squares_m2: float
    residual_m: float

    @classmethod
    def to(
        cls, seconds: Array, heights_m: Array, start: Array, flights: int, first_free: int = 0
    ) -> _Fit:
        """Gauss-Newton's method with shortened steps.

        Args:
            seconds: shape (T,).
            heights_m: shape (T,).
            start: unknowns to begin with, shape (5,).
            flights: see `_Fit`.
            first_free: 1 to leave the restitution as it is.
        """
        values, residuals = start, _residuals(seconds, heights_m, start)
        squares = float(residuals @ residuals)
        for _ in range(20):
            slopes = _slopes(seconds, heights_m, values, first_free)
            step = np.linalg.lstsq(slopes, -residuals, rcond=None)[0]
            for fraction in (1.0, 0.5, 0.2, 0.05):
                tried = values.copy()
                tried[first_free:] += fraction * step
                tried[0] = np.clip(tried[0], 0.0, 1.0)
                tried_residuals = _residuals(seconds, heights_m, tried)
                tried_squares = float(tried_residuals @ tried_residuals)
                if tried_squares < squares:
                    break
            else:
                break
            gained = squares - tried_squares
            values, residuals, squares = tried, tried_residuals, tried_squares
            if gained < 1e-7 * squares:
                break
        residual_m = float(np.sqrt(squares / max(len(seconds) - _UNKNOWNS, 1)))
        return cls(seconds, heights_m, values, flights, squares, residual_m)

    def without_rounded_impacts(self) -> _Fit:
        """Where neighbouring residuals are alike a filter was at work: it rounds the impacts."""
        residuals = _residuals(self.seconds, self.heights_m, self.unknowns)
        if correlation_time(residuals, _UNKNOWNS) == 1:
            return self
        restitution, impact_s, fall_s = self.unknowns[:3]
        times = (self.seconds - impact_s) / fall_s
        starts, _ = Bounce(float(restitution)).flights(float(times[-1]))
        reach = _AT_IMPACT * float(np.median(np.diff(times)))
        near = np.abs(times[:, None] - starts).min(axis=1) < reach
        if np.count_nonzero(~near) < 2 * _FEWEST:
            return self
        return _Fit.to(self.seconds[~near], self.heights_m[~near], self.unknowns, self.flights)

    def estimates(self) -> tuple[ModelEstimate, ModelEstimate]:
        """The ideal ball and the real one, by how well each explains the samples.

        The real ball's two parameters have normal priors; with them, and linear about the ideal
        fit, both the evidence and their effect on the restitution are in closed form (the Laplace
        approximation). The ideal ball's interval is by profile likelihood.
        """
        from scipy.stats import t

        residuals = _residuals(self.seconds, self.heights_m, self.unknowns)
        samples_each = correlation_time(residuals, _UNKNOWNS)  # that count as one
        freedom = max(len(self.seconds) / samples_each - _UNKNOWNS, 3.0)
        value, impact_s, fall_s, drop_m, _ = self.unknowns.tolist()
        variance = self.squares_m2 / freedom / samples_each + (_EXACT / 10 * drop_m) ** 2
        times = (self.seconds - impact_s) / fall_s
        ideal = Bounce(value).heights(times)
        slope = (Bounce(value, _STEP).heights(times) - ideal) / _STEP
        drag = (Bounce(value, 0.0, _STEP).heights(times) - ideal) / _STEP
        extra = drop_m * np.column_stack([slope, drag])
        slopes = _slopes(self.seconds, self.heights_m, self.unknowns)
        inverse = np.linalg.pinv(slopes)
        across = extra - slopes @ (inverse @ extra)  # what no change of the ideal ball explains
        priors = np.array([SLOPE_SD, _DRAG_SD_1_M * drop_m])
        scaled = across * priors / np.sqrt(variance * samples_each)
        precision = scaled.T @ scaled + np.eye(2)
        gradient = -scaled.T @ residuals / np.sqrt(variance * samples_each)
        found = np.linalg.solve(precision, gradient)
        log_odds = 0.5 * float(gradient @ found) - 0.5 * float(np.linalg.slogdet(precision)[1])
        moves = -(inverse @ extra)[0] * priors  # of the restitution, for one prior deviation each
        wider = float(moves @ np.linalg.solve(precision, moves))
        allowed = variance * samples_each * float(t.ppf(0.975, freedom)) ** 2
        reach = [max(abs(self._end(side, allowed) - value), _LEAST_HALF_WIDTH) for side in (-1, 1)]
        odds = _REAL / (1 - _REAL) * np.exp(min(log_odds, 50.0))
        real = float(odds / (1 + odds))
        below, above = (half_width / TWO_SIDED for half_width in reach)
        more = np.hypot((below, above), np.sqrt(wider))
        shifted = value + float(moves @ found)
        return (
            ModelEstimate(value, (below, above), 1 - real),
            ModelEstimate(shifted, (float(more[0]), float(more[1])), real),
        )

    def _end(self, side: float, allowed_m2: float) -> float:
        """Where on one side the squares are `allowed_m2` more, all else fitted anew.

        By the secant on the root of what they are more, which grows all but straight.
        """
        value, begin = float(self.unknowns[0]), self.unknowns
        reach, longest = _LEAST_HALF_WIDTH, 1.0
        for _ in range(12):
            at = float(np.clip(value + side * reach, 0.0, 1.0))
            start = np.concatenate([[at], begin[1:]])
            fit = _Fit.to(self.seconds, self.heights_m, start, self.flights, first_free=1)
            risen = max(fit.squares_m2 - self.squares_m2, 0.0)
            fraction = np.sqrt(risen / max(allowed_m2, 1e-300))
            if 0.95 < fraction < 1.05 or (at in {0.0, 1.0} and fraction < 1):
                return at
            if fraction > 1:
                longest = min(longest, reach)
            else:
                begin = fit.unknowns
            further = float(np.clip(1 / max(fraction, 1e-3), 0.1, 8.0))
            reach = min(reach * further, 0.98 * longest)
        return float(np.clip(value + side * reach, 0.0, 1.0))


def _residuals(seconds: Array, heights_m: Array, unknowns: Array) -> Array:
    """Heights of the ideal ball less those of the samples [m], shape (T,)."""
    restitution, impact_s, fall_s, drop_m, contact_m = unknowns
    times = (seconds - impact_s) / fall_s
    return contact_m + drop_m * Bounce(float(restitution)).heights(times) - heights_m


def _slopes(seconds: Array, heights_m: Array, unknowns: Array, first_free: int = 0) -> Array:
    """Of the residuals over the unknowns from `first_free` on, by differences; shape (T, ...)."""
    residuals = _residuals(seconds, heights_m, unknowns)
    moves = np.diag(np.full(len(unknowns), _UNKNOWN_STEP))[first_free:]
    return np.column_stack(
        [
            (_residuals(seconds, heights_m, unknowns + move) - residuals) / _UNKNOWN_STEP
            for move in moves
        ]
    )
