"""Assignment of heard times to a ball's impacts, by beam search.

An impact may be missed, a time may be a noise. A reading numbers the times: flights shorten by
nearly the same ratio, so each time after the first three is predicted by those before it (an
extended Kalman filter of time, log duration and log ratio). The beam keeps the best readings
that end with each time. A score is the log odds against noises at random times.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.arrays import Array

# Probability of an impact that is not heard, and the rate of noises, as a share of the rate at
# which times follow each other.
MISSED, FALSE = 0.06, 0.12

# The same share of noises before the first impact, and how many of them count.
_BEFORE, _MAX_BEFORE = 0.15, 5

MAX_FLIGHTS, MAX_FALSE = 3, 3  # flights in one interval, and noises in a row, between two impacts
_PAUSE = 5.0  # median intervals: a longer one is a pause
_STARTS = 24  # times from which on the first impact is looked for at most
_BEAM = 80  # readings that are kept of those that end with the same time
_JITTER_S = 0.002  # standard deviation of a time while searching
_DRIFT = 0.06  # of the log ratio from flight to flight: slope and drag change it slowly
_FARTHEST_SDS = 5.0  # of a foretold time; farther off it is another time
_RATIOS = np.linspace(0.08, 1.04, 481)  # of a flight's duration to the one before, to begin with


@dataclass(frozen=True, eq=False)
class Reading:
    """Times assigned to a ball's impacts.

    Attributes:
        numbers: of the impacts, 0 the first that is heard; -1 of a time that is none, shape (N,).
        score: log odds against noises, roughly.
    """

    numbers: NDArray[np.int64]
    score: float

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
    return np.minimum(first, _MAX_BEFORE) * np.log(_BEFORE)


def noise_rate_hz(times_s: Array) -> float:
    """Return how often times follow each other, but for pauses: so would noises, if all were."""
    apart_s = np.diff(times_s)
    return 1 / float(apart_s[apart_s < _PAUSE * np.median(apart_s)].mean())


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
        ending.append(_Beam.joined(found).best(_BEAM))
    every = _Beam.joined(ending).best(most)
    return [
        Reading(numbers, float(score))
        for numbers, score in zip(every.numbers, every.scores, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class _Beam:
    """Beam of R readings that end with one time, and what each predicts.

    Attributes:
        scores: shape (R,).
        numbers: shape (R, N).
        state: time of the last impact [s], log duration of the flight after it, log ratio; shape
            (R, 3).
        covariance: of it, shape (R, 3, 3).
    """

    scores: Array
    numbers: NDArray[np.int64]
    state: Array
    covariance: Array

    @classmethod
    def joined(cls, parts: list[_Beam]) -> _Beam:
        """Join several beams."""
        return cls(
            np.concatenate([part.scores for part in parts]),
            np.concatenate([part.numbers for part in parts]),
            np.concatenate([part.state for part in parts]),
            np.concatenate([part.covariance for part in parts]),
        )

    def best(self, most: int) -> _Beam:
        """Return the readings with the highest scores, in order."""
        return self._only(np.argsort(-self.scores, kind="stable")[:most])

    def _only(self, rows: NDArray[np.int64]) -> _Beam:
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
        near = off**2 < _FARTHEST_SDS**2 * variance
        near &= self.state[:, 2] < np.log(_RATIOS[-1])
        part = replace(self, scores=self.scores + density + costs)
        chosen = np.flatnonzero(near)
        part, across, off, variance = part._only(chosen), across[near], off[near], variance[near]
        gain = across / variance[:, None]
        state = part.state + gain * off[:, None]
        covariance = part.covariance - gain[:, :, None] * across[:, None, :]
        numbers = part.numbers.copy()
        numbers[:, at] = numbers.max(axis=1, initial=-1) + lasting
        return _Beam(
            part.scores, numbers, *_moved(state, covariance, lasting, row[near].astype(np.float64))
        )


def _moved(state: Array, covariance: Array, lasting: int, row: Array) -> tuple[Array, Array]:
    """Move state and covariance on to the impact `lasting` flights later (EKF prediction)."""
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
    return later, spread


def _starts(times_s: Array, at: int, rate_hz: float) -> _Beam:
    """Return the readings whose third impact that is heard is the time of index `at`."""
    reach = MAX_FALSE + 1
    picks = [
        (first, second, before, after)
        for second in range(max(at - reach, 1), at)
        for first in range(max(second - reach, 0), second)
        for before in range(1, MAX_FLIGHTS + 1)
        for after in range(1, MAX_FLIGHTS + 1)
        if first < _STARTS
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
    inside = np.isfinite(values).all(axis=1)
    return _Beam(scores, numbers, state, covariance)._only(np.flatnonzero(inside))


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
