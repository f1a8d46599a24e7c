"""Measure payload errors: the paper's table 1, logs like a real driver's, and strangers' arms.

Each log goes the whole way of `tunenet-tune`. The strangers' arms share no code and no constants
with the fit; the same logs go to what a roboticist would write instead, without the tare and with
it, and to the Cramér-Rao bound.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.estimators.base import Observation, Problem
from tunenet_logs.analysis.estimators.methods import TuneNet
from tunenet_logs.analysis.evaluation.study import csv_text, json_text, seeds_in_words, table_line
from tunenet_logs.analysis.evaluation.worlds.arm import (
    CLEAN,
    FULL,
    LIGHT,
    StrangerRun,
    Troubles,
    described_arm,
    stranger_log,
)
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import Piece, parallel_map
from tunenet_logs.analysis.payload.detection import (
    PAPER_GRAVITY_M_S2,
    PAPER_MASS_KG,
    PAPER_RATE_HZ,
    PAPER_SAMPLES,
    TRAININGS,
    paper_torques,
    payload_readings,
)
from tunenet_logs.analysis.payload.torque_model import CONVENTIONS, Convention
from tunenet_logs.analysis.tunenet.network import Model, train
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array, Episode, median_step
from tunenet_logs.recorders.simulators.arm.description import (
    JACO_TOOL_LINK,
    JACO_URDF,
    Payload,
    jaco,
)
from tunenet_logs.recorders.simulators.arm.path import circle, random_path
from tunenet_logs.recorders.simulators.arm.payload import (
    REAL_ARM,
    TOPIC,
    Disturbances,
    DisturbanceScales,
    PayloadSimulator,
    drawn,
    driver_episode,
    through_kinovas_driver,
)
from tunenet_logs.terminal import Progress

# ---- Baselines: least squares, tare subtraction, and the Cramér-Rao bound.
# The bound is what no unbiased estimate beats where nothing but the sensors' noise, the payload's
# centre and, without a tare, their zeros are unknown.


_SMOOTH_S = 0.35  # of the parabolas whose derivatives are a joint's speed and acceleration
_SLOW_RAD_S = 0.01  # dry friction turns over with a joint's speed, over this


def least_squares(model: Any, frame: int, held: Episode) -> float:
    """Estimate the mass [kg] by least squares, beside offset, viscous and dry friction a joint."""
    seconds, where, effort = _read(held)
    speed, pull, empty = _moved(model, seconds, where)
    per_kg = _rigid(_holding(model, frame, 1.0, np.zeros(3)), where, speed, pull) - empty
    own = (np.ones_like(speed), speed, np.tanh(speed / _SLOW_RAD_S))
    slopes = np.hstack([per_kg.T.reshape(-1, 1), *map(_diagonal, own)])
    return float(_solve(slopes, (effort - empty).T.ravel())[0])


def tare_subtracted(model: Any, frame: int, held: Episode, empty: Episode) -> float:
    """Estimate the mass [kg] and first moments from two runs along one motion."""
    seconds, where, effort = _read(held)
    tare_seconds, tare_where, tare_effort = _read(empty)
    inside = (seconds > tare_seconds[0]) & (seconds < tare_seconds[-1])
    speed, pull, own = _moved(model, seconds, where)
    _, _, tare_own = _moved(model, tare_seconds, tare_where)
    left = tare_effort - tare_own
    there = np.column_stack([np.interp(seconds, tare_seconds, column) for column in left.T])
    base = _rigid(_holding(model, frame, 1.0, np.zeros(3)), where, speed, pull) - own
    columns = [base]
    for axis in np.eye(3):
        moved = _rigid(_holding(model, frame, 1.0, 0.01 * axis), where, speed, pull) - own
        columns.append((moved - base) / 0.01)
    slopes = np.stack([column[inside].T.ravel() for column in columns], axis=1)
    return float(_solve(slopes, (effort - own - there)[inside].T.ravel())[0])


def bound_kg(held: StrangerRun, empty: StrangerRun | None) -> float:
    """Return the Cramér-Rao bound on the mass's standard deviation [kg]; no tare if None."""
    count = held.feels.shape[1]
    precision = np.zeros((4 + count, 4 + count))
    for joint in range(count):
        noise = held.noise_nm[joint]
        zero = np.zeros((len(held.feels), count))
        zero[:, joint] = 1.0
        slopes = np.hstack([held.feels[:, joint], zero]) / noise
        precision += slopes.T @ slopes
        if empty is not None:
            precision[4 + joint, 4 + joint] += len(empty.seconds) / noise**2
    return float(np.sqrt(np.linalg.pinv(precision)[0, 0]))


