"""Balls fitted to a track from an impact on: which of its samples count, and for what flights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from analysis.drop.film_fit import (
    DRAG,
    FALL,
    IDEAL,
    IMPACT,
    PERSPECTIVE,
    RESTITUTION,
    SLOPE,
    SPAN,
    FilmFit,
    TrackSamples,
    fit_film,
    grid_starts,
)
from analysis.drop.free_fall import run_slopes, slope_corners
from tunenet_logs.arrays import Array

Balls = Sequence[tuple[int, ...]]
"""Free unknowns of each kind of ball that is fitted."""

FEWEST_SAMPLES = 12
"""For six unknowns and a noise."""

MOST_IMPACTS = 6
"""Of a fit: a later bounce is too low to say more, and one law holds less well for it."""

_FALL_FRACTIONS = (0.96, 0.8, 0.6)
"""Lower parts of a descent that are tried as its free fall, the largest first."""

_STARTS = 6
_ROUGHLY = (10, 1e-4)
"""Points of the grid that are fitted from (the best alone ends in the wrong minimum at times), and
iterations and gain in cost that end those fits, which are only compared."""

_FEWEST = 4
"""TrackSamples of a fall, and of what follows it."""

_REST_SEEN = 2.0
"""Fall times of a rest that are fitted: more of them would only repeat the contact's position."""

_USUAL, _SLIGHT = {SLOPE: 0.08, DRAG: 0.05}, 0.2
"""Where the fit of a law begins: what most balls have, and a fraction of that for a second fit."""

_SHAPE, _SAME = (RESTITUTION, FALL, PERSPECTIVE), np.array([0.01, 0.02, 0.05])
"""By how much starts differ that may lead to different ends."""

_LITTLE, _EXACT = 0.004, 0.001
"""Fractions of the fall: residuals beyond noise that pass, of all flights, and of the first."""

_HOPELESS = 0.12
"""Fraction of the fall, rms: a rough fit with more becomes no drop's."""

_STEEP = 0.25
"""A slope beyond those of real balls."""

_HELD, _AT_RELEASE = 1.5, 0.05
"""Fall times before the impact, from which on a ball is where it is let go, to that fraction."""

_SURE_SLOPE = 0.06
"""Noise of a slope, as a fraction of the steepest, at which runs of samples are long enough."""

_FAST, _SHARP = 0.25, 0.25
"""An impact, as fractions: of the fastest fall, before it; of the sharpest corner, at it. They are
higher than for recorded positions: a picture has perspective, and other things that move."""

_LIFTED, _LYING = 1.15, 0.05
"""Fractions of a fall: above the one the ball is lifted, below the other it lies."""

_GAP_S = 1.0
"""A longer time in which the ball is not found ends its bounces."""


class FilmFits(NamedTuple):
    """Balls, fitted to the same samples.

    Attributes:
        balls: the ideal one first.
        flights: how many are explained of a ball that then bounces otherwise; None where all are.
    """

    balls: tuple[FilmFit, ...]
    flights: int | None = None


def best_of(fits: Sequence[FilmFit]) -> FilmFit:
    """The likeliest of fits to the same samples."""
    scale = min(fit.scale_px for fit in fits)
    return min(fits, key=lambda fit: fit.cost(scale))


def fits_from(whole: TrackSamples, impacts: Sequence[int], balls: Balls) -> FilmFits:
    """The fits if the first of these is the first impact; none where no fall is seen before."""
    index, last = impacts[0], bounces_end(whole.seconds, whole.positions_px, impacts)
    best: tuple[FilmFit, ...] = ()
    for fraction in _FALL_FRACTIONS:
        first = fall_start(whole.positions_px, index, fraction, whole.noise_px)
        if index - first < _FEWEST or last - index < _FEWEST:
            continue
        rough = _rough_fits(whole.part(first, last), float(whole.seconds[index]))
        if not rough:
            continue
        view = rough[0].projection()
        hopeful = view.residual_rms_px / view.span_px < _HOPELESS
        fits = _finished(whole, rough, balls) if hopeful else (rough[0],)
        if not best or misfit(fits) < 0.7 * misfit(best):
            best = fits
        if is_good(fits):
            return FilmFits(fits)
    return _of_first_flights(whole, impacts, best, balls) if best else FilmFits(())


def _of_first_flights(
    whole: TrackSamples, impacts: Sequence[int], fits: tuple[FilmFit, ...], balls: Balls
) -> FilmFits:
    """The fits to as many flights as one law explains, or those to all if it explains none.

    A ball that is out of round, or later hits an edge, is a ball up to there.
    """
    start_s, end_s = fits[0].samples.seconds[[0, -1]]
    first = int(np.searchsorted(whole.seconds, start_s))
    for flights in range(min(len(impacts), MOST_IMPACTS) - 1, 0, -1):
        end = impacts[flights]
        if whole.seconds[end] >= end_s or end - impacts[0] < _FEWEST:
            continue
        begun = whole.part(0, end)
        rough = _rough_fits(begun.part(first, end), float(whole.seconds[impacts[0]]))
        shorter = _finished(begun, rough, balls) if rough else ()
        if shorter and is_good(shorter, _EXACT) and _is_usual(whole, best_of(shorter)):
            return FilmFits(shorter, flights)
    return FilmFits(fits)


