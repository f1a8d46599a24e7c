"""What could be wrong with a filmed drop and still look like one: its clock, its distance.

A fit takes up much of what is wrong, so these look at what it cannot take up: places that lag
behind the fitted ball from some moment on, and a ball that grows or shrinks as no fitted camera
has it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.drop.film_fit import IMPACT, SLOPED, FilmFit
from analysis.drop.projection import Projection
from tunenet_logs.arrays import Array

_MOMENTS = 60
_EDGE = 3
_FEWEST = 12
_AT_REST = 1.0
"""Fall times of a rest that count."""


def clock_doubt(fit: FilmFit) -> tuple[float, float]:
    """Whether the clock jumps, or goes at another rate, from some moment on.

    Args:
        fit: of the drop.

    Returns:
        How much likelier that makes the track (logarithm), and the moment [s]. By a score test: one
        more unknown, linear about the fit, the best of all moments.
    """
    samples = fit.samples
    seconds = samples.seconds
    if len(seconds) < _FEWEST:
        return 0.0, float(seconds[0])
    known, _ = np.linalg.qr(samples.slopes(fit.unknowns, SLOPED))
    speed = -samples.slopes(fit.unknowns, (IMPACT,))[:, 0]
    every = max(1, len(seconds) // _MOMENTS)
    moments = seconds[_EDGE:-_EDGE:every]
    since = seconds[:, None] - moments
    shifts = np.hstack([since > 0, np.maximum(since, 0.0)]) * speed[:, None]
    new = shifts - known @ (known.T @ shifts)
    power = np.maximum((new**2).sum(axis=0), 1e-9 * (shifts**2).sum(axis=0) + 1e-12)
    gains = (new.T @ fit.left_px) ** 2 / power / fit.scale_px**2 / fit.worth / 2
    best = int(gains.argmax())
    return float(gains[best]), float(moments[best % len(moments)])


@dataclass(frozen=True)
class SizeDoubt:
    """How the ball's size in the picture changes, beside what the fitted camera asks for.

    Attributes:
        grows: by what share from the first used picture to the last, at one height.
        grows_sd: its standard error.
        perspective: k by the ball's size less that by the fit.
        perspective_sd: its standard error.
    """

    grows: float
    grows_sd: float
    perspective: float
    perspective_sd: float


def size_doubt(
    seconds: Array, along_px: Array, radius_px: Array, projection: Projection
) -> SizeDoubt | None:
    """Least squares of log radius over height, time and speed; None where too little is seen.

    A ball at height u is 1 / (1 + (e^k - 1) u) as large as at contact; a long exposure draws it out
    by its speed, which is therefore fitted too.

    Args:
        seconds: shape (T,).
        along_px: places along the image's vertical, shape (T,).
        radius_px: shape (T,); NaN where it is not known.
        projection: of the drop.
    """
    heights = np.clip(projection.heights(along_px), 0.0, 1.2)
    times = projection.fall_times(seconds)
    last = float(projection.impacts(float(seconds[-1]))[-1])
    good = np.isfinite(radius_px) & (radius_px > 0) & (times > -1) & (times < last + _AT_REST)
    if np.count_nonzero(good) < _FEWEST:
        return None
    nearly = projection.perspective or 1e-6
    depth = np.log1p(np.expm1(nearly) * heights) / nearly
    speed = np.abs(np.gradient(along_px, seconds))
    speed = speed / max(float(speed.max()), 1e-9)
    length = float(np.ptp(times[good]))
    columns = np.column_stack([np.ones(len(times)), depth, times / length, speed])[good]
    sizes = np.log(radius_px[good])
    weights = np.ones(len(sizes))
    found, spread = np.zeros(columns.shape[1]), 0.0
    for _ in range(5):
        found = np.linalg.lstsq(columns * weights[:, None], sizes * weights, rcond=None)[0]
        left = sizes - columns @ found
        spread = 1.4826 * float(np.median(np.abs(left))) + 1e-6
        weights = 1 / np.sqrt(1 + (left / spread / 2) ** 2)
    sds = spread * np.sqrt(np.diag(np.linalg.pinv(columns.T @ columns)))
    return SizeDoubt(
        grows=float(found[2]),
        grows_sd=float(sds[2]),
        perspective=float(-found[1] - projection.perspective),
        perspective_sd=float(sds[1]),
    )
