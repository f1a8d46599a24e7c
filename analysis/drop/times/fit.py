"""What impact times say of a ball: restitution, slope and drag, each with its 95 % interval.

For every slope and drag of a grid the time of the first impact, the speed after it and the
restitution at the second are fitted by least squares; likelihood, priors and the unknown jitter of
the times weigh them. A ball stays on the table for a moment at each impact: how long it does is one
more unknown, in closed form. With the height of the drop the restitution at the first impact
follows too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.drop.times import impact_prior as priors
from analysis.drop.times.flight_times import FlightTimes, fallen_m_s, flights
from recorders.simulators.base import GRAVITY_M_S2
from tunenet_logs.arrays import Array

HEIGHT_SD, LEAST_HEIGHT_SD_M = 0.005, 0.003
"""By how much a height may be off that was measured by hand: a fraction, and a length [m]."""

CONTACT_S, CONTACT_SD_S, CONTACTS_S = 0.002, 0.003, (0.0, 0.009)
"""How long a ball touches the table: a steel ball .2 ms, a soft one 8 ms."""

BOUNCE_SCATTER = 0.002
"""Standard deviation of each impact's own restitution about the law, as a fraction."""

_FREEDOM = 2.0
"""Of the height's distribution."""

_ROUGH, _FINE, _REACH_SDS = (18, 12), (25, 25), 4.5
"""Cells of the grid, first over all balls, then about what is likely, so many sds to a side."""

_ITERATIONS, _SHORT = 7, 1e-6
"""Of Gauss and Newton's method, and the step of its derivatives."""

_LEAST_SD = 1e-5
"""Of a restitution: no clock and no table are better."""

FLIGHT_RANGE = float(np.log(100.0))
"""Of the log duration of a first flight, before it is heard."""

_NEGLIGIBLE = 1e-6
"""Weight of a ball that is left away."""

_TRIED = np.linspace(0.06, 1.1, 209)
"""Restitutions to begin with."""


@dataclass(frozen=True)
class Rig:
    """What is known beside the times.

    Attributes:
        drag_1_m: of the ball; None where it is not known.
        height_m: of the drop whose first impact is heard first; None where it is not known.
        has_clock: whether the seconds are true.
        jitter_s: usual standard deviation of a time.
    """

    drag_1_m: float | None = None
    height_m: float | None = None
    has_clock: bool = True
    jitter_s: float = priors.TRIGGER_JITTER_S

    @property
    def height_sd_m(self) -> float:
        """Standard deviation of the height."""
        return max(HEIGHT_SD * (self.height_m or 0.0), LEAST_HEIGHT_SD_M)


@dataclass(frozen=True, eq=False)
class Balls:
    """Balls that may have made the times, each of a slope, a drag and a jitter; shape (M,) each.

    Attributes:
        weights: adding up to 1.
        restitutions: at the first impact that can be told: the second that is heard, or the first
            where the height is known.
        sds: of them.
        slopes: p.
        drags_1_m: likewise.
        jitters_s: of the times.
        begins: log speed after the first impact [m/s].
        contacts_s: how long each touches the table.
        log_evidence: of all together, against noises: see `fit_times`.
        height_sds: by how many standard deviations the law's first rebound is off from what the
            height asks for; 0 without a height.
    """

    weights: Array
    restitutions: Array
    sds: Array
    slopes: Array
    drags_1_m: Array
    jitters_s: Array
    begins: Array
    contacts_s: Array
    log_evidence: float
    height_sds: float

    def mean(self, values: Array) -> float:
        """Of values of the balls, shape (M,)."""
        return float(self.weights @ values)

    def sd(self, values: Array) -> float:
        """Standard deviation of them."""
        return float(np.sqrt(max(self.weights @ values**2 - self.mean(values) ** 2, 0.0)))


def fit_times(
    times_s: Array, numbers: NDArray[np.int64], log_rate: float, rig: Rig, *, fine: bool = True
) -> Balls:
    """All balls whose impacts may have been heard at these times.

    Args:
        times_s: of the impacts, shape (N,), N at least 3 [s].
        numbers: of the impacts, the first 0, shape (N,).
        log_rate: logarithm of the density of noises' times [1/s], by which the evidence is divided.
        rig: what is known.
        fine: whether the grid is refined about the likeliest.
    """
    nodes = priors.nodes(
        priors.WHOLE_SLOPE,
        priors.WHOLE_LOG_DRAG,
        _ROUGH,
        rig.drag_1_m,
        has_clock=rig.has_clock,
    )
    white = Whitening.of(times_s, numbers, rig)
    balls = _weighed(_Fit.of(times_s, numbers, nodes, white), nodes, log_rate, rig)
    if not fine:
        return balls
    positive = balls.drags_1_m > 0
    logs = np.log(np.where(positive, balls.drags_1_m, priors.USUAL_DRAG_1_M))
    ends = [_about(balls, balls.slopes, 0.01), _about(balls, logs, 0.1)]
    nodes = priors.nodes(ends[0], ends[1], _FINE, rig.drag_1_m, has_clock=rig.has_clock)
    return _weighed(_Fit.of(times_s, numbers, nodes, white), nodes, log_rate, rig)


