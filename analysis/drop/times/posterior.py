"""Posterior of the ball that was heard: averaged over readings of the times, and over balls."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from analysis.drop.times.fit import Balls, Rig, fit_times
from analysis.drop.times.flight_times import (
    FlightTimes,
    apex_m,
    fallen_m_s,
    flights,
    leaving_speeds,
)
from analysis.drop.times.least_squares import Whitening
from analysis.drop.times.missing_impacts import MISSED, Reading, noise_rate_hz, readings
from analysis.drop.times.rhythms import Rhythm, best_rhythm
from analysis.record import Rebound
from analysis.statistics import TWO_SIDED
from recorders.simulators.base import GRAVITY_M_S2
from tunenet_logs.arrays import Array

MAX_TIMES = 60  # that are looked at: by then a ball hardly rises
_READINGS = 8  # that are fitted; most have one that stands out
_NEGLIGIBLE = 1e-4  # weight of a reading that is left away
_TAILS = (0.025, 0.975)  # probabilities at the ends of an interval
_HALVINGS = 24  # of a bracket of about 1 around a quantile
_TYPICAL_APEX_M = 0.4  # of a first flight whose true seconds are not known


@dataclass(frozen=True)
class Besides:
    """Evidence beside the times.

    Attributes:
        rate_hz: of times that are none of the ball's.
        log_odds: of the ball by all else than the times.
    """

    rate_hz: float
    log_odds: float


@dataclass(frozen=True, eq=False)
class HeardBall:
    """Posterior of a ball by its impact times.

    Attributes:
        values: restitution at the first reported impact, slope, drag [1/m], shape (3,).
        interval95: shape (3, 2).
        reading: the likeliest.
        times_s: of its impacts, as they were heard, shape (N,) [s].
        rig: what was known.
        jitter_s: standard deviation of a time.
        scatter: of each impact's own restitution about the law, as a fraction.
        contact_s: how long the ball touches the table at each impact.
        log_odds: against noises at random times.
        rhythm: likeliest rhythm that is no ball's, and a ball's log odds against it.
        height_sds: by how many standard deviations the height contradicts the times.
        begin_s: time of the first impact by the values [s].
        leaving_m_s: speed after it.
        seconds_s: true seconds in one of the log's: 1, where it has a clock.
    """

    values: Array
    interval95: Array
    reading: Reading
    times_s: Array
    rig: Rig
    jitter_s: float
    scatter: float
    contact_s: float
    log_odds: float
    rhythm: tuple[str, float]
    height_sds: float
    begin_s: float
    leaving_m_s: float
    seconds_s: float

    @property
    def numbers(self) -> NDArray[np.int64]:
        """Numbers of the impacts that were heard, the first 0, shape (N,)."""
        return self.reading.numbers[self.reading.heard]

    @property
    def told(self) -> int:
        """Number of the impact whose restitution the first value is: 1, or 0 with a height."""
        return int(self.rig.height_m is None)

    @cached_property
    def flown(self) -> FlightTimes:
        """Flights of the ball of the values, to the last impact that was heard."""
        return _flown(int(self.numbers.max()), self.leaving_m_s, self.values, self.rig)

    @property
    def predicted_s(self) -> Array:
        """Predicted begin of each impact by the values, shape (I,) [s]."""
        flown_s = self.flown.impacts_s[:, 0] / self.seconds_s
        return self.begin_s + flown_s + self.contact_s * np.arange(len(flown_s))

    @property
    def contactless_s(self) -> Array:
        """Predicted impacts of a ball of the same flights that leaves at once, shape (I,) [s]."""
        return self.predicted_s - self._delays_s(np.arange(len(self.predicted_s)))

    @property
    def heard_contactless_s(self) -> Array:
        """Heard times as that ball would have made them, shape (N,) [s]."""
        return self.times_s - self._delays_s(self.numbers)

    def _delays_s(self, numbers: NDArray[np.int64]) -> Array:
        """Return the delays by the contacts since the first reported impact."""
        return self.contact_s * (numbers - self.told).astype(np.float64)

    @property
    def residuals_s(self) -> Array:
        """Residuals, heard less predicted, shape (N,) [s]."""
        return self.times_s - self.predicted_s[self.numbers]

    @property
    def fall_m(self) -> float:
        """Height of the fall that ends with the first reported impact [m]."""
        if self.rig.height_m is not None:
            arrives = self.leaving_m_s / max(float(self.values[0]), 1e-3)
            drag_1_m = max(float(self.values[2]), 1e-9)
            reached = min(drag_1_m / GRAVITY_M_S2 * arrives**2, 0.999)
            return -float(np.log1p(-reached)) / (2 * drag_1_m)
        return apex_m(self.leaving_m_s, float(self.values[2]))

    @cached_property
    def rebounds(self) -> tuple[Rebound, ...]:
        """Each impact between two flights heard whole, by their durations alone."""
        found = [self._told()]
        drag_1_m = float(self.values[2])
        known = dict(zip(self.numbers.tolist(), self.times_s.tolist(), strict=True))
        for number in sorted(known):
            if number <= self.told or not {number - 1, number + 1} <= known.keys():
                continue
            lasted = np.array(
                [known[number] - known[number - 1], known[number + 1] - known[number]]
            )
            lasted = np.maximum(lasted - self.contact_s, lasted / 2)
            before, after = leaving_speeds(lasted * self.seconds_s, drag_1_m)
            arrives = float(self._arriving(before, drag_1_m))
            value = float(after) / arrives
            drags = self.interval95[2]
            open_sd = abs(np.ptp([after / self._arriving(before, float(k)) for k in drags])) / (
                2 * TWO_SIDED
            )
            parts = np.array([1 / lasted[0], sum(1 / lasted), 1 / lasted[1]])
            sd = float(np.hypot(value * self.jitter_s * np.linalg.norm(parts), open_sd))
            ends = max(value - TWO_SIDED * sd, 0.0), min(value + TWO_SIDED * sd, 1.0)
            found.append(Rebound(known[number], min(value, 1.0), ends, self._speed(arrives)))
        return tuple(found)

    def _told(self) -> Rebound:
        low, high = self.interval95[0].tolist()
        if self.told:
            arrives = float(self.flown.arriving_m_s[1, 0])
        else:
            arrives = float(fallen_m_s(self.fall_m, float(self.values[2])))
        at_s = float(self.predicted_s[self.told])
        return Rebound(at_s, float(self.values[0]), (low, high), self._speed(arrives))

    def _speed(self, arrives_m_s: float) -> float | None:
        return arrives_m_s if self.rig.has_clock else None

    @staticmethod
    def _arriving(leaving_m_s: float, drag_1_m: float) -> float:
        reach = leaving_m_s * np.sqrt(max(drag_1_m, 0.0) / GRAVITY_M_S2)
        return float(leaving_m_s / np.hypot(1.0, reach))


def heard_ball(times_s: Array, rig: Rig, besides: Besides | None = None) -> HeardBall | None:
    """Average over readings and balls that may have been heard; None where no ball explains any.

    Args:
        times_s: rising, shape (N,) [s]; of more than `MAX_TIMES` the first.
        rig: what is known of the ball.
        besides: None where the times are all that was heard.
    """
    times_s = times_s[:MAX_TIMES]
    if len(times_s) < 3:
        return None
    seconds_s = 1.0 if rig.has_clock else _typical_seconds(times_s)
    clock = times_s * seconds_s
    log_rate = float(np.log(noise_rate_hz(clock) if besides is None else besides.rate_hz))
    heightless = replace(rig, height_m=None)  # it tells nothing of which time is an impact
    tried = [
        (one, fit_times(clock[one.heard], one.numbers[one.heard], log_rate, heightless, fine=False))
        for one in readings(clock, _READINGS)
    ]
    if not tried:
        return None
    odds = np.array([balls.log_evidence + one.log_prior(clock) for one, balls in tried])
    best = int(odds.argmax())
    first = tried[best][0].heard[0]
    weights = np.exp(odds - odds.max())
    weights[[one.heard[0] != first for one, _ in tried]] = 0.0
    weights /= weights.sum()
    chosen = [
        (weight, fit_times(clock[one.heard], one.numbers[one.heard], log_rate, rig))
        for weight, (one, _) in zip(weights.tolist(), tried, strict=True)
        if weight > _NEGLIGIBLE
    ]
    reading = tried[best][0]
    balls = chosen[sum(weights[:best] > _NEGLIGIBLE)][1]
    values = np.array(
        [balls.mean(one) for one in (balls.restitutions, balls.slopes, balls.drags_1_m)]
    )
    values[0] = min(values[0], 1.0)
    contact_s = balls.mean(balls.contacts_s)
    flown = clock[reading.heard] - contact_s * reading.numbers[reading.heard]
    begin, leaving = _held(flown, reading, values, balls, rig)
    return HeardBall(
        values=values,
        interval95=_intervals(chosen),
        reading=reading,
        times_s=times_s[reading.heard],
        rig=rig,
        jitter_s=balls.mean(balls.jitters_s) / seconds_s,
        scatter=balls.mean(balls.scatters),
        contact_s=contact_s / seconds_s,
        log_odds=_log_odds(float(odds[best]), tried[best], clock, besides),
        rhythm=_against_rhythms(clock, reading, log_rate, heightless),
        height_sds=balls.height_sds,
        begin_s=begin / seconds_s,
        leaving_m_s=leaving,
        seconds_s=seconds_s,
    )


def _log_odds(
    odds: float, tried: tuple[Reading, Balls], clock_s: Array, besides: Besides | None
) -> float:
    """Return the log odds against noises at random times."""
    if besides is None:
        return odds - float(np.log(len(clock_s)))
    reading, balls = tried
    heard = len(reading.heard)
    missed = reading.missed * np.log(MISSED) + heard * np.log1p(-MISSED)
    return balls.log_evidence + float(missed) + besides.log_odds


def _against_rhythms(
    clock_s: Array, reading: Reading, log_rate: float, rig: Rig
) -> tuple[str, float]:
    """Return the best rhythm of these impacts, or of all times, and a ball's log odds over it."""
    heard = reading.heard
    times_s, numbers = clock_s[heard], reading.numbers[heard]
    prior = reading.log_prior(clock_s)
    ball = fit_times(times_s, numbers, log_rate, rig).log_evidence + prior
    every = Reading(np.arange(len(clock_s)), 0.0)
    of_same = best_rhythm(times_s, numbers, log_rate, rig.jitter_s)
    of_every = best_rhythm(clock_s, every.numbers, log_rate, rig.jitter_s)
    tried: list[tuple[Rhythm, float]] = [(of_same, prior), (of_every, every.log_prior(clock_s))]
    best, most = max(
        ((one.name, one.log_evidence + log) for one, log in tried), key=lambda pair: pair[1]
    )
    return best, ball - most


