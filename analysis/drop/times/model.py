"""Posterior of the ball that was heard: averaged over readings of the times, and over balls.

Balls on a grid of slopes and drags are fitted by least squares, all at once, with contact durations
in closed form. Likelihood, priors and the unknown jitter of the times weigh them, and readings
(`readings.py`) are weighed by their evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.drop.times import readings as priors
from tunenet_logs.analysis.drop.times.readings import (
    MISSED,
    Reading,
    best_rhythm,
    noise_rate_hz,
    readings,
)
from tunenet_logs.analysis.record import Rebound
from tunenet_logs.analysis.statistics import TWO_SIDED, normalised
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.ball import MIN_SPEED_M_S
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

# ---- Flight time since each impact: by so much a faster return delays what follows


def since_impacts_s(times_s: Array, numbers: NDArray[np.integer]) -> Array:
    """Return the seconds from impacts 0 to K - 1, K the last's number, to each time, (N, K).

    It is 0 for times before the impact. An impact that was not heard lies between its neighbours,
    or before the first as far from it as the first two are apart.
    """
    first = int(numbers[0])
    impacts_s = np.interp(np.arange(numbers[-1]), numbers, times_s)
    impacts_s[:first] -= np.ptp(times_s[:2]) * np.arange(first, 0, -1)
    return np.maximum(times_s[:, None] - impacts_s, 0.0)


# ---- Impact times of many bouncing balls at once: flights with drag, in closed form

# Below it the closed form would lose its digits: over 100 m it changes a flight by 1e-7.
_MIN_DRAG_1_M = 1e-9
_SPEEDS_M_S = 1e-6, 1e3  # beyond them no fit of a ball goes on
_LOG_SPEEDS = np.log(_SPEEDS_M_S)


@dataclass(frozen=True, eq=False)
class FlightTimes:
    """Flights of M balls, N + 1 impacts each."""

    impacts_s: Array  # after the first impact, which is 0, shape (N + 1, M) [s]
    leaving_m_s: Array  # speeds after these impacts, shape (N + 1, M)
    arriving_m_s: Array  # speeds before them, the first of them unknown (NaN), shape (N + 1, M)


def flights(
    count: int, leaving_m_s: Array, restitution: Array, slope: Array, drag_1_m: Array
) -> FlightTimes:
    """Compute `count` flights of M balls from an impact on, left at these speeds.

    The restitution is that at the second impact, e_n = e_2 (v_n / v_2)^-p constant below
    `MIN_SPEED_M_S`; more than 1 is not cut, so that a fit can show it. Shape (M,) each.
    """
    drag_1_m = np.maximum(drag_1_m, _MIN_DRAG_1_M)
    rate, per_speed = np.sqrt(GRAVITY_M_S2 * drag_1_m), np.sqrt(drag_1_m / GRAVITY_M_S2)
    shape = (count + 1, *np.shape(leaving_m_s + restitution))
    impacts_s, leaving, arriving = np.zeros(shape), np.zeros(shape), np.full(shape, np.nan)
    leaving[0] = leaving_m_s
    first = np.ones(shape[1:])
    for number in range(1, count + 1):
        reach = leaving[number - 1] * per_speed
        impacts_s[number] = impacts_s[number - 1] + (np.arctan(reach) + np.arcsinh(reach)) / rate
        speed = leaving[number - 1] / np.hypot(1.0, reach)
        arriving[number] = speed
        held = np.maximum(speed, MIN_SPEED_M_S)
        if number == 1:
            first = held
        kept = restitution * (held / first) ** -slope
        leaving[number] = np.clip(kept * speed, *_SPEEDS_M_S)
    return FlightTimes(impacts_s, leaving, arriving)


def leaving_speeds(lasting_s: Array, drag_1_m: float) -> Array:
    """Solve for the speeds at the start of flights of these durations, by Newton, (N,) [m/s]."""
    drag_1_m = max(drag_1_m, _MIN_DRAG_1_M)
    rate, per_speed = np.sqrt(GRAVITY_M_S2 * drag_1_m), np.sqrt(drag_1_m / GRAVITY_M_S2)
    speeds = GRAVITY_M_S2 * lasting_s / 2
    for _ in range(6):
        reach = speeds * per_speed
        lasted = (np.arctan(reach) + np.arcsinh(reach)) / rate
        grows = (1 / (1 + reach**2) + 1 / np.hypot(1.0, reach)) / GRAVITY_M_S2
        speeds = np.maximum(speeds - (lasted - lasting_s) / grows, speeds / 2)
    return speeds


def apex_m(leaving_m_s: float, drag_1_m: float) -> float:
    """Return how high a ball rises that leaves with this speed [m]."""
    drag_1_m = max(drag_1_m, _MIN_DRAG_1_M)
    return float(np.log1p(drag_1_m * leaving_m_s**2 / GRAVITY_M_S2) / (2 * drag_1_m))


def fallen_m_s(height_m: Array | float, drag_1_m: Array | float) -> Array:
    """Return the speed at the end of a fall from rest, of the shape of both [m/s]."""
    drag_1_m = np.maximum(drag_1_m, _MIN_DRAG_1_M)
    return np.sqrt(-GRAVITY_M_S2 / drag_1_m * np.expm1(-2 * drag_1_m * height_m))


# ---- Least squares of many balls at once, each of a slope and a drag, by Gauss-Newton

_ITERATIONS, _SHORT = 7, 1e-6  # of Gauss and Newton's method, and the step of its derivatives
_TRIED = np.linspace(0.06, 1.1, 209)  # restitutions to begin with


@dataclass(frozen=True, eq=False)
class Whitening:
    """Whitening of the times' residuals: independent, of the size of the jitter.

    An impact that returns more than the law says makes all later flights longer.
    """

    rows: Array  # lower triangle, shape (N, N)
    log_size: float  # logarithm of its determinant
    ratio_1_s: float  # scatter of the impacts over the jitter [1/s]
    log_prior: float = 0.0  # of that ratio

    @classmethod
    def of(cls, times_s: Array, numbers: NDArray[np.int64], ratio_1_s: float) -> Whitening:
        """Build the whitening of the times that were heard, by Cholesky factorisation."""
        later_s = since_impacts_s(times_s, numbers)[:, 1:]  # the first's is the speed after it
        spread = np.eye(len(times_s)) + ratio_1_s**2 * later_s @ later_s.T
        rows = np.asarray(np.linalg.inv(np.linalg.cholesky(spread)), dtype=np.float64)
        return cls(rows, float(np.log(np.diag(rows)).sum()), ratio_1_s)


def whitenings(
    times_s: Array, numbers: NDArray[np.int64], jitter_s: float
) -> tuple[Whitening, ...]:
    """Build one whitening for each scatter that balls have, by the usual jitter."""
    return tuple(
        replace(Whitening.of(times_s, numbers, scatter / jitter_s), log_prior=float(np.log(likely)))
        for scatter, likely in priors.SCATTERS.items()
    )


@dataclass(frozen=True, eq=False)
class BallsByTimes:
    """Least-squares fits of every ball of a grid."""

    # Time of the first impact [s], log speed after it [m/s], restitution at the second; shape (M,
    # 3), of balls that touch the table for the usual time.
    unknowns: Array
    spread: Array  # of them, for a jitter of 1 s, shape (M, 3, 3)
    squares: Array  # sum of the squared residuals, shape (M,) [s²]
    leans: Array  # change of the unknowns with longer contacts, shape (M, 3) [1/s]
    # Sum of the residuals times what a contact of 1 s more makes of them, shape (M,) [s].
    across: Array
    bends: Array  # sum of the squares of the latter, shape (M,)
    seconds_m_s: Array  # speed of the second impact, shape (M,)
    count: int  # N, of the times
    white: Whitening  # what made the residuals independent

    @classmethod
    def of(
        cls, times_s: Array, numbers: NDArray[np.int64], nodes: priors.Nodes, white: Whitening
    ) -> BallsByTimes:
        """Fit all balls at once by Gauss-Newton, from the ball without air that fits best."""
        count = int(numbers.max())

        def flown(begin: Array, kept: Array) -> FlightTimes:
            return flights(count, np.exp(begin), kept, nodes.slopes, nodes.drags_1_m)

        longer = numbers.astype(np.float64)  # each contact before a time delays it
        times_s = times_s - priors.CONTACT_S * longer
        start = ideal_ball(times_s, numbers)
        unknowns = np.tile(start, (len(nodes.slopes), 1))
        first = left = np.zeros((len(times_s), len(unknowns)))
        leans = np.zeros_like(unknowns)
        seconds, spread = unknowns[:, 0], np.zeros((len(unknowns), 3, 3))
        for step in range(_ITERATIONS + 1):
            begin, kept = unknowns[:, 1], unknowns[:, 2]
            here = flown(begin, kept)
            hits = here.impacts_s[numbers]
            seconds = here.arriving_m_s[1]
            first = white.rows @ (times_s[:, None] - unknowns[:, 0] - hits)
            moved = flown(begin + _SHORT, kept), flown(begin, kept + _SHORT)
            slopes = [(one.impacts_s[numbers] - hits) / _SHORT for one in moved]
            jacobian = np.stack([np.ones_like(hits), *slopes], axis=-1)
            jacobian = np.tensordot(white.rows, jacobian, 1)
            normal = np.einsum("nmi,nmj->mij", jacobian, jacobian)
            normal += 1e-12 * np.eye(3)
            spread = np.linalg.inv(normal)
            if step == _ITERATIONS:
                late = white.rows @ longer
                leans = -np.einsum("mij,nmj,n->mi", spread, jacobian, late)
                left = late[:, None] + np.einsum("nmi,mi->nm", jacobian, leans)
                break
            gradient = np.einsum("nmi,nm->mi", jacobian, first)
            moves = np.einsum("mij,mj->mi", spread, gradient)
            moves[:, 1:] = np.clip(moves[:, 1:], -0.15, 0.15)  # so that no step goes astray
            unknowns = unknowns + moves
            unknowns[:, 2] = np.clip(unknowns[:, 2], 0.01, 1.3)
        squares, across = (first**2).sum(axis=0), (first * left).sum(axis=0)
        bends = (left**2).sum(axis=0)
        return cls(unknowns, spread, squares, leans, across, bends, seconds, len(times_s), white)


def ideal_ball(times_s: Array, numbers: NDArray[np.int64]) -> Array:
    """Fit a ball without air and slope: first impact [s], log speed [m/s], restitution."""
    powers = _TRIED[:, None] ** np.arange(int(numbers.max()))
    at = np.cumsum(np.column_stack([np.zeros(len(_TRIED)), powers]), axis=1)[:, numbers]
    middle = at.mean(axis=1)
    about = at - middle[:, None]
    lasting = about @ times_s / (about**2).sum(axis=1)
    begin = times_s.mean() - lasting * middle
    squares = ((times_s - begin[:, None] - lasting[:, None] * at) ** 2).sum(axis=1)
    best = int(np.where(lasting > 0, squares, np.inf).argmin())
    speed_m_s = max(float(lasting[best]), 1e-6) * GRAVITY_M_S2 / 2
    return np.array([begin[best], np.log(speed_m_s), _TRIED[best]])


# ---- Contact durations, marginalised in closed form


@dataclass(frozen=True, eq=False)
class WithContacts:
    """Fit of every ball with every jitter, marginalised over contact durations."""

    # Log speed after the first impact [m/s] and restitution at the second, shape (M, J, 2).
    middles: Array
    covariances: Array  # of them, shape (M, J, 2, 2)
    contacts_s: Array  # how long the ball touches the table, shape (M, J)
    log_gains: Array  # what the contacts add to the logarithm of the evidence, shape (M, J)

    @classmethod
    def of(cls, fit: BallsByTimes) -> WithContacts:
        """Marginalise contacts: their effect is linear, their prior a truncated normal."""
        jitters = priors.JITTERS_S
        sharpness = fit.bends[:, None] / jitters**2 + priors.CONTACT_SD_S**-2
        pull = fit.across[:, None] / jitters**2
        sd = sharpness**-0.5
        ends = np.array(priors.CONTACTS_S) - priors.CONTACT_S
        log_share, longer_s, variance = _cut_normal(pull / sharpness, sd, *ends)
        leans = fit.leans[:, None, 1:]
        own = jitters[:, None, None] ** 2 * fit.spread[:, None, 1:, 1:]
        shared = leans[..., :, None] * leans[..., None, :] * variance[..., None, None]
        gains = 0.5 * pull**2 / sharpness + np.log(sd / priors.CONTACT_SD_S) + log_share
        middles = fit.unknowns[:, None, 1:] + leans * longer_s[..., None]
        middles[..., 0] = np.clip(middles[..., 0], *_LOG_SPEEDS)
        return cls(
            middles,
            own + shared,
            priors.CONTACT_S + longer_s,
            gains,
        )


def _cut_normal(middle: Array, sd: Array, low: float, high: float) -> tuple[Array, Array, Array]:
    """Return a truncated normal's log share between two ends, its mean and variance."""
    from scipy.special import log_ndtr

    flipped = middle > (low + high) / 2  # so that the nearer end is the lower one
    centre = np.where(flipped, -middle, middle)
    first, last = np.where(flipped, -high, low), np.where(flipped, -low, high)
    begin, end = (first - centre) / sd, (last - centre) / sd
    over, beyond = log_ndtr(-begin), log_ndtr(-end)
    log_share = over + np.log1p(-np.exp(np.minimum(beyond - over, -1e-12)))
    density_begin, density_end = (
        np.exp(-0.5 * at**2 - 0.5 * np.log(2 * np.pi) - log_share) for at in (begin, end)
    )
    shift = density_begin - density_end
    inside = np.clip(centre + sd * shift, first, last)
    bent = 1 + begin * density_begin - np.where(np.isfinite(end), end * density_end, 0.0) - shift**2
    variance = np.clip(sd**2 * bent, 0.0, sd**2)
    return log_share, np.where(flipped, -inside, inside), variance


