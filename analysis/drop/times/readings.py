"""Assign heard times to a ball's impacts, by beam search, or to a rhythm that is no ball's.

An impact may be missed, a time may be a noise. A reading numbers the times: flights shorten by
nearly the same ratio, so each time after the first three is predicted by those before it (an
extended Kalman filter of time, log duration and log ratio). The beam keeps the best readings
that end with each time. A score is the log odds against noises at random times.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Array

# ---- Priors of a ball that is heard, before its times are looked at

# Probabilities of a ball that keeps its restitution, and of one that the air does not slow: what is
# heard is real, and in air.
NO_SLOPE, NO_DRAG = 0.1, 0.05
# Another ball's slope: half normal, with a little room below 0.
_SLOPE_SD, _NEGATIVE_SD = 0.09, 0.02
# Another ball's drag: log normal. A steel ball has .002, a table-tennis ball .13.
TYPICAL_DRAG_1_M, LOG_DRAG_SD = 0.03, 1.1
# Ends of the grid that leaves nothing out: of the slope, and of the log of the drag [1/m].
WHOLE_SLOPE, WHOLE_LOG_DRAG = (-0.25, 0.45), (float(np.log(5e-4)), float(np.log(0.6)))
FLIGHT_RANGE = float(np.log(100.0))  # of the log duration of a first flight, before it is heard
KNOWN_DRAG = 0.1  # fraction by which a drag may be off that follows from a ball's mass and size
# Usual standard deviation of a time: of a trigger at a sound's threshold, which has .1 to 5 ms, and
# of an onset that is looked for in the sound.
TRIGGER_JITTER_S, ONSET_JITTER_S = 0.001, 0.00025
JITTERS_S = np.geomspace(3e-5, 0.03, 31)  # standard deviations of a time that are tried
# Prior probability of each standard deviation of an impact's own restitution about the law, as a
# fraction of it: a machined ball's on stone, a table-tennis ball's, a marble's on a floor. The
# times' own jitter scales it.
SCATTERS = {0.002: 0.5, 0.01: 0.3, 0.03: 0.2}
# How long a ball touches the table: a steel ball .2 ms, a soft one 8 ms.
CONTACT_S, CONTACT_SD_S, CONTACTS_S = 0.002, 0.003, (0.0, 0.009)


@dataclass(frozen=True, eq=False)
class Nodes:
    """Grid of balls, shape (M,) each."""

    slopes: Array  # p
    drags_1_m: Array  # deceleration by the air over speed squared
    log_prior: Array  # of each cell


def log_jitter_prior(usual_s: float) -> Array:
    """Return the log prior of each of `JITTERS_S`, normalised."""
    off = np.log(JITTERS_S / usual_s) / 0.9  # a factor 2.5 either way
    weights = np.exp(-0.5 * off**2)
    return np.log(weights / weights.sum())


def log_scatter_prior(scatters: Array) -> Array:
    """Return the log prior against too much scatter: 0 where there is not."""
    over = np.maximum(np.log(scatters / 0.04), 0.0)  # no ball that keeps to a law has more
    return -0.5 * (over / 0.1) ** 2


def nodes(
    slopes: tuple[float, float],
    log_drags: tuple[float, float],
    counts: tuple[int, int],
    known_drag_1_m: float | None,
    *,
    has_clock: bool = True,
) -> Nodes:
    """Build a grid over slope and log drag within these ends, with balls of no slope or no drag."""
    low, high = max(slopes[0], WHOLE_SLOPE[0]), min(slopes[1], WHOLE_SLOPE[1])
    edges = np.linspace(min(low, high - 1e-3), high, counts[0] + 1)
    slope = (edges[1:] + edges[:-1]) / 2
    sds = np.where(slope < 0, _NEGATIVE_SD, _SLOPE_SD)
    density = np.exp(-0.5 * (slope / sds) ** 2) / np.sqrt(np.pi / 2) / (_NEGATIVE_SD + _SLOPE_SD)
    slope_prior = np.append(density * np.diff(edges) * (1 - NO_SLOPE), NO_SLOPE)
    slope = np.append(slope, 0.0)
    if known_drag_1_m is not None:
        off = np.linspace(-2.4, 2.4, 7)  # standard deviations: 98 % of a normal distribution
        drag = known_drag_1_m * (1 + KNOWN_DRAG * off)
        drag_prior = np.exp(-0.5 * off**2)
        drag_prior /= drag_prior.sum()
    else:
        ends = np.array(WHOLE_LOG_DRAG)
        low, high = max(log_drags[0], ends[0]), min(log_drags[1], ends[1])
        edges = np.linspace(min(low, high - 0.1), high, counts[1] + 1)
        # Without a clock nothing tells how high the ball flies: a factor 2 either way.
        sd = LOG_DRAG_SD if has_clock else float(np.hypot(LOG_DRAG_SD, 0.7))
        middle = (edges[1:] + edges[:-1]) / 2
        off = (middle - np.log(TYPICAL_DRAG_1_M)) / sd
        density = np.exp(-0.5 * off**2) / np.sqrt(2 * np.pi) / sd
        drag = np.append(np.exp(middle), 0.0)
        drag_prior = np.append(density * np.diff(edges) * (1 - NO_DRAG), NO_DRAG)
    both = np.meshgrid(slope, drag, indexing="ij")
    prior = np.outer(slope_prior, drag_prior).ravel()
    return Nodes(both[0].ravel(), both[1].ravel(), np.log(np.maximum(prior, 1e-300)))


# ---- Beam search for the readings

# Probability of an impact that is not heard, and the rate of noises, as a share of the rate at
# which times follow each other.
MISSED, FALSE = 0.06, 0.12
MAX_FLIGHTS, MAX_FALSE = 3, 3  # flights in one interval, and noises in a row, between two impacts
_JITTER_S = 0.002  # standard deviation of a time while searching
_DRIFT = 0.06  # of the log ratio from flight to flight: slope and drag change it slowly
_RATIOS = np.linspace(0.08, 1.04, 481)  # of a flight's duration to the one before, to begin with


@dataclass(frozen=True, eq=False)
class Reading:
    """Times assigned to a ball's impacts."""

    # Of the impacts, 0 the first that is heard; -1 of a time that is none, shape (N,).
    numbers: NDArray[np.int64]
    score: float  # log odds against noises, roughly

    @property
    def heard(self) -> NDArray[np.int64]:
        """Indices of the times that are impacts."""
        return np.flatnonzero(self.numbers >= 0)

    @property
    def missed(self) -> int:
        """Number of impacts between the first and the last that are not heard."""
        return int(self.numbers.max()) + 1 - len(self.heard)

    @property
    def false(self) -> int:
        """Number of times between the first impact and the last that are none."""
        heard = self.heard
        return int(heard[-1] - heard[0]) + 1 - len(heard)

    def log_prior(self, times_s: Array) -> float:
        """Return the log prior of what was missed and is false, over that of noises alone."""
        first, last = times_s[self.heard[[0, -1]]]
        return (
            (1 - FALSE) * noise_rate_hz(times_s) * float(last - first)
            + self.missed * np.log(MISSED)
            + len(self.heard) * np.log1p(-MISSED)
            + self.false * np.log(FALSE)
            + float(_log_before(self.heard[0]))
        )


