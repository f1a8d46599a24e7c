"""A filmed drop: from the ball's track in the picture to its heights.

The scale is time: a fall that lasts T0 is g T0^2 / 2 high. So a film's frame rate must be its true
one for the heights to be true; the restitution does not depend on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.drop.film_fit import DRAGGED, SLOPED, FilmFit, TrackSamples
from analysis.drop.film_search import (
    FEWEST_SAMPLES,
    Balls,
    FilmFits,
    best_of,
    film_impacts,
    fits_from,
    is_good,
    misfit,
)
from analysis.drop.free_fall import Drop
from analysis.drop.observations import canonical_axis, paper_axis
from analysis.drop.projection import Projection
from analysis.estimators.base import Observation, resample
from analysis.statistics import noise_of
from analysis.tracking.track import Track
from recorders.simulators.balls import Ball
from recorders.simulators.contact import CALIBRATED
from tunenet_logs.arrays import Array
from tunenet_logs.errors import NotFoundError

_LEAST_SPAN_PX = 15.0
"""Below it no bounce is told from the noise of a track; the checks ask for 40."""

_MARGIN_S = 0.5
"""Kept before what is fitted, to be seen in a review."""

_WHOLE_PX_NOISE, _LEAST_NOISE_PX = 0.45, 0.1
"""Least noise [px] of positions in whole pixels, and of others. Rounding to whole pixels is no
noise: a ball that lies still is always rounded the same way."""

_STRAIGHT = 0.0015
"""Fraction of the span by which a good lens may distort the vertical."""

_EARLIER, _LATER = 1.1, 0.8
"""Fractions of the drop's fall from which another fall before it, or after it, is reported."""

_MOST_CANDIDATES = 6
"""Impacts that may be the first of a drop: what moves before it is a hand's."""

_CLEARLY = 3.0
"""Log likelihood that another ball than the ideal one has to gain: 20 to 1."""

_NO_DROP, _ENDLESS = 0.05, 0.995
"""Rms residual, as a fraction of the fall, and restitution: what has more is no drop."""

_LEAST_SEEN, _MOST_LOG_SIZE = 0.3, 1.2
"""Of a drop: fall times seen after the impact, and logarithm of its height over the track's."""


@dataclass(frozen=True, eq=False)
class FilmedDrop:
    """One drop in a track.

    Attributes:
        track: the ball in every picture.
        down_px: unit vector of the image's vertical, shape (2,).
        fits: to the same samples: of a ball that keeps its restitution, of one whose restitution
            falls with speed, and of one that the air slows; the latter unless the air is known, and
            not the one before if the drag is asked for.
        best: of the fits: the ideal ball's unless another explains clearly more.
        projection: where its heights are in the picture, by the best fit; on the log's time.
        used: which pictures the drop is made of, shape (T,) of the track.
        sideways: distance from the image's vertical [drop heights], shape (used pictures,).
        drop: its heights by the projection, contact at 0.
        left_out: how many impacts are before it, after deeper falls, that no drop could be fitted
            from.
        later_s: impacts after it, after falls as deep, on the drop's clock.
        flights: how many it is made of where the ball bounces otherwise after them; None where not.
    """

    track: Track
    down_px: Array
    fits: tuple[FilmFit, ...]
    best: FilmFit
    projection: Projection
    used: NDArray[np.bool_]
    sideways: Array
    drop: Drop
    left_out: int
    later_s: tuple[float, ...]
    flights: int | None = None