# ---- Posterior of a ball by its impact times: restitution, slope and drag, on a grid
# For every slope and drag the first impact, the speed after it and the second one's restitution are
# fitted. With the drop height the first impact's restitution follows too.

_REACH_SDS = 4.5  # of the fine grid about what is likely, to a side
_MIN_BALL_WEIGHT = 1e-6  # a ball with less is left out


@dataclass(frozen=True)
class DropSetup:
    """Knowledge of ball, drop and clock beside the times."""

    drag_1_m: float | None = None  # of the ball; None where it is not known
    # Of the drop whose first impact is heard first; None where it is not known.
    height_m: float | None = None
    has_clock: bool = True  # whether the seconds are true
    jitter_s: float = priors.TRIGGER_JITTER_S  # usual standard deviation of a time


@dataclass(frozen=True, eq=False)
class Balls:
    """Weighted samples of balls that may have made the times; shape (M,) each."""

    weights: Array  # adding up to 1
    # At the first impact where it can be determined: the second that is heard, or the first with a
    # known height.
    restitutions: Array
    sds: Array  # of them
    slopes: Array  # p
    drags_1_m: Array  # likewise
    jitters_s: Array  # of the times
    scatters: Array  # of each impact's own restitution about the law, as a fraction
    begins: Array  # log speed after the first impact [m/s]
    contacts_s: Array  # how long each touches the table
    log_evidence: float  # of all together, against noises: see `fit_times`
    # By how many standard deviations the law's first rebound is off from what the height asks for;
    # 0 without a height.
    height_sds: float

    @classmethod
    def mixed(cls, parts: Sequence[Balls]) -> Balls:
        """Mix several parts, each with its evidence."""
        logs = np.array([one.log_evidence for one in parts])
        shares, log_evidence = normalised(logs)
        kept = [
            (one, share)
            for one, share in zip(parts, shares, strict=True)
            if share > _MIN_BALL_WEIGHT
        ]
        merged = {
            field.name: np.concatenate([getattr(one, field.name) for one, _ in kept])
            for field in fields(cls)
            if field.name not in {"weights", "log_evidence", "height_sds"}
        }
        weights = np.concatenate([share * one.weights for one, share in kept])
        return cls(
            weights=weights / weights.sum(),
            log_evidence=log_evidence,
            height_sds=float(sum(share * one.height_sds for one, share in kept)),
            **merged,
        )

    def mean(self, values: Array) -> float:
        """Return the weighted mean of values of the balls, shape (M,)."""
        return float(self.weights @ values)

    def sd(self, values: Array) -> float:
        """Return their weighted standard deviation."""
        return float(np.sqrt(max(self.weights @ values**2 - self.mean(values) ** 2, 0.0)))


