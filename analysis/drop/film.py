"""Filmed drop: from the ball's track in the picture to its heights.

The scale is time: a fall that lasts T0 is g T0^2 / 2 high. So a film's frame rate must be its true
one for the heights to be true; the restitution does not depend on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.drop.bounce_fit import BounceFit
from analysis.drop.bounce_model import IMPACT, BounceSamples
from analysis.drop.bounce_posterior import BallPosterior, ball_posterior
from analysis.drop.bounce_samples import MIN_SAMPLES
from analysis.drop.film_faults import late_fault
from analysis.drop.film_reasons import too_small, why_not
from analysis.drop.film_search import FilmFit, bounces_end, film_impacts, fit_from, is_good, misfit
from analysis.drop.free_fall import Drop
from analysis.drop.observations import canonical_axis, canonical_observation, paper_axis
from analysis.drop.projection import Projection
from analysis.drop.remedies import FILM_MORE
from analysis.estimators.base import Observation, resample
from analysis.statistics import noise_of
from analysis.tracking.track import Track
from recorders.simulators.balls import Ball
from recorders.simulators.contact import CALIBRATED
from tunenet_logs.arrays import Array
from tunenet_logs.errors import NotFoundError

_MIN_SPAN_PX = 15.0  # below it no bounce is told from the noise of a track; the checks ask for 40
_MARGIN_S = 0.5  # kept before what is fitted, to be seen in a review
# Least noise [px] of positions in whole pixels, and of others. Rounding to whole pixels is no
# noise: a ball that lies still is always rounded the same way.
_WHOLE_PX_NOISE, _MIN_NOISE_PX = 0.45, 0.1

_STRAIGHT = 0.0015  # fraction of the span by which a good lens may distort the vertical
# Fractions of the drop's fall from which another fall before it, or after it, is reported.
_EARLIER, _LATER = 1.1, 0.8

_MAX_CANDIDATES = 6  # impacts that may be the first of a drop: what moves before it is a hand's
_MAX_CUTS = 3  # times that the end of a track is left out
# Rms residual, as a fraction of the fall, and restitution: what has more is no drop.
_NO_DROP, _ENDLESS = 0.05, 0.995

# Of a drop: fall times seen after the impact, and logarithm of its height over the track's.
_MIN_SEEN, _MAX_LOG_SIZE = 0.3, 1.2


@dataclass(frozen=True, eq=False)
class FilmedDrop:
    """One drop in a track, and its camera.

    Attributes:
        track: the ball in every picture.
        down_px: unit vector of the image's vertical, shape (2,).
        posterior: of the ball, with its fit.
        projection: where its heights are in the picture, by that fit; on the log's time.
        end_s: when what the ball does after its first impact ends in the picture, on the drop's
            clock: lifted, or long not found.
        used: which pictures the drop is made of, shape (T,) of the track.
        sideways: distance from the image's vertical [drop heights], shape (used pictures,).
        drop: its heights by the projection, contact at 0.
        left_out: how many impacts are before it, after deeper falls, that no drop could be fitted
            from.
        later_s: impacts after it, after falls as deep, on the drop's clock.
        flights: how many it is made of where the ball bounces otherwise after them; None where not.
        uneven_s: when its clock jumps, after the second impact: what comes later is left out; None
            where it does not.
    """

    track: Track
    down_px: Array
    posterior: BallPosterior
    projection: Projection
    end_s: float
    used: NDArray[np.bool_]
    sideways: Array
    drop: Drop
    left_out: int
    later_s: tuple[float, ...]
    flights: int | None = None
    uneven_s: float | None = None

    @property
    def fit(self) -> BounceFit:
        """Fit of the posterior's ball, in the camera that goes with it."""
        return self.posterior.fit


class _NoDropError(Exception):
    """No bounce could be fitted to a track.

    Attributes:
        impacts: samples at which a fall may end.
        fitted: whether any of them follows a free fall.
    """

    def __init__(self, impacts: list[int], fitted: bool) -> None:
        super().__init__()
        self.impacts, self.fitted = impacts, fitted


