"""How long the flights of a filmed ball last, by its impacts alone: no restitution, no camera.

Near an impact the fall and the flight after it are smooth curves of time in any camera's picture,
and where the two meet is the impact. How much shorter the second flight is than the first is the
restitution of the second impact, whatever was filmed and from where.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from analysis.drop.film_fit import FALL, IMPACT, FilmFit
from tunenet_logs.arrays import Array

_FEWEST = 5
_CUBIC = 9
_OUTLIER = 5.0


@dataclass(frozen=True)
class FlightRatio:
    """Duration of the second flight over that of the first.

    Attributes:
        value: as seen.
        fitted: as the fitted ball has it.
        sd: standard error of the value.
    """

    value: float
    fitted: float
    sd: float


def flight_ratio(fit: FilmFit) -> FlightRatio | None:
    """From the first three impacts; None where they are not seen well enough."""
    fall_s = float(np.exp(fit.unknowns[FALL]))
    times = (fit.samples.seconds - fit.unknowns[IMPACT]) / fall_s
    starts, _ = fit.samples.bounce(fit.unknowns).flights(float(times[-1]))
    if len(starts) < 4 or starts[2] > times[-1]:
        return None
    edges = np.array([-1.0, *starts[:4]])
    edges[-1] = min(edges[-1], times[-1])
    half = 0.5 * float(np.median(np.diff(times)))
    flights = [
        _Smooth.through(times, fit, begin + half, end - half)
        for begin, end in itertools.pairwise(edges)
    ]
    if any(one is None for one in flights):
        return None
    seen = [one for one in flights if one is not None]
    reach = 4 * half + 0.03
    met = [
        first.meets(then, at, reach)
        for first, then, at in zip(seen[:-1], seen[1:], starts[:3], strict=True)
    ]
    if any(one is None for one in met):
        return None
    (one, two, three), sds = np.array([pair for pair in met if pair is not None]).T
    ratio = (three - two) / (two - one)
    slopes = np.array([ratio, -1 - ratio, 1.0]) / (two - one)
    return FlightRatio(
        value=float(ratio),
        fitted=float((starts[2] - starts[1]) / starts[1]),
        sd=float(np.linalg.norm(slopes * sds)),
    )


@dataclass(frozen=True, eq=False)
class _Smooth:
    """One flight as a polynomial of time."""

    middle: float
    powers: Array
    covariance: Array

    @classmethod
    def through(cls, times: Array, fit: FilmFit, begin: float, end: float) -> _Smooth | None:
        inside = (times > begin) & (times < end)
        inside &= np.abs(fit.left_px) < _OUTLIER * fit.scale_px
        count = int(np.count_nonzero(inside))
        if count < _FEWEST:
            return None
        middle = float(times[inside].mean())
        columns = np.vander(times[inside] - middle, 4 if count >= _CUBIC else 3)
        places = fit.samples.places_px[inside]
        powers, *_ = np.linalg.lstsq(columns, places, rcond=None)
        covariance = np.linalg.pinv(columns.T @ columns) * fit.scale_px**2
        return cls(middle, powers.astype(np.float64), covariance.astype(np.float64))

    def meets(self, then: _Smooth, near: float, reach: float) -> tuple[float, float] | None:
        """When this flight ends in the next, and the standard error; None if it does not."""
        grid = np.linspace(near - reach, near + reach, 201)
        apart = np.polyval(self.powers, grid - self.middle)
        apart = apart - np.polyval(then.powers, grid - then.middle)
        crossed = np.flatnonzero((apart[:-1] > 0) & (apart[1:] <= 0))
        if not len(crossed):
            return None
        at = int(min(crossed, key=lambda one: abs(grid[one] - near)))
        slope = (apart[at + 1] - apart[at]) / (grid[1] - grid[0])
        when = float(grid[at] - apart[at] / slope)
        variance = sum(
            float(row @ one.covariance @ row)
            for one in (self, then)
            for row in [np.vander([when - one.middle], len(one.powers))[0]]
        )
        return when, float(np.sqrt(variance) / abs(slope))