def fit_times(
    times_s: Array,
    numbers: NDArray[np.int64],
    log_rate: float,
    rig: DropSetup,
    *,
    fine: bool = True,
) -> Balls:
    """Fit all balls whose impacts, of these numbers from 0, may have been heard then (3 or more).

    On a grid, refined about the likeliest if `fine`; the evidence is against noises of the
    logarithmic rate `log_rate` [1/s].
    """
    whites = whitenings(times_s, numbers, rig.jitter_s)

    def fitted(
        slopes: tuple[float, float], log_drags: tuple[float, float], counts: tuple[int, int]
    ) -> Balls:
        nodes = priors.nodes(slopes, log_drags, counts, rig.drag_1_m, has_clock=rig.has_clock)
        fits = [BallsByTimes.of(times_s, numbers, nodes, white) for white in whites]
        return Balls.mixed([_weighed(fit, nodes, log_rate, rig) for fit in fits])

    balls = fitted(priors.WHOLE_SLOPE, priors.WHOLE_LOG_DRAG, (18, 12))
    if not fine:
        return balls
    logs = np.log(np.where(balls.drags_1_m > 0, balls.drags_1_m, priors.TYPICAL_DRAG_1_M))
    ends: list[tuple[float, float]] = []
    for values, least_sd in ((balls.slopes, 0.01), (logs, 0.1)):
        middle, reach = balls.mean(values), _REACH_SDS * max(balls.sd(values), least_sd)
        ends.append((middle - reach, middle + reach))
    return fitted(ends[0], ends[1], (25, 25))


