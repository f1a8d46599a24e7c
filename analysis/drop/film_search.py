"""Search for a bounce in a film's track from an impact on: its samples and flights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from analysis.drop.bounce_fit import BounceFit, best_of, fit_bounce
from analysis.drop.bounce_grid import grid_starts
from analysis.drop.bounce_model import (
    DRAG,
    FALL,
    IDEAL,
    IMPACT,
    MAX_BENDS,
    PERSPECTIVE,
    RESTITUTION,
    SLOPE,
    SPAN,
    BounceSamples,
)
from analysis.drop.bounce_samples import MAX_IMPACTS, sharp, with_held
from analysis.drop.free_fall import run_slopes, slope_corners
from analysis.statistics import correlation_time
from tunenet_logs.arrays import Array

MIN_SAMPLES = 12  # for six unknowns and a noise
# Lower parts of a descent that are tried as its free fall, the largest first.
_FALL_FRACTIONS = (0.96, 0.8, 0.6)

_STARTS = 6
# Points of the grid that are fitted from (the best alone ends in the wrong minimum at times), and
# iterations and gain in cost that end those fits, which are only compared.
_ROUGHLY = (10, 1e-4)

_MIN_COUNT = 4  # samples of a fall, and of what follows it
# Fall times of a rest that are fitted: more of them would only repeat the contact's position.
_REST_SEEN = 2.0

# Where the fit of a law begins: what most balls have, and a fraction of that for a second fit.
_TYPICAL, _SLIGHT = {SLOPE: 0.08, DRAG: 0.05}, 0.2

# By how much starts differ that may lead to different ends.
_SHAPE, _SAME = (RESTITUTION, FALL, PERSPECTIVE), np.array([0.01, 0.02, 0.05])

# Fractions of the fall: residuals beyond noise that pass, of all flights, and of the first.
_LITTLE, _EXACT = 0.004, 0.001

_HOPELESS = 0.12  # fraction of the fall, rms: a rough fit with more becomes no drop's
# Log likelihood that bends of the contact have to gain: of 100 straight ones 1 gains as much.
_CLEARLY = 8.0

_STEEP = 0.25  # a slope beyond those of real balls
# Fall times before the impact, from which on a ball is where it is let go, to that fraction.
_HELD, _AT_RELEASE = 1.5, 0.05

# Noise of a slope, as a fraction of the steepest, at which runs of samples are long enough.
_SURE_SLOPE = 0.06

# An impact, as fractions: of the fastest fall, before it; of the sharpest corner, at it. They are
# higher than for recorded positions: a picture has perspective, and other things that move.
_FAST, _SHARP = 0.25, 0.25

# Fractions of a fall: above the one the ball is lifted, below the other it lies.
_LIFTED, _LYING = 1.15, 0.05

_GAP_S = 1.0  # a longer time in which the ball is not found ends its bounces


class FilmFit(NamedTuple):
    """Bounce fitted to a film.

    Attributes:
        fit: of all unknowns.
        flights: how many are explained of a ball that then bounces otherwise; None where all are.
    """

    fit: BounceFit
    flights: int | None = None


def fit_from(whole: BounceSamples, impacts: Sequence[int]) -> FilmFit | None:
    """Fit a bounce whose first impact is the first of these; None where no fall is seen before."""
    index, last = impacts[0], bounces_end(whole.seconds, whole.positions, impacts)
    best: BounceFit | None = None
    for fraction in _FALL_FRACTIONS:
        first = fall_start(whole.positions, index, fraction, whole.noise)
        if index - first < _MIN_COUNT or last - index < _MIN_COUNT:
            continue
        rough = _rough_fits(whole.part(first, last), float(whole.seconds[index]))
        if not rough:
            continue
        view = rough[0].projection()
        hopeful = view.residual_rms / view.span < _HOPELESS
        fit = _finished(whole, rough) if hopeful else rough[0]
        if best is None or misfit(fit) < 0.7 * misfit(best):
            best = fit
        if is_good(fit):
            return FilmFit(_likelier(fit, with_bends(fit)))
    if best is not None and misfit(best) < _HOPELESS:
        bent = with_bends(best)
        if is_good(bent):
            return FilmFit(bent)
    return _of_first_flights(whole, impacts, best) if best else None


def _of_first_flights(whole: BounceSamples, impacts: Sequence[int], fit: BounceFit) -> FilmFit:
    """Fit as many flights as one law explains, or keep the fit to all if it explains none.

    A ball that is out of round, or later hits an edge, is a ball up to there.
    """
    start_s, end_s = fit.samples.seconds[[0, -1]]
    first = int(np.searchsorted(whole.seconds, start_s))
    for flights in range(min(len(impacts), MAX_IMPACTS) - 1, 0, -1):
        end = impacts[flights]
        if whole.seconds[end] >= end_s or end - impacts[0] < _MIN_COUNT:
            continue
        begun = whole.part(0, end)
        rough = _rough_fits(begun.part(first, end), float(whole.seconds[impacts[0]]))
        shorter = _finished(begun, rough) if rough else None
        if shorter and is_good(shorter, _EXACT) and _is_usual(whole, shorter):
            return FilmFit(shorter, flights)
    return FilmFit(fit)


def _likelier(fit: BounceFit, bent: BounceFit) -> BounceFit:
    """Choose the fit without bends unless they explain clearly more: any noise is bent a little."""
    scale = min(fit.scale, bent.scale)
    factor = max(correlation_time(fit.residuals, len(fit.free)), fit.effective_sample_factor)
    gained = (fit.misfit_cost(scale) - bent.misfit_cost(scale)) / factor
    return bent if gained - bent.prior_cost() + fit.prior_cost() > _CLEARLY else fit


def with_bends(fit: BounceFit) -> BounceFit:
    """Refit with a contact that may move through the picture from each impact on."""
    impacts_s = fit.projection().impacts(float(fit.samples.seconds[-1]))
    impacts_s = float(fit.unknowns[IMPACT]) + float(np.exp(fit.unknowns[FALL])) * impacts_s
    samples = replace(fit.samples, bends_s=tuple(impacts_s[:MAX_BENDS].tolist()))
    return fit_bounce(samples, fit.unknowns, samples.unknowns, most=60)


def _rough_fits(samples: BounceSamples, impact_s: float) -> list[BounceFit]:
    """Fit the ideal ball from the best points of the grid, best first."""
    starts = grid_starts(samples.seconds, samples.positions, impact_s, _STARTS)
    fits = [fit_bounce(samples, start, IDEAL, *_ROUGHLY) for start in starts]
    scale = min((fit.scale for fit in fits), default=1.0)
    return sorted(fits, key=lambda fit: fit.cost(scale))


def _finished(whole: BounceSamples, rough: list[BounceFit]) -> BounceFit:
    """Fit the bounces that count and the ball before it was let go."""
    starts: list[Array] = []
    for start in (fit.unknowns for fit in rough[:3]):  # without those that lead to the same end
        if not any(np.all(np.abs(start - kept)[list(_SHAPE)] < _SAME) for kept in starts):
            starts.append(start)
    fit = _from_any(rough[0].samples, starts, *_ROUGHLY)
    samples = _counting(whole, fit)
    fit = _from_any(samples, [fit.unknowns])
    samples = with_held(whole, fit)
    if samples is not fit.samples:
        held = fit_bounce(samples, fit.unknowns, fit.free)
        if held.tail_sd < 1.5 * max(fit.tail_sd, whole.noise):
            fit = held
    return _from_any(sharp(fit), [fit.unknowns, rough[0].unknowns])


def _from_any(
    samples: BounceSamples, starts: Sequence[Array], most: int = 30, gain: float = 1e-6
) -> BounceFit:
    """Fit from all starts and keep the best, with a usual slope and drag where they have none.

    From too steep a law a fit may not find back to a slight one, so a slight one is tried too.
    """
    fits: list[BounceFit] = []
    for start in starts:
        unset = not any(start[law] for law in _TYPICAL)
        for fraction in (1.0, _SLIGHT) if unset else (1.0,):
            begin = start.copy()
            for law, usual in _TYPICAL.items():
                begin[law] = begin[law] or fraction * usual
            fits.append(fit_bounce(samples, begin, samples.unknowns, most, gain))
    return best_of(fits)


def _counting(whole: BounceSamples, fit: BounceFit) -> BounceSamples:
    """Remove the bounces after the sixth, and most of a rest."""
    impact_s, fall_s = float(fit.unknowns[IMPACT]), float(np.exp(fit.unknowns[FALL]))
    seconds = fit.samples.seconds
    last = float((seconds[-1] - impact_s) / fall_s)
    starts, speeds = whole.bounce(fit.unknowns).flights(last)
    if len(starts) > MAX_IMPACTS:
        end = float(starts[MAX_IMPACTS])
    else:
        end = float(starts[-1]) if speeds[-1] == 0 else np.inf
    first = int(np.searchsorted(whole.seconds, seconds[0]))
    end_s = min(impact_s + fall_s * (end + _REST_SEEN), float(seconds[-1]))
    last_at = int(np.searchsorted(whole.seconds, end_s, side="right"))
    return whole.part(first, last_at) if last_at - first > MIN_SAMPLES else fit.samples


def misfit(fit: BounceFit) -> float:
    """Return the tail of the residuals, as a fraction of the fall."""
    return fit.tail_sd / float(fit.unknowns[SPAN])


def is_good(fit: BounceFit, little: float = _LITTLE) -> bool:
    """Return whether the residuals are noise, or little of the fall."""
    return misfit(fit) < 1.5 * fit.samples.noise / float(fit.unknowns[SPAN]) + little


def _is_usual(whole: BounceSamples, fit: BounceFit) -> bool:
    """Return whether a law is usual for balls, and releases the ball where it is seen held.

    Few flights are explained by many laws.
    """
    times = whole.times(fit.unknowns)
    held = (times > -_HELD) & (times < -1.0)
    off = np.median(whole.residuals(fit.unknowns)[held]) if np.any(held) else 0.0
    return abs(fit.unknowns[SLOPE]) < _STEEP and abs(off) < _AT_RELEASE * fit.unknowns[SPAN]


def film_impacts(seconds: Array, along_px: Array, noise_px: float) -> list[int]:
    """Locate the samples at which a fast fall ends, in order.

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
    """Locate the first sample of the fall to `index`, its slow upper part left out.

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
    """Locate where the bounces after the first impact end: lifted, or long not found.

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
