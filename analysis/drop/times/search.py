"""Search for the ball among a sound's onsets: the chain of onsets that a ball explains best.

Chains are found by their rhythm and loudness. Each is then fitted, and what the fit predicts is
looked for: an impact before the first, one that was passed over, softer ones after the last. Every
change must raise the evidence: the log odds against onsets at random times, of random loudness and
colour.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.drop.times import readings as priors
from tunenet_logs.analysis.drop.times.model import (
    MAX_TIMES,
    ClutterModel,
    DropSetup,
    HeardBall,
    Whitening,
    flights,
    heard_ball,
    ideal_ball,
    whitenings,
)
from tunenet_logs.analysis.drop.times.readings import MISSED
from tunenet_logs.analysis.onsets import Onsets
from tunenet_logs.analysis.statistics import normalised
from tunenet_logs.episode import Array

# ---- Chains of onsets that may be one ball's: flights that shorten by a ratio, ever softer
# Every three onsets whose gaps shorten as a ball's predict a fourth, and so on. A chain's log odds
# say how sharply its times follow each other, and how steadily it softens and keeps its colour.

_MIN_S = 0.06  # of a flight: from a shorter one on a ball rattles
_MAX_RATIO = 0.985  # of a flight's duration to the one before
_MAX_IMPACTS = 40  # of a chain
_MISSED = float(np.log(0.08))  # of an impact that is not heard; two in a row end a chain
_PER_DECADE_DB = 30.0  # by which a knock gets softer, as its ball gets slower
_CHAIN_LOUDNESS_SD_DB = 4.0  # of a ball's knock about that
_COLOUR_SD_DB = 4.0  # the same of a band


@dataclass(frozen=True, eq=False)
class KnockChain:
    """Onsets as one ball's impacts."""

    which: NDArray[np.int64]  # indices of the onsets, shape (N,)
    numbers: NDArray[np.int64]  # of the impacts, the first 0, shape (N,)
    score: float = 0.0  # log odds, roughly


@dataclass(frozen=True, eq=False)
class Crowd:
    """Statistics of onsets that are nobody's."""

    rate_hz: float  # of them
    loudness_db: float  # mean
    spread_db: float  # standard deviation about it
    colour_sd_db: float  # of a band's share

    @classmethod
    def of(cls, heard: Onsets, lasts_s: float) -> Crowd:
        """Estimate them from all that were heard: a ball's are few among many, or all."""
        spread = float(np.std(heard.loudness_db))
        colours = heard.colours_db
        colour = float(np.sqrt(np.mean((colours - colours.mean(axis=0)) ** 2)))
        return cls(
            len(heard) / max(lasts_s, 0.2),
            float(heard.loudness_db.mean()),
            max(spread, 6.0),  # dB
            max(colour, 5.0),  # dB
        )

    def loudness_odds(self, loudness_db: Array, foretold_db: Array) -> Array:
        """Return the log odds of a ball's loudness against one of these."""
        own = -0.5 * ((loudness_db - foretold_db) / _CHAIN_LOUDNESS_SD_DB) ** 2
        own = np.maximum(own, -8.0) - np.log(_CHAIN_LOUDNESS_SD_DB)
        other = -0.5 * ((loudness_db - self.loudness_db) / self.spread_db) ** 2
        return own - other + np.log(self.spread_db)

    def colour_odds(self, squares_db2: Array) -> Array:
        """Return the log odds of the mean squared difference of two onsets' colours."""
        own, other = 2 * _COLOUR_SD_DB**2, 2 * self.colour_sd_db**2
        odds = -0.5 * squares_db2 / own + 0.5 * squares_db2 / other + 0.5 * np.log(other / own)
        return 2.0 * np.maximum(odds, -3.0)  # so many bands tell something of their own


def chains(heard: Onsets, lasts_s: float, most: int = 40) -> list[KnockChain]:
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


