"""The bounce in closed form, fitted to a recorded drop: restitution and its 95 % interval.

The network finds the right basin of a cost that has dozens; from there least squares over all
samples is efficient, and its profile likelihood says how sure the value is. What else is unknown
of a recording is fitted with it: the impact's time, the fall time, the drop height, the level of
the table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.observe.free_fall import Drop
from recorders.simulators.bounce import bounce_heights, impact_places

Array = NDArray[np.float64]

_FALL_SEEN = 0.95
_REST_SEEN = 1.0
_FLIGHTS = (1, 2, 3, 5, 8, 13, 1000)
_EXACT = 1e-4
"""Of the drop height: what no recording, and no model of a ball, is held to."""

_LEAST_HALF_WIDTH = 2e-5
_FIT_SD = 4.0
_NUISANCE = 4
_FEWEST = 12


@dataclass(frozen=True)
class BounceFit:
    """A fitted drop.

    Attributes:
        restitution: at the first impact, and at all that were fitted.
        interval95: of the restitution, by profile likelihood.
        flights: how many were fitted: as many as one restitution explains to within the noise.
        residual_m: root mean square of what the fit leaves.
        samples: how many it was fitted to.
    """

    restitution: float
    interval95: tuple[float, float]
    flights: int
    residual_m: float
    samples: int


def fit_bounce(drop: Drop, initial: float) -> BounceFit | None:
    """Fit the drop from `initial`, the network's restitution; None where too little is seen."""
    best: _Fit | None = None
    for count in _FLIGHTS:
        start = best.unknowns if best else _first(drop, initial)
        window = _window(drop, start, count)
        if best is not None and np.count_nonzero(window) == len(best.seconds):
            continue
        if np.count_nonzero(window) < _FEWEST:
            continue
        fit = _Fit.to(drop.seconds[window], drop.heights_m[window], start, count)
        if best is not None and not fit.within(drop.noise_m):
            break
        best = fit
    if best is None:
        return None
    return BounceFit(
        restitution=best.restitution,
        interval95=best.interval95(),
        flights=best.flights,
        residual_m=best.sd,
        samples=len(best.seconds),
    )


def _first(drop: Drop, restitution: float) -> Array:
    """Restitution, impact [s], fall time [s], drop height [m], contact [m]."""
    return np.array(
        [restitution, drop.impact_s, drop.fall_time_s, drop.drop_height_m, drop.contact_m]
    )


def _window(drop: Drop, unknowns: Array, flights: int) -> NDArray[np.bool_]:
    """The samples from most of the fall to the end of so many flights, and of a short rest."""
    restitution, impact_s, fall_s = unknowns[:3]
    end = float(impact_places(restitution, flights + 1)[-1])
    rest = 2 * restitution / max(1 - restitution, 1e-9)
    if end > 0.98 * rest:
        end = rest + _REST_SEEN
    places = (drop.seconds - impact_s) / fall_s
    return (places > -_FALL_SEEN) & (places < end)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Least squares over one window; `unknowns` as `_first` has them."""

    seconds: Array
    heights_m: Array
    unknowns: Array
    flights: int
    squares: float

    @classmethod
    def to(cls, seconds: Array, heights_m: Array, start: Array, flights: int) -> _Fit:
        """Fit all five."""
        unknowns, squares = _solve(_residual(seconds, heights_m), start)
        return cls(seconds, heights_m, unknowns, flights, squares)

    @property
    def restitution(self) -> float:
        return float(self.unknowns[0])

    @property
    def freedom(self) -> int:
        return len(self.seconds) - _NUISANCE - 1

    @property
    def sd(self) -> float:
        return float(np.sqrt(self.squares / self.freedom))

    def within(self, noise_m: float) -> bool:
        """Whether what is left is noise: its variance within 4 standard deviations of it."""
        allowed = noise_m**2 * (1 + _FIT_SD * np.sqrt(2 / self.freedom))
        return self.sd**2 < allowed + (_EXACT * self.unknowns[3]) ** 2

    def interval95(self) -> tuple[float, float]:
        """Where fixing the restitution costs no more than chance would."""
        from scipy.stats import f

        residual = _residual(self.seconds, self.heights_m)
        most = self.squares * (1 + f.ppf(0.95, 1, self.freedom) * self._widening() / self.freedom)

        def excess(restitution: float, start: Array) -> tuple[float, Array]:
            nuisance, squares = _solve(
                lambda others: residual(np.array([restitution, *others])), start
            )
            return squares - float(most), nuisance

        low = self._end(excess, -1.0)
        high = self._end(excess, 1.0)
        return (
            max(0.0, min(low, self.restitution - _LEAST_HALF_WIDTH)),
            min(1.0, max(high, self.restitution + _LEAST_HALF_WIDTH)),
        )

    def _end(self, excess: Callable[[float, Array], tuple[float, Array]], side: float) -> float:
        """The restitution on one side at which the excess is 0: doubled steps, then halved."""
        inside, nuisance = self.restitution, self.unknowns[1:]
        step = 1e-6
        outside = inside
        while True:
            outside = float(np.clip(inside + side * step, 0.0, 1.0))
            over, found = excess(outside, nuisance)
            if over > 0:
                break
            inside, nuisance = outside, found
            if outside in {0.0, 1.0}:
                return outside
            step *= 2
        for _ in range(12):
            middle = (inside + outside) / 2
            over, found = excess(middle, nuisance)
            if over > 0:
                outside = middle
            else:
                inside, nuisance = middle, found
        return outside

    def _widening(self) -> float:
        """How much more variance neighbours that lean the same way bring (AR(1))."""
        left = _residual(self.seconds, self.heights_m)(self.unknowns)
        lean = float(left[1:] @ left[:-1] / max(left @ left, 1e-300))
        if lean < 2 / np.sqrt(len(left)):
            return 1.0
        return (1 + lean) / (1 - min(lean, 0.95))


def _residual(seconds: Array, heights_m: Array) -> Callable[[Array], Array]:
    def residual(unknowns: Array) -> Array:
        restitution, impact_s, fall_s, drop_m, contact_m = unknowns
        places = (seconds - impact_s) / fall_s
        return contact_m + drop_m * bounce_heights(places, restitution) - heights_m

    return residual


def _solve(residual: Callable[[Array], Array], start: Array) -> tuple[Array, float]:
    """Gauss-Newton with halved steps; the solution and its sum of squares."""
    values, left = start, residual(start)
    squares = float(left @ left)
    for _ in range(20):
        steps = 1e-7 * np.maximum(np.abs(values), 1e-2)
        slopes = np.column_stack(
            [(residual(values + move) - left) / move.sum() for move in np.diag(steps)]
        )
        whole = np.linalg.lstsq(slopes, -left, rcond=None)[0]
        for share in (1.0, 0.5, 0.25, 0.1, 0.02):
            tried = values + share * whole
            tried[:1] = np.clip(tried[:1], 0.0, 1.0) if len(tried) > _NUISANCE else tried[:1]
            tried_left = residual(tried)
            tried_squares = float(tried_left @ tried_left)
            if tried_squares < squares:
                break
        else:
            break
        gained = squares - tried_squares
        values, left, squares = tried, tried_left, tried_squares
        if gained < 1e-9 * squares:
            break
    return values, squares