def _about(balls: Balls, values: Array, least_sd: float) -> tuple[float, float]:
    middle, sd = balls.mean(values), max(balls.sd(values), least_sd)
    return middle - _REACH_SDS * sd, middle + _REACH_SDS * sd


@dataclass(frozen=True, eq=False)
class Whitening:
    """Makes residuals of the times independent, of the size of the jitter.

    An impact that returns more than the law says makes all later flights longer. How much that is
    beside the jitter is taken from the usual jitter.

    Attributes:
        rows: lower triangle, shape (N, N).
        log_size: logarithm of its determinant.
    """

    rows: Array
    log_size: float

    @classmethod
    def of(cls, times_s: Array, numbers: NDArray[np.int64], rig: Rig) -> Whitening:
        """Of the times that were heard."""
        every = np.interp(np.arange(numbers.max() + 1), numbers, times_s)
        later_s = np.maximum(times_s[:, None] - every[None, 1:-1], 0.0)
        spread = np.eye(len(times_s)) + (BOUNCE_SCATTER / rig.jitter_s) ** 2 * later_s @ later_s.T
        rows = np.linalg.inv(np.linalg.cholesky(spread))
        return cls(rows, float(np.log(np.diag(rows)).sum()))


@dataclass(frozen=True, eq=False)
class _Fit:
    """Least squares of every ball of a grid.

    Attributes:
        unknowns: time of the first impact [s], log speed after it [m/s], restitution at the second;
            shape (M, 3), of balls that touch the table for the usual time.
        spread: of them, for a jitter of 1 s, shape (M, 3, 3).
        squares: sum of the squared residuals, shape (M,) [s²].
        leans: change of the unknowns with longer contacts, shape (M, 3) [1/s].
        across: sum of the residuals times what a contact of 1 s more makes of them, shape (M,) [s].
        bends: sum of the squares of the latter, shape (M,).
        log_size: see `Whitening`.
        seconds_m_s: speed of the second impact, shape (M,).
        count: N, of the times.
    """

    unknowns: Array
    spread: Array
    squares: Array
    leans: Array
    across: Array
    bends: Array
    seconds_m_s: Array
    count: int
    log_size: float

    @classmethod
    def of(
        cls,
        times_s: Array,
        numbers: NDArray[np.int64],
        nodes: priors.Nodes,
        white: Whitening,
    ) -> _Fit:
        """Gauss-Newton for all balls at once, from the ball without air that fits best."""
        count = int(numbers.max())

        def flown(begin: Array, kept: Array) -> FlightTimes:
            return flights(count, np.exp(begin), kept, nodes.slopes, nodes.drags_1_m)

        longer = numbers.astype(np.float64)  # each contact before a time delays it
        times_s = times_s - CONTACT_S * longer
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
            jacobian = np.stack(
                [
                    np.ones_like(hits),
                    (flown(begin + _SHORT, kept).impacts_s[numbers] - hits) / _SHORT,
                    (flown(begin, kept + _SHORT).impacts_s[numbers] - hits) / _SHORT,
                ],
                axis=-1,
            )
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
            moves[:, 1:] = np.clip(moves[:, 1:], -0.15, 0.15)
            unknowns = unknowns + moves
            unknowns[:, 2] = np.clip(unknowns[:, 2], 0.01, 1.3)
        across, bends = (first * left).sum(axis=0), (left**2).sum(axis=0)
        squares = (first**2).sum(axis=0)
        return cls(
            unknowns, spread, squares, leans, across, bends, seconds, len(times_s), white.log_size
        )


def ideal_ball(times_s: Array, numbers: NDArray[np.int64]) -> Array:
    """The best ball without air and slope: first impact [s], log speed [m/s], restitution."""
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