def find_filmed_drop(
    track: Track, start_ns: int, ball: Ball | None = None, *, fit_drag: bool = False
) -> FilmedDrop:
    """The first drop in a track.

    Args:
        track: see `track_ball`.
        start_ns: where the drop's clock is 0.
        ball: what was dropped, if that is known.
        fit_drag: whether to find the air's drag, and not the slope of the restitution.

    Raises:
        NotFoundError: there is none; the message says why.
    """
    known = _usable(track)
    if len(known) < FEWEST_SAMPLES:
        raise NotFoundError(f"the ball is seen in {len(known)} pictures: too few for a drop")
    seconds = (track.stamps_ns[known] - start_ns).astype(np.float64) * 1e-9
    down = track.gravity_px / np.linalg.norm(track.gravity_px)
    along = -(track.places_px[known] @ down)
    span = float(np.ptp(along))
    if span < _LEAST_SPAN_PX:
        raise NotFoundError(f"the ball moves by only {span:.0f} px: film it larger, from closer")
    drag_1_m = (ball.drag_1_m if ball and not fit_drag else None) or 0.0
    least_px = _WHOLE_PX_NOISE if is_whole(track.places_px[known]) else _LEAST_NOISE_PX
    noise_px = max(noise_of(along), least_px)
    distortion_px = _STRAIGHT * span
    whole = TrackSamples(
        seconds=seconds,
        positions_px=along,
        noise_px=max(noise_px, distortion_px),
        distortion_variance_fraction=max(0.0, 1 - (noise_px / distortion_px) ** 2),
        drag_1_s2=drag_1_m * CALIBRATED.gravity_m_s2 / 2,
        exposure_s=min(track.exposure_s, float(np.median(np.diff(seconds)))),
    )
    balls = (DRAGGED,) if fit_drag else (SLOPED,) if drag_1_m else (SLOPED, DRAGGED)
    fits, flights = _find_fits(whole, balls)
    best = _preferred_fit(fits)
    projection = best.projection()
    before_s = projection.impact_s - projection.fall_time_s / 4
    before = whole.part(0, int(np.searchsorted(seconds, before_s)))
    later = whole.part(int(np.searchsorted(seconds, best.samples.seconds[-1])), len(seconds))
    begin = int(np.searchsorted(seconds, best.samples.seconds[0] - _MARGIN_S))
    last = int(np.searchsorted(seconds, best.samples.seconds[-1], side="right"))
    used = np.zeros(len(track.stamps_ns), dtype=bool)
    used[known[begin:last]] = True
    across = track.places_px[used] @ np.array([down[1], -down[0]])
    return FilmedDrop(
        track=track,
        down_px=down,
        fits=fits,
        best=best,
        projection=projection,
        used=used,
        sideways=(across - np.median(across)) / projection.span_px,
        drop=_drop(seconds[begin:last], along[begin:last], projection, whole.noise_px, begin),
        left_out=len(_deep_falls_s(before, _EARLIER * projection.span_px)),
        later_s=tuple(_deep_falls_s(later, _LATER * projection.span_px)),
        flights=flights,
    )


def canonical_film(film: FilmedDrop) -> Observation:
    """The flights that were seen, on the canonical grid of `canonical`.

    They are those of the fitted ball, without the air, not the samples: those carry the noise of a
    track, which counts for much where a bounce is small.
    """
    axis, fit, drop = canonical_axis(), film.projection, film.drop
    values = replace(fit.bounce, drag=0.0).heights(axis)
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


def _usable(track: Track) -> NDArray[np.intp]:
    """Pictures in which the ball is found, each later than the one before."""
    known = np.flatnonzero(np.isfinite(track.places_px).all(axis=1))
    stamps_ns = track.stamps_ns[known]
    later = stamps_ns > np.concatenate(
        [[np.iinfo(np.int64).min], np.maximum.accumulate(stamps_ns)[:-1]]
    )
    return known[later] if np.linalg.norm(track.gravity_px) > 0 else known[:0]


def is_whole(positions_px: Array) -> bool:
    """Whether positions [px], of any shape, are rounded to whole pixels."""
    return bool(np.all(positions_px == np.round(positions_px)))