def _weighed(fit: BallsByTimes, nodes: priors.Nodes, log_rate: float, rig: DropSetup) -> Balls:
    """Weigh every ball of the grid with every jitter by its evidence."""
    jitters = priors.JITTERS_S
    free = fit.count - 3
    told = WithContacts.of(fit)
    log = nodes.log_prior[:, None] + priors.log_jitter_prior(rig.jitter_s)[None, :]
    scatters = fit.white.ratio_1_s * jitters
    log = log + fit.white.log_prior + priors.log_scatter_prior(scatters)
    log = log + told.log_gains + fit.white.log_size
    log = log - fit.squares[:, None] / (2 * jitters**2) - free * np.log(jitters)
    log = log + 0.5 * np.linalg.slogdet(fit.spread)[1][:, None]
    log -= 0.5 * free * np.log(2 * np.pi) + np.log(priors.FLIGHT_RANGE) + (fit.count - 1) * log_rate
    begin, value = told.middles[..., 0], told.middles[..., 1]
    variance = told.covariances[..., 1, 1]
    off_sds = np.zeros_like(log)
    if rig.height_m is not None:
        tied = _from_height(told, fit.seconds_m_s, nodes, rig)
        value, variance, begin, off_sds, height_log = tied
        log = log + height_log
    weights, evidence = normalised(log)
    rows, columns = np.nonzero(weights > _MIN_BALL_WEIGHT)
    chosen = weights[rows, columns]
    chosen = chosen / chosen.sum()
    return Balls(
        weights=chosen,
        restitutions=value[rows, columns],
        sds=np.sqrt(variance[rows, columns] + 1e-5**2),  # no clock and no table are better
        slopes=nodes.slopes[rows],
        drags_1_m=nodes.drags_1_m[rows],
        jitters_s=jitters[columns],
        scatters=scatters[columns],
        begins=begin[rows, columns],
        contacts_s=told.contacts_s[rows, columns],
        log_evidence=evidence,
        height_sds=float(chosen @ off_sds[rows, columns]),
    )