def _typical_seconds(times_s: Array) -> float:
    """Return seconds that make the longest flight as high as usual: only its drag needs them."""
    usual_s = 2 * float(np.sqrt(2 * _TYPICAL_APEX_M / GRAVITY_M_S2))
    return usual_s / float(np.quantile(np.diff(times_s), 0.9))


def _flown(count: int, leaving_m_s: float, values: Array, rig: Rig) -> FlightTimes:
    """Return the flights of one ball, shape (count + 1, 1)."""
    restitution, slope, drag_1_m = (np.array([one]) for one in values.tolist())
    if rig.height_m is not None:  # from the law's value at the first impact to that at the second
        arrives = leaving_m_s / np.maximum(restitution, 1e-3)
        second = flights(1, np.array([leaving_m_s]), restitution, slope, drag_1_m).arriving_m_s[1]
        restitution = restitution * (second / arrives) ** -slope
    return flights(count, np.array([leaving_m_s]), restitution, slope, drag_1_m)


def _held(
    clock_s: Array, reading: Reading, values: Array, balls: Balls, rig: Rig
) -> tuple[float, float]:
    """Fit first impact [s] and speed after it [m/s] by Gauss-Newton, with the values held."""
    numbers = reading.numbers[reading.heard]
    log_speed, short, begin_s = balls.mean(balls.begins), 1e-6, float(clock_s[0])
    ratio_1_s = balls.mean(balls.scatters) / balls.mean(balls.jitters_s)
    rows = Whitening.of(clock_s, numbers, ratio_1_s).rows
    for _ in range(6):
        hits, moved = (
            _flown(int(numbers.max()), float(np.exp(at)), values, rig).impacts_s[numbers, 0]
            for at in (log_speed, log_speed + short)
        )
        columns = np.column_stack([np.ones(len(hits)), (moved - hits) / short])
        off = clock_s - begin_s - hits
        step, *_ = np.linalg.lstsq(rows @ columns, rows @ off, rcond=None)
        begin_s, log_speed = begin_s + float(step[0]), log_speed + float(np.clip(step[1], -1, 1))
    return begin_s, float(np.exp(log_speed))