def find_filmed_drop(track: Track, start_ns: int, ball: Ball | None = None) -> FilmedDrop:
    """Find and fit the first drop in a track; its clock is 0 at `start_ns`.

    Raises:
        NotFoundError: there is none; the message says why.
    """
    known = _usable(track)
    if len(known) < MIN_SAMPLES:
        raise NotFoundError(
            f"the ball is seen in {len(known)} pictures: too few for a drop", FILM_MORE
        )
    seconds = (track.stamps_ns[known] - start_ns).astype(np.float64) * 1e-9
    down = track.gravity_px / np.linalg.norm(track.gravity_px)
    along = -(track.places_px[known] @ down)
    span = float(np.ptp(along))
    if span < _MIN_SPAN_PX:
        raise NotFoundError(too_small(track, span))
    least_px = _WHOLE_PX_NOISE if is_whole(track.places_px[known]) else _MIN_NOISE_PX
    noise_px = max(noise_of(along), least_px)
    distortion_px = _STRAIGHT * span
    whole = BounceSamples(
        seconds=seconds,
        positions=along,
        noise=max(noise_px, distortion_px),
        distortion_variance_fraction=max(0.0, 1 - (noise_px / distortion_px) ** 2),
        drag_1_m=ball.drag_1_m if ball else None,
        exposure_s=min(track.exposure_s, float(np.median(np.diff(seconds)))),
    )
    try:
        found, impacts, uneven_s = _trusted_fit(whole)
    except _NoDropError as error:
        reason = why_not(track, whole, error.impacts, fitted=error.fitted)
        raise NotFoundError(reason) from error
    posterior = ball_posterior(found.fit)
    fit = posterior.fit
    projection = fit.projection()
    end_s = float(seconds[bounces_end(seconds, along, impacts) - 1])
    before_s = projection.impact_s - projection.fall_time_s / 4
    before = whole.part(0, int(np.searchsorted(seconds, before_s)))
    later = whole.part(int(np.searchsorted(seconds, fit.samples.seconds[-1])), len(seconds))
    begin = int(np.searchsorted(seconds, fit.samples.seconds[0] - _MARGIN_S))
    last = int(np.searchsorted(seconds, fit.samples.seconds[-1], side="right"))
    used = np.zeros(len(track.stamps_ns), dtype=bool)
    used[known[begin:last]] = True
    across = track.places_px[used] @ np.array([down[1], -down[0]])
    return FilmedDrop(
        track=track,
        down_px=down,
        posterior=posterior,
        projection=projection,
        end_s=end_s if uneven_s is None else min(end_s, uneven_s),
        used=used,
        sideways=(across - np.median(across)) / projection.span,
        drop=_drop(seconds[begin:last], along[begin:last], projection, whole.noise, begin),
        left_out=len(_deep_falls_s(before, _EARLIER * projection.span)),
        later_s=tuple(_deep_falls_s(later, _LATER * projection.span)),
        flights=found.flights,
        uneven_s=uneven_s,
    )


def canonical_film(film: FilmedDrop) -> Observation:
    """Return the fall and the flights that were seen, on the canonical grid of `canonical`.

    They are the fitted ball's, not the samples: those carry the noise of a track, which counts for
    much where a bounce is small.
    """
    axis, fit, drop = canonical_axis(), film.projection, film.drop
    values = fit.bounce.heights(axis)
    first, last = fit.fall_times(drop.seconds[[0, -1]]).tolist()
    seen = last if np.isnan(drop.rest_m) else np.inf
    values[(axis < first) | (axis > seen)] = np.nan
    return canonical_observation(values)


def image_rows(film: FilmedDrop, start_s: float) -> Observation:
    """Return y in the picture, 0 at the top and 1 at the bottom: what the paper's network sees.

    The paper's 400 samples at 60 Hz start at `start_s`, on the drop's clock. A recording that ends
    with the ball at rest goes on with it at rest; else what is missing is NaN.
    """
    rows = film.track.places_px[film.used, 1] / film.track.size_px[1]
    wanted = start_s + paper_axis()
    seconds = film.drop.seconds
    values = resample(seconds, rows, wanted)
    if not np.isnan(film.drop.rest_m):
        values[wanted > seconds[-1]] = rows[-1]
    return Observation(values[:, None], paper_axis(), "time [s]", ("y [picture heights]",))


def drop_by(film: FilmedDrop, posterior: BallPosterior) -> Drop:
    """Reconstruct a film's drop by another posterior of the same pictures."""
    along = -(film.track.places_px[film.used] @ film.down_px)
    noise_px = film.drop.noise_m / film.drop.drop_height_m * film.projection.span
    view = posterior.fit.projection()
    return _drop(film.drop.seconds, along, view, noise_px, film.drop.first)


def _usable(track: Track) -> NDArray[np.intp]:
    """Return the pictures in which the ball is found, each later than the one before."""
    known = np.flatnonzero(np.isfinite(track.places_px).all(axis=1))
    stamps_ns = track.stamps_ns[known]
    later = stamps_ns > np.concatenate(
        [[np.iinfo(np.int64).min], np.maximum.accumulate(stamps_ns)[:-1]]
    )
    return known[later] if np.linalg.norm(track.gravity_px) > 0 else known[:0]