def _from_height(
    told: WithContacts, seconds_m_s: Array, nodes: priors.Nodes, rig: DropSetup
) -> tuple[Array, Array, Array, Array, Array]:
    """Condition on height and law: the restitution at the first impact, shape (M, J).

    The times tell the speed after the first impact and the restitution at the second; the height
    tells the speed before the first. The law ties all three: one more measurement, in closed form.
    Returned with variances, log speeds after the first impact, how many standard deviations the law
    is off, and the logarithm of what that does to the weights.
    """
    assert rig.height_m is not None
    slopes = nodes.slopes[:, None]
    arrives = fallen_m_s(rig.height_m, nodes.drags_1_m)[:, None]
    height_sd_m = max(0.005 * rig.height_m, 0.003)  # measured by hand
    arrives_sd = 0.5 * height_sd_m / rig.height_m
    begin, kept = told.middles[..., 0], np.maximum(told.middles[..., 1], 0.01)
    # f = log e_2 - p log(v_1 / v_2) - log w_1 + log v_1, which is 0 by the law
    off = np.log(kept) + (1 - slopes) * np.log(arrives) - begin
    off = off + slopes * np.log(seconds_m_s[:, None])
    bent = (seconds_m_s[:, None] / np.exp(begin)) ** 2  # d log v_2 / d log w_1
    by_arrives = 1 - slopes
    row = np.stack([slopes * bent - 1, 1 / kept], axis=-1)
    across = np.einsum("mjab,mjb->mja", told.covariances, row)  # with log w_1 and e_2
    arrives_move = by_arrives * arrives_sd**2
    variance = np.einsum("mja,mja->mj", row, across) + by_arrives * arrives_move
    # log e_1 = log w_1 - log v_1, before and after f = 0 is told
    before = begin - np.log(arrives)
    covariance = across[..., 0] - arrives_move
    log_value = before - covariance / variance * off
    own = told.covariances[..., 0, 0] + arrives_sd**2
    log_variance = np.maximum(own - covariance**2 / variance, 0.0)
    value = np.exp(log_value)
    begins = begin - across[..., 0] / variance * off
    # A height may be wrong altogether: Student's t of 2 degrees of freedom.
    likely = -0.5 * (2.0 + 1) * np.log1p(off**2 / variance / 2.0) - 0.5 * np.log(variance)
    return value, value**2 * log_variance, begins, np.abs(off) / np.sqrt(variance), likely