def _rough_fits(samples: TrackSamples, impact_s: float) -> list[FilmFit]:
    """Of the ideal ball from the best points of the grid, best first."""
    starts = grid_starts(samples.seconds, samples.positions_px, impact_s, _STARTS)
    fits = [fit_film(samples, start, IDEAL, *_ROUGHLY) for start in starts]
    scale = min((fit.scale_px for fit in fits), default=1.0)
    return sorted(fits, key=lambda fit: fit.cost(scale))


def _finished(whole: TrackSamples, rough: list[FilmFit], balls: Balls) -> tuple[FilmFit, ...]:
    """All balls, fitted to the bounces that count and to the ball before it was let go."""
    starts: list[Array] = []
    for start in (fit.unknowns for fit in rough[:3]):  # without those that lead to the same end
        if not any(np.all(np.abs(start - kept)[list(_SHAPE)] < _SAME) for kept in starts):
            starts.append(start)
    real = best_of([_from_any(rough[0].samples, starts, ball, *_ROUGHLY) for ball in balls])
    samples = _counting(whole, real)
    real = _from_any(samples, [real.unknowns], real.free)
    samples = _with_held(whole, real)
    if samples is not real.samples:
        held = fit_film(samples, real.unknowns, real.free)
        if held.tail_sd_px < 1.5 * max(real.tail_sd_px, whole.noise_px):
            real = held
    samples = _sharp(real)
    ideal = _from_any(samples, [real.unknowns, rough[0].unknowns], IDEAL)
    starts = [real.unknowns, ideal.unknowns]
    return (ideal, *(_from_any(samples, starts, ball) for ball in balls))


def _from_any(
    samples: TrackSamples,
    starts: Sequence[Array],
    free: tuple[int, ...],
    most: int = 30,
    gain: float = 1e-6,
) -> FilmFit:
    """The best fit from any of the starts, with a usual slope or drag where they have none.

    From too steep a law a fit may not find back to a slight one, so a slight one is tried too.
    """
    fits = []
    for start in starts:
        unset = any(law in free and not start[law] for law in _USUAL)
        for fraction in (1.0, _SLIGHT) if unset else (1.0,):
            begin = start.copy()
            for law, usual in _USUAL.items():
                begin[law] = (begin[law] or fraction * usual) if law in free else 0.0
            fits.append(fit_film(samples, begin, free, most, gain))
    return best_of(fits)


def _counting(whole: TrackSamples, fit: FilmFit) -> TrackSamples:
    """Without the bounces after the sixth, and without most of a rest."""
    impact_s, fall_s = float(fit.unknowns[IMPACT]), float(np.exp(fit.unknowns[FALL]))
    seconds = fit.samples.seconds
    last = float((seconds[-1] - impact_s) / fall_s)
    starts, speeds = whole.bounce(fit.unknowns).flights(last)
    if len(starts) > MOST_IMPACTS:
        end = float(starts[MOST_IMPACTS])
    else:
        end = float(starts[-1]) if speeds[-1] == 0 else np.inf
    first = int(np.searchsorted(whole.seconds, seconds[0]))
    end_s = min(impact_s + fall_s * (end + _REST_SEEN), float(seconds[-1]))
    last_at = int(np.searchsorted(whole.seconds, end_s, side="right"))
    return whole.part(first, last_at) if last_at - first > FEWEST_SAMPLES else fit.samples


def _with_held(whole: TrackSamples, fit: FilmFit) -> TrackSamples:
    """With the samples just before the fall in which the ball is where it is let go."""
    first = int(np.searchsorted(whole.seconds, fit.samples.seconds[0]))
    fall_s = float(np.exp(fit.unknowns[FALL]))
    earliest = float(fit.unknowns[IMPACT]) - 2 * fall_s
    begin = int(np.searchsorted(whole.seconds, earliest))
    if first == begin:
        return fit.samples
    residuals = whole.part(begin, first).residuals_px(fit.unknowns)
    held, misses = first, 0
    while held > begin and misses < 3:  # three in a row that are elsewhere: it is not held yet
        held -= 1
        misses = misses + 1 if abs(residuals[held - begin]) > 4 * fit.scale_px else 0
    held = min(held + misses, first)
    last = first + len(fit.samples.seconds)
    return fit.samples if first == held else whole.part(held, last)