def _read(episode: Episode) -> tuple[Array, Array, Array]:
    """Return times [s], shape (T,), positions [rad] and torques [N·m], both of shape (T, J)."""
    position = episode.signals["/joint_states.position"]
    effort = episode.signals["/joint_states.effort"]
    seconds = np.asarray(position.stamps_ns * 1e-9, np.float64)
    return seconds, np.array(position.values), np.array(effort.values)


def _moved(model: Any, seconds: Array, where: Array) -> tuple[Array, Array, Array]:
    """Return speeds and accelerations by Savitzky-Golay, and the model's torques, all (T, J)."""
    from scipy.signal import savgol_filter

    step = median_step(seconds)
    window = max(2 * int(_SMOOTH_S / step / 2) + 1, 7)
    speed = np.asarray(savgol_filter(where, window, 3, 1, step, axis=0), np.float64)
    pull = np.asarray(savgol_filter(where, window, 3, 2, step, axis=0), np.float64)
    return speed, pull, _rigid(model, where, speed, pull)


def _rigid(model: Any, where: Array, speed: Array, pull: Array) -> Array:
    """Return inverse dynamics torques [N·m] along a motion, all of shape (T, J)."""
    library, data = import_module("pinocchio"), model.createData()
    rows = zip(where, speed, pull, strict=True)
    return np.array([library.rnea(model, data, *row).copy() for row in rows])


def _holding(model: Any, frame: int, mass_kg: float, centre_m: Array) -> Any:
    """Attach a point mass to the model's hand, at a place of the tool frame, shape (3,)."""
    library, model = import_module("pinocchio"), model.copy()
    mount = model.frames[frame]
    body = library.Inertia(mass_kg, centre_m, np.zeros((3, 3)))
    at = mount.parentJoint
    model.inertias[at] = model.inertias[at] + mount.placement.act(body)
    return model


def _diagonal(column: Array) -> Array:
    """Return a column a joint, over the samples of all joints in turn: (J T, J)."""
    samples, count = column.shape
    block = np.zeros((count * samples, count))
    for joint in range(count):
        block[joint * samples : (joint + 1) * samples, joint] = column[:, joint]
    return block


def _solve(slopes: Array, target: Array) -> Array:
    return np.asarray(np.linalg.lstsq(slopes, target, rcond=None)[0], np.float64)


# ---- Logs like a real driver's: errors, and the coverage of intervals.
# Torques come from the engine's inverse dynamics, the fit's from Pinocchio; nothing of the
# disturbances is given.


# Logs are drawn from these and a seed; whatever was chosen was chosen on seeds below 100 000.
_DRIVER_SEEDS = 5_000_000

ARMS = 1_000  # arms, with their disturbances, that belong to each seed of the command
MAX_KG = 1.0  # of a payload: the range of the paper's training
MAX_OFFSET_M = 0.03  # of its centre from the gripper's, along each axis
# Samples of the motion, its duration, and messages where noise is the only disturbance.
_PATH_HZ, _SECONDS, _NOISE_RATE_HZ = 500.0, 5.2, 60.0

_OF_SD = float(np.sqrt(2 / np.pi))  # mean absolute value of a Gaussian over its standard deviation
_PORTION = 10  # logs in a piece of work: few, so that the processes end together


