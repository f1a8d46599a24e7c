"""Search for the ball among a sound's onsets: the chain of onsets that a ball explains best.

Chains are found by their rhythm and loudness (`knocks`). Here each is fitted, and what the fit
predicts is looked for: an impact before the first, one that was passed over, softer ones after
the last. Every change must raise the evidence: the log odds against onsets at random times, of
random loudness and colour.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.drop.times.fit import Rig
from analysis.drop.times.knocks import Crowd, KnockChain, chains, softer_db
from analysis.drop.times.likelihood import log_likelihood
from analysis.drop.times.missing_impacts import MISSED
from analysis.drop.times.posterior import MAX_TIMES, Besides, HeardBall, heard_ball
from analysis.listening.onsets import Onsets
from tunenet_logs.arrays import Array

_FITTED = 24  # chains that are fitted
_CHANGES = 30  # of the best chain at most
# Before the first impact, and about a foretold one, where knocks are tried.
_BEFORE_S, _NEAR_S = 1.6, 0.02

_EVEN = 0.985  # restitution of a beat that keeps on: of no ball
_SECONDS = 6  # chains of other knocks that are looked at
_ECHO_SPREAD_S = 0.002  # by which what is late by the same time everywhere is an echo
# Of a knock's own moment that come to that: an echo begins less sharply than a knock.
_ECHO_SDS = 2.0

_AS_LOUD_DB = 6.0  # below the ball's own, from which on another knock is as loud
# For ten times the speed: of a ball's knocks, usually; their spread; that of a beat's, about 0.
_SOFTENING_DB, _SOFTENING_SD_DB, _BEAT_SD_DB = 28.0, 8.0, 5.0

# Usual scatter of a knock's loudness, and how many knocks that counts for.
_LOUDNESS_SD_DB, _LOUDNESS_KNOWN = 2.0, 2

# Of a knock that is clipped; and knocks that are not, from which on their softening is known.
_FULL_SCALE, _MIN_SOFTENING = 0.98, 4

_TRIED = 6  # knocks, for one impact


@dataclass(frozen=True, eq=False)
class BallAmong:
    """Ball found among onsets, and what was heard beside it.

    Attributes:
        ball: by its impact times, on the sound's clock.
        which: indices of its impacts among the onsets, shape (N,).
        second_odds: log odds of a second ball while this one bounces, or just before.
        earlier_s: its impacts where all are before this one's first: of the same ball, most likely;
            shape (E,), else empty.
        as_loud: other knocks meanwhile that are as loud as its own.
        softening_odds: log odds that its knocks soften as a ball's do, against knocks that stay as
            loud; None where too few are below full scale.
        clipped: its knocks that are as loud as the recording can tell.
    """

    ball: HeardBall
    which: NDArray[np.int64]
    second_odds: float
    earlier_s: Array
    as_loud: int
    softening_odds: float | None
    clipped: int


def ball_among(heard: Onsets, lasts_s: float, rig: Rig) -> BallAmong | None:
    """Find the likeliest ball among the onsets; None where nothing sounds like one."""
    found = chains(heard, lasts_s)[:_FITTED]
    if not found:
        return None
    judge = _Judge(heard, Crowd.of(heard, lasts_s), replace(rig, height_m=None))
    best = max((judge.judged(one) for one in found), key=lambda one: one.score)
    best = _completed(judge, best)
    which = best.which[:MAX_TIMES]
    ball = heard_ball(heard.times_s[which], rig, judge.besides(best))
    if ball is None:
        return None
    kept = which[ball.reading.heard]
    clipped = heard.peaks[kept] > _FULL_SCALE
    return BallAmong(
        ball,
        kept,
        *_second_odds(judge, kept),
        _as_loud(heard, kept),
        _softening_odds(ball, np.where(clipped, np.nan, heard.loudness_db[kept])),
        int(clipped.sum()),
    )


@dataclass(frozen=True, eq=False)
class _Judge:
    """Evidence of chains.

    Attributes:
        heard: all knocks.
        crowd: what they are like.
        rig: what is known of the ball, but for its height.
    """

    heard: Onsets
    crowd: Crowd
    rig: Rig

    def judged(self, chain: KnockChain) -> KnockChain:
        """Score a chain by its evidence."""
        which, numbers = chain.which, chain.numbers
        times_s = self.heard.times_s[which]
        rate = float(np.log(self.crowd.rate_hz))
        odds, restitution = log_likelihood(times_s, numbers, rate, self.rig)
        if restitution > _EVEN:
            return replace(chain, score=-np.inf)
        missed = int(numbers.max()) + 1 - len(which)
        score = odds + missed * np.log(MISSED) + len(which) * np.log1p(-MISSED)
        return replace(chain, score=score + self._beside(chain))

    def _beside(self, chain: KnockChain) -> float:
        """Return the log odds of loudness, colour, and the onsets that are left for chance."""
        loud = self.heard.loudness_db[chain.which]
        colours = self.heard.colours_db[chain.which]
        foretold = softer_db(self.heard.times_s[chain.which], chain.numbers)
        foretold = foretold + float(np.median(loud - foretold))
        odds = self.crowd.loudness_odds(loud, foretold)
        off = ((colours - np.median(colours, axis=0)) ** 2).mean(axis=1)
        odds = odds + self.crowd.colour_odds(off)
        every, own = len(self.heard), len(chain.which)
        left = (every - own) * np.log((every - own) / every) if every > own else 0.0
        return float(odds.sum()) + own + float(left) - float(np.log(every))

    def besides(self, chain: KnockChain) -> Besides:
        """Return what the times alone do not say."""
        return Besides(self.crowd.rate_hz, self._beside(chain))


def _completed(judge: _Judge, chain: KnockChain) -> KnockChain:
    """Climb to the best chain: make every change that raises the evidence, the best first."""
    for _ in range(_CHANGES):
        tried = [judge.judged(one) for one in _changes(judge.heard, chain)]
        best = max(tried, key=lambda one: one.score, default=chain)
        if best.score <= chain.score:
            break
        chain = best
    return chain


def _changes(heard: Onsets, chain: KnockChain) -> list[KnockChain]:
    """Return the chains with one onset more, or one less."""
    times_s, which, numbers = heard.times_s, chain.which, chain.numbers
    own_s = times_s[which]
    found: list[KnockChain] = []
    if len(which) > 3:
        for place in range(len(which)):
            left, rest = np.delete(which, place), np.delete(numbers, place)
            found.append(KnockChain(left, rest - rest[0], 0.0))
    first = own_s[0]
    earlier = np.flatnonzero((times_s > first - _BEFORE_S) & (times_s < first))
    first_gap = (own_s[1] - first) / (numbers[1] - numbers[0])
    earlier = earlier[(first - times_s[earlier]) > 0.9 * first_gap]
    found.extend(
        KnockChain(np.append(one, which), np.append(0, numbers + 1), 0.0)
        for one in earlier[::-1][:_TRIED].tolist()
    )
    # gaps shrink evenly in their logarithm: good enough to look about
    logs = np.log(np.diff(own_s) / np.diff(numbers))
    middles = (numbers[1:] + numbers[:-1]) / 2
    slope, level = np.polyfit(middles, logs, 1) if len(logs) > 1 else (0.0, logs[0])
    last = int(numbers[-1])
    for number in np.setdiff1d(np.arange(last + 3), numbers).tolist():
        at = int(np.searchsorted(numbers, number)) - 1
        steps = np.arange(numbers[at], number) + 0.5
        due = own_s[at] + float(np.exp(level + slope * steps).sum())
        near = np.flatnonzero(np.abs(times_s - due) < _NEAR_S * len(steps))
        near = np.setdiff1d(near, which)
        near = near[(times_s[near] > own_s[at])]
        if at + 1 < len(own_s):
            near = near[times_s[near] < own_s[at + 1]]
        closest = near[np.argsort(np.abs(times_s[near] - due))[:_TRIED]]
        for one in closest.tolist():
            place = at + 1
            found.append(
                KnockChain(np.insert(which, place, one), np.insert(numbers, place, number), 0.0)
            )
    return found


def _softening_odds(ball: HeardBall, loudness_db: Array) -> float | None:
    """Regress loudness, NaN where not known, on the log impact speed, for the odds of a ball."""
    speeds = np.log10(ball.flown.arriving_m_s[ball.numbers, 0])
    known = np.isfinite(speeds + loudness_db)  # nobody hears how fast it arrives at the first
    if known.sum() < _MIN_SOFTENING:
        return None
    speeds, loudness_db = speeds[known], loudness_db[known]
    off = speeds - speeds.mean()
    spread = float(off @ off)
    slope = float(off @ loudness_db) / spread
    left = loudness_db - loudness_db.mean() - slope * off
    variance = (left @ left + _LOUDNESS_KNOWN * _LOUDNESS_SD_DB**2) / (
        len(left) - 2 + _LOUDNESS_KNOWN
    )
    of_ball = variance / spread + _SOFTENING_SD_DB**2
    of_beat = variance / spread + _BEAT_SD_DB**2
    odds = slope**2 / of_beat - (slope - _SOFTENING_DB) ** 2 / of_ball
    return 0.5 * float(odds + np.log(of_beat / of_ball))


def _as_loud(heard: Onsets, which: NDArray[np.int64]) -> int:
    """Count the others between the ball's first and last that are as loud as its own then."""
    own_s, own_db = heard.times_s[which], heard.loudness_db[which]
    others = heard.only(np.setdiff1d(np.arange(len(heard)), which))
    inside = (others.times_s > own_s[0]) & (others.times_s < own_s[-1])
    least_db = np.interp(others.times_s, own_s, own_db) - _AS_LOUD_DB
    return int((inside & (others.loudness_db > least_db)).sum())


def _second_odds(judge: _Judge, which: NDArray[np.int64]) -> tuple[float, Array]:
    """Return the odds of another chain before the last impact, and its times if all are earlier."""
    heard, own_s = judge.heard, judge.heard.times_s[which]
    others = heard.only(np.setdiff1d(np.arange(len(heard)), which))
    inside = (others.times_s > own_s[0] - _BEFORE_S) & (others.times_s < own_s[-1])
    others = others.only(inside)
    judge = replace(judge, heard=others)
    odds, best_s = -np.inf, np.zeros(0)
    for chain in chains(others, float(own_s[-1] - own_s[0]) + _BEFORE_S)[:_SECONDS]:
        times_s, sds_s = others.times_s[chain.which], others.sds_s[chain.which]
        late_s = times_s - own_s[np.maximum(np.searchsorted(own_s, times_s) - 1, 0)]
        off_s = np.abs(late_s - np.median(late_s))
        if np.any(off_s > _ECHO_SPREAD_S / 2 + _ECHO_SDS * sds_s):
            score = judge.judged(chain).score
            if score > odds:
                odds, best_s = score, times_s
    earlier_s = best_s if len(best_s) and best_s[-1] < own_s[0] else np.zeros(0)
    return float(odds), earlier_s
