"""Measure payload errors on arms that share no code and no constants with the fit.

The same logs go to what a roboticist would write instead, and to the Cramér-Rao bound. Each log
goes the whole way of `tunenet-tune`, without its tare and with it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from analysis.evaluation.payload.baselines import bound_kg, least_squares, tare_subtracted
from analysis.evaluation.payload.stranger_arm import (
    CLEAN,
    FULL,
    LIGHT,
    Troubles,
    described_arm,
    stranger_log,
)
from analysis.payload.torque_model import Convention
from analysis.processes import Piece, parallel_map
from analysis.selection import Options, Selection
from analysis.tuning import tune_episode
from recorders.simulators.arm.description import JACO_TOOL_LINK, JACO_URDF
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode
from tunenet_logs.terminal import Progress

# Logs are drawn from these and on; whatever was chosen was chosen on seeds up to 1000.
STRANGER_SEEDS = 9_000_000

# Logs that belong to each seed of the command: as many as it can be asked for.
LOGS_OF_A_SEED = 100_000

# What a stranger's driver means by torque: the joint's, with the arm's weight.
PLAIN = Convention(1, True)

# An answer that is `ok` and further off than this many halves of its interval misleads.
_FAR_HALF_WIDTHS = 3.0

_OF_SD = float(np.sqrt(2 / np.pi))  # mean absolute value of a Gaussian over its standard deviation
_G = 1000.0  # grams in a kilogram
PORTION = 5  # logs in a piece of work: few, so that the processes end together


@dataclass(frozen=True)
class StrangerCase:
    """Cell of arms with the same troubles.

    Attributes:
        label: in words.
        troubles: of the arms.
        size: of the troubles, by what the label stands for.
    """

    label: str
    troubles: Troubles
    size: float = 1.0

    @property
    def sized(self) -> Troubles:
        """Troubles at this size."""
        return self.troubles.times(self.size)


# The last seven have one trouble alone, beside the noise of the first.
STRANGER_CASES = (
    StrangerCase("clean", CLEAN),
    *(
        StrangerCase(label, troubles, size)
        for label, troubles in (("light", LIGHT), ("full", FULL))
        for size in (0.5, 1.0, 2.0)
    ),
    StrangerCase("tilt of 1.5 degrees", Troubles(tilt_rad=float(np.radians(1.5)))),
    StrangerCase("drift", Troubles(drift=0.008, warming=0.004)),
    StrangerCase("encoders' zeros", Troubles(zero_rad=float(np.radians(0.5)))),
    StrangerCase("rotors", Troubles(rotor_kg_m2=0.5)),
    StrangerCase("friction", Troubles(dry=0.03, viscous=0.03, load=0.04)),
    StrangerCase("ripple and hoses", Troubles(ripple=0.008, hoses=0.01)),
    StrangerCase(
        "links", Troubles(link_mass=0.04, link_centre_m=0.003, link_inertia=0.1, gain=0.015)
    ),
)


@dataclass(frozen=True)
class StrangerAnswer:
    """Answer of `tunenet-tune` on a log.

    Attributes:
        mass_kg: its value.
        low_kg: lower end of its 95 % interval, whether a user is shown it or not.
        high_kg: the upper end.
        is_ok: whether that is its verdict; else it is suspect.
        convention: what it takes the driver's torques for.
    """

    mass_kg: float
    low_kg: float
    high_kg: float
    is_ok: bool
    convention: Convention


@dataclass(frozen=True)
class StrangerResult:
    """All answers on one log, and the truth.

    Attributes:
        truth_kg: the mass.
        least_squares_kg: its value, without the tare.
        tare_subtracted_kg: its value, with the tare.
        bounds_kg: standard deviations of the mass, without and with the tare.
        answers: without and with the tare; None where the log is rejected.
    """

    truth_kg: float
    least_squares_kg: float
    tare_subtracted_kg: float
    bounds_kg: tuple[float, float]
    answers: tuple[StrangerAnswer | None, StrangerAnswer | None]


@dataclass(frozen=True)
class Rival:
    """Baseline on the logs that were answered.

    Attributes:
        mae_g: mean absolute error.
        standing: where ours is: "ahead" or "behind" of it by more than a standard error of the
            paired difference, else "level".
    """

    mae_g: float
    standing: str


@dataclass(frozen=True)
class StrangerRow:
    """Cell without the tares, or with them; None where nothing was answered.

    Attributes:
        case: which cell.
        has_tare: whether each log was tuned with its tare.
        logs: how many.
        answered: fraction that was not rejected; what follows is of these, but for `ok`.
        ok: fraction of all with that verdict.
        mae_g: mean absolute error.
        mae_sd_g: standard error of it.
        median_g: of the absolute errors.
        worst_g: of them.
        bound_g: mean absolute error at the Cramér-Rao bound of noise alone.
        least_squares: the baseline that needs no tare.
        tare_subtracted: the baseline that needs one.
        held: fraction of the intervals that contain the truth.
        width_g: their median width.
        far_ok: fraction of all logs that are ok and further off than three half widths.
        wrong_ok: logs that are ok and whose convention is not what the driver means.
    """

    case: StrangerCase
    has_tare: bool
    logs: int
    answered: float
    ok: float
    mae_g: float | None
    mae_sd_g: float | None
    median_g: float | None
    worst_g: float | None
    bound_g: float | None
    least_squares: Rival | None
    tare_subtracted: Rival | None
    held: float | None
    width_g: float | None
    far_ok: float
    wrong_ok: int


def stranger_rows(
    seeds: Sequence[int], count: int, jobs: int | None, progress: Progress
) -> list[StrangerRow]:
    """Run every cell on `count` logs in all, in equal shares of the seeds: two rows each."""
    numbers = stranger_numbers(seeds, count)
    pieces = [
        Piece((case, numbers[at : at + PORTION]), len(numbers[at : at + PORTION]), case.label)
        for case in STRANGER_CASES
        for at in range(0, len(numbers), PORTION)
    ]
    done = parallel_map(_tuned, pieces, jobs, progress, ("strangers", "log"))
    rows = []
    for case in STRANGER_CASES:
        results = [
            result
            for piece, part in zip(pieces, done, strict=True)
            if piece.item[0] == case
            for result in part
        ]
        rows += [stranger_row(case, results, has_tare=has_tare) for has_tare in (False, True)]
    return rows


def stranger_numbers(seeds: Sequence[int], count: int) -> tuple[int, ...]:
    """Return the draw numbers of `count` logs, in equal shares of the command's seeds."""
    share = -(-count // len(seeds))
    numbers = [
        STRANGER_SEEDS + seed * LOGS_OF_A_SEED + one for seed in seeds for one in range(share)
    ]
    return tuple(numbers[:count])


def stranger_result(case: StrangerCase, number: int) -> StrangerResult:
    """Draw a log and run every method on it."""
    log = stranger_log(JACO_URDF, JACO_TOOL_LINK, number, case.sized)
    held, empty = log.held.episode, log.empty.episode
    model = described_arm(JACO_URDF)
    frame = model.getFrameId(JACO_TOOL_LINK)
    return StrangerResult(
        truth_kg=log.mass_kg,
        least_squares_kg=least_squares(model, frame, held),
        tare_subtracted_kg=tare_subtracted(model, frame, held, empty),
        bounds_kg=(bound_kg(log.held, None), bound_kg(log.held, log.empty)),
        answers=(stranger_answer(held, ()), stranger_answer(held, (empty,))),
    )


def stranger_answer(episode: Episode, tares: tuple[Episode, ...]) -> StrangerAnswer | None:
    """Tune a log with the whole of `tunenet-tune`; None where it is rejected."""
    tuning = tune_episode(episode, Options(task="payload", selection=Selection(tares=tares)))
    fit = tuning.trace.fit if tuning.trace else None
    if tuning.estimate is None or fit is None:
        return None
    low_kg, high_kg = fit.interval95[0].tolist()
    is_ok = tuning.verdict == "ok"
    return StrangerAnswer(float(tuning.estimate[0]), low_kg, high_kg, is_ok, fit.detail.convention)


def _tuned(work: tuple[StrangerCase, tuple[int, ...]]) -> list[StrangerResult]:
    case, numbers = work
    return [stranger_result(case, number) for number in numbers]


def stranger_row(
    case: StrangerCase, results: Sequence[StrangerResult], *, has_tare: bool
) -> StrangerRow:
    """Compute the figures of one cell's logs, one or more."""
    logs = [(one, answer) for one in results if (answer := one.answers[has_tare]) is not None]

    def figures(of: Callable[[StrangerResult, StrangerAnswer], float]) -> Array:
        return np.array([of(one, answer) for one, answer in logs], np.float64)

    truth = figures(lambda one, _: one.truth_kg)
    off_g = _G * np.abs(figures(lambda _, answer: answer.mass_kg) - truth)
    low, high = figures(lambda _, answer: answer.low_kg), figures(lambda _, answer: answer.high_kg)
    ok = figures(lambda _, answer: answer.is_ok) > 0
    right = figures(lambda _, answer: answer.convention == PLAIN) > 0
    far = off_g > _FAR_HALF_WIDTHS * _G * (high - low) / 2
    squares_g = _G * np.abs(figures(lambda one, _: one.least_squares_kg) - truth)
    subtracted_g = _G * np.abs(figures(lambda one, _: one.tare_subtracted_kg) - truth)
    return StrangerRow(
        case=case,
        has_tare=has_tare,
        logs=len(results),
        answered=len(logs) / len(results),
        ok=int(np.sum(ok)) / len(results),
        mae_g=_over(np.mean, off_g),
        mae_sd_g=_over(_standard_error, off_g),
        median_g=_over(np.median, off_g),
        worst_g=_over(np.max, off_g),
        bound_g=_over(np.mean, _G * _OF_SD * figures(lambda one, _: one.bounds_kg[has_tare])),
        least_squares=_rival(off_g, squares_g),
        tare_subtracted=_rival(off_g, subtracted_g) if has_tare else None,
        held=_over(np.mean, ((low <= truth) & (truth <= high)).astype(np.float64)),
        width_g=_over(np.median, _G * (high - low)),
        far_ok=int(np.sum(ok & far)) / len(results),
        wrong_ok=int(np.sum(ok & ~right)),
    )


def _over(summary: Callable[[Array], float], values: Array) -> float | None:
    return float(summary(values)) if len(values) else None


def _standard_error(values: Array) -> float:
    """Return the standard error of a mean; 0 for one value, which gives none."""
    return float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0


def _rival(ours_g: Array, theirs_g: Array) -> Rival | None:
    """Compare a baseline's absolute errors with ours on the same logs, both of shape (N,)."""
    if not len(ours_g):
        return None
    lead_g, sd_g = float(np.mean(theirs_g - ours_g)), _standard_error(theirs_g - ours_g)
    standing = "level" if abs(lead_g) <= sd_g else "ahead" if lead_g > 0 else "behind"
    return Rival(float(np.mean(theirs_g)), standing)