@dataclass(frozen=True)
class LogCase:
    """Kind of log, a line of the table."""

    label: str
    is_circle: bool
    has_tare: bool = False
    # white noise of the torques alone; None for all disturbances of a real driver
    noise_nm: float | None = None
    is_off_centre: bool = False  # whether the payload's centre is drawn too
    rate_hz: float = 65.0  # of the driver's messages
    share: float = 1.0  # of the sizes of `REAL_ARM` that disturbances are drawn with


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
    """Results of one case; of masses in kg, None where nothing was answered."""

    case: LogCase
    logs: int  # how many
    answered: float  # fraction that got a value
    ok: float  # fraction with that verdict
    mae: float | None  # mean absolute error of the answered
    # the same of the best unbiased estimate, under the model that each answer states (Cramér and
    # Rao; mean of sd sqrt(2 / pi))
    bound: float | None
    secant: float | None  # mean absolute error of the line through two rollouts
    # fraction of the intervals of the answered that contain the truth, shown or not
    held: float | None
    width: float | None  # their median width
    told: float | None  # fraction of the answered whose centre of mass is reported
    # mean absolute errors of it along x, y, z of the tool
    centre_mm: tuple[float, float, float] | None
    told_mae: float | None  # mean absolute error of the mass where it is


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
    done = parallel_map(_tuned_logs, pieces, jobs, progress, ("payloads", "log"))
    rows = []
    for case in CASES:
        parts = [one for piece, one in zip(pieces, done, strict=True) if piece.item[0] == case]
        rows.append(row_of(case, np.concatenate(parts)))
    return rows


def row_of(case: LogCase, found: Array) -> LogRow:
    """Compute a line from what `_tuned_logs` gives, shape (N, 13)."""
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


def _tuned_logs(work: tuple[LogCase, tuple[int, ...]]) -> Array:
    """Return a row a log: truth, value, interval, bound, secant, ok, centre found, centre true."""
    case, numbers = work
    return np.array([_tuned_log(case, number) for number in numbers])


def _tuned_log(case: LogCase, number: int) -> list[float]:
    arm, seed = jaco(), _DRIVER_SEEDS + number
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
    tuning = tune_episode(episode, TuneOptions(task="payload", tares=tuple(tares)))
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


# ---- Table 1 (Allevato et al. 2019): the mass in an arm's gripper.
# Networks learn from masses of 0 to 1 kg; validation targets are as heavy, test targets 1 kg more.


Observe = Callable[[Episode], Observation]

ITERATIONS = 9  # K of the paper's table 1
_MASS_SEEDS = 7_000_000  # targets are drawn from these and a seed; training from the seed alone
# By how much the targets are heavier than what was learnt from [kg].
SETS: Mapping[str, float] = {"validation": 0.0, "test": 1.0}

# Of the masses learnt from; the mean of the targets is as much heavier as they are.
TRAINED_MEAN_KG = sum(PAPER_MASS_KG) / 2

EFFORT = f"{TOPIC}.effort"


@dataclass(frozen=True)
class MassMethod:
    """Method, a row of the table."""

    name: str  # what files call it
    label: str  # what the table calls it
    iterations: int  # K; 0 where nothing is iterated
    # mean absolute errors of the paper on each set [kg]; None where it has none
    paper: tuple[float | None, float | None] = (None, None)
    percent: float | None = None  # the paper's percent on the test set


METHODS = (
    MassMethod("paper", "TuneNet, paper's text", ITERATIONS, (0.011, 0.198), 13.2),
    MassMethod("paper-code", "TuneNet, z-scores", ITERATIONS, (0.011, 0.198), 13.2),
    MassMethod("one", "1 kg for every target", 0, (None, 0.504), 28.0),
    MassMethod("mean", "mean of the targets", 0, (0.25, 0.255), 17.1),
    MassMethod("secant", "secant through two rollouts", 2),
    MassMethod("default-1", "ours", 1),
    MassMethod("default", "ours", ITERATIONS),
)


@dataclass(frozen=True, eq=False)
class MassRow:
    """Errors of a method on one set."""

    method: MassMethod
    which: str
    errors: Array  # absolute errors [kg], shape (seeds, targets)
    percents: Array  # of the target's mass [%], of the same shape