@dataclass(frozen=True, eq=False)
class _Told:
    """What a fit tells of every ball with every jitter, contacts averaged over.

    Attributes:
        middles: log speed after the first impact [m/s] and restitution at the second, shape
            (M, J, 2).
        covariances: of them, shape (M, J, 2, 2).
        contacts_s: how long the ball touches the table, shape (M, J).
        log_gains: what the contacts add to the logarithm of the evidence, shape (M, J).
    """

    middles: Array
    covariances: Array
    contacts_s: Array
    log_gains: Array

    @classmethod
    def of(cls, fit: _Fit) -> _Told:
        """What a contact changes is linear, and its prior a part of a normal distribution."""
        jitters = priors.JITTERS_S
        sharpness = fit.bends[:, None] / jitters**2 + CONTACT_SD_S**-2
        pull = fit.across[:, None] / jitters**2
        sd = sharpness**-0.5
        ends = np.array(CONTACTS_S) - CONTACT_S
        log_share, longer_s, variance = _cut_normal(pull / sharpness, sd, *ends)
        leans = fit.leans[:, None, 1:]
        own = jitters[:, None, None] ** 2 * fit.spread[:, None, 1:, 1:]
        shared = leans[..., :, None] * leans[..., None, :] * variance[..., None, None]
        gains = 0.5 * pull**2 / sharpness + np.log(sd / CONTACT_SD_S) + log_share
        return cls(
            fit.unknowns[:, None, 1:] + leans * longer_s[..., None],
            own + shared,
            CONTACT_S + longer_s,
            gains,
        )


def _cut_normal(middle: Array, sd: Array, low: float, high: float) -> tuple[Array, Array, Array]:
    """Logarithm of a normal distribution's share between two ends, mean and variance there."""
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


def _weighed(fit: _Fit, nodes: priors.Nodes, log_rate: float, rig: Rig) -> Balls:
    """Every ball of the grid with every jitter, by the evidence of each."""
    jitters = priors.JITTERS_S
    free = fit.count - 3
    told = _Told.of(fit)
    log = nodes.log_prior[:, None] + priors.log_jitter_prior(rig.jitter_s)[None, :]
    log = log + told.log_gains + fit.log_size
    log = log - fit.squares[:, None] / (2 * jitters**2) - free * np.log(jitters)
    log = log + 0.5 * np.linalg.slogdet(fit.spread)[1][:, None]
    log -= 0.5 * free * np.log(2 * np.pi) + np.log(FLIGHT_RANGE) + (fit.count - 1) * log_rate
    begin, value = told.middles[..., 0], told.middles[..., 1]
    variance = told.covariances[..., 1, 1]
    off_sds = np.zeros_like(log)
    if rig.height_m is not None:
        value, variance, begin, off_sds, height_log = _from_height(
            told, fit.seconds_m_s, nodes, rig
        )
        log = log + height_log
    most = log.max()
    weights = np.exp(log - most)
    evidence = float(most + np.log(weights.sum()))
    weights /= weights.sum()
    rows, columns = np.nonzero(weights > _NEGLIGIBLE)
    chosen = weights[rows, columns]
    chosen = chosen / chosen.sum()
    return Balls(
        weights=chosen,
        restitutions=value[rows, columns],
        sds=np.sqrt(variance[rows, columns] + _LEAST_SD**2),
        slopes=nodes.slopes[rows],
        drags_1_m=nodes.drags_1_m[rows],
        jitters_s=jitters[columns],
        begins=begin[rows, columns],
        contacts_s=told.contacts_s[rows, columns],
        log_evidence=evidence,
        height_sds=float(chosen @ off_sds[rows, columns]),
    )


def _from_height(
    told: _Told, seconds_m_s: Array, nodes: priors.Nodes, rig: Rig
) -> tuple[Array, Array, Array, Array, Array]:
    """The restitution at the first impact by height and law, shape (M, J).

    The times tell the speed after the first impact and the restitution at the second; the height
    tells the speed before the first. The law ties all three: one more measurement, in closed form.

    Returns:
        Restitutions, their variances, log speeds after the first impact, how many standard
        deviations the law is off, and the logarithm of what that does to the weights.
    """
    assert rig.height_m is not None
    slopes = nodes.slopes[:, None]
    arrives = fallen_m_s(rig.height_m, nodes.drags_1_m)[:, None]
    arrives_sd = 0.5 * rig.height_sd_m / rig.height_m
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
    square = off**2 / variance  # a height may be wrong altogether: Student's t
    likely = -0.5 * (_FREEDOM + 1) * np.log1p(square / _FREEDOM) - 0.5 * np.log(variance)
    return value, value**2 * log_variance, begins, np.abs(off) / np.sqrt(variance), likely