def _seeds(heard: Onsets) -> NDArray[np.int64]:
    """Return the triples whose gaps and loudness may be a ball's, shape (S, 3)."""
    times_s, loud = heard.times_s, heard.loudness_db
    gaps = times_s[None, :] - times_s[:, None]
    first, second = np.nonzero((gaps >= _MIN_S) & (gaps <= 1.5))  # [s]
    rows = [np.zeros((0, 3), dtype=np.int64)]
    softer = loud[None, :] < loud[:, None] + 2 * _CHAIN_LOUDNESS_SD_DB
    for middle in range(len(times_s)):
        before = first[(second == middle) & softer[first, middle]]
        after = second[(first == middle) & softer[middle, second]]
        if not len(before) or not len(after):
            continue
        ratio = gaps[middle, after][None, :] / gaps[before, middle][:, None]
        one, two = np.nonzero((ratio >= 0.35) & (ratio <= _MAX_RATIO))
        triple = np.column_stack([before[one], np.full(len(one), middle), after[two]])
        rows.append(triple.astype(np.int64))
    seeds = np.concatenate(rows)
    if len(seeds) > 60_000:  # those of the loudest knocks
        loudest = np.argsort(-loud[seeds].min(axis=1), kind="stable")[:60_000]
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
        sd = np.hypot(0.002, 0.02 * gap_next) * (1 + missed)
        at = np.clip(np.searchsorted(times_s, due), 1, len(times_s) - 1)
        at = np.where(due - times_s[at - 1] < times_s[at] - due, at - 1, at)
        off = (times_s[at] - due) / sd
        gain = -0.5 * off**2 - np.log(np.sqrt(2 * np.pi) * sd * crowd.rate_hz)
        gain += crowd.loudness_odds(loud[at], level)
        gain += crowd.colour_odds(((colours[at] - mean_colour) ** 2).mean(axis=1))
        met = alive & (np.abs(off) < 3.5) & (gain > _MISSED)  # farther it is another
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


# ---- Laplace approximation of a ball's evidence by its times, against noises
# `fit_times` averages over a grid of slopes and drags, and is slow. To choose among chains, one
# ball is fitted with the same unknowns and priors, the posterior about it normal.

_SLOPE, _SLOPE_SD = 0.04, 0.07
# Of the derivatives: log speed, restitution, slope, log drag.
_STEPS = np.array([1e-6, 1e-6, 1e-5, 1e-4])
_FLAT = 3  # unknowns without a prior: time of the first impact, log speed after it, restitution


def log_likelihood(
    times_s: Array, numbers: NDArray[np.int64], log_rate: float, rig: DropSetup
) -> tuple[float, float]:
    """Return the log odds against noises of the logarithmic rate `log_rate`, and the restitution.

    Of impacts at three times or more, numbered from 0; the height of the drop is not used.
    """
    tried = [
        _likelihood(times_s, numbers, white, rig)
        for white in whitenings(times_s, numbers, rig.jitter_s)
    ]
    logs = np.array([log for log, _ in tried])
    _, found = normalised(logs)
    odds = found - float(np.log(priors.FLIGHT_RANGE)) - (len(times_s) - 1) * log_rate
    return odds, tried[int(logs.argmax())][1]


def _likelihood(
    times_s: Array, numbers: NDArray[np.int64], white: Whitening, rig: DropSetup
) -> tuple[float, float]:
    """Return the log likelihood with this share of scatter, and the ball's restitution."""
    log_drag = np.log(rig.drag_1_m or priors.TYPICAL_DRAG_1_M)
    middles = np.array([0.0, 0.0, 0.0, _SLOPE, log_drag, priors.CONTACT_S])
    drag_sd = priors.KNOWN_DRAG if rig.drag_1_m else priors.LOG_DRAG_SD
    prior = np.array([0.0, 0.0, 0.0, _SLOPE_SD**-2, drag_sd**-2, priors.CONTACT_SD_S**-2])
    at: Array = middles.copy()
    at[:_FLAT] = ideal_ball(times_s - priors.CONTACT_S * numbers, numbers)
    left, columns = _seen(times_s, numbers, at)
    for _ in range(8):
        left, columns = white.rows @ left, white.rows @ columns
        normal = columns.T @ columns / rig.jitter_s**2 + np.diag(prior + 1e-9)
        pull = columns.T @ left / rig.jitter_s**2 + prior * (middles - at)
        step = np.linalg.solve(normal, pull)
        step[1:3] = np.clip(step[1:3], -0.15, 0.15)
        at = np.asarray(at + step, dtype=np.float64)
        at[2] = np.clip(at[2], 0.01, 1.3)
        # Slope and log drag, within which balls are.
        at[3:5] = np.clip(at[3:5], np.array([-0.25, np.log(5e-4)]), np.array([0.45, np.log(0.6)]))
        left, columns = _seen(times_s, numbers, at)
    left, columns = white.rows @ left, white.rows @ columns
    jitters = priors.JITTERS_S[:, None, None]
    normal = columns.T @ columns / jitters**2 + np.diag(prior + 1e-9)
    pull = (columns.T @ left) / jitters[..., 0] ** 2 + prior * (middles - at)
    gain = np.einsum("ji,ji->j", pull, np.linalg.solve(normal, pull[..., None])[..., 0])
    squares = (left @ left) / priors.JITTERS_S**2 + prior @ (middles - at) ** 2 - gain
    log = priors.log_jitter_prior(rig.jitter_s) - 0.5 * squares
    log = log + white.log_prior + priors.log_scatter_prior(white.ratio_1_s * priors.JITTERS_S)
    log = log - len(times_s) * np.log(priors.JITTERS_S) - 0.5 * np.linalg.slogdet(normal)[1]
    log = log + 0.5 * np.log(prior[_FLAT:]).sum() + white.log_size
    log = log - 0.5 * (len(times_s) - _FLAT) * np.log(2 * np.pi)
    return normalised(log)[1], float(at[2])