@dataclass(frozen=True)
class MassOrder:
    """Settings of the experiment."""

    seeds: tuple[int, ...]  # each with its own training and targets
    targets: int  # of each set and seed
    jobs: int | None  # processes; None for all cores
    pairs: int | None = None  # of training, in place of the presets'
    epochs: int | None = None  # likewise


def mass_rows(order: MassOrder, progress: Progress) -> list[MassRow]:
    """Run every method on the same targets, every seed in a process of its own."""
    pieces = [Piece((seed, order), 1, f"seed {seed}") for seed in order.seeds]
    done = parallel_map(_one_seed, pieces, order.jobs, progress, ("masses", "seed"))
    rows = []
    for method in METHODS:
        for which in SETS:
            found = np.stack([results[method.name, which] for results in done])
            errors = np.abs(found[:, 0] - found[:, 1])
            rows.append(MassRow(method, which, errors, 100 * errors / found[:, 1]))
    return rows


def _one_seed(work: tuple[int, MassOrder]) -> dict[tuple[str, str], Array]:
    """Return values and truths by method and set, each of shape (2, targets)."""
    seed, order = work
    simulator = PayloadSimulator(
        jaco(),
        circle(PAPER_RATE_HZ, PAPER_SAMPLES / PAPER_RATE_HZ),
        gravity_m_s2=PAPER_GRAVITY_M_S2,
    )
    networks = {name: _trained(name, seed, order) for name in TRAININGS}
    rng = np.random.default_rng([_MASS_SEEDS, seed])
    found: dict[tuple[str, str], Array] = {}
    for which, heavier in SETS.items():
        initial = rng.uniform(*PAPER_MASS_KG, order.targets)
        truths = rng.uniform(*PAPER_MASS_KG, order.targets) + heavier
        values = _simple(simulator, truths, TRAINED_MEAN_KG + heavier)
        for name, model in networks.items():
            steps = _iterated(simulator, model, OBSERVE[name](simulator), initial, truths)
            values |= {name: steps[:, -1], f"{name}-1": steps[:, 1]}
        for method in METHODS:
            found[method.name, which] = np.array([values[method.name], truths])
    return found


def _simple(simulator: PayloadSimulator, truths: Array, mean_kg: float) -> dict[str, Array]:
    empty, per_kg = simulator.empty_efforts_nm, simulator.efforts_nm_per_kg
    beyond = np.array([simulator.efforts_nm(float(truth)) - empty for truth in truths])
    secant = np.tensordot(beyond, per_kg, 2) / (per_kg**2).sum()
    return {
        "one": np.ones(len(truths)),
        "mean": np.full(len(truths), mean_kg),
        "secant": secant,
    }


def _trained(name: str, seed: int, order: MassOrder) -> Model:
    preset, quiet = TRAININGS[name], Progress(quiet=True)
    pairs = preset.make_pairs(order.pairs, seed, 1, quiet)
    recipe = preset.recipe
    if order.epochs is not None:
        recipe = replace(recipe, epochs=order.epochs)
    return train(preset.network, pairs, recipe, seed, quiet)


def _iterated(
    simulator: PayloadSimulator, model: Model, observe: Observe, initial: Array, truths: Array
) -> Array:
    """Return the iterates of every target [kg], shape (targets, K + 1)."""
    name = simulator.parameters[0].name
    rows: list[list[float]] = []
    for guess, truth in zip(initial, truths, strict=True):
        target = observe(simulator.rollout({name: float(truth)}))
        problem = Problem(target, simulator, observe, np.array([guess]))
        trace = TuneNet(model).estimate(problem, ITERATIONS)
        rows.append([float(step.values[0]) for step in trace.steps])
    return np.array(rows)


def _observe_torques(_simulator: PayloadSimulator) -> Observe:
    def observe(episode: Episode) -> Observation:
        effort = episode.signals[EFFORT]
        return paper_torques(effort.seconds, effort.values)

    return observe


