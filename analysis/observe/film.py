"""A filmed drop: from the ball's track in the picture to its heights.

The scale is time: a fall that lasts T0 is g T0^2 / 2 high. So a film's frame rate must be its true
one for the heights to be true; the restitution does not depend on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.observe.base import Observation, resample
from analysis.observe.drop import canonical_axis, paper_axis
from analysis.observe.free_fall import Drop, impact_candidates, noise_of
from analysis.observe.projection import Projection, bounce_curve, fit_projection
from analysis.observe.tracking.track import Track
from recorders.simulators.contact import CALIBRATED
from tunenet_logs.errors import NotFoundError

Array = NDArray[np.float64]

_LEAST_SPAN_PX = 15.0
_MOST_IMPACTS = 6
_MOST_CANDIDATES = 6
_FALL_SHARES = (0.96, 0.8, 0.6)
_GOOD_FIT = 0.012
_MARGIN_S = 0.5


@dataclass(frozen=True, eq=False)
class FilmedDrop:
    """One drop in a track.

    Attributes:
        track: the ball in every picture.
        down_px: unit vector of the image's vertical, shape (2,).
        projection: where its heights are in the picture; on the log's time.
        used: which pictures the drop is made of, shape (T,) of the track.
        sideways: distance from the image's vertical [drop heights], one for each used picture.
        drop: its heights by the projection, contact at 0.
    """

    track: Track
    down_px: Array
    projection: Projection
    used: NDArray[np.bool_]
    sideways: Array
    drop: Drop


def find_filmed_drop(track: Track, start_ns: int) -> FilmedDrop:
    """The first drop in a track.

    Args:
        track: see `track_ball`.
        start_ns: where the drop's clock is 0.

    Raises:
        NotFoundError: there is none; the message says why.
    """
    known = np.flatnonzero(track.found)
    seconds = (track.stamps_ns[known] - start_ns).astype(np.float64) * 1e-9
    down = track.gravity_px / np.linalg.norm(track.gravity_px)
    along = -(track.places_px[known] @ down)
    span = float(np.ptp(along))
    if span < _LEAST_SPAN_PX:
        raise NotFoundError(f"the ball moves by only {span:.0f} px: film it larger, from closer")
    noise = max(noise_of(along), 0.02)
    candidates = impact_candidates(seconds, along)
    fits = []
    for at in range(min(len(candidates), _MOST_CANDIDATES)):
        fit = _fit_from(seconds, along, candidates[at:], noise)
        if fit is None:
            continue
        projection, first, last = fit
        quality = projection.residual_px / projection.span_px
        fits.append((quality, projection, first, last))
        if quality < _GOOD_FIT and _plausible(projection, float(seconds[last - 1]), span):
            break
    plausible = [fit for fit in fits if _plausible(fit[1], float(seconds[fit[3] - 1]), span)]
    if not plausible:
        raise NotFoundError(_why_not(len(candidates), bool(fits)))
    _, projection, first, last = min(plausible, key=lambda fit: max(fit[0], _GOOD_FIT))
    begin = max(0, int(np.searchsorted(seconds, seconds[first] - _MARGIN_S)))
    used = np.zeros(len(track.stamps_ns), dtype=bool)
    used[known[begin:last]] = True
    across = track.places_px[used] @ np.array([down[1], -down[0]])
    return FilmedDrop(
        track=track,
        down_px=down,
        projection=projection,
        used=used,
        sideways=(across - np.median(across)) / projection.span_px,
        drop=_drop(seconds[begin:last], along[begin:last], projection, noise, begin),
    )


def canonical_film(film: FilmedDrop) -> Observation:
    """The flights that were seen, on the canonical grid of `canonical`.

    They are the parabolas of the fitted projection, each as long as it was seen to last, not the
    samples: those carry the noise of a track, which counts for much where a bounce is small.
    """
    axis, fit, drop = canonical_axis(), film.projection, film.drop
    values = bounce_curve(axis, fit.impacts)
    last = float(fit.fall_times(drop.seconds[-1:])[0])
    seen = last if np.isnan(drop.rest_m) else np.inf
    values[axis > seen] = np.nan
    return Observation(values[:, None], axis, "time after impact [fall times]", ("[drop heights]",))


def image_rows(film: FilmedDrop, start_s: float) -> Observation:
    """The ball's y in the picture, 0 at the top and 1 at the bottom: what the paper's network sees.

    A recording that ends with the ball at rest goes on with it at rest; else what is missing is
    NaN.

    Args:
        film: the drop.
        start_s: where the paper's 400 samples at 60 Hz start, on the drop's clock.
    """
    rows = film.track.places_px[film.used, 1] / film.track.size_px[1]
    wanted = start_s + paper_axis()
    seconds = film.drop.seconds
    values = resample(seconds, rows, wanted)
    if not np.isnan(film.drop.rest_m):
        values[wanted > seconds[-1]] = rows[-1]
    return Observation(values[:, None], paper_axis(), "time [s]", ("y [picture heights]",))


def _fit_from(
    seconds: Array, along: Array, impacts: list[int], noise: float
) -> tuple[Projection, int, int] | None:
    """The projection if the first of these is the first impact, and the samples that it is from."""
    index = impacts[0]
    last = _end(seconds, along, impacts)
    impacts = [one for one in impacts[:_MOST_IMPACTS] if one < last]
    best: tuple[Projection, int, int] | None = None
    for share in _FALL_SHARES:
        first = _fall_start(along, index, share, noise)
        if index - first < 4 or last - index < 4:
            continue
        fall_s = _fall_time(seconds[first:index], along[first:index])
        if fall_s is None:
            continue
        part = slice(first, last)
        fit = fit_projection(seconds[part], along[part], seconds[impacts], fall_s, noise)
        if fit is None:
            continue
        if best is None or fit.residual_px < 0.7 * best[0].residual_px:
            best = (fit, first, last)
        if fit.residual_px < 2 * noise + 0.003 * fit.span_px:
            break
    return best


def _fall_start(along: Array, index: int, share: float, noise: float) -> int:
    """The first sample of the fall, its slow upper part left out: there a hand may still be."""
    low = float(along[index - 1 : index + 2].min())
    top, first = low, index
    while first > 0 and along[first - 1] > top - 4 * noise - 0.03 * (top - low):
        first -= 1
        top = max(top, float(along[first]))
    high = np.flatnonzero(along[first:index] > low + share * (top - low))
    return first + (int(high[-1]) + 1 if len(high) else 0)


def _fall_time(seconds: Array, along: Array) -> float | None:
    """T0 [s] by the parabola of the fall; None where it does not accelerate downward."""
    clock = seconds - seconds[-1]
    curve, slope, _ = (float(value) for value in np.polyfit(clock, along, 2))
    if curve >= 0 or slope >= 0:
        return None
    return float(np.clip(slope / (2 * curve), 0.5 * np.ptp(clock), 6 * np.ptp(clock)))


def _end(seconds: Array, along: Array, impacts: list[int]) -> int:
    """Where the bounces end: at the last impact that is modelled, or when the ball is lifted."""
    index = impacts[0]
    low = float(along[index - 1 : index + 2].min())
    top = float(along[max(0, index - 200) : index].max())
    above = np.flatnonzero(along[index:] > low + 1.15 * (top - low))
    last = index + int(above[0]) if len(above) else len(along)
    if len(impacts) > _MOST_IMPACTS:
        last = min(last, impacts[_MOST_IMPACTS] + 1)
    gaps = np.flatnonzero(np.diff(seconds[index:last]) > 1.0)
    return index + int(gaps[0]) + 1 if len(gaps) else last


def _plausible(projection: Projection, last_s: float, span_px: float) -> bool:
    """Whether it can be a drop at all: what it sees of one, and how large."""
    after = float(projection.fall_times(np.array([last_s]))[0])
    size = abs(np.log(projection.span_px / span_px))
    return after > 0.3 and size < 1.2 and projection.residual_px < 0.05 * projection.span_px


def _why_not(impacts: int, fitted: bool) -> str:
    if not impacts:
        return "no bounce is seen: the ball never falls onto anything in view"
    if not fitted:
        return "no free fall is seen before an impact (carried, caught, or too few pictures)"
    return "what the ball does is no drop: it does not bounce along parabolas of one acceleration"


def _drop(seconds: Array, along: Array, fit: Projection, noise_px: float, first: int) -> Drop:
    gravity = CALIBRATED.gravity_m_s2
    height_m = gravity * fit.fall_time_s**2 / 2
    heights = np.clip(fit.heights(along), -1.0, 2.0)
    lying = seconds > fit.impact_s + fit.fall_time_s * fit.impacts[-1]
    return Drop(
        first=first,
        seconds=seconds,
        heights_m=heights * height_m,
        release_s=fit.impact_s - fit.fall_time_s,
        release_m=height_m,
        impact_s=fit.impact_s,
        contact_m=0.0,
        impact_speed_m_s=gravity * fit.fall_time_s,
        flight_restitution=fit.first_flight,
        flight_restitution_sd=fit.flight_ratio_sd,
        gravity_m_s2=gravity,
        drag=float("nan"),
        drag_sd=float("nan"),
        noise_m=noise_px / fit.span_px * height_m,
        rest_m=0.0 if lying.sum() > 5 else float("nan"),
        rest_tolerance_m=height_m,
    )
