"""Measure payload errors and interval coverage on logs like a real driver's.

Arms, drivers and payloads are drawn; torques come from the engine's inverse dynamics, the fit's
from Pinocchio. Each log goes the whole way of `tunenet-tune`: nothing of the disturbances is given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from analysis.processes import Piece, parallel_map
from analysis.selection import Options, Selection
from analysis.tuning import tune_episode
from recorders.simulators.arm.description import Payload, jaco
from recorders.simulators.arm.disturbances import (
    REAL_ARM,
    Disturbances,
    DisturbanceScales,
    drawn,
    through_kinovas_driver,
)
from recorders.simulators.arm.driver import driver_episode
from recorders.simulators.arm.path import circle, random_path
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import Progress

# Logs are drawn from these and a seed; whatever was chosen was chosen on seeds below 100 000.
TEST_SEEDS = 5_000_000

ARMS = 1_000  # arms, with their disturbances, that belong to each seed of the command
MAX_KG = 1.0  # of a payload: the range of the paper's training
MAX_OFFSET_M = 0.03  # of its centre from the gripper's, along each axis
# Samples of the motion, its duration, and messages where noise is the only disturbance.
_PATH_HZ, _SECONDS, _NOISE_RATE_HZ = 500.0, 5.2, 60.0

_OF_SD = float(np.sqrt(2 / np.pi))  # mean absolute value of a Gaussian over its standard deviation
_PORTION = 10  # logs in a piece of work: few, so that the processes end together


@dataclass(frozen=True)
class LogCase:
    """Kind of log, a line of the table.

    Attributes:
        noise_nm: white noise of the torques alone; None for all disturbances of a real driver.
        is_off_centre: whether the payload's centre is drawn too.
        share: of the sizes of `REAL_ARM` that disturbances are drawn with.
        rate_hz: of the driver's messages.
    """

    label: str
    is_circle: bool
    has_tare: bool = False
    noise_nm: float | None = None
    is_off_centre: bool = False
    rate_hz: float = 65.0
    share: float = 1.0


CASES = (
    LogCase("noise of 0.05 N·m alone, circle", True, noise_nm=0.05),
    LogCase("noise of 0.2 N·m alone, circle", True, noise_nm=0.2),
    LogCase("noise of 0.5 N·m alone, circle", True, noise_nm=0.5),
    LogCase("driver, circle", True),
    LogCase("driver, any motion", False),
    LogCase("driver, circle, half as large", True, share=0.5),
    LogCase("driver, any motion, half as large", False, share=0.5),
    LogCase("driver, circle, tare", True, has_tare=True),
    LogCase("driver, any motion, tare", False, has_tare=True),
    LogCase("driver at 10 Hz, circle", True, rate_hz=10.0),
    LogCase("driver, circle, tare, off centre", True, has_tare=True, is_off_centre=True),
    LogCase("driver, any motion, tare, off centre", False, has_tare=True, is_off_centre=True),
)


@dataclass(frozen=True)
class LogRow:
    """Results of one case; of masses in kg, None where nothing was answered.

    Attributes:
        logs: how many.
        answered: fraction that got a value.
        ok: fraction with that verdict.
        mae: mean absolute error of the answered.
        bound: the same of the best unbiased estimate, under the model that each answer states
            (Cramér and Rao; mean of sd sqrt(2 / pi)).
        secant: mean absolute error of the line through two rollouts.
        held: fraction of the intervals of the answered that contain the truth, shown or not.
        width: their median width.
        told: fraction of the answered whose centre of mass is reported.
        centre_mm: mean absolute errors of it along x, y, z of the tool.
        told_mae: mean absolute error of the mass where it is.
    """

    case: LogCase
    logs: int
    answered: float
    ok: float
    mae: float | None
    bound: float | None
    secant: float | None
    held: float | None
    width: float | None
    told: float | None
    centre_mm: tuple[float, float, float] | None
    told_mae: float | None


def log_rows(
    seeds: Sequence[int], count: int, jobs: int | None, progress: Progress
) -> list[LogRow]:
    """Tune every case on `count` logs in all, in equal shares of the seeds."""
    share = -(-count // len(seeds))
    numbers = [seed * ARMS + one for seed in seeds for one in range(share)][:count]
    pieces = [
        Piece((case, tuple(numbers[at : at + _PORTION])), len(numbers[at : at + _PORTION]), "")
        for case in CASES
        for at in range(0, len(numbers), _PORTION)
    ]
    done = parallel_map(_tuned, pieces, jobs, progress, ("payloads", "log"))
    rows = []
    for case in CASES:
        parts = [one for piece, one in zip(pieces, done, strict=True) if piece.item[0] == case]
        rows.append(row_of(case, np.concatenate(parts)))
    return rows


def row_of(case: LogCase, found: Array) -> LogRow:
    """Compute a line from what `_tuned` gives, shape (N, 13)."""
    answered = found[np.isfinite(found[:, 1])]
    truth, value, low, high, bound, secant = answered[:, :6].T
    centred = answered[np.isfinite(answered[:, 7])]
    off_mm = 1000 * np.abs(centred[:, 7:10] - centred[:, 10:13])
    error = np.abs(value - truth)
    x, y, z = (_mean(one) or 0.0 for one in off_mm.T)
    return LogRow(
        case=case,
        logs=len(found),
        answered=len(answered) / len(found),
        ok=float(np.mean(found[:, 6])),
        mae=_mean(error),
        bound=_mean(_OF_SD * bound),
        secant=_mean(np.abs(secant - truth)),
        held=_mean((low <= truth) & (truth <= high)),
        width=float(np.median(high - low)) if len(answered) else None,
        told=len(centred) / len(answered) if len(answered) else None,
        centre_mm=(x, y, z) if len(centred) else None,
        told_mae=_mean(np.abs(centred[:, 1] - centred[:, 0])),
    )


def _mean(values: NDArray) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _tuned(work: tuple[LogCase, tuple[int, ...]]) -> Array:
    """Return a row a log: truth, value, interval, bound, secant, ok, centre found, centre true."""
    case, numbers = work
    return np.array([_tuned_one(case, number) for number in numbers])


def _tuned_one(case: LogCase, number: int) -> list[float]:
    arm, seed = jaco(), TEST_SEEDS + number
    rng = np.random.default_rng([seed, 0xBE])
    mass_kg = float(rng.uniform(0, MAX_KG))
    x, y, z = (rng.uniform(-MAX_OFFSET_M, MAX_OFFSET_M, 3) * case.is_off_centre).tolist()
    path = circle if case.is_circle else lambda *when: random_path(arm, seed, *when)
    moved = path(_PATH_HZ, _SECONDS)
    sizes = DisturbanceScales(
        **{
            item.name: getattr(REAL_ARM, item.name) * case.share
            for item in fields(DisturbanceScales)
            if item.name not in ("torque_noise_nm", "most_lag_s", "friction_opposes")
        }
    )
    disturbances = through_kinovas_driver(drawn(seed, arm, sizes), case.rate_hz)
    if case.noise_nm is not None:
        disturbances = Disturbances(
            torque_noise_nm=case.noise_nm, rate_hz=_NOISE_RATE_HZ, noise_seed=2 * seed
        )
    tares = [driver_episode(arm, moved, None, disturbances.another_run())] * case.has_tare
    episode = driver_episode(arm, moved, Payload(mass_kg, (x, y, z)), disturbances)
    tuning = tune_episode(episode, Options(task="payload", selection=Selection(tares=tuple(tares))))
    nothing = float("nan")
    fit = tuning.trace.fit if tuning.trace else None
    if tuning.estimate is None or fit is None:
        return [mass_kg, *[nothing] * 5, 0.0, *[nothing] * 3, x, y, z]
    low, high = fit.interval95[0]
    centre = fit.extra[0].values if fit.extra else [nothing] * 3
    secant = nothing if tuning.cross_check is None else tuning.cross_check.value
    ok = float(tuning.verdict == "ok")
    bound = fit.detail.bound_kg
    value = float(tuning.estimate[0])
    return [mass_kg, value, low, high, bound, secant, ok, *centre, x, y, z]
