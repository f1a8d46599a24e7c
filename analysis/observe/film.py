"""A filmed drop: from the ball's track in the picture to its heights.

The scale is time: a fall that lasts T0 is g T0^2 / 2 high. So a film's frame rate must be its true
one for the heights to be true; the restitution does not depend on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.observe.base import Observation, resample
from analysis.observe.bounce_bank import bank_starts
from analysis.observe.drop import canonical_axis, paper_axis
from analysis.observe.film_fit import (
    DRAG,
    DRAGGED,
    FALL,
    IDEAL,
    IMPACT,
    RESTITUTION,
    SLOPE,
    SLOPED,
    SPAN,
    FilmFit,
    Samples,
    fit_film,
)
from analysis.observe.film_windows import bounces_end, fall_start, film_impacts, held_start
from analysis.observe.free_fall import Drop, noise_of
from analysis.observe.projection import Projection
from analysis.observe.tracking.track import Track
from recorders.simulators.balls import Ball
from recorders.simulators.contact import CALIBRATED
from tunenet_logs.errors import NotFoundError

Array = NDArray[np.float64]
Balls = Sequence[tuple[int, ...]]

_LEAST_SPAN_PX = 15.0
_MOST_IMPACTS = 6
_MOST_CANDIDATES = 6
_FALL_SHARES = (0.96, 0.8, 0.6)
_STARTS = 6
_ROUGHLY = (10, 1e-4)
_FEWEST, _FEWEST_SAMPLES = 4, 12
_MARGIN_S = 0.5
_REST_SEEN = 2.0
_WHOLE_PX_NOISE, _LEAST_NOISE_PX = 0.45, 0.1
"""Rounding to whole pixels is no noise: a ball that lies still is always rounded the same way."""

_STRAIGHT = 0.0015
"""Of the span: what no lens is held to."""

_USUAL = {SLOPE: 0.08, DRAG: 0.05}
_CLEARLY = 3.0
"""Log likelihood that another ball than the ideal one has to gain."""

_ENDLESS = 0.995
"""A restitution that no ball has."""


@dataclass(frozen=True, eq=False)
class FilmedDrop:
    """One drop in a track.

    Attributes:
        track: the ball in every picture.
        down_px: unit vector of the image's vertical, shape (2,).
        fits: to the same samples: of a ball that keeps its restitution, of one whose restitution
            falls with speed, and of one that the air slows; the latter unless the air is known, and
            not the one before if the drag is asked for.
        projection: where its heights are in the picture, by the best fit; on the log's time.
        used: which pictures the drop is made of, shape (T,) of the track.
        sideways: distance from the image's vertical [drop heights], one for each used picture.
        drop: its heights by the projection, contact at 0.
        left_out: impacts before it, after deeper falls, from which no drop could be fitted.
    """

    track: Track
    down_px: Array
    fits: tuple[FilmFit, ...]
    projection: Projection
    used: NDArray[np.bool_]
    sideways: Array
    drop: Drop
    left_out: int

    @property
    def best(self) -> FilmFit:
        """Of the fits: the ideal ball's unless another explains clearly more."""
        return _told_by(self.fits)


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
    known = np.flatnonzero(track.found)
    seconds = (track.stamps_ns[known] - start_ns).astype(np.float64) * 1e-9
    down = track.gravity_px / np.linalg.norm(track.gravity_px)
    along = -(track.places_px[known] @ down)
    span = float(np.ptp(along))
    if span < _LEAST_SPAN_PX:
        raise NotFoundError(f"the ball moves by only {span:.0f} px: film it larger, from closer")
    drag_1_m = (ball.drag_1_m if ball and not fit_drag else None) or 0.0
    least_px = _WHOLE_PX_NOISE if is_whole(track.places_px[known]) else _LEAST_NOISE_PX
    noise_px = max(noise_of(along), least_px)
    bent_px = _STRAIGHT * span
    bent = max(0.0, 1 - (noise_px / bent_px) ** 2)
    noise_px = max(noise_px, bent_px)
    whole = Samples(seconds, along, noise_px, bent, drag_1_m * CALIBRATED.gravity_m_s2 / 2)
    balls = (DRAGGED,) if fit_drag else (SLOPED,) if drag_1_m else (SLOPED, DRAGGED)
    fits = _best_fits(whole, balls)
    best = _told_by(fits)
    projection = best.projection()
    begin = int(np.searchsorted(seconds, best.samples.seconds[0] - _MARGIN_S))
    last = int(np.searchsorted(seconds, best.samples.seconds[-1], side="right"))
    used = np.zeros(len(track.stamps_ns), dtype=bool)
    used[known[begin:last]] = True
    across = track.places_px[used] @ np.array([down[1], -down[0]])
    return FilmedDrop(
        track=track,
        down_px=down,
        fits=fits,
        projection=projection,
        used=used,
        sideways=(across - np.median(across)) / projection.span_px,
        drop=_drop(seconds[begin:last], along[begin:last], projection, noise_px, begin),
        left_out=_left_out(whole, projection),
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


def best_of(fits: Sequence[FilmFit]) -> FilmFit:
    """The likeliest of fits to the same samples."""
    scale = min(fit.scale_px for fit in fits)
    return min(fits, key=lambda fit: fit.cost(scale))


def _told_by(fits: Sequence[FilmFit]) -> FilmFit:
    ideal, best = fits[0], best_of(fits)
    scale = min(fit.scale_px for fit in fits)
    gained = (ideal.cost(scale) - best.cost(scale)) / best.worth
    return best if gained > _CLEARLY else ideal


def _best_fits(whole: Samples, balls: Balls) -> tuple[FilmFit, ...]:
    """The fits from the first impact that may be the first one.

    Raises:
        NotFoundError: from none of them on the track is a drop's.
    """
    impacts = film_impacts(whole.seconds, whole.places_px, whole.noise_px)
    span = float(np.ptp(whole.places_px))
    found: list[tuple[FilmFit, ...]] = []
    for index in impacts[:_MOST_CANDIDATES]:
        fits = _fits_from(whole, index, balls)
        if not fits:
            continue
        found.append(fits)
        if _good(fits) and _plausible(best_of(fits), span):
            break
    plausible = [fits for fits in found if _plausible(best_of(fits), span)]
    if not plausible:
        raise NotFoundError(_why_not(len(impacts), bool(found)))
    return min(plausible, key=lambda fits: _misfit(fits) if not _good(fits) else 0.0)


def _fits_from(whole: Samples, index: int, balls: Balls) -> tuple[FilmFit, ...]:
    """The fits if the ball first hits near sample `index`; none where no fall is seen before."""
    last = bounces_end(whole.seconds, whole.places_px, index)
    best: tuple[FilmFit, ...] = ()
    for share in _FALL_SHARES:
        first = fall_start(whole.places_px, index, share, whole.noise_px)
        if index - first < _FEWEST or last - index < _FEWEST:
            continue
        rough = _rough_fits(_part(whole, first, last), float(whole.seconds[index]))
        if not rough:
            continue
        fits = _finished(whole, rough, balls)
        if not best or _misfit(fits) < 0.7 * _misfit(best):
            best = fits
        if _good(fits):
            break
    return best


def _left_out(whole: Samples, chosen: Projection) -> int:
    """How many impacts are seen before the chosen one, each after a deeper fall."""
    before = int(np.searchsorted(whole.seconds, chosen.impact_s - chosen.fall_time_s / 4))
    seconds, places = whole.seconds[:before], whole.places_px[:before]
    if before < _FEWEST_SAMPLES:
        return 0
    impacts = film_impacts(seconds, places, whole.noise_px)
    begins = [0, *impacts]
    falls = [
        float(places[begin : at + 1].max() - places[at])
        for begin, at in zip(begins, impacts, strict=False)
    ]
    return sum(fall > 1.1 * chosen.span_px for fall in falls)


def _rough_fits(samples: Samples, impact_s: float) -> list[FilmFit]:
    """From the best points of the bank, best first."""
    bank = bank_starts(samples.seconds, samples.places_px, impact_s, _STARTS)
    fits = [fit_film(samples, start, IDEAL, *_ROUGHLY) for _, start in bank]
    scale = min((fit.scale_px for fit in fits), default=1.0)
    return sorted(fits, key=lambda fit: fit.cost(scale))


def _finished(whole: Samples, rough: list[FilmFit], balls: Balls) -> tuple[FilmFit, ...]:
    """All balls, fitted to the bounces that count and to the ball before it was let go."""
    starts = [fit.unknowns for fit in rough[:3]]
    real = best_of([_from_any(rough[0].samples, starts, ball, *_ROUGHLY) for ball in balls])
    samples = _counting(whole, real)
    real = _from_any(samples, [real.unknowns], real.free)
    samples = _with_held(whole, real)
    if samples is not real.samples:
        held = fit_film(samples, real.unknowns, real.free)
        if held.nearly_worst_px < 1.5 * max(real.nearly_worst_px, whole.noise_px):
            real = held
    ideal = _from_any(real.samples, [real.unknowns, rough[0].unknowns], IDEAL)
    starts = [real.unknowns, ideal.unknowns]
    return (ideal, *(_from_any(real.samples, starts, ball) for ball in balls))


def _from_any(
    samples: Samples,
    starts: Sequence[Array],
    free: tuple[int, ...],
    most: int = 30,
    gain: float = 1e-6,
) -> FilmFit:
    """The best fit from any of the starts, with a usual slope or drag where they have none."""
    fits = []
    for start in starts:
        begin = start.copy()
        for one, usual in _USUAL.items():
            begin[one] = (begin[one] or usual) if one in free else 0.0
        fits.append(fit_film(samples, begin, free, most, gain))
    return best_of(fits)


def _counting(whole: Samples, fit: FilmFit) -> Samples:
    """Without the bounces after the sixth, and without most of a rest."""
    impact_s, fall_s = float(fit.unknowns[IMPACT]), float(np.exp(fit.unknowns[FALL]))
    seconds = fit.samples.seconds
    last = float((seconds[-1] - impact_s) / fall_s)
    starts, speeds = whole.bounce(fit.unknowns).flights(last)
    if len(starts) > _MOST_IMPACTS:
        end = float(starts[_MOST_IMPACTS])
    else:
        end = float(starts[-1]) if speeds[-1] == 0 else np.inf
    first = int(np.searchsorted(whole.seconds, seconds[0]))
    end_s = min(impact_s + fall_s * (end + _REST_SEEN), float(seconds[-1]))
    last_at = int(np.searchsorted(whole.seconds, end_s, side="right"))
    return _part(whole, first, last_at) if last_at - first > _FEWEST_SAMPLES else fit.samples


def _with_held(whole: Samples, fit: FilmFit) -> Samples:
    """With the samples just before the fall in which the ball is where it is let go."""
    first = int(np.searchsorted(whole.seconds, fit.samples.seconds[0]))
    fall_s = float(np.exp(fit.unknowns[FALL]))
    earliest = float(fit.unknowns[IMPACT]) - 2 * fall_s
    begin = int(np.searchsorted(whole.seconds, earliest))
    if first == begin:
        return fit.samples
    left = _part(whole, begin, first).left_px(fit.unknowns)
    held = begin + held_start(left, 4 * fit.scale_px)
    last = first + len(fit.samples.seconds)
    return fit.samples if first == held else _part(whole, held, last)


def _part(whole: Samples, first: int, last: int) -> Samples:
    return replace(whole, seconds=whole.seconds[first:last], places_px=whole.places_px[first:last])


def is_whole(places_px: Array) -> bool:
    """Whether places are rounded to whole pixels."""
    return bool(np.all(places_px == np.round(places_px)))


def _misfit(fits: Sequence[FilmFit]) -> float:
    """What the best ball leaves, as a share of the fall."""
    return min(fit.nearly_worst_px / float(fit.unknowns[SPAN]) for fit in fits)


def _good(fits: Sequence[FilmFit]) -> bool:
    """Whether what is left is noise, or little."""
    best = best_of(fits)
    noise = best.samples.noise_px / float(best.unknowns[SPAN])
    return _misfit(fits) < 1.5 * noise + 0.004


def _plausible(fit: FilmFit, span_px: float) -> bool:
    """Whether it can be a drop at all: what it sees of one, and how large."""
    seconds = fit.samples.seconds[-1] - fit.unknowns[IMPACT]
    after = float(seconds / np.exp(fit.unknowns[FALL]))
    size = abs(np.log(fit.unknowns[SPAN] / span_px))
    rms = float(np.sqrt(np.mean(fit.left_px**2))) / fit.unknowns[SPAN]
    lasting = fit.unknowns[RESTITUTION] > _ENDLESS
    return bool(after > 0.3 and size < 1.2 and rms < 0.05 and not lasting)


def _why_not(impacts: int, fitted: bool) -> str:
    if not impacts:
        return (
            "no bounce is seen: the ball never falls onto anything in view; at the next drop: "
            "keep the table in view"
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


def _drop(seconds: Array, along: Array, fit: Projection, noise_px: float, first: int) -> Drop:
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