def _log_before(first: NDArray[np.int64]) -> Array:
    """Return the log prior of so many times before the first impact."""
    return np.minimum(first, 5) * np.log(0.15)  # at most five of them count


def noise_rate_hz(times_s: Array) -> float:
    """Return how often times follow each other, but for pauses: so would noises, if all were."""
    apart_s = np.diff(times_s)
    return 1 / float(apart_s[apart_s < 5.0 * np.median(apart_s)].mean())  # longer ones are pauses


def readings(times_s: Array, most: int) -> list[Reading]:
    """Find the likeliest readings of rising times (N,) [s] by beam search, best first."""
    count = len(times_s)
    if count < 3:
        return []
    rate_hz = noise_rate_hz(times_s)
    ending: list[_Beam] = []
    for at in range(count):
        found = [_starts(times_s, at, rate_hz)]
        for back in range(1, min(MAX_FALSE + 1, at) + 1):
            before = ending[at - back]
            found += [
                before.extended(times_s, at, back - 1, lasting, rate_hz)
                for lasting in range(1, MAX_FLIGHTS + 1)
            ]
        ending.append(_Beam.joined(found).best(80))  # so many are kept
    every = _Beam.joined(ending).best(most)
    return [Reading(*one) for one in zip(every.numbers, every.scores.tolist(), strict=True)]