def is_whole(positions_px: Array) -> bool:
    """Return whether positions [px], of any shape, are rounded to whole pixels."""
    return bool(np.all(positions_px == np.round(positions_px)))


def _drop(seconds: Array, along: Array, fit: Projection, noise_px: float, first: int) -> Drop:
    """Build a drop of positions along the vertical; at rest where 6 samples or more lie still."""
    gravity = CALIBRATED.gravity_m_s2
    height_m = gravity * fit.fall_time_s**2 / 2
    heights = np.clip(fit.heights(along, seconds), -1.0, 2.0)
    last = float(fit.fall_times(seconds[-1:])[0])
    starts, speeds = fit.bounce.flights(last)
    lies_s = fit.impact_s + fit.fall_time_s * float(starts[-1])
    lying = seconds[(seconds > lies_s) & (speeds[-1] == 0)]
    return Drop(
        first=first,
        seconds=seconds,
        heights_m=heights * height_m,
        release_s=fit.impact_s - fit.fall_time_s * fit.bounce.fall_time,
        release_m=height_m,
        impact_s=fit.impact_s,
        contact_m=0.0,
        impact_speed_m_s=gravity * fit.fall_time_s,
        flight_restitution=fit.bounce.restitution,
        flight_restitution_sd=float("nan"),
        gravity_m_s2=gravity,
        flight_gravity_m_s2=float("nan"),
        fall_s=(fit.impact_s, fit.impact_s),
        flight_s=(fit.impact_s, fit.impact_s),
        noise_m=noise_px / fit.span * height_m,
        rest_s=float("nan"),
        rest_m=0.0 if len(lying) > 5 else float("nan"),
        rest_tolerance_m=height_m,
    )


def _find_fit(whole: BounceSamples) -> tuple[FilmFit, list[int]]:
    """Fit from the first impact that may be the first one; return the impacts from there on.

    Raises:
        _NoDropError: from none of them on the track is a drop's.
    """
    impacts = film_impacts(whole.seconds, whole.positions, whole.noise)
    span = float(np.ptp(whole.positions))
    fitted = False
    plausible: list[tuple[FilmFit, list[int]]] = []
    for at in range(min(len(impacts), _MAX_CANDIDATES)):
        found = fit_from(whole, impacts[at:])
        if found is None:
            continue
        fitted = True
        view = found.fit.projection()
        seen = view.fall_times(found.fit.samples.seconds[-1:])[0] > _MIN_SEEN
        size = abs(np.log(view.span / span)) < _MAX_LOG_SIZE
        bounces = view.residual_rms / view.span < _NO_DROP
        if seen and size and bounces and view.bounce.restitution <= _ENDLESS:
            plausible.append((found, impacts[at:]))
            if is_good(found.fit):
                break
    if not plausible:
        raise _NoDropError(impacts, fitted)
    return min(plausible, key=lambda one: 0.0 if is_good(one[0].fit) else misfit(one[0].fit))


def _trusted_fit(whole: BounceSamples) -> tuple[FilmFit, list[int], float | None]:
    """Fit the track before its `late_fault`; return its impacts, when a clock is at fault [s].

    Raises:
        _NoDropError: see `_find_fit`.
    """
    (found, impacts), uneven_s = _find_fit(whole), None
    for _ in range(_MAX_CUTS):
        fault = late_fault(found.fit)
        if fault is None:
            break
        try:
            shorter, _ = _find_fit(whole.part(0, int(whole.seconds.searchsorted(fault.seconds))))
        except _NoDropError:
            break
        apart_s = shorter.fit.unknowns[IMPACT] - found.fit.unknowns[IMPACT]
        if abs(apart_s) > shorter.fit.projection().fall_time_s / 4:
            break  # of another drop
        found = FilmFit(shorter.fit, shorter.flights or fault.flights or found.flights)
        uneven_s = fault.seconds if fault.flights is None else uneven_s
    return found, impacts, uneven_s


def _deep_falls_s(samples: BounceSamples, least_px: float) -> list[float]:
    """Return when falls of at least `least_px` end in an impact [s]."""
    seconds, positions = samples.seconds, samples.positions
    if len(seconds) < MIN_SAMPLES:
        return []
    impacts = film_impacts(seconds, positions, samples.noise)
    begins = [0, *impacts]
    return [
        float(seconds[at])
        for begin, at in zip(begins, impacts, strict=False)
        if positions[begin : at + 1].max() - positions[at] > least_px
    ]
