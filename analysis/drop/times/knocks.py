"""Chains of onsets that may be one ball's: flights that shorten by a ratio, ever softer.

Every three onsets whose gaps shorten as a ball's predict a fourth, and so on. A chain's score is
its log odds against onsets at random times with random loudness: as sharp as its times follow
each other, and as steadily as it gets softer and keeps its colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.listening.onsets import Onsets
from tunenet_logs.arrays import Array

_MIN_S, _MAX_S = 0.06, 1.5  # of a flight: from a shorter one on a ball rattles
_MIN_RATIO, _MAX_RATIO = 0.35, 0.985  # of a flight's duration to the one before
_MAX_SEEDS = 60_000  # triples of knocks that are followed, those of the loudest knocks first
_MAX_IMPACTS = 40  # of a chain
_DRIFT, _JITTER_S = 0.02, 0.002  # standard deviation of a foretold gap: a fraction, and a time
_FARTHEST_SDS = 3.5  # off a foretold time; farther off it is another knock
_MISSED = float(np.log(0.08))  # of an impact that is not heard; two in a row end a chain
_PER_DECADE_DB = 30.0  # by which a knock gets softer, as its ball gets slower
# Of a ball's knock about that, and at least of other knocks among each other.
_LOUDNESS_SD_DB, _MIN_SPREAD_DB = 4.0, 6.0

# The same of a band, and how many bands tell something of their own.
_COLOUR_SD_DB, _MIN_COLOUR_DB, _COLOURS = 4.0, 5.0, 2.0

_CHAINS = 40  # that are told apart at the end


@dataclass(frozen=True, eq=False)
class KnockChain:
    """Onsets as one ball's impacts.

    Attributes:
        which: indices of the onsets, shape (N,).
        numbers: of the impacts, the first 0, shape (N,).
        score: log odds, roughly.
    """

    which: NDArray[np.int64]
    numbers: NDArray[np.int64]
    score: float


@dataclass(frozen=True, eq=False)
class Crowd:
    """Statistics of onsets that are nobody's.

    Attributes:
        rate_hz: of them.
        loudness_db: mean.
        spread_db: standard deviation about it.
        colour_sd_db: of a band's share.
    """

    rate_hz: float
    loudness_db: float
    spread_db: float
    colour_sd_db: float

    @classmethod
    def of(cls, heard: Onsets, lasts_s: float) -> Crowd:
        """Estimate them from all that were heard: a ball's are few among many, or all."""
        spread = float(np.std(heard.loudness_db))
        colours = heard.colours_db
        colour = float(np.sqrt(np.mean((colours - colours.mean(axis=0)) ** 2)))
        return cls(
            len(heard) / max(lasts_s, 0.2),
            float(heard.loudness_db.mean()),
            max(spread, _MIN_SPREAD_DB),
            max(colour, _MIN_COLOUR_DB),
        )

    def loudness_odds(self, loudness_db: Array, foretold_db: Array) -> Array:
        """Return the log odds of a ball's loudness against one of these."""
        own = -0.5 * ((loudness_db - foretold_db) / _LOUDNESS_SD_DB) ** 2
        own = np.maximum(own, -8.0) - np.log(_LOUDNESS_SD_DB)
        other = -0.5 * ((loudness_db - self.loudness_db) / self.spread_db) ** 2
        return own - other + np.log(self.spread_db)

    def colour_odds(self, squares_db2: Array) -> Array:
        """Return the log odds of the mean squared difference of two onsets' colours."""
        own, other = 2 * _COLOUR_SD_DB**2, 2 * self.colour_sd_db**2
        odds = -0.5 * squares_db2 / own + 0.5 * squares_db2 / other + 0.5 * np.log(other / own)
        return _COLOURS * np.maximum(odds, -3.0)


def chains(heard: Onsets, lasts_s: float, most: int = _CHAINS) -> list[KnockChain]:
    """Find the likeliest chains of three impacts or more, best first."""
    if len(heard) < 3:
        return []
    crowd = Crowd.of(heard, lasts_s)
    seeds = _seeds(heard)
    if not len(seeds):
        return []
    which, scores = _followed(heard, seeds, crowd)
    order = np.argsort(-scores, kind="stable")
    found: list[KnockChain] = []
    taken: set[bytes] = set()
    for row in order.tolist():
        numbers = np.flatnonzero(which[row] >= 0)
        own = which[row][numbers]
        if own.tobytes() in taken:
            continue
        taken.add(own.tobytes())
        found.append(KnockChain(own, numbers - numbers[0], float(scores[row])))
        if len(found) == most:
            break
    return found


