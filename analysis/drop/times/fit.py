"""Posterior of a ball by its impact times: restitution, slope and drag, on a grid.

For every slope and drag of the grid the time of the first impact, the speed after it and the
restitution at the second are fitted by least squares; likelihood, priors and the unknown jitter
of the times weigh them. A ball stays on the table for a moment at each impact: how long is one
more unknown, in closed form. With the drop height the first impact's restitution follows too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from analysis.drop.times import impact_prior as priors
from analysis.drop.times.contacts import WithContacts
from analysis.drop.times.flight_times import fallen_m_s
from analysis.drop.times.least_squares import BallsByTimes, whitenings
from tunenet_logs.arrays import Array

# By how much a height may be off that was measured by hand: a fraction, and a length [m].
HEIGHT_SD, MIN_HEIGHT_SD_M = 0.005, 0.003

_FREEDOM = 2.0  # of the height's distribution
# Cells of the grid, first over all balls, then about what is likely, so many sds to a side.
_ROUGH, _FINE, _REACH_SDS = (18, 12), (25, 25), 4.5

_MIN_SD = 1e-5  # of a restitution: no clock and no table are better
FLIGHT_RANGE = float(np.log(100.0))  # of the log duration of a first flight, before it is heard
_NEGLIGIBLE = 1e-6  # weight of a ball that is left away


@dataclass(frozen=True)
class Rig:
    """Knowledge of ball, drop and clock beside the times.

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
        return max(HEIGHT_SD * (self.height_m or 0.0), MIN_HEIGHT_SD_M)


@dataclass(frozen=True, eq=False)
class Balls:
    """Weighted samples of balls that may have made the times: slope, drag, jitter; shape (M,) each.

    Attributes:
        weights: adding up to 1.
        restitutions: at the first impact where it can be determined: the second that is heard, or
            the first with a known height.
        sds: of them.
        slopes: p.
        drags_1_m: likewise.
        jitters_s: of the times.
        scatters: of each impact's own restitution about the law, as a fraction.
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
    scatters: Array
    begins: Array
    contacts_s: Array
    log_evidence: float
    height_sds: float

    @classmethod
    def mixed(cls, parts: Sequence[Balls]) -> Balls:
        """Mix several parts, each with its evidence."""
        logs = np.array([one.log_evidence for one in parts])
        shares = np.exp(logs - logs.max())
        log_evidence = float(logs.max() + np.log(shares.sum()))
        shares /= shares.sum()
        kept = [
            (one, share) for one, share in zip(parts, shares, strict=True) if share > _NEGLIGIBLE
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
    times_s: Array, numbers: NDArray[np.int64], log_rate: float, rig: Rig, *, fine: bool = True
) -> Balls:
    """Fit all balls whose impacts may have been heard at these times, on a grid.

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

    def fitted(nodes: priors.Nodes) -> Balls:
        whites = whitenings(times_s, numbers, rig.jitter_s)
        fits = [BallsByTimes.of(times_s, numbers, nodes, white) for white in whites]
        return Balls.mixed([_weighed(fit, nodes, log_rate, rig) for fit in fits])

    balls = fitted(nodes)
    if not fine:
        return balls
    positive = balls.drags_1_m > 0
    logs = np.log(np.where(positive, balls.drags_1_m, priors.TYPICAL_DRAG_1_M))
    ends = [_about(balls, balls.slopes, 0.01), _about(balls, logs, 0.1)]
    nodes = priors.nodes(ends[0], ends[1], _FINE, rig.drag_1_m, has_clock=rig.has_clock)
    return fitted(nodes)


def _about(balls: Balls, values: Array, least_sd: float) -> tuple[float, float]:
    middle, sd = balls.mean(values), max(balls.sd(values), least_sd)
    return middle - _REACH_SDS * sd, middle + _REACH_SDS * sd


def _weighed(fit: BallsByTimes, nodes: priors.Nodes, log_rate: float, rig: Rig) -> Balls:
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
        sds=np.sqrt(variance[rows, columns] + _MIN_SD**2),
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
    told: WithContacts, seconds_m_s: Array, nodes: priors.Nodes, rig: Rig
) -> tuple[Array, Array, Array, Array, Array]:
    """Condition on height and law: the restitution at the first impact, shape (M, J).

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