def _seen(times_s: Array, numbers: NDArray[np.int64], at: Array) -> tuple[Array, Array]:
    """Return the times' residuals, shape (N,), and their predictions' derivatives, (N, 6)."""
    balls = np.tile(at[1:5], (5, 1))
    balls[1:] += np.diag(_STEPS)
    count = int(numbers.max())
    speed, kept, slope, log_drag = balls.T
    hits = flights(count, np.exp(speed), kept, slope, np.exp(log_drag)).impacts_s[numbers]
    bends = (hits[:, 1:] - hits[:, :1]) / _STEPS
    late = numbers.astype(np.float64)
    columns = np.column_stack([np.ones(len(numbers)), bends, late])
    return times_s - at[0] - hits[:, 0] - at[5] * numbers, columns


# ---- Best chain: each is fitted and completed, then judged beside all other onsets

_BEFORE_S = 1.6  # before the first impact, where knocks are tried
# For ten times the speed: of a ball's knocks, usually; their spread; that of a beat's, about 0.
_SOFTENING_DB, _SOFTENING_SD_DB, _BEAT_SD_DB = 28.0, 8.0, 5.0
_TRIED = 6  # knocks, for one impact


@dataclass(frozen=True, eq=False)
class BallAmong:
    """Ball found among onsets, and what was heard beside it."""

    ball: HeardBall  # by its impact times, on the sound's clock
    which: NDArray[np.int64]  # indices of its impacts among the onsets, shape (N,)
    second_odds: float  # log odds of a second ball while this one bounces, or just before
    # Its impacts where all are before this one's first: of the same ball, most likely; shape (E,),
    # else empty.
    earlier_s: Array
    as_loud: int  # other knocks meanwhile that are as loud as its own
    # Log odds that its knocks soften as a ball's do, against knocks that stay as loud; None where
    # too few are below full scale.
    softening_odds: float | None
    clipped: int  # its knocks that are as loud as the recording can tell


def ball_among(heard: Onsets, lasts_s: float, rig: DropSetup) -> BallAmong | None:
    """Find the likeliest ball among the onsets; None where nothing sounds like one."""
    found = chains(heard, lasts_s)[:24]  # the best ones are fitted
    if not found:
        return None
    crowd = Crowd.of(heard, lasts_s)
    judge = _Judge(heard, crowd, replace(rig, height_m=None))
    chain = max((judge.judged(one) for one in found), key=lambda one: one.score)
    # Climb to the best chain: make every change that raises the evidence, the best first.
    for _ in range(30):
        tried = [judge.judged(one) for one in _changes(heard, chain)]
        better = max(tried, key=lambda one: one.score, default=chain)
        if better.score <= chain.score:
            break
        chain = better
    which = chain.which[:MAX_TIMES]
    ball = heard_ball(heard.times_s[which], rig, ClutterModel(crowd.rate_hz, judge.beside(chain)))
    if ball is None:
        return None
    kept = which[ball.reading.heard]
    # Others between its first and last that are as loud as its own then, to 6 dB.
    own_s, own_db = heard.times_s[kept], heard.loudness_db[kept]
    others = heard.only(np.setdiff1d(np.arange(len(heard)), kept))
    inside = (others.times_s > own_s[0]) & (others.times_s < own_s[-1])
    least_db = np.interp(others.times_s, own_s, own_db) - 6.0
    as_loud = int((inside & (others.loudness_db > least_db)).sum())
    clipped = heard.peaks[kept] > 0.98  # of full scale
    return BallAmong(
        ball,
        kept,
        *_second_odds(judge, kept),
        as_loud,
        _softening_odds(ball, np.where(clipped, np.nan, own_db)),
        int(clipped.sum()),
    )


