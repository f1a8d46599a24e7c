"""A bounce as an uncalibrated camera shows it: heights through an unknown projective map.

Along the image of the vertical a height u [drop heights] above contact appears at
p = A + B phi(u), phi(u) = e^k u / (1 + (e^k - 1) u): contact at A, drop height at A + B, and k the
perspective between the two. Time is in fall times T0 after the first impact. So six numbers and the
times of the impacts say what a track looks like, whatever camera, height and frame rate; the
restitution is not one of them, it shows in how long each flight lasts.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PERSPECTIVE_SD = 0.7
"""Prior of k: from the camera poses that people use."""

_RATIO_SD = 0.05
_LOSS_SCALE = 2.5
_LEAST_NOISE_PX = 0.05
_ROUGHLY, _EXACTLY = (14, 1e-3), (40, 1e-7)
"""Most steps, and the gain that ends them."""

_GOOD_COST = 1.0
"""Half the squared residuals a sample, in noise: other starts can hardly do better."""


@dataclass(frozen=True, eq=False)
class Projection:
    """Where heights are in the picture, and when the ball hits.

    Attributes:
        contact_px: A, along the image's vertical, up positive.
        span_px: B.
        perspective: k.
        impact_s: the first impact.
        fall_time_s: T0.
        impacts: all impacts in order [fall times after the first], the first is 0, shape (N,).
        flight_ratio_sd: standard error of the first flight's duration over 2 T0.
        residual_px: rms of the track about it.
        worst_px: largest residual.
    """

    contact_px: float
    span_px: float
    perspective: float
    impact_s: float
    fall_time_s: float
    impacts: Array
    flight_ratio_sd: float
    residual_px: float
    worst_px: float

    def heights(self, places_px: Array) -> Array:
        """Heights [drop heights] of places along the image's vertical."""
        share = (places_px - self.contact_px) / self.span_px
        grow = np.exp(self.perspective)
        return share / np.maximum(grow - (grow - 1) * share, 1e-3)

    def places_px(self, heights: Array) -> Array:
        """Places along the image's vertical of heights [drop heights]."""
        return self.contact_px + self.span_px * _projected(heights, self.perspective)

    def fall_times(self, seconds: Array) -> Array:
        """Times [fall times after the first impact]."""
        return (seconds - self.impact_s) / self.fall_time_s

    @property
    def first_flight(self) -> float:
        """Duration of the first flight over that of the fall and its mirror image: e."""
        return float(self.impacts[1] / 2) if len(self.impacts) > 1 else float("nan")


def bounce_curve(times: Array, impacts: Array) -> Array:
    """Height [drop heights] of a ball that falls from rest and hits at these times.

    Args:
        times: [fall times after the first impact], shape (T,).
        impacts: increasing, the first is 0, shape (N,); after the last the ball lies still.
    """
    held = np.clip(times, -1.0, None)
    heights = 1 - (held + 1) ** 2
    flight = np.clip(np.searchsorted(impacts, times, side="right") - 1, 0, len(impacts) - 1)
    begin = impacts[flight]
    end = np.append(impacts[1:], impacts[-1])[flight]
    flying = np.maximum((times - begin) * (end - times), 0.0)
    return np.where(times < 0, heights, flying)


def fit_projection(
    seconds: Array, places_px: Array, impacts_s: Array, fall_time_s: float, noise_px: float
) -> Projection | None:
    """The projection that a track fits best, from starts of different perspective and fall time.

    Args:
        seconds: shape (T,): the fall, the bounces, nothing before or after.
        places_px: along the image's vertical, up positive, shape (T,).
        impacts_s: first guess of the impacts, at least one; where the last is not seen to end in
            another, its flight's end is to be found too.
        fall_time_s: first guess.
        noise_px: standard deviation of a place.

    Returns:
        None where no start leads anywhere.
    """
    best: tuple[float, Array, Array] | None = None
    for stretch, perspective in product((1.0, 0.75, 1.35), (0.0, 0.6, -0.6)):
        start = _start(seconds, places_px, impacts_s, fall_time_s * stretch, perspective)
        found = _refine(seconds, places_px, start, noise_px, _ROUGHLY)
        if found is not None and (best is None or found[0] < best[0]):
            best = found
        if best is not None and best[0] < _GOOD_COST * len(seconds):
            break
    if best is not None:
        best = _refine(seconds, places_px, best[1], noise_px, _EXACTLY)
    return None if best is None else _unpack(seconds, places_px, best[1], best[2])