def _intervals(parts: list[tuple[float, Balls]]) -> Array:
    """Return the 95 % credible intervals of the mixture of all readings, shape (3, 2)."""
    weights = np.concatenate([weight * balls.weights for weight, balls in parts])
    weights /= weights.sum()
    restitutions, sds, slopes, drags = (
        np.concatenate([getattr(balls, name) for _, balls in parts])
        for name in ("restitutions", "sds", "slopes", "drags_1_m")
    )
    ends = [_quantile(at, restitutions, sds, weights) for at in _TAILS]
    return np.array([np.clip(ends, 0.0, 1.0), _on_grid(slopes, weights), _on_grid(drags, weights)])


def _on_grid(values: Array, weights: Array) -> Array:
    """Return the 95 % interval of values on a grid, linear between its nodes."""
    nodes, where = np.unique(values, return_inverse=True)
    each = np.bincount(where, weights)
    return np.interp(_TAILS, np.cumsum(each) - each / 2, nodes)


def _quantile(probability: float, middles: Array, sds: Array, weights: Array) -> float:
    """Find a quantile of a mixture of normal distributions, by bisection."""
    from scipy.special import ndtr

    low, high = float((middles - 5 * sds).min()), float((middles + 5 * sds).max())
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        below = float(weights @ ndtr((middle - middles) / sds)) < probability
        low, high = (middle, high) if below else (low, middle)
    return (low + high) / 2