@dataclass(frozen=True, eq=False)
class _Judge:
    """Evidence of chains."""

    heard: Onsets  # all knocks
    crowd: Crowd  # what they are like
    rig: DropSetup  # what is known of the ball, but for its height

    def judged(self, chain: KnockChain) -> KnockChain:
        """Score a chain by its evidence."""
        which, numbers = chain.which, chain.numbers
        times_s = self.heard.times_s[which]
        rate = float(np.log(self.crowd.rate_hz))
        odds, restitution = log_likelihood(times_s, numbers, rate, self.rig)
        if restitution > 0.985:  # a beat that keeps on is of no ball
            return replace(chain, score=-np.inf)
        missed = int(numbers.max()) + 1 - len(which)
        score = odds + missed * np.log(MISSED) + len(which) * np.log1p(-MISSED)
        return replace(chain, score=score + self.beside(chain))

    def beside(self, chain: KnockChain) -> float:
        """Return the log odds of loudness, colour, and the onsets that are left for chance."""
        loud = self.heard.loudness_db[chain.which]
        colours = self.heard.colours_db[chain.which]
        # How much softer each knock is than the first, by the gaps before.
        gaps = np.diff(self.heard.times_s[chain.which]) / np.diff(chain.numbers)
        foretold = _PER_DECADE_DB * np.log10(np.append(gaps[0], gaps) / gaps[0])
        foretold = foretold + float(np.median(loud - foretold))
        odds = self.crowd.loudness_odds(loud, foretold)
        off = ((colours - np.median(colours, axis=0)) ** 2).mean(axis=1)
        odds = odds + self.crowd.colour_odds(off)
        every, own = len(self.heard), len(chain.which)
        left = (every - own) * np.log((every - own) / every) if every > own else 0.0
        return float(odds.sum()) + own + float(left) - float(np.log(every))


def _changes(heard: Onsets, chain: KnockChain) -> list[KnockChain]:
    """Return the chains with one onset more, or one less."""
    times_s, which, numbers = heard.times_s, chain.which, chain.numbers
    own_s = times_s[which]
    found: list[KnockChain] = []
    if len(which) > 3:
        for place in range(len(which)):
            left, rest = np.delete(which, place), np.delete(numbers, place)
            found.append(KnockChain(left, rest - rest[0]))
    first = own_s[0]
    earlier = np.flatnonzero((times_s > first - _BEFORE_S) & (times_s < first))
    first_gap = (own_s[1] - first) / (numbers[1] - numbers[0])
    earlier = earlier[(first - times_s[earlier]) > 0.9 * first_gap]
    found.extend(
        KnockChain(np.append(one, which), np.append(0, numbers + 1))
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
        near = np.flatnonzero(np.abs(times_s - due) < 0.02 * len(steps))  # [s]
        near = np.setdiff1d(near, which)
        near = near[(times_s[near] > own_s[at])]
        if at + 1 < len(own_s):
            near = near[times_s[near] < own_s[at + 1]]
        closest = near[np.argsort(np.abs(times_s[near] - due))[:_TRIED]]
        for one in closest.tolist():
            more = np.insert(which, at + 1, one), np.insert(numbers, at + 1, number)
            found.append(KnockChain(*more))
    return found


def _softening_odds(ball: HeardBall, loudness_db: Array) -> float | None:
    """Regress loudness, NaN where not known, on the log impact speed, for the odds of a ball."""
    speeds = np.log10(ball.flown.arriving_m_s[ball.numbers, 0])
    is_known = np.isfinite(speeds + loudness_db)  # nobody hears how fast it arrives at the first
    if is_known.sum() < 4:
        return None
    speeds, loudness_db = speeds[is_known], loudness_db[is_known]
    off = speeds - speeds.mean()
    spread = float(off @ off)
    slope = float(off @ loudness_db) / spread
    left = loudness_db - loudness_db.mean() - slope * off
    known, sd_db = 2, 2.0  # a knock's loudness usually scatters so: it counts for so many knocks
    variance = (left @ left + known * sd_db**2) / (len(left) - 2 + known)
    of_ball = variance / spread + _SOFTENING_SD_DB**2
    of_beat = variance / spread + _BEAT_SD_DB**2
    odds = slope**2 / of_beat - (slope - _SOFTENING_DB) ** 2 / of_ball
    return 0.5 * float(odds + np.log(of_beat / of_ball))


def _second_odds(judge: _Judge, which: NDArray[np.int64]) -> tuple[float, Array]:
    """Return the odds of another chain before the last impact, and its times if all are earlier."""
    heard, own_s = judge.heard, judge.heard.times_s[which]
    others = heard.only(np.setdiff1d(np.arange(len(heard)), which))
    inside = (others.times_s > own_s[0] - _BEFORE_S) & (others.times_s < own_s[-1])
    others = others.only(inside)
    judge = replace(judge, heard=others)
    odds, best_s = -np.inf, np.zeros(0)
    for chain in chains(others, float(own_s[-1] - own_s[0]) + _BEFORE_S)[:6]:
        times_s, sds_s = others.times_s[chain.which], others.sds_s[chain.which]
        late_s = times_s - own_s[np.maximum(np.searchsorted(own_s, times_s) - 1, 0)]
        off_s = np.abs(late_s - np.median(late_s))
        # What is late by the same time everywhere is an echo.
        if np.any(off_s > 0.002 / 2 + 2.0 * sds_s):
            score = judge.judged(chain).score
            if score > odds:
                odds, best_s = score, times_s
    earlier_s = best_s if len(best_s) and best_s[-1] < own_s[0] else np.zeros(0)
    return float(odds), earlier_s