def _drop(seconds: Array, along: Array, fit: Projection, noise_px: float, first: int) -> Drop:
    """The heights of positions along the vertical; at rest where 6 samples or more lie still."""
    gravity = CALIBRATED.gravity_m_s2
    height_m = gravity * fit.fall_time_s**2 / 2
    heights = np.clip(fit.heights(along), -1.0, 2.0)
    last = float(fit.fall_times(seconds[-1:])[0])
    starts, speeds = fit.bounce.flights(last)
    lies_s = fit.impact_s + fit.fall_time_s * float(starts[-1])
    lying = seconds[(seconds > lies_s) & (speeds[-1] == 0)]
    return Drop(
        first=first,
        seconds=seconds,
        heights_m=heights * height_m,
        release_s=fit.impact_s - fit.fall_time_s,
        release_m=height_m,
        impact_s=fit.impact_s,
        contact_m=0.0,
        impact_speed_m_s=gravity * fit.fall_time_s,
        flight_restitution=fit.bounce.restitution,
        flight_restitution_sd=float("nan"),
        gravity_m_s2=gravity,
        drag=float("nan"),
        drag_sd=float("nan"),
        noise_m=noise_px / fit.span_px * height_m,
        rest_m=0.0 if len(lying) > 5 else float("nan"),
        rest_tolerance_m=height_m,
    )


def _find_fits(whole: TrackSamples, balls: Balls) -> FilmFits:
    """The fits from the first impact that may be the first one.

    Raises:
        NotFoundError: from none of them on the track is a drop's.
    """
    impacts = film_impacts(whole.seconds, whole.positions_px, whole.noise_px)
    span = float(np.ptp(whole.positions_px))
    fitted = False
    plausible: list[FilmFits] = []
    for at in range(min(len(impacts), _MOST_CANDIDATES)):
        fits = fits_from(whole, impacts[at:], balls)
        if not fits.balls:
            continue
        fitted = True
        best = best_of(fits.balls)
        view = best.projection()
        seen = view.fall_times(best.samples.seconds[-1:])[0] > _LEAST_SEEN
        size = abs(np.log(view.span_px / span)) < _MOST_LOG_SIZE
        bounces = view.residual_rms_px / view.span_px < _NO_DROP
        if seen and size and bounces and view.bounce.restitution <= _ENDLESS:
            plausible.append(fits)
            if is_good(fits.balls):
                break
    if not plausible:
        raise NotFoundError(_why_not(whole, impacts, fitted))
    return min(plausible, key=lambda fits: 0.0 if is_good(fits.balls) else misfit(fits.balls))


def _preferred_fit(fits: Sequence[FilmFit]) -> FilmFit:
    """The ideal ball's fit, the first one, unless another explains clearly more."""
    ideal, best = fits[0], best_of(fits)
    scale = min(fit.scale_px for fit in fits)
    gained = (ideal.cost(scale) - best.cost(scale)) / best.effective_sample_factor
    return best if gained > _CLEARLY else ideal


def _deep_falls_s(samples: TrackSamples, least_px: float) -> list[float]:
    """When falls of at least `least_px` end in an impact [s]."""
    seconds, positions = samples.seconds, samples.positions_px
    if len(seconds) < FEWEST_SAMPLES:
        return []
    impacts = film_impacts(seconds, positions, samples.noise_px)
    begins = [0, *impacts]
    return [
        float(seconds[at])
        for begin, at in zip(begins, impacts, strict=False)
        if positions[begin : at + 1].max() - positions[at] > least_px
    ]


def _why_not(whole: TrackSamples, impacts: list[int], fitted: bool) -> str:
    if not impacts:
        return (
            "no bounce is seen: the ball never falls onto anything in view; at the next drop: "
            "keep the table in view"
        )
    after = len(whole.seconds) - impacts[-1]
    if len(impacts) == 1 and after < FEWEST_SAMPLES:
        return (
            f"the recording, or what is seen of the ball, ends {after} pictures after the impact; "
            "at the next drop: record until the ball lies still, all in view"
        )
    if not fitted:
        return (
            "no free fall is seen before an impact (carried, caught, or too few pictures); at the "
            "next drop: let go above the table, in view, and record until the ball lies still"
        )
    return (
        "what the ball does is no drop: it does not bounce along parabolas of one acceleration; at "
        "the next drop: let it bounce on a flat table, untouched, the camera still"
    )