def _start(
    seconds: Array, places_px: Array, impacts_s: Array, fall_time_s: float, perspective: float
) -> Array:
    """t1, log T0, A, B, k, then log durations of the flights [fall times]."""
    flights = np.diff(impacts_s) / fall_time_s
    ratio = flights[-1] / (flights[-2] if len(flights) > 1 else 2.0) if len(flights) else 0.6
    last = flights[-1] if len(flights) else 2.0
    flights = np.append(flights, last * np.clip(ratio, 0.2, 1.0))
    impacts = np.concatenate([[0.0], np.cumsum(flights)])
    shape = _projected(bounce_curve((seconds - impacts_s[0]) / fall_time_s, impacts), perspective)
    design = np.column_stack([np.ones_like(shape), shape])
    (contact, span), *_ = np.linalg.lstsq(design, places_px, rcond=None)
    head = [impacts_s[0], np.log(fall_time_s), contact, max(span, 1.0), perspective]
    return np.concatenate([head, np.log(flights)])


def _refine(
    seconds: Array, places_px: Array, start: Array, noise_px: float, effort: tuple[int, float]
) -> tuple[float, Array, Array] | None:
    """Robust least squares from one start: cost, parameters, their covariance."""
    from scipy.optimize import least_squares

    noise = max(noise_px, _LEAST_NOISE_PX)

    def residuals(values: Array) -> Array:
        off = (_model(seconds, values) - places_px) / noise
        bounded = off / np.sqrt(1 + np.abs(off) / _LOSS_SCALE / 4)
        flights = values[5:]
        steady = np.diff(flights, prepend=np.log(2.0))  # log e of each bounce
        prior = np.concatenate([[values[4] / PERSPECTIVE_SD], np.diff(steady) / _RATIO_SD])
        return np.concatenate([bounded, prior])

    low = np.full(len(start), -np.inf)
    high = np.full(len(start), np.inf)
    low[0], high[0] = start[0] + np.array([-0.3, 0.3]) * np.exp(start[1])
    low[1], high[1] = start[1] - 1.2, start[1] + 1.2
    low[3], low[4], high[4] = 1e-3, -3.0, 3.0
    low[5:], high[5:] = -6.0, np.log(2.2)
    begin = np.clip(start, low + 1e-6, high - 1e-6)
    scale = np.ones(len(start))
    scale[0], scale[2:4] = np.exp(start[1]), start[3]
    try:
        most, tolerance = effort
        found = least_squares(
            residuals, begin, bounds=(low, high), x_scale=scale, max_nfev=most, ftol=tolerance
        )
    except (ValueError, np.linalg.LinAlgError):
        return None
    covariance = np.linalg.pinv(found.jac.T @ found.jac)
    return float(found.cost), found.x, covariance


def _model(seconds: Array, values: Array) -> Array:
    impact_s, log_fall, contact, span, perspective = values[:5]
    impacts = np.concatenate([[0.0], np.cumsum(np.exp(values[5:]))])
    times = (seconds - impact_s) / np.exp(log_fall)
    return contact + span * _projected(bounce_curve(times, impacts), perspective)


def _projected(heights: Array, perspective: float) -> Array:
    grow = np.exp(perspective)
    return grow * heights / np.maximum(1 + (grow - 1) * heights, 1e-3)


def _unpack(seconds: Array, places_px: Array, values: Array, covariance: Array) -> Projection:
    off = _model(seconds, values) - places_px
    impact_s, log_fall, contact, span, perspective = (float(value) for value in values[:5])
    flights = np.exp(values[5:])
    return Projection(
        contact_px=contact,
        span_px=span,
        perspective=perspective,
        impact_s=impact_s,
        fall_time_s=float(np.exp(log_fall)),
        impacts=np.concatenate([[0.0], np.cumsum(flights)]),
        flight_ratio_sd=float(flights[0] / 2 * np.sqrt(covariance[5, 5])),
        residual_px=float(np.sqrt(np.mean(off**2))),
        worst_px=float(np.abs(off).max()),
    )