def _observe_readings(simulator: PayloadSimulator) -> Observe:
    empty, per_kg = simulator.empty_efforts_nm, simulator.efforts_nm_per_kg

    def observe(episode: Episode) -> Observation:
        return payload_readings(episode.signals[EFFORT].values, empty, per_kg)

    return observe


# What the network of each preset looks at.
OBSERVE: Mapping[str, Callable[[PayloadSimulator], Observe]] = {
    "default": _observe_readings,
    "paper": _observe_torques,
    "paper-code": _observe_torques,
}


# ---- Strangers' arms: the product beside the baselines, and arms with one trouble alone.


# Logs are drawn from these and on; whatever was chosen was chosen on seeds up to 1000.
STRANGER_SEEDS = 9_000_000

# Logs that belong to each seed of the command: as many as it can be asked for.
LOGS_OF_A_SEED = 100_000

# What a stranger's driver means by torque: the joint's, with the arm's weight.
PLAIN = Convention(1, True)

# An answer that is `ok` and further off than this many halves of its interval misleads.
_FAR_HALF_WIDTHS = 3.0
_G = 1000.0  # grams in a kilogram
_BATCH = 5  # strangers' logs in a piece of work: few, so that the processes end together


@dataclass(frozen=True)
class StrangerCase:
    """Cell of arms with the same troubles."""

    label: str  # in words
    troubles: Troubles  # of the arms
    size: float = 1.0  # of the troubles, by what the label stands for

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
    """Answer of `tunenet-tune` on a log."""

    mass_kg: float  # its value
    low_kg: float  # lower end of its 95 % interval, whether a user is shown it or not
    high_kg: float  # the upper end
    is_ok: bool  # whether that is its verdict; else it is suspect
    convention: Convention  # what it takes the driver's torques for


@dataclass(frozen=True)
class StrangerResult:
    """All answers on one log, and the truth."""

    truth_kg: float  # the mass
    least_squares_kg: float  # its value, without the tare
    tare_subtracted_kg: float  # its value, with the tare
    bounds_kg: tuple[float, float]  # standard deviations of the mass, without and with the tare
    # without and with the tare; None where the log is rejected
    answers: tuple[StrangerAnswer | None, StrangerAnswer | None]


@dataclass(frozen=True)
class Rival:
    """Baseline on the logs that were answered."""

    mae_g: float  # mean absolute error
    # where ours is: "ahead" or "behind" of it by more than a standard error of the paired
    # difference, else "level"
    standing: str


@dataclass(frozen=True)
class StrangerRow:
    """Cell without the tares, or with them; None where nothing was answered."""

    case: StrangerCase  # which cell
    has_tare: bool  # whether each log was tuned with its tare
    logs: int  # how many
    answered: float  # fraction that was not rejected; what follows is of these, but for `ok`
    ok: float  # fraction of all with that verdict
    mae_g: float | None  # mean absolute error
    mae_sd_g: float | None  # standard error of it
    median_g: float | None  # of the absolute errors
    worst_g: float | None  # of them
    bound_g: float | None  # mean absolute error at the Cramér-Rao bound of noise alone
    least_squares: Rival | None  # the baseline that needs no tare
    tare_subtracted: Rival | None  # the baseline that needs one
    held: float | None  # fraction of the intervals that contain the truth
    width_g: float | None  # their median width
    far_ok: float  # fraction of all logs that are ok and further off than three half widths
    wrong_ok: int  # logs that are ok and whose convention is not what the driver means


def stranger_rows(
    seeds: Sequence[int], count: int, jobs: int | None, progress: Progress
) -> list[StrangerRow]:
    """Run every cell on `count` logs in all, in equal shares of the seeds: two rows each."""
    numbers = stranger_numbers(seeds, count)
    pieces = [
        Piece((case, numbers[at : at + _BATCH]), len(numbers[at : at + _BATCH]), case.label)
        for case in STRANGER_CASES
        for at in range(0, len(numbers), _BATCH)
    ]
    done = parallel_map(_stranger_results, pieces, jobs, progress, ("strangers", "log"))
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
    tuning = tune_episode(episode, TuneOptions(task="payload", tares=tares))
    fit = tuning.trace.fit if tuning.trace else None
    if tuning.estimate is None or fit is None:
        return None
    low_kg, high_kg = fit.interval95[0].tolist()
    is_ok = tuning.verdict == "ok"
    return StrangerAnswer(float(tuning.estimate[0]), low_kg, high_kg, is_ok, fit.detail.convention)


