"""Least squares of many balls at once, each of a slope and a drag, to the times heard."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.drop.since_impacts import since_impacts_s
from analysis.drop.times import impact_prior as priors
from analysis.drop.times.flight_times import FlightTimes, flights
from recorders.simulators.base import GRAVITY_M_S2
from tunenet_logs.arrays import Array

_ITERATIONS, _SHORT = 7, 1e-6  # of Gauss and Newton's method, and the step of its derivatives
_TRIED = np.linspace(0.06, 1.1, 209)  # restitutions to begin with


@dataclass(frozen=True, eq=False)
class Whitening:
    """Whitening of the times' residuals: independent, of the size of the jitter.

    An impact that returns more than the law says makes all later flights longer.

    Attributes:
        rows: lower triangle, shape (N, N).
        log_size: logarithm of its determinant.
        ratio_1_s: scatter of the impacts over the jitter [1/s].
        log_prior: of that ratio.
    """

    rows: Array
    log_size: float
    ratio_1_s: float
    log_prior: float = 0.0

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
    """Least-squares fits of every ball of a grid.

    Attributes:
        unknowns: time of the first impact [s], log speed after it [m/s], restitution at the second;
            shape (M, 3), of balls that touch the table for the usual time.
        spread: of them, for a jitter of 1 s, shape (M, 3, 3).
        squares: sum of the squared residuals, shape (M,) [s²].
        leans: change of the unknowns with longer contacts, shape (M, 3) [1/s].
        across: sum of the residuals times what a contact of 1 s more makes of them, shape (M,) [s].
        bends: sum of the squares of the latter, shape (M,).
        white: what made the residuals independent.
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
    white: Whitening

    @classmethod
    def of(
        cls,
        times_s: Array,
        numbers: NDArray[np.int64],
        nodes: priors.Nodes,
        white: Whitening,
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