class _Beam(NamedTuple):
    """Beam of R readings that end with one time, and what each predicts."""

    scores: Array  # shape (R,)
    numbers: NDArray[np.int64]  # shape (R, N)
    # Time of the last impact [s], log duration of the flight after it, log ratio; shape (R, 3).
    state: Array
    covariance: Array  # of it, shape (R, 3, 3)

    @classmethod
    def joined(cls, parts: list[_Beam]) -> _Beam:
        """Join several beams."""
        return cls(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def best(self, most: int) -> _Beam:
        """Return the readings with the highest scores, in order."""
        return self.only(np.argsort(-self.scores, kind="stable")[:most])

    def only(self, rows: NDArray[np.int64]) -> _Beam:
        """Return the readings of these rows."""
        return _Beam(self.scores[rows], self.numbers[rows], self.state[rows], self.covariance[rows])

    def extended(self, times_s: Array, at: int, false: int, lasting: int, rate_hz: float) -> _Beam:
        """Extend by the time of index `at` as the impact `lasting` flights later (EKF update)."""
        each = np.exp(self.state[:, 1:2] + np.arange(lasting) * self.state[:, 2:])
        row = np.stack([np.ones(len(each)), each.sum(axis=1), each @ np.arange(lasting)], axis=1)
        off = times_s[at] - self.state[:, 0] - row[:, 1]
        across = np.einsum("rij,rj->ri", self.covariance, row)
        variance = np.einsum("ri,ri->r", row, across) + _JITTER_S**2
        density = -0.5 * (off**2 / variance + np.log(2 * np.pi * variance)) - np.log(rate_hz)
        since_s = times_s[at] - times_s[at - false - 1]
        costs = (1 - FALSE) * rate_hz * since_s
        costs += false * np.log(FALSE) + (lasting - 1) * np.log(MISSED) + np.log1p(-MISSED)
        near = off**2 < 5.0**2 * variance  # farther off it is another one
        near &= self.state[:, 2] < np.log(_RATIOS[-1])
        part = self._replace(scores=self.scores + density + costs).only(np.flatnonzero(near))
        across, off, variance = across[near], off[near], variance[near]
        gain = across / variance[:, None]
        state = part.state + gain * off[:, None]
        covariance = part.covariance - gain[:, :, None] * across[:, None, :]
        numbers = part.numbers.copy()
        numbers[:, at] = numbers.max(axis=1, initial=-1) + lasting
        # Move state and covariance on to the impact `lasting` flights later (EKF prediction).
        row = row[near].astype(np.float64)
        move = np.tile(np.eye(3), (len(state), 1, 1))
        move[:, 0] = row
        move[:, 1, 2] = lasting
        each = np.exp(state[:, 1:2] + np.arange(lasting) * state[:, 2:])
        later = np.column_stack(
            [state[:, 0] + each.sum(axis=1), state[:, 1] + lasting * state[:, 2], state[:, 2]]
        )
        spread = move @ covariance @ move.transpose(0, 2, 1)
        spread[:, 2, 2] += lasting * _DRIFT**2
        spread[:, 1, 1] += lasting * _DRIFT**2
        return _Beam(part.scores, numbers, later, spread)


def _starts(times_s: Array, at: int, rate_hz: float) -> _Beam:
    """Return the readings whose third impact that is heard is the time of index `at`."""
    reach = MAX_FALSE + 1
    picks = [
        (first, second, before, after)
        for second in range(max(at - reach, 1), at)
        for first in range(max(second - reach, 0), second)
        for before in range(1, MAX_FLIGHTS + 1)
        for after in range(1, MAX_FLIGHTS + 1)
        if first < 24  # later times begin no ball
    ]
    chosen = np.array(picks, dtype=np.int64).reshape(-1, 4)
    first, second, before, after = chosen.T
    one, two = times_s[second] - times_s[first], times_s[at] - times_s[second]
    short = 1e-4
    values, grows = _begun(one, two, before, after)
    by_one = (_begun(one * (1 + short), two, before, after)[0] - values) / (short * one[:, None])
    by_two = (_begun(one, two * (1 + short), before, after)[0] - values) / (short * two[:, None])
    jacobian = np.zeros((len(chosen), 3, 3))
    jacobian[:, 0, 2] = 1.0
    jacobian[:, 1:, 0], jacobian[:, 1:, 1], jacobian[:, 1:, 2] = -by_one, by_one - by_two, by_two
    covariance = _JITTER_S**2 * jacobian @ jacobian.transpose(0, 2, 1)
    flown = (before + after).astype(np.float64)
    covariance[:, 1, 1] += flown * _DRIFT**2
    covariance[:, 2, 2] += flown * _DRIFT**2
    state = np.column_stack([np.full(len(chosen), times_s[at]), values])
    numbers = np.full((len(chosen), len(times_s)), -1)
    rows = np.arange(len(chosen))
    numbers[rows, first], numbers[rows, second] = 0, before
    numbers[rows, at] = before + after
    scores = -np.log(np.ptp(_RATIOS) * one * grows) - np.log(rate_hz) - np.log(len(times_s))
    scores += (before + after - 2) * np.log(MISSED) + 3 * np.log1p(-MISSED)
    scores += (1 - FALSE) * rate_hz * (times_s[at] - times_s[first])
    scores += (at - first - 2) * np.log(FALSE) + _log_before(first)
    inside = np.flatnonzero(np.isfinite(values).all(axis=1))
    return _Beam(scores, numbers, state, covariance).only(inside)


def _begun(
    one_s: Array, two_s: Array, before: NDArray[np.int64], after: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Return log duration and ratio after two intervals, (R, 2), NaN if no ball's; its growth."""
    ratio, grows = np.full((2, len(one_s)), np.nan)
    for flown in range(1, MAX_FLIGHTS + 1):
        for later in range(1, MAX_FLIGHTS + 1):
            rows = (before == flown) & (after == later)
            curve = _interval_ratios(flown, later)
            asked = (two_s / one_s)[rows]
            ratio[rows] = np.interp(asked, curve, _RATIOS, left=np.nan, right=np.nan)
            grows[rows] = np.interp(asked, curve, np.gradient(curve, _RATIOS))
    powers = np.arange(MAX_FLIGHTS)
    sums = np.where(powers < before[:, None], ratio[:, None] ** powers, 0.0).sum(axis=1)
    values = np.column_stack(
        [np.log(one_s / sums) + (before + after) * np.log(ratio), np.log(ratio)]
    )
    return values, grows


@cache
def _interval_ratios(before: int, after: int) -> Array:
    """Return the second interval over the first, of so many flights, at each of `_RATIOS`."""
    one = sum(_RATIOS**power for power in range(before))
    two = sum(_RATIOS**power for power in range(before, before + after))
    return np.asarray(two / one)


# ---- Rhythms that are no ball's: the evidence of each for the same times, against a ball's
# A hand keeps its beat, or quickens it by a time, a tempo, or a ratio that falls; a ball's may only
# grow. Times are jittered one by one as a ball's, or each beat runs from the one before.

# Standard deviations of a beat that are tried, in mean beats.
_STEADY_SDS = np.geomspace(0.002, 0.5, 25)


def best_rhythm(
    times_s: Array,
    numbers: NDArray[np.int64],
    log_rate: float,
    jitter_s: float = TRIGGER_JITTER_S,
) -> tuple[str, float]:
    """Find the rhythm with the highest evidence for three times or more, against noises.

    Returned in words, with its log evidence.
    """
    count = int(numbers.max())
    steps = np.arange(count)[None, :] / max(count - 1, 1)
    # By which the last beat is shorter than the first, below 0 longer; by how much its tempo is
    # over the first's.
    shares, tempos = np.linspace(-1.0, 0.98, 1001)[:, None], np.geomspace(0.02, 20.0, 400)[:, None]
    # The beats' durations over the first, shape (M, count), of each kind of rhythm.
    families = {
        "an even beat": np.ones((1, count)),
        "beats that shorten by one time each": 1 - shares * steps,
        "a tempo that grows evenly": 1 / (1 + tempos * steps),
        "beats whose ratio falls": _bent(count),
    }
    found: list[tuple[str, float]] = []
    for name, beats in families.items():
        sums = np.cumsum(np.column_stack([np.zeros(len(beats)), beats]), axis=1)[:, numbers]
        # The log evidence where each time has its own jitter, shape (M,).
        middle = sums.mean(axis=1)
        about = sums - middle[:, None]
        length = (about**2).sum(axis=1)
        first_s = about @ times_s / length
        off = times_s - times_s.mean() - first_s[:, None] * about
        jitters, free = JITTERS_S, len(times_s) - 2
        log = log_jitter_prior(jitter_s) - free * np.log(jitters * np.sqrt(2 * np.pi))
        log = log - (off**2).sum(axis=1)[:, None] / (2 * jitters**2)
        each = np.logaddexp(
            _summed(log) - 0.5 * np.log(len(times_s) * length) - _log_duration(first_s),
            _running(times_s, sums, np.diff(numbers)),
        )
        most = float(each.max())
        evidence = most + float(np.log(np.exp(each - most).mean())) - float(np.log(2.0))
        found.append((name, evidence - FLIGHT_RANGE - (len(times_s) - 1) * log_rate))
    return max(found, key=lambda one: one[1])


@lru_cache(maxsize=4)
def _bent(count: int) -> Array:
    steps = np.arange(count)
    first, bend = (
        one.ravel()[:, None]
        # Of the log of the first ratio of beats, and what is added to it from beat to beat.
        for one in np.meshgrid(np.linspace(-1.5, 0.0, 61), -np.geomspace(0.002, 0.3, 40))
    )
    return np.exp(np.maximum(first * steps + bend * steps * (steps - 1) / 2, -20.0))


def _running(times_s: Array, sums: Array, apart: NDArray[np.int64]) -> Array:
    """Return the log evidence where each beat runs from the one before, shape (M,)."""
    scale = np.sqrt(apart)
    heard, shape = np.diff(times_s) / scale, np.diff(sums, axis=1) / scale
    length = (shape**2).sum(axis=1)
    first_s = shape @ heard / length
    off = heard - first_s[:, None] * shape
    sds = _STEADY_SDS * float(np.ptp(times_s)) / int(apart.sum())
    prior = np.exp(-0.5 * (np.log(_STEADY_SDS / 0.03) / 1.0) ** 2)  # of a hand: log normal
    log = np.log(prior / prior.sum()) - (len(heard) - 1) * np.log(sds * np.sqrt(2 * np.pi))
    log = log - (off**2).sum(axis=1)[:, None] / (2 * sds**2)
    return _summed(log) - 0.5 * np.log(length) - np.log(scale).sum() - _log_duration(first_s)


def _log_duration(first_s: Array) -> Array:
    """Return the log duration of the first beat; infinite where there is none."""
    return np.where(first_s > 0, np.log(np.maximum(first_s, 1e-9)), np.inf)


def _summed(log: Array) -> Array:
    most = log.max(axis=1)
    return most + np.log(np.exp(log - most[:, None]).sum(axis=1))