def _stranger_results(work: tuple[StrangerCase, tuple[int, ...]]) -> list[StrangerResult]:
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


# ---- Torque conventions: how often a log reveals its driver's.
# A torque is the joint's or the load's, with the arm's weight in it or without. Strangers' logs
# without a tare, light and full ones in turn, are given as each of the four drivers would.


# Of a log; who trusts `ok` is misled by the third alone.
OUTCOMES = ("right and ok", "right and suspect", "wrong and ok", "wrong and suspect", "rejected")

_TROUBLES = (LIGHT, FULL)


@dataclass(frozen=True)
class ConventionRow:
    """Logs of drivers with one convention."""

    convention: Convention | None  # what they mean; None for all drivers together
    logs: int  # how many
    outcomes: Mapping[str, int]  # how many of them, by the words of `OUTCOMES`


@dataclass(frozen=True)
class _Asked:
    """One log."""

    number: int  # that it is drawn from
    at: int  # its place among all, which says the troubles and the convention

    @property
    def convention(self) -> Convention:
        return CONVENTIONS[self.at // len(_TROUBLES) % len(CONVENTIONS)]


def convention_rows(
    seeds: Sequence[int], count: int, jobs: int | None, progress: Progress
) -> list[ConventionRow]:
    """Tune `count` logs in equal shares of the seeds: a row each convention, and one of all."""
    asked = [_Asked(number, at) for at, number in enumerate(stranger_numbers(seeds, count))]
    parts = [tuple(asked[at : at + _BATCH]) for at in range(0, len(asked), _BATCH)]
    pieces = [Piece(part, len(part), "") for part in parts]
    done = parallel_map(_outcomes, pieces, jobs, progress, ("conventions", "log"))
    told = [what for part in done for what in part]
    rows = []
    for meant in (*CONVENTIONS, None):
        pairs = zip(asked, told, strict=True)
        own = [what for one, what in pairs if meant in (None, one.convention)]
        counts = {what: own.count(what) for what in OUTCOMES}
        rows.append(ConventionRow(meant, len(own), counts))
    return rows


def _outcomes(asked: tuple[_Asked, ...]) -> list[str]:
    found = []
    for one in asked:
        troubles = _TROUBLES[one.at % len(_TROUBLES)]
        log = stranger_log(JACO_URDF, JACO_TOOL_LINK, one.number, troubles)
        meant = as_meant(described_arm(JACO_URDF), log.held, one.convention)
        found.append(outcome(one.convention, stranger_answer(meant, ())))
    return found


def outcome(meant: Convention, answer: StrangerAnswer | None) -> str:
    """Classify an answer as one of `OUTCOMES`."""
    if answer is None:
        return "rejected"
    known = "right" if answer.convention == meant else "wrong"
    return f"{known} and {'ok' if answer.is_ok else 'suspect'}"


def as_meant(model: Any, run: StrangerRun, convention: Convention) -> Episode:
    """Convert a run to another driver's convention, given Pinocchio's model of the empty arm."""
    position = run.episode.signals["/joint_states.position"]
    effort = run.episode.signals["/joint_states.effort"]
    values = np.array(effort.values)
    if not convention.has_gravity:
        library, data = import_module("pinocchio"), model.createData()
        weight = library.computeGeneralizedGravity
        values -= np.array([weight(model, data, row).copy() for row in position.values])
    turned = replace(effort, values=convention.sign * values)
    return replace(run.episode, signals={position.name: position, effort.name: turned})


# ---- JSON and CSV.


def mass_records(rows: Sequence[MassRow], order: MassOrder) -> list[dict[str, Any]]:
    """Return one record for each method, set and seed."""
    sets = list(SETS)
    return [
        {
            "method": row.method.name,
            "iterations": row.method.iterations,
            "set": row.which,
            "seed": seed,
            "mae_kg": float(errors.mean()),
            "percent": float(percents.mean()),
            "paper_mae_kg": row.method.paper[sets.index(row.which)],
        }
        for row in rows
        for seed, errors, percents in zip(order.seeds, row.errors, row.percents, strict=True)
    ]


def log_records(rows: Sequence[LogRow]) -> list[dict[str, Any]]:
    """Return one record for each case."""
    records = []
    for row in rows:
        record = asdict(row)
        record["case"] = row.case.label
        records.append(record)
    return records


def stranger_records(rows: Sequence[StrangerRow]) -> list[dict[str, Any]]:
    """Return one record for each cell, without the tares and with them."""
    records = []
    for row in rows:
        record = asdict(row)
        record["case"], record["size"] = row.case.label, row.case.size
        records.append(record)
    return records


def payload_json(
    masses: Sequence[MassRow],
    logs: Sequence[LogRow],
    order: MassOrder,
    strangers: Sequence[StrangerRow] = (),
    conventions: Sequence[ConventionRow] = (),
) -> str:
    """Serialise `masses` for each seed, with the mean over all, and the rows of the others."""
    summary = [
        {
            "method": row.method.name,
            "set": row.which,
            "mae_kg": float(np.mean(row.errors)),
            "percent": float(np.mean(row.percents)),
        }
        for row in masses
    ]
    content = {
        "seeds": list(order.seeds),
        "targets": order.targets,
        "summary": summary,
        "masses": mass_records(masses, order),
        "logs": log_records(logs),
        "strangers": stranger_records(strangers),
        "conventions": [asdict(row) for row in conventions],
    }
    return json_text(content)


def payload_csv(masses: Sequence[MassRow], order: MassOrder) -> str:
    """Format table 1 in long form."""
    records = mass_records(masses, order)
    return csv_text(list(records[0]) if records else ["method"], records)


# ---- Tables for a terminal, the paper's figures beside ours.


_WIDTHS = (30, 4, 32, 32, 0)
_LOG_WIDTHS = (38, 6, 10, 10, 10, 10, 8, 8, 0)
_STRANGER_WIDTHS = (26, 6, 6, 14, 8, 7, 9, 15, 17, 8, 8, 8, 8, 0)
_CONVENTION_WIDTHS = (20, 16, 16, 18, 18, 0)  # of the columns [characters]


def mass_table(rows: Sequence[MassRow], order: MassOrder) -> str:
    """Tabulate the paper's table 1: mean absolute errors and percent, over the seeds."""
    lines = [
        f"Mass in the gripper, mean absolute error in kg; {seeds_in_words(order.seeds)}, "
        f"{order.targets} targets each.",
        "In brackets: the paper's. [lowest–highest]: of the seeds.",
        "",
        table_line(("method", "K", "validation, 0 to 1 kg", "test, 1 to 2 kg", "test, %"), _WIDTHS),
    ]
    for method in METHODS:
        of = {row.which: row for row in rows if row.method == method}
        errors = [
            _figure(of[which], published)
            for which, published in zip(SETS, method.paper, strict=True)
        ]
        iterations = str(method.iterations) if method.iterations else "-"
        percent = f"{float(np.mean(of['test'].percents)):.2g}"
        if method.percent is not None:
            percent += f" ({method.percent:g})"
        lines.append(table_line((method.label, iterations, *errors, percent), _WIDTHS))
    return "\n".join(lines)


def log_table(rows: Sequence[LogRow]) -> str:
    """Tabulate errors beside the Cramér-Rao bound, coverage, centres of mass."""
    head = ("logs", "count", "answered", "MAE, kg", "bound's", "secant", "held", "width", "centre")
    lines = [
        f"Payloads of 0 to {MAX_KG:g} kg in logs of 5 s, through the whole of tunenet-tune.",
        "bound's: the best that the model which the answer states allows (Cramér and Rao).",
        "centre: how often it is given, with which errors of x, y, z and of the mass then.",
        "",
        table_line(head, _LOG_WIDTHS),
    ]
    for row in rows:
        figures = [_short(error) for error in (row.mae, row.bound, row.secant)]
        cells = [row.case.label, str(row.logs), f"{100 * row.answered:.3g} %", *figures]
        held = "-" if row.held is None else f"{100 * row.held:.3g} %"
        lines.append(table_line([*cells, held, _short(row.width), _centre(row)], _LOG_WIDTHS))
    return "\n".join(lines)


def stranger_table(rows: Sequence[StrangerRow]) -> str:
    """Tabulate errors on arms that share no code with the fit, beside the baselines."""
    head = ("arms", "tare", "logs", "MAE, g", "median", "worst", "bound's", "least squares")
    head += ("tare subtracted", "held", "width", "ok", "ok, far", "ok, wrong sign or gravity")
    lines = [
        "Payloads of 0 to 2.5 kg on strangers' arms, through the whole of tunenet-tune, in g.",
        "MAE: with its standard error. bound's: of noise alone (Cramér and Rao). ahead, level,",
        "behind: ours, by a standard error of the paired difference. held: 95 % intervals, shown",
        "or not. ok, far: off by over three half widths of it; at most 1 log in 400 may be.",
        "",
        table_line(head, _STRANGER_WIDTHS),
    ]
    for row in rows:
        size = {0.5: ", half as large", 2.0: ", twice as large"}.get(row.case.size, "")
        mae = "-" if row.mae_g is None else f"{row.mae_g:.1f} ± {row.mae_sd_g:.1f}"
        figures = [_tenths(one) for one in (row.median_g, row.worst_g, row.bound_g)]
        rivals = [_rival_words(one) for one in (row.least_squares, row.tare_subtracted)]
        cells = [row.case.label + size, "yes" if row.has_tare else "no", str(row.logs), mae]
        cells += [*figures, *rivals, _percent(row.held), _tenths(row.width_g)]
        cells += [_percent(row.ok), _percent(row.far_ok), str(row.wrong_ok)]
        lines.append(table_line(cells, _STRANGER_WIDTHS))
    return "\n".join(lines)


def convention_table(rows: Sequence[ConventionRow]) -> str:
    """Tabulate the recognised conventions: a column for each kind of driver."""
    head = ["sign and gravity"]
    for row in rows:
        means = row.convention
        sign = "" if means is None else f"{'joint' if means.sign > 0 else 'load'}'s"
        weight = "" if means is None else f", {'with' if means.has_gravity else 'without'}"
        head.append(sign + weight or "all drivers")
    lines = [
        "What drivers mean by torque, the joint's or the load's, with the arm's weight or",
        "without, as told from strangers' logs without a tare, light and full ones in turn.",
        "",
        table_line(head, _CONVENTION_WIDTHS),
        table_line(["logs", *(str(row.logs) for row in rows)], _CONVENTION_WIDTHS),
    ]
    for what in OUTCOMES:
        counts = [str(row.outcomes[what]) for row in rows]
        lines.append(table_line([what, *counts], _CONVENTION_WIDTHS))
    return "\n".join(lines)


def _tenths(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.3g} %"


def _rival_words(rival: Rival | None) -> str:
    return "-" if rival is None else f"{rival.mae_g:.1f} {rival.standing}"


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"


def _centre(row: LogRow) -> str:
    if row.centre_mm is None or row.told_mae is None or not row.told:
        return "-"
    axes = " / ".join(f"{error_mm:.1f}" for error_mm in row.centre_mm)
    return f"{100 * row.told:.3g} %, {axes} mm, {row.told_mae:.4f} kg"


def _figure(row: MassRow, published: float | None) -> str:
    seeds = row.errors.mean(axis=1)
    paper = "" if published is None else f" ({published:g})"
    spread = f" [{seeds.min():.2g}–{seeds.max():.2g}]" if len(seeds) > 1 else ""
    return f"{seeds.mean():.2g}{paper}{spread}"
