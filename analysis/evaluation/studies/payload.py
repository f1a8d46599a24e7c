"""Measure payload errors: the paper's table 1, logs like a real driver's, and strangers' arms.

Each log goes the whole way of `tunenet-tune`. The strangers' arms share no code and no constants
with the fit; the same logs go to what a roboticist would write instead, without the tare and with
it, and to the Cramér-Rao bound.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from importlib import import_module
from typing import Any

import numpy as np

from tunenet_logs.analysis.estimators.base import Observation, Problem
from tunenet_logs.analysis.estimators.methods import TuneNet
from tunenet_logs.analysis.evaluation.study import (
    Columns,
    Order,
    Part,
    Row,
    decimals,
    figure,
    holds,
    listed,
    scored,
    shown,
    table,
)
from tunenet_logs.analysis.evaluation.worlds.arm import (
    CLEAN,
    FULL,
    LIGHT,
    StrangerRun,
    Troubles,
    described_arm,
    holding,
    rigid_nm,
    stranger_log,
    stranger_runs,
)
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import Piece
from tunenet_logs.analysis.payload import detection
from tunenet_logs.analysis.payload.arm_log import read_arm_log
from tunenet_logs.analysis.payload.torque_fit import fit_payload
from tunenet_logs.analysis.payload.torque_model import (
    CONVENTIONS,
    Convention,
    arm_motion,
)
from tunenet_logs.analysis.registry import needed
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


def least_squares(model: Any, frame: int, held: Episode) -> float:
    """Estimate the mass [kg] by least squares, beside offset, viscous and dry friction a joint."""
    from scipy.linalg import block_diag

    seconds, where, effort = _read(held)
    speed, pull, empty = _moved(model, seconds, where)
    per_kg = rigid_nm(_holding_1_kg(model, frame, np.zeros(3)), where, speed, pull) - empty
    # dry friction turns over with a joint's speed, over .01 rad/s
    own = (np.ones_like(speed), speed, np.tanh(speed / 0.01))
    # one a joint, each joint in turn
    columns = [np.asarray(block_diag(*one.T[:, :, None]), np.float64) for one in own]
    slopes = np.hstack([per_kg.T.reshape(-1, 1), *columns])
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
    base = rigid_nm(_holding_1_kg(model, frame, np.zeros(3)), where, speed, pull) - own
    columns = [base]
    for axis in np.eye(3):
        moved = rigid_nm(_holding_1_kg(model, frame, 0.01 * axis), where, speed, pull) - own
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
    window = max(2 * int(0.35 / step / 2) + 1, 7)  # .35 s
    speed, pull = (
        np.asarray(savgol_filter(where, window, 3, order, step, axis=0), np.float64)
        for order in (1, 2)
    )
    return speed, pull, rigid_nm(model, where, speed, pull)


def _holding_1_kg(model: Any, frame: int, centre_m: Array) -> Any:
    return holding(model, frame, 1.0, centre_m, np.zeros((3, 3)))


def _solve(slopes: Array, target: Array) -> Array:
    return np.asarray(np.linalg.lstsq(slopes, target, rcond=None)[0], np.float64)


# ---- Logs like a real driver's: errors, and the coverage of intervals.
# Torques come from the engine's inverse dynamics, the fit's from Pinocchio; nothing of the
# disturbances is given.

ARMS = 1_000  # arms, with their disturbances, that belong to each seed of the command
MAX_OFFSET_M = 0.03  # of its centre from the gripper's, along each axis

_OF_SD = float(np.sqrt(2 / np.pi))  # mean absolute value of a Gaussian over its standard deviation


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


def driver_log(case: tuple[LogCase, int]) -> list[Row]:
    """Tune a log of a case; whatever was chosen was chosen on numbers below 100 000."""
    which, seed = case[0], 5_000_000 + case[1]
    arm = jaco()
    rng = np.random.default_rng([seed, 0xBE])
    mass_kg = float(rng.uniform(0, 1.0))  # the range of the paper's training
    x, y, z = (rng.uniform(-MAX_OFFSET_M, MAX_OFFSET_M, 3) * which.is_off_centre).tolist()
    when = (500.0, 5.2)  # samples a second of the motion, and its duration
    moved = circle(*when) if which.is_circle else random_path(arm, seed, *when)
    sizes = {
        item.name: getattr(REAL_ARM, item.name) * which.share
        for item in fields(DisturbanceScales)
        if item.name not in ("torque_noise_nm", "most_lag_s", "friction_opposes")
    }
    disturbances = through_kinovas_driver(
        drawn(seed, arm, DisturbanceScales(**sizes)), which.rate_hz
    )
    if which.noise_nm is not None:
        disturbances = Disturbances(
            torque_noise_nm=which.noise_nm, rate_hz=60.0, noise_seed=2 * seed
        )
    tares = [driver_episode(arm, moved, None, disturbances.another_run())] * which.has_tare
    episode = driver_episode(arm, moved, Payload(mass_kg, (x, y, z)), disturbances)
    tuning = tune_episode(episode, TuneOptions(task="payload", tares=tuple(tares)))
    fit = tuning.trace.fit if tuning.trace else None
    row: Row = {"truth": mass_kg, "value": None, "ok": tuning.verdict == "ok"}
    if tuning.estimate is None or fit is None:
        return [{**row, "ok": False}]
    row["value"] = float(tuning.estimate[0])
    row["low"], row["high"] = fit.interval95[0].tolist()
    row["bound"] = fit.detail.bound_kg
    row["secant"] = np.nan if tuning.cross_check is None else tuning.cross_check.value
    # errors along x, y, z of the tool
    off_m = np.abs(fit.extra[0].values - (x, y, z)) if fit.extra else None
    return [{**row, "centre_mm": None if off_m is None else 1000 * off_m}]


def log_row(case: LogCase, logs: Sequence[Row]) -> Row:
    """Compute the figures of a case [kg]; None where nothing was answered."""
    answered = [one for one in logs if one["value"] is not None]
    centred = [one for one in answered if one["centre_mm"] is not None]

    def of(name: str, rows: Sequence[Row] = answered) -> Array:
        return np.array([one[name] for one in rows], np.float64)

    truth, low, high = of("truth"), of("low"), of("high")
    return {
        "case": case.label,
        "logs": len(logs),
        "answered": len(answered) / len(logs),
        "ok": figure([one["ok"] for one in logs]),
        "mae": figure(np.abs(of("value") - truth)),
        # the same of the best unbiased estimate, under the model that each answer states (Cramér
        # and Rao; mean of sd sqrt(2 / pi))
        "bound": figure(_OF_SD * of("bound")),
        "secant": figure(np.abs(of("secant") - truth)),
        "held": figure(holds(low, high, truth)),  # of the intervals, shown or not
        "width": figure(high - low, np.median),
        "told": len(centred) / len(answered) if answered else None,  # whose centre is reported
        "centre_mm": np.mean([one["centre_mm"] for one in centred], axis=0) if centred else None,
        "told_mae": figure(np.abs(of("value", centred) - of("truth", centred))),
    }


# ---- Table 1 (Allevato et al. 2019): the mass in an arm's gripper.
# Networks learn from masses of 0 to 1 kg; validation targets are as heavy, test targets 1 kg more.

ITERATIONS = 9  # K of the paper's table 1
# By how much the targets are heavier than what was learnt from [kg].
SETS: Mapping[str, float] = {"validation": 0.0, "test": 1.0}


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


def masses_of_seed(case: tuple[int, Order]) -> list[Row]:
    """Run every method on the same targets of a seed: a row for each method and set."""
    seed, order = case
    path = circle(detection.PAPER_RATE_HZ, detection.PAPER_SAMPLES / detection.PAPER_RATE_HZ)
    simulator = PayloadSimulator(jaco(), path, gravity_m_s2=detection.PAPER_GRAVITY_M_S2)
    empty, per_kg = simulator.empty_efforts_nm, simulator.efforts_nm_per_kg
    mass = simulator.parameters[0].name

    def torques(episode: Episode) -> Observation:
        effort = episode.signals[EFFORT]
        return detection.paper_torques(effort.seconds, effort.values)

    def readings(episode: Episode) -> Observation:
        return detection.payload_readings(episode.signals[EFFORT].values, empty, per_kg)

    networks: dict[str, Model] = {}
    for name, preset in detection.TRAININGS.items():
        quiet = Progress(quiet=True)
        pairs = preset.make_pairs(order.pairs, seed, 1, quiet)
        recipe = replace(preset.recipe, epochs=order.epochs or preset.recipe.epochs)
        networks[name] = train(preset.network, pairs, recipe, seed, quiet)
    # targets are drawn from these and a seed; training from the seed alone
    rng = np.random.default_rng([7_000_000, seed])
    rows: list[Row] = []
    for which, heavier in SETS.items():
        initial = rng.uniform(*detection.PAPER_MASS_KG, order.targets)
        truths = rng.uniform(*detection.PAPER_MASS_KG, order.targets) + heavier
        episodes = [simulator.rollout({mass: float(truth)}) for truth in truths]
        beyond = np.array([one.signals[EFFORT].values - empty for one in episodes])
        values: dict[str, Array] = {
            "one": np.ones(len(truths)),
            "mean": np.full(len(truths), sum(detection.PAPER_MASS_KG) / 2 + heavier),
            "secant": np.tensordot(beyond, per_kg, 2) / (per_kg**2).sum(),
        }
        for name, model in networks.items():
            observe = readings if name == "default" else torques
            steps: list[list[float]] = []  # of every target [kg]
            for guess, episode in zip(initial, episodes, strict=True):
                problem = Problem(observe(episode), simulator, observe, np.array([guess]))
                trace = TuneNet(model).estimate(problem, ITERATIONS)
                steps.append([float(step.values[0]) for step in trace.steps])
            iterates = np.array(steps)
            values |= {name: iterates[:, -1], f"{name}-1": iterates[:, 1]}
        for method in METHODS:
            errors = np.abs(values[method.name] - truths)
            rows.append(
                {
                    "method": method.name,
                    "iterations": method.iterations,
                    "set": which,
                    "seed": seed,
                    "mae_kg": float(errors.mean()),
                    "percent": float((100 * errors / truths).mean()),  # of the target's mass
                    "paper_mae_kg": method.paper[list(SETS).index(which)],
                }
            )
    return rows


# ---- Strangers' arms: the product beside the baselines, and arms with one trouble alone.

# Logs are drawn from these and on; whatever was chosen was chosen on seeds up to 1000.
STRANGER_SEEDS = 9_000_000

# Logs that belong to each seed of the command: as many as it can be asked for.
LOGS_OF_A_SEED = 100_000

# What a stranger's driver means by torque: the joint's, with the arm's weight.
PLAIN = Convention(1, True)

_G = 1000.0  # grams in a kilogram


@dataclass(frozen=True)
class StrangerCase:
    """Cell of arms with the same troubles."""

    label: str  # in words
    troubles: Troubles  # of the arms
    size: float = 1.0  # of the troubles, by what the label stands for


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


def stranger_numbers(seeds: Sequence[int], count: int) -> tuple[int, ...]:
    """Return the draw numbers of `count` logs, in equal shares of the command's seeds."""
    share = -(-count // len(seeds))
    firsts = (STRANGER_SEEDS + seed * LOGS_OF_A_SEED for seed in seeds)
    return tuple(first + one for first in firsts for one in range(share))[:count]


def stranger_logs(case: tuple[StrangerCase, tuple[int, ...]]) -> list[Row]:
    """Draw logs and run every method on each; what differs is without the tare, and with it."""
    which, numbers = case
    model = described_arm(JACO_URDF)
    frame = model.getFrameId(JACO_TOOL_LINK)
    rows: list[Row] = []
    for number in numbers:
        log = stranger_log(JACO_URDF, JACO_TOOL_LINK, number, which.troubles.times(which.size))
        held, empty = log.held.episode, log.empty.episode
        rows.append(
            {
                "truth": log.mass_kg,
                "least_squares": least_squares(model, frame, held),
                "tare_subtracted": tare_subtracted(model, frame, held, empty),
                # standard deviations of the mass
                "bounds": (bound_kg(log.held, None), bound_kg(log.held, log.empty)),
                # None where the log is rejected
                "answers": (stranger_answer(held, ()), stranger_answer(held, (empty,))),
            }
        )
    return rows


def stranger_answer(episode: Episode, tares: tuple[Episode, ...]) -> StrangerAnswer | None:
    """Tune a log with the whole of `tunenet-tune`; None where it is rejected."""
    tuning = tune_episode(episode, TuneOptions(task="payload", tares=tares))
    fit = tuning.trace.fit if tuning.trace else None
    if tuning.estimate is None or fit is None:
        return None
    low_kg, high_kg = fit.interval95[0].tolist()
    is_ok = tuning.verdict == "ok"
    return StrangerAnswer(float(tuning.estimate[0]), low_kg, high_kg, is_ok, fit.detail.convention)


def stranger_row(case: StrangerCase, logs: Sequence[Row], *, has_tare: bool) -> Row:
    """Compute the figures of one cell's logs [g], without their tares or with them."""
    pairs = [(one, answer) for one in logs if (answer := one["answers"][has_tare]) is not None]
    answers = [answer for _, answer in pairs]
    truth = np.array([one["truth"] for one, _ in pairs])
    low, high = (
        np.array([getattr(one, name) for one in answers]) for name in ("low_kg", "high_kg")
    )
    off_g = _G * np.abs(np.array([one.mass_kg for one in answers]) - truth)
    # An answer that is `ok` and further off than this many halves of its interval misleads.
    far = off_g > 3.0 * _G * (high - low) / 2
    ok = np.array([one.is_ok for one in answers], bool)
    wrong = np.array([one.convention != PLAIN for one in answers], bool)
    row: Row = {
        "case": case.label,
        "size": case.size,
        "has_tare": has_tare,
        "logs": len(logs),
        "answered": len(pairs) / len(logs),  # what follows is of these, but for `ok`, `far_ok`
        "ok": int(ok.sum()) / len(logs),
        "mae_g": figure(off_g),
        "mae_sd_g": figure(off_g, _standard_error),
        "median_g": figure(off_g, np.median),
        "worst_g": figure(off_g, np.max),
        # mean absolute error at the Cramér-Rao bound of noise alone
        "bound_g": figure([_G * _OF_SD * one["bounds"][has_tare] for one, _ in pairs]),
        "held": figure(holds(low, high, truth)),
        "width_g": figure(_G * (high - low), np.median),
        "far_ok": int(np.sum(ok & far)) / len(logs),  # further off than three half widths
        "wrong_ok": int(np.sum(ok & wrong)),  # whose convention is not what the driver means
    }
    for name in ("least_squares", "tare_subtracted")[: 1 + has_tare]:
        theirs_g = _G * np.abs(np.array([one[name] for one, _ in pairs]) - truth)
        lead_g, sd_g = figure(theirs_g - off_g), figure(theirs_g - off_g, _standard_error)
        if lead_g is not None and sd_g is not None:
            # ours, by a standard error of the paired difference
            standing = "level" if abs(lead_g) <= sd_g else "ahead" if lead_g > 0 else "behind"
            row |= {f"{name}_mae_g": figure(theirs_g), f"{name}_standing": standing}
    return row


def _standard_error(values: Array) -> float:
    """Return the standard error of a mean; 0 for one value, which gives none."""
    return float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0


# ---- Torque conventions: how often a log reveals its driver's.
# A torque is the joint's or the load's, with the arm's weight in it or without. Strangers' logs
# without a tare, light and full ones in turn, are given as each of the four drivers would.

# Of a log; who trusts `ok` is misled by the third alone.
OUTCOMES = ("right and ok", "right and suspect", "wrong and ok", "wrong and suspect", "rejected")

_TROUBLES = (LIGHT, FULL)


def convention_of(at: int) -> Convention:
    """Return what the driver of log `at` of all means."""
    return CONVENTIONS[at // len(_TROUBLES) % len(CONVENTIONS)]


def convention_log(case: tuple[int, int]) -> list[str]:
    """Tune a log, given its place among all and a number to draw it from; see `OUTCOMES`."""
    at, number = case
    convention = convention_of(at)
    log = stranger_log(JACO_URDF, JACO_TOOL_LINK, number, _TROUBLES[at % len(_TROUBLES)])
    meant = as_meant(described_arm(JACO_URDF), log.held, convention)
    return [outcome(convention, stranger_answer(meant, ()))]


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


# ---- Cards: what an arm's card is worth beside tares of the log itself.
# A stranger's arm: a log whose payload is sought, three runs of the empty gripper and one with
# another payload, all along other motions, the sensors' zeros drifting between any two runs. Every
# card is from runs that the log knows nothing of.

WAYS = (
    "alone",
    "one tare",
    "three tares",
    "card of an empty run",
    "card of another payload's run",
    "card of that and one tare",
    "card of that and three tares",
    "the same, learnt in two steps",
)


def fits_of_arm(number: int) -> list[Array]:
    """Return mass, lower and upper end, truth [kg] in each of `WAYS`, shape (W, 4)."""
    rng = np.random.default_rng([number, 77])
    mass_kg, other_kg = rng.uniform(0.0, 2.5), rng.uniform(0.2, 2.5)
    away = rng.standard_normal(3)
    centre_m = 0.015 * away / np.linalg.norm(away)
    payloads = [(mass_kg, centre_m), (other_kg, -centre_m), None, None, None]
    runs = stranger_runs(JACO_URDF, JACO_TOOL_LINK, number, FULL, payloads)
    arm = jaco()
    log, other, *empty = (arm_motion(read_arm_log(one.episode, arm)) for one in runs)
    of_other = fit_payload(arm, other, empty[:1]).learnt
    cards = (
        fit_payload(arm, empty[0], []).learnt,
        fit_payload(arm, other, []).learnt,
        of_other,
        fit_payload(arm, other, empty).learnt,
        fit_payload(arm, empty[1], empty[2:], known=of_other).learnt,
    )
    fits = [fit_payload(arm, log, tares) for tares in ([], empty[:1], empty)]
    fits += [fit_payload(arm, log, known=card) for card in cards]
    return [np.array([[fit.held.mass_kg, *fit.held.interval95, mass_kg] for fit in fits])]


def _cards(order: Order, progress: Progress) -> Part:
    """Draw the arms in equal shares of the seeds."""
    count = order.targets_of("payload", "cards")
    share = -(-count // len(order.seeds))
    numbers = [5_000 + 1_000 * seed + one for seed in order.seeds for one in range(share)][:count]
    cases = {"": [Piece(number, 1, f"arm {number}") for number in numbers]}
    found = scored(fits_of_arm, cases, order, progress, ("cards", "arm"))[""]
    masses, lows, highs, truths = np.stack(found).transpose(2, 1, 0)
    errors_g = _G * np.abs(masses - truths)
    more_g, held = errors_g - errors_g[WAYS.index("one tare")], holds(lows, highs, truths)
    rows: list[Row] = [
        {
            "way": way,
            "mean_g": figure(errors_g[at]),
            "sd_g": float(errors_g[at].std() / np.sqrt(count)),
            "median_g": figure(errors_g[at], np.median),
            "worst_g": figure(errors_g[at], np.max),
            "more_than_one_tare_g": figure(more_g[at]),
            "more_sd_g": float(more_g[at].std() / np.sqrt(count)),
            "held": figure(held[at]),
            "width_g": figure(_G * (highs - lows)[at], np.median),
        }
        for at, way in enumerate(WAYS)
    ]
    return Part("cards", listed(rows, f"Errors of {count} strangers' arms, by the fit alone"), rows)


# ---- Run: section by section.


def run(order: Order, progress: Progress) -> Iterator[Part]:
    """Run the sections in their order."""
    for section in order.sections:
        yield SECTIONS[section](order, progress)


def _masses(order: Order, progress: Progress) -> Part:
    """Run every seed in a process of its own, as its networks are trained there."""
    needed("torch")
    cases = {"": [Piece((seed, order), 1, f"seed {seed}") for seed in order.seeds]}
    rows = scored(masses_of_seed, cases, order, progress, ("masses", "seed"))[""]
    return Part("masses", mass_table(rows, order), rows)


def _logs(order: Order, progress: Progress) -> Part:
    count = max(1, order.targets_of("payload", "logs") * 2 // 3)
    share = -(-count // len(order.seeds))
    numbers = [seed * ARMS + one for seed in order.seeds for one in range(share)][:count]
    cases = {one: [Piece((one, number), 1, one.label) for number in numbers] for one in CASES}
    done = scored(driver_log, cases, order, progress, ("payloads", "log"))
    rows = [log_row(case, logs) for case, logs in done.items()]
    title = (
        "Payloads of 0 to 1 kg in logs of 5 s, through the whole of tunenet-tune.\n"
        "bound's: the best that the model which the answer states allows (Cramér and Rao).\n"
        "centre: how often it is given, with which errors of x, y, z and of the mass then.\n"
    )
    return Part("logs", table(shown(_LOG_COLUMNS, rows), title), rows)


def _strangers(order: Order, progress: Progress) -> Part:
    numbers = stranger_numbers(order.seeds, order.targets_of("payload", "strangers"))
    cases = {
        one: [Piece((one, (number,)), 1, one.label) for number in numbers] for one in STRANGER_CASES
    }
    done = scored(stranger_logs, cases, order, progress, ("strangers", "log"))
    rows = [
        stranger_row(case, logs, has_tare=has_tare)
        for case, logs in done.items()
        for has_tare in (False, True)
    ]
    title = (
        "Payloads of 0 to 2.5 kg on strangers' arms, through the whole of tunenet-tune, in g.\n"
        "MAE: with its standard error. bound's: of noise alone (Cramér and Rao). ahead, level,\n"
        "behind: ours, by a standard error of the paired difference. held: 95 % intervals, shown\n"
        "or not. ok, far: off by over three half widths of it; at most 1 log in 400 may be.\n"
    )
    return Part("strangers", table(shown(_STRANGER_COLUMNS, rows), title), rows)


def _conventions(order: Order, progress: Progress) -> Part:
    numbers = stranger_numbers(order.seeds, order.targets_of("payload", "conventions"))
    cases = {"": [Piece(one) for one in enumerate(numbers)]}
    outcomes = scored(convention_log, cases, order, progress, ("conventions", "log"))[""]
    rows: list[Row] = []
    for meant in (*CONVENTIONS, None):
        own = [what for at, what in enumerate(outcomes) if meant in (None, convention_of(at))]
        words = "all drivers"
        if meant is not None:
            words = f"{'joint' if meant.sign > 0 else 'load'}'s, "
            words += "with" if meant.has_gravity else "without"
        rows.append(
            {"drivers": words, "logs": len(own), **{what: own.count(what) for what in OUTCOMES}}
        )
    lines = [["sign and gravity", *(row["drivers"] for row in rows)]]
    lines += [[what, *(str(row[what]) for row in rows)] for what in ("logs", *OUTCOMES)]
    title = (
        "What drivers mean by torque, the joint's or the load's, with the arm's weight or\n"
        "without, as told from strangers' logs without a tare, light and full ones in turn.\n"
    )
    return Part("conventions", table(lines, title), rows)


SECTIONS = {
    "masses": _masses,
    "logs": _logs,
    "strangers": _strangers,
    "conventions": _conventions,
    "cards": _cards,
}


# ---- Tables for a terminal, the paper's figures beside ours.


def mass_table(rows: Sequence[Row], order: Order) -> str:
    """Tabulate the paper's table 1: mean absolute errors and percent, over the seeds."""
    lines = [["method", "K", "validation, 0 to 1 kg", "test, 1 to 2 kg", "test, %"]]
    for method in METHODS:
        own = [row for row in rows if row["method"] == method.name]
        cells = [method.label, str(method.iterations) if method.iterations else "-"]
        for which, published in zip(SETS, method.paper, strict=True):
            seeds = np.array([row["mae_kg"] for row in own if row["set"] == which])
            paper = "" if published is None else f" ({published:g})"
            spread = f" [{seeds.min():.2g}–{seeds.max():.2g}]" if len(seeds) > 1 else ""
            cells.append(f"{seeds.mean():.2g}{paper}{spread}")
        test = np.mean([row["percent"] for row in own if row["set"] == "test"])
        paper = "" if method.percent is None else f" ({method.percent:g})"
        lines.append([*cells, f"{test:.2g}{paper}"])
    title = (
        f"Mass in the gripper, mean absolute error in kg; {order.seeds_in_words}, "
        f"{order.targets} targets each.\n"
        "In brackets: the paper's. [lowest–highest]: of the seeds.\n"
    )
    return table(lines, title)


def _rival(name: str) -> Callable[[Row], str]:
    def cell(row: Row) -> str:
        mae_g = row.get(f"{name}_mae_g")
        return "-" if mae_g is None else f"{mae_g:.1f} {row[f'{name}_standing']}"

    return cell


def _centre(row: Row) -> str:
    if row["centre_mm"] is None:
        return "-"
    axes = " / ".join(f"{error_mm:.1f}" for error_mm in row["centre_mm"])
    return f"{100 * row['told']:.3g} %, {axes} mm, {row['told_mae']:.4f} kg"


def _share(fraction: float | None) -> str:
    return "-" if fraction is None else f"{100 * fraction:.3g} %"


_LOG_COLUMNS: Columns = (
    ("logs", lambda row: row["case"]),
    ("count", lambda row: str(row["logs"])),
    ("answered", lambda row: _share(row["answered"])),
    ("MAE, kg", lambda row: decimals(row["mae"], 4)),
    ("bound's", lambda row: decimals(row["bound"], 4)),
    ("secant", lambda row: decimals(row["secant"], 4)),
    ("held", lambda row: _share(row["held"])),
    ("width", lambda row: decimals(row["width"], 4)),
    ("centre", _centre),
)
_SIZES = {0.5: ", half as large", 2.0: ", twice as large"}
_STRANGER_COLUMNS: Columns = (
    ("arms", lambda row: row["case"] + _SIZES.get(row["size"], "")),
    ("tare", lambda row: "yes" if row["has_tare"] else "no"),
    ("logs", lambda row: str(row["logs"])),
    (
        "MAE, g",
        lambda row: "-" if row["mae_g"] is None else f"{row['mae_g']:.1f} ± {row['mae_sd_g']:.1f}",
    ),
    ("median", lambda row: decimals(row["median_g"])),
    ("worst", lambda row: decimals(row["worst_g"])),
    ("bound's", lambda row: decimals(row["bound_g"])),
    ("least squares", _rival("least_squares")),
    ("tare subtracted", _rival("tare_subtracted")),
    ("held", lambda row: _share(row["held"])),
    ("width", lambda row: decimals(row["width_g"])),
    ("ok", lambda row: _share(row["ok"])),
    ("ok, far", lambda row: _share(row["far_ok"])),
    ("ok, wrong sign or gravity", lambda row: str(row["wrong_ok"])),
)