def softer_db(times_s: Array, numbers: NDArray[np.int64]) -> Array:
    """Predict how much softer each knock of a ball is than the first, by its gaps, shape (N,)."""
    gaps = np.diff(times_s) / np.diff(numbers)
    speeds = np.append(gaps[0], gaps)
    return _PER_DECADE_DB * np.log10(speeds / gaps[0])


def _seeds(heard: Onsets) -> NDArray[np.int64]:
    """Return the triples whose gaps and loudness may be a ball's, shape (S, 3)."""
    times_s, loud = heard.times_s, heard.loudness_db
    gaps = times_s[None, :] - times_s[:, None]
    first, second = np.nonzero((gaps >= _MIN_S) & (gaps <= _MAX_S))
    rows = [np.zeros((0, 3), dtype=np.int64)]
    softer = loud[None, :] < loud[:, None] + 2 * _LOUDNESS_SD_DB
    for middle in range(len(times_s)):
        before = first[(second == middle) & softer[first, middle]]
        after = second[(first == middle) & softer[middle, second]]
        if not len(before) or not len(after):
            continue
        ratio = gaps[middle, after][None, :] / gaps[before, middle][:, None]
        one, two = np.nonzero((ratio >= _MIN_RATIO) & (ratio <= _MAX_RATIO))
        triple = np.column_stack([before[one], np.full(len(one), middle), after[two]])
        rows.append(triple.astype(np.int64))
    seeds = np.concatenate(rows)
    if len(seeds) > _MAX_SEEDS:
        loudest = np.argsort(-loud[seeds].min(axis=1), kind="stable")[:_MAX_SEEDS]
        seeds = seeds[np.sort(loudest)]
    return seeds


def _followed(
    heard: Onsets, seeds: NDArray[np.int64], crowd: Crowd
) -> tuple[NDArray[np.int64], Array]:
    """Extend every seed: onset of each impact, -1 if missed, shape (S, I); and scores (S,)."""
    times_s, loud, colours = heard.times_s, heard.loudness_db, heard.colours_db
    count = len(seeds)
    which = np.full((count, _MAX_IMPACTS), -1)
    which[:, :3] = seeds
    one, two = np.diff(times_s[seeds], axis=1).T
    ratio = two / one
    scores = -np.log(crowd.rate_hz * one) - np.log(len(times_s)) - np.log(crowd.rate_hz * two)
    mean_colour = colours[seeds].mean(axis=1)
    for column in range(3):
        off = ((colours[seeds[:, column]] - mean_colour) ** 2).mean(axis=1) * 1.5
        scores += crowd.colour_odds(2 * off)
    level = loud[seeds].mean(axis=1)
    step = _PER_DECADE_DB * np.log10(ratio)
    for column in range(3):
        scores += crowd.loudness_odds(loud[seeds[:, column]], level + (column - 1) * step)
    level = level + step
    last, gap, missed = times_s[seeds[:, 2]], two.copy(), np.zeros(count, dtype=np.int64)
    alive = np.ones(count, dtype=np.bool_)
    best = scores.copy()
    ends = np.full(count, 3)
    for number in range(3, _MAX_IMPACTS):
        gap_next = gap * ratio
        alive &= (gap_next > _MIN_S / 2) & (missed < 2)
        if not alive.any():
            break
        level = level + _PER_DECADE_DB * np.log10(ratio)
        due = last + gap_next
        sd = np.hypot(_JITTER_S, _DRIFT * gap_next) * (1 + missed)
        at = np.clip(np.searchsorted(times_s, due), 1, len(times_s) - 1)
        at = np.where(due - times_s[at - 1] < times_s[at] - due, at - 1, at)
        off = (times_s[at] - due) / sd
        gain = -0.5 * off**2 - np.log(np.sqrt(2 * np.pi) * sd * crowd.rate_hz)
        gain += crowd.loudness_odds(loud[at], level)
        gain += crowd.colour_odds(((colours[at] - mean_colour) ** 2).mean(axis=1))
        met = alive & (np.abs(off) < _FARTHEST_SDS) & (gain > _MISSED)
        gone = alive & ~met
        scores[met] += gain[met]
        scores[gone] += _MISSED
        which[met, number] = at[met]
        newly = np.where(met, times_s[at] - last, gap_next)
        grown = np.where(met, newly / gap, ratio)
        ratio = np.where(met, np.clip(0.5 * ratio + 0.5 * grown, 0.3, _MAX_RATIO), ratio)
        level = np.where(met, 0.6 * level + 0.4 * loud[at], level)
        gap, last = newly, np.where(met, times_s[at], due)
        missed = np.where(met, 0, missed + 1)
        better = met & (scores > best)
        best[better], ends[better] = scores[better], number + 1
    which[np.arange(_MAX_IMPACTS)[None, :] >= ends[:, None]] = -1
    return which, best