# ---- Ball that was heard: the average over readings, and against rhythms

MAX_TIMES = 60  # that are looked at: by then a ball hardly rises
_MIN_READING_WEIGHT = 1e-4  # a reading with less is left out
_TAILS = (0.025, 0.975)  # probabilities at the ends of an interval


@dataclass(frozen=True)
class ClutterModel:
    """Evidence beside the times."""

    rate_hz: float  # of times that are none of the ball's
    log_odds: float  # of the ball by all else than the times


@dataclass(frozen=True, eq=False)
class HeardBall:
    """Posterior of a ball by its impact times."""

    values: Array  # restitution at the first reported impact, slope, drag [1/m], shape (3,)
    interval95: Array  # shape (3, 2)
    reading: Reading  # the likeliest
    times_s: Array  # of its impacts, as they were heard, shape (N,) [s]
    rig: DropSetup  # what was known
    jitter_s: float  # standard deviation of a time
    scatter: float  # of each impact's own restitution about the law, as a fraction
    contact_s: float  # how long the ball touches the table at each impact
    log_odds: float  # against noises at random times
    # Likeliest rhythm that is no ball's, and a ball's log odds against it.
    rhythm: tuple[str, float]
    height_sds: float  # by how many standard deviations the height contradicts the times
    begin_s: float  # time of the first impact by the values [s]
    leaving_m_s: float  # speed after it
    seconds_s: float  # true seconds in one of the log's: 1, where it has a clock

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

    def with_contacts(self, seconds: Array) -> Array:
        """Convert times of a rollout, which leaves the table at once, to those of the ball [s].

        Each flight takes the contact before it along.
        """
        without = self.contactless_s
        return seconds + np.interp(seconds, without, self.predicted_s - without)

    def _delays_s(self, numbers: NDArray[np.int64]) -> Array:
        """Return the delays by the contacts since the first reported impact."""
        return self.contact_s * (numbers - self.told).astype(np.float64)

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
            lasted = np.diff([known[number - 1], known[number], known[number + 1]])
            lasted = np.maximum(lasted - self.contact_s, lasted / 2)
            before, after = leaving_speeds(lasted * self.seconds_s, drag_1_m)
            arrives = float(_arriving(before, drag_1_m))
            value = float(after) / arrives
            # What the drag's interval leaves open, and what the jitter of three times makes.
            open_sd = float(np.ptp(after / _arriving(before, self.interval95[2]))) / (2 * TWO_SIDED)
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


def _arriving(leaving_m_s: float, drag_1_m: Array | float) -> Array:
    """Return the speeds at the end of flights that begin with this speed [m/s]."""
    reach = leaving_m_s * np.sqrt(np.maximum(drag_1_m, 0.0) / GRAVITY_M_S2)
    return leaving_m_s / np.hypot(1.0, reach)