def _sharp(fit: FilmFit) -> TrackSamples:
    """Without the pictures whose exposure an impact may be in: those show both of its sides."""
    samples, fall_s = fit.samples, float(np.exp(fit.unknowns[FALL]))
    times = samples.times(fit.unknowns)
    impacts, _ = samples.bounce(fit.unknowns).flights(float(times[-1]))
    after = np.searchsorted(impacts, times, side="right")
    edges = np.concatenate([[-np.inf], impacts, [np.inf]])
    apart_s = fall_s * np.minimum(times - edges[after], edges[after + 1] - times)
    kept = (apart_s > samples.exposure_s / 2) | (times > impacts[-1])
    if np.count_nonzero(kept) < FEWEST_SAMPLES:
        return samples
    return replace(samples, seconds=samples.seconds[kept], positions_px=samples.positions_px[kept])


def misfit(fits: Sequence[FilmFit]) -> float:
    """Residuals of the best ball, as a fraction of the fall."""
    return min(fit.tail_sd_px / float(fit.unknowns[SPAN]) for fit in fits)


def is_good(fits: Sequence[FilmFit], little: float = _LITTLE) -> bool:
    """Whether the residuals are noise, or little of the fall."""
    best = best_of(fits)
    noise = best.samples.noise_px / float(best.unknowns[SPAN])
    return misfit(fits) < 1.5 * noise + little


def _is_usual(whole: TrackSamples, fit: FilmFit) -> bool:
    """Whether a law is one that balls have, and lets go of the ball where it is seen held.

    Few flights are explained by many laws.
    """
    times = whole.times(fit.unknowns)
    held = (times > -_HELD) & (times < -1.0)
    off = np.median(whole.residuals_px(fit.unknowns)[held]) if np.any(held) else 0.0
    return abs(fit.unknowns[SLOPE]) < _STEEP and abs(off) < _AT_RELEASE * fit.unknowns[SPAN]


def film_impacts(seconds: Array, along_px: Array, noise_px: float) -> list[int]:
    """Samples at which a fast fall ends, in order.

    The slopes are taken over as many samples as the noise requires.

    Args:
        seconds: shape (T,).
        along_px: positions along the image's vertical, up positive, shape (T,).
        noise_px: standard deviation of a position.
    """
    period_s = float(np.median(np.diff(seconds)))
    width = 2
    while True:
        if len(along_px) <= 2 * width + 1:
            return []
        slopes = run_slopes(seconds, along_px, width)
        half = (width + 1) // 2
        noise = noise_px * np.sqrt(2 / half) / ((width + 1 - half) * period_s)
        if noise < -_SURE_SLOPE * slopes.min() or 8 * width > len(along_px):
            break
        width += max(1, width // 3)
    return slope_corners(slopes, width, _FAST * min(slopes.min(), 0.0), _SHARP)


def fall_start(along_px: Array, index: int, fraction: float, noise_px: float) -> int:
    """The first sample of the fall to `index`, its slow upper part left out.

    There a hand may still be.

    Args:
        along_px: positions, up positive, shape (T,).
        index: of the impact.
        fraction: of the fall that is kept, from below.
        noise_px: standard deviation of a position.
    """
    low = float(along_px[max(index - 1, 0) : index + 2].min())
    top, first = low, index
    while first > 0 and along_px[first - 1] > top - 4 * noise_px - 0.03 * (top - low):
        first -= 1
        top = max(top, float(along_px[first]))
    high = np.flatnonzero(along_px[first:index] > low + fraction * (top - low))
    return first + (int(high[-1]) + 1 if len(high) else 0)


def bounces_end(seconds: Array, along_px: Array, impacts: Sequence[int]) -> int:
    """Where the bounces after the first of these impacts end: lifted, or long not found.

    Args:
        seconds: shape (T,).
        along_px: positions, up positive, shape (T,).
        impacts: as `film_impacts` finds them, from the first one on.
    """
    index = impacts[0]
    low = float(along_px[max(index - 1, 0) : index + 2].min())
    top = float(along_px[max(0, index - 200) : index].max())
    last = len(along_px)
    limits = [(index, low + _LIFTED * (top - low))]
    if len(impacts) > 1 and impacts[1] > index + 2:  # no bounce is higher than the first
        apex = float(along_px[index : impacts[1]].max())
        limits.append((impacts[1], apex + (_LIFTED - 1) * (top - low)))
    for begin, most in limits:
        above = np.flatnonzero(along_px[begin:last] > most)
        if len(above):
            lying = np.flatnonzero(along_px[begin : begin + above[0]] < low + _LYING * (top - low))
            last = begin + int(lying[-1] if len(lying) else above[0])
    gaps = np.flatnonzero(np.diff(seconds[index:last]) > _GAP_S)
    return index + int(gaps[0]) + 1 if len(gaps) else last