def heard_ball(
    times_s: Array, rig: DropSetup, besides: ClutterModel | None = None
) -> HeardBall | None:
    """Average over readings and balls that may have been heard; None where no ball explains any.

    Of more than `MAX_TIMES` rising times [s] the first; `besides` only where more than times was
    heard.
    """
    times_s = times_s[:MAX_TIMES]
    if len(times_s) < 3:
        return None
    seconds_s = 1.0
    if not rig.has_clock:  # only the drag needs them: the longest flight goes 0.4 m up, as is usual
        longest_s = float(np.quantile(np.diff(times_s), 0.9))
        seconds_s = 2 * float(np.sqrt(2 * 0.4 / GRAVITY_M_S2)) / longest_s
    clock = times_s * seconds_s
    log_rate = float(np.log(noise_rate_hz(clock) if besides is None else besides.rate_hz))
    heightless = replace(rig, height_m=None)  # it tells nothing of which time is an impact
    # Most have one that stands out.
    tried = [
        (one, fit_times(clock[one.heard], one.numbers[one.heard], log_rate, heightless, fine=False))
        for one in readings(clock, 8)
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
        if weight > _MIN_READING_WEIGHT
    ]
    reading = tried[best][0]
    balls = chosen[sum(weights[:best] > _MIN_READING_WEIGHT)][1]
    of_balls = balls.restitutions, balls.slopes, balls.drags_1_m
    values = np.array([balls.mean(one) for one in of_balls])
    values[0] = min(values[0], 1.0)
    if values[0] <= 0:  # the best of all balls would not leave the table
        return None
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
    odds: float, tried: tuple[Reading, Balls], clock_s: Array, besides: ClutterModel | None
) -> float:
    """Return the log odds against noises at random times."""
    if besides is None:
        return odds - float(np.log(len(clock_s)))
    reading, balls = tried
    heard = len(reading.heard)
    missed = reading.missed * np.log(MISSED) + heard * np.log1p(-MISSED)
    return balls.log_evidence + float(missed) + besides.log_odds


def _against_rhythms(
    clock_s: Array, reading: Reading, log_rate: float, rig: DropSetup
) -> tuple[str, float]:
    """Return the best rhythm of these impacts, or of all times, and a ball's log odds over it."""
    heard = reading.heard
    times_s, numbers = clock_s[heard], reading.numbers[heard]
    prior = reading.log_prior(clock_s)
    ball = fit_times(times_s, numbers, log_rate, rig).log_evidence + prior
    every = Reading(np.arange(len(clock_s)), 0.0)
    of_same = best_rhythm(times_s, numbers, log_rate, rig.jitter_s)
    of_every = best_rhythm(clock_s, every.numbers, log_rate, rig.jitter_s)
    tried = [(of_same, prior), (of_every, every.log_prior(clock_s))]
    rhythms = [(name, evidence + log) for (name, evidence), log in tried]
    best, most = max(rhythms, key=lambda one: one[1])
    return best, ball - most


def _flown(count: int, leaving_m_s: float, values: Array, rig: DropSetup) -> FlightTimes:
    """Return the flights of one ball, shape (count + 1, 1)."""
    restitution, slope, drag_1_m = (np.array([one]) for one in values.tolist())
    if rig.height_m is not None:  # from the law's value at the first impact to that at the second
        arrives = leaving_m_s / np.maximum(restitution, 1e-3)
        second = flights(1, np.array([leaving_m_s]), restitution, slope, drag_1_m).arriving_m_s[1]
        restitution = restitution * (second / arrives) ** -slope
    return flights(count, np.array([leaving_m_s]), restitution, slope, drag_1_m)


def _held(
    clock_s: Array, reading: Reading, values: Array, balls: Balls, rig: DropSetup
) -> tuple[float, float]:
    """Fit first impact [s] and speed after it [m/s] by Gauss-Newton, with the values held."""
    numbers = reading.numbers[reading.heard]
    log_speed = float(np.clip(balls.mean(balls.begins), *_LOG_SPEEDS))
    short, begin_s = 1e-6, float(clock_s[0])
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
        begin_s += float(step[0])
        log_speed = float(np.clip(log_speed + np.clip(step[1], -1, 1), *_LOG_SPEEDS))
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
    for _ in range(24):  # of a bracket of about 1 around a quantile
        middle = (low + high) / 2
        below = float(weights @ ndtr((middle - middles) / sds)) < probability
        low, high = (middle, high) if below else (low, middle)
    return (low + high) / 2
