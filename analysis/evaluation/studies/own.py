"""Test a user's own model on itself: what its log can tell, and how surely, if the model is right.

The model is simulated as the log drives it, with values that the log's own fit leaves possible and
the log's noise, and tuned anew. Without a log its actuators follow sines, and what has none is let
go. Truth and fit share the model: what is wrong in it, the checks of a real log say.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tunenet_logs.analysis.evaluation.study import Order, Part, Row, decimals, figure, scored, table
from tunenet_logs.analysis.experiment import Tuning, drop_invalid_samples
from tunenet_logs.analysis.export.model import posterior_sample
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import Piece
from tunenet_logs.analysis.sysid.checks import excitation, partners_of
from tunenet_logs.analysis.sysid.columns import noises_of
from tunenet_logs.analysis.sysid.fit import SimulatorFit
from tunenet_logs.analysis.sysid.least_squares import ranges_of
from tunenet_logs.analysis.sysid.matching import rotations
from tunenet_logs.analysis.sysid.source import Connected, ModelSource, part_of, tuned_first
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import LogError, NotFoundError, UsageError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.base import Parameter
from tunenet_logs.recorders.simulators.model.parameters import MANY_SIDED, element_names
from tunenet_logs.recorders.simulators.model.rollout import STOPPED, ModelSimulator
from tunenet_logs.recorders.simulators.mujoco import mujoco
from tunenet_logs.terminal import Progress, listed, one_line
from tunenet_logs.timing.stamps import trim_clock_jumps

# ---- A motion where there is no log: actuators follow sines, other joints are let go.

_DRIVEN_S, _FREE_S = 10.0, 4.0  # how long, with actuators and without
_RATE_HZ, _START_NS = 100.0, 1_700_000_000_000_000_000
_NOISE = 0.01  # white, over the standard deviation of each column
_REACH = {True: 0.05, False: 0.5}  # of a joint without limits that slides [m], turns [rad]
_THROW_M_S = 0.5  # of a free body, along x


def default_motion(model: Any, path: Path) -> Episode:
    """Return a log of a compiled model's joints and free bodies, 100 Hz, and of commands.

    Its states hold the start alone: a rollout gives the rest. UsageError where it cannot be driven.
    """
    library = mujoco()
    seconds = np.arange(0.0, _DRIVEN_S if model.nu else _FREE_S, 1 / _RATE_HZ)
    stamps_ns = _START_NS + np.round(1e9 * seconds).astype(np.int64)
    data = library.MjData(model)
    if model.nkey:
        data.qpos[:] = model.key_qpos[0]
    moved = {
        int(model.actuator_trnid[number, 0])
        for number in range(model.nu)
        if _is_at_joint(model, number)
    }
    reach, columns = dict[int, float](), dict[str, Array]()
    signals: list[Signal] = []
    for joint, name in enumerate(element_names(model, "joint")):
        place, kind = int(model.jnt_qposadr[joint]), int(model.jnt_type[joint])
        if kind in MANY_SIDED:
            body = model.body(int(model.jnt_bodyid[joint])).name
            if body and kind == MANY_SIDED[0]:
                start = data.qpos[place : place + 7]
                throw = _THROW_M_S * seconds[:, None] * np.eye(3)[0]
                turn = np.tile(np.roll(start[3:], -1), (len(seconds), 1))
                signals.append(Signal(f"/{body}", stamps_ns, start[:3] + throw, tuple("xyz"), "m"))
                signals.append(Signal(f"/{body}.orientation", stamps_ns, turn, tuple("xyzw"), "1"))
            continue
        reach[joint] = _REACH[kind == library.mjtJoint.mjJNT_SLIDE]
        if model.jnt_limited[joint]:
            low, high = model.jnt_range[joint]
            reach[joint] = min(reach[joint], (high - low) / 4)
            data.qpos[place] = np.clip(data.qpos[place], low + reach[joint], high - reach[joint])
        if joint not in moved:
            data.qpos[place] += 0.9 * reach[joint]
        if name:
            columns[name] = np.full(len(seconds), data.qpos[place])
    if columns:
        still = np.column_stack(list(columns.values()))
        for quantity, values, unit in (
            ("position", still, "rad"),
            ("velocity", 0 * still, "rad/s"),
        ):
            name = f"/joint_states.{quantity}"
            signals.append(Signal(name, stamps_ns, values, tuple(columns), unit))
    if not signals:
        raise UsageError(f"{path}: no joint has a name, nor a free body", "name them in the model")
    if model.nu:
        values = _commands(model, data, reach, seconds, path)
        names = tuple(map(str, range(model.nu)))
        signals.append(Signal("/commands", stamps_ns, values, names, "1", drives=True))
    return Episode(EpisodeInfo(), {one.name: one for one in signals})


def _commands(
    model: Any, data: Any, reach: Mapping[int, float], seconds: Array, path: Path
) -> Array:
    """Return controls by which each joint would follow two sines, shape (T, nu)."""
    library, found = mujoco(), np.zeros((len(seconds), model.nu))
    library.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    library.mj_fullM(model, data, mass)
    grown = np.minimum(seconds, 1.0)  # within the first second
    for number in range(model.nu):
        rates = 2 * np.pi * np.array([0.4, 1.1]) * (1 + 0.3 * number / model.nu)
        shares = grown[:, None] * np.array([0.7, 0.3])
        shape = np.sum(shares * np.sin(np.outer(seconds, rates)), axis=1)
        low, high = model.actuator_ctrlrange[number]
        is_limited = bool(model.actuator_ctrllimited[number])
        if not _is_at_joint(model, number):
            if not is_limited:
                raise UsageError(
                    f"{path}: actuator {number} moves no joint and has no ctrlrange",
                    "give it one, or name a log to drive the model by",
                )
            found[:, number] = (low + high) / 2 + shape * (high - low) / 4
            continue
        joint = int(model.actuator_trnid[number, 0])
        place, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        gear = float(model.actuator_gear[number, 0]) or 1.0
        gain = float(model.actuator_gainprm[number, 0]) or 1.0
        _, on_position, on_speed = model.actuator_biasprm[number, :3]
        angle = reach.get(joint, 0.0) * shape
        speed = np.gradient(angle, seconds)
        if on_position:
            wanted = gear * (data.qpos[place] + angle)
        elif on_speed:
            wanted = gear * speed
        else:  # the torque that moves the joint alone so, its weight held
            moving = mass[dof, dof] * np.gradient(speed, seconds)
            wanted = (moving + data.qfrc_bias[dof]) / (gear * gain)
        found[:, number] = np.clip(wanted, low, high) if is_limited else wanted
    return found


def _is_at_joint(model: Any, actuator: int) -> bool:
    kinds = mujoco().mjtTrn
    joint = model.actuator_trnid[actuator, 0]
    at_joint = (int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT))
    is_one = int(model.actuator_trntype[actuator]) in at_joint
    return is_one and int(model.jnt_type[joint]) not in MANY_SIDED


# ---- The model driven as the log was, and logs of it whose truth is known.


@dataclass(frozen=True)
class Own:
    """What a user tests: a model, what is tuned of it, and the log that drives it."""

    options: TuneOptions  # with a model's source
    log: Path | None  # None for the default motion

    @property
    def source(self) -> ModelSource:
        """The model's source."""
        assert isinstance(self.options.source, ModelSource)
        return self.options.source

    def episode(self) -> Episode:
        """Return what is compared and drives, as it is read or made."""
        if self.log is None:
            return default_motion(self.source.model, self.source.path)
        episode = drop_invalid_samples(read_episode(self.log, self.options.reading))
        return part_of(trim_clock_jumps(episode), self.options.start_s, self.options.end_s)


def simulated_log(
    connected: Connected, truth: Array, noise: Mapping[str, Array] | None, rng: np.random.Generator
) -> Episode:
    """Simulate what the log shows at values of all parameters, shape (P,), with noise added.

    `noise` is by signal, of its columns that are compared, one standard deviation; without it a
    hundredth of how much each varies. LogError where the rollout stops.
    """
    simulator = connected.simulator
    assert isinstance(simulator, ModelSimulator)
    (clean,) = simulator.rollouts(truth[None])
    if why := clean.info.notes[STOPPED]:
        raise LogError(why)
    signals = {one.signal.name: one.signal for one in simulator.drives}
    for sensed in simulator.sensed:
        name, shown = sensed.signal.name, clean.signals[sensed.signal.name].values
        size = _NOISE * np.nanstd(shown, axis=0) if noise is None else noise[name]
        scatter = size * rng.standard_normal(shown.shape)
        if sensed.sensors[0].kind == "framexaxis":  # as quaternions: what a log has of it
            turned = Rotation.from_rotvec(scatter[:, :3]) * Rotation.from_matrix(rotations(shown))
            quaternions = turned.as_quat()
            signals[name] = replace(sensed.signal, values=quaternions, columns=tuple("xyzw"))
            continue
        given = signals.get(name, sensed.signal)
        values = given.values.copy()
        for place, column in enumerate(sensed.columns):
            at = given.columns.index(column)
            is_there = np.isfinite(sensed.signal.values[:, at])
            values[:, at] = np.where(is_there, shown[:, place] + scatter[:, place], np.nan)
        signals[name] = replace(given, values=values)
    return Episode(EpisodeInfo(), signals)


def _noise(connected: Connected, simulated: Array | None) -> dict[str, Array]:
    """Return the noise of each compared column, by signal: what of it no motion explains.

    `simulated` is what a fit shows, shape (M,): of efforts that jump, what is left of them.
    """
    target, found = connected.target, dict[str, Array]()
    noises = np.array([one.noise for one in target.columns])
    if simulated is not None:
        noises = noises_of(target, simulated - target.values)
    sizes = {
        (column.signal, column.name): float(noise)
        for column, noise in zip(target.columns, noises, strict=True)
    }
    assert isinstance(connected.simulator, ModelSimulator)
    for sensed in connected.simulator.sensed:
        name = sensed.signal.name
        found[name] = np.array([sizes.get((name, column), 0.0) for column in sensed.columns])
    return found


@dataclass(frozen=True, eq=False)
class Truths:
    """What the logs of a test are made of."""

    values: Array  # of the T tuned parameters, in the order of the model's, shape (N, T)
    starts: Array  # of what else is uncertain, about which it is drawn, shape (S,)
    noise: Mapping[str, Array] | None  # see `simulated_log`
    origin: str  # whence the values are, in words


def truths(own: Own, count: int, seed: int, progress: Progress) -> Truths:
    """Draw values that the log leaves possible; without a log, values in the ranges."""
    source = own.source
    try:
        connected = source.connect(own.episode())
    except NotFoundError as error:
        raise NotFoundError(f"{own.log or source.path}: {error.what}", error.remedy) from error
    parameters = tuned_first(connected.simulator.parameters)
    tuned = len(source.parameters)
    starts = np.array([one.initial for one in parameters[tuned:]])
    rng = np.random.default_rng((seed, 57))
    if own.log is None:
        drawn = _in_ranges(parameters[:tuned], count, rng)
        return Truths(drawn, starts, None, "drawn from their ranges")
    with progress.stages(one_line(own.log)):
        tuning = tune_episode(own.episode(), replace(own.options, start_s=None, end_s=None))
    trace = tuning.trace
    fit = None if trace is None else trace.fit
    if trace is None or fit is None or fit.posterior is None:
        drawn = _in_ranges(parameters[:tuned], count, rng)
        why = f"drawn from their ranges, as the log gives none ({tuning.reason})"
        return Truths(drawn, starts, _noise(connected, None), why)
    names = [one.name for one in tuning.parameters]
    drawn = posterior_sample(names, trace.estimate, fit.posterior, count, seed)
    detail: SimulatorFit = fit.detail
    starts, noise = (
        detail.solution.values[tuned : len(parameters)],
        _noise(connected, detail.simulated),
    )
    return Truths(drawn, starts, noise, f"that the log leaves possible (it is {tuning.verdict})")


def _in_ranges(parameters: Sequence[Parameter], count: int, rng: np.random.Generator) -> Array:
    """Draw values from ranges, evenly by their logarithm where none is 0, shape (count, T)."""
    found = np.empty((count, len(parameters)))
    for place, one in enumerate(parameters):
        low, high = one.training_range
        share = rng.uniform(0.05, 0.95, count)  # an end would be doubted
        found[:, place] = (
            low * (high / low) ** share if low * high > 0 else low + share * (high - low)
        )
    return found


# ---- One log of it, tuned as a user would tune it.


@dataclass(frozen=True, eq=False)
class OwnTrial:
    """A log to be made and tuned."""

    own: Own
    seed: tuple[int, int]  # the test's, and the log's number
    truth: Array  # of the tuned parameters, shape (T,)
    made: Truths  # of all logs


def rows_of(trial: OwnTrial) -> list[Row]:
    """Make a log and tune it: a row for each parameter, or one alone where none was found."""
    own, made = trial.own, trial.made
    connected = own.source.connect(own.episode())
    rng = np.random.default_rng(trial.seed)
    unsure = tuned_first(connected.simulator.parameters)[len(trial.truth) :]
    starts = [
        float(np.clip(start + (one.prior_sd or 0.0) * rng.standard_normal(), *one.bounds))
        for one, start in zip(unsure, made.starts.tolist(), strict=True)
    ]
    told: Row = {"seed": trial.seed[0], "log": trial.seed[1]}
    try:
        episode = simulated_log(connected, np.array([*trial.truth, *starts]), made.noise, rng)
    except LogError as error:
        return [told | {"verdict": "not simulated", "reason": str(error)}]
    began_s = time.perf_counter()
    tuning = tune_episode(episode, replace(own.options, start_s=None, end_s=None))
    told |= {
        "verdict": tuning.verdict,
        "reason": tuning.reason,
        "rollouts": tuning.rollouts,
        "seconds": round(time.perf_counter() - began_s, 2),
    }
    return _estimates(told, tuning, trial.truth.tolist())


def _estimates(told: Row, tuning: Tuning, truth: Sequence[float]) -> list[Row]:
    if tuning.trace is None or tuning.trace.fit is None:
        return [told]
    fit = tuning.trace.fit
    detail: SimulatorFit = fit.detail
    ends = fit.interval95
    assert ends is not None
    needed_s = told_after(detail)
    rows: list[Row] = []
    for place, one in enumerate(tuning.parameters):
        partners = partners_of(detail, one) if one in detail.unidentifiable else None
        rows.append(
            told
            | {
                "address": one.name,
                "unit": one.unit,
                "truth": truth[place],
                "value": float(tuning.trace.estimate[place]),
                "low": float(ends[place][0]),
                "high": float(ends[place][1]),
                "is_told": partners is None,
                "partners": partners or [],
                "needed_s": float(needed_s[place]),
            }
        )
    return rows


_ENOUGH = 0.1  # of a value, or of a tenth of its range where that is more: half an interval


def told_after(fit: SimulatorFit) -> Array:
    """Return how many seconds of the log tell each tuned value to a tenth, shape (T,); else NaN.

    The information (Fisher's) of the samples up to a time, with the slopes of the whole fit; scaled
    so that at the end it is the fit's interval.
    """
    target, solution, scales = fit.target, fit.solution, ranges_of(fit.parameters)
    weighed = solution.slopes * scales / target.per_value(solution.noise)[:, None]
    known = [0.0 if one.prior_sd is None else 1.0 for one in fit.parameters]
    normal = np.diag(np.array(known) + 1e-6)
    edges_s = np.linspace(0.0, target.end_s, 101)
    place = np.clip(np.searchsorted(edges_s, target.seconds) - 1, 0, 99)
    sd = np.empty((100, fit.tuned))
    for number in range(100):
        rows = weighed[place == number]
        normal = normal + rows.T @ rows
        sd[number] = np.sqrt(np.diag(np.linalg.inv(normal)))[: fit.tuned]
    half95 = sd / sd[-1] * fit.half95[: fit.tuned]
    values = np.abs(solution.values[: fit.tuned])
    wanted = _ENOUGH * np.maximum(values, 0.1 * scales[: fit.tuned])
    is_enough = half95 <= wanted
    first = edges_s[1:][np.argmax(is_enough, axis=0)]
    return np.where(is_enough.any(axis=0), first, np.nan)


# ---- Run, and the table.


def run(order: Order, progress: Progress) -> Iterator[Part]:
    """Make the logs and tune them."""
    assert order.own is not None
    own = Own(*order.own)
    source, log = own.source, own.log
    trials: list[OwnTrial] = []
    origin = ""
    for seed in order.seeds:
        made = truths(own, order.targets, seed, progress)
        origin = made.origin
        values = enumerate(made.values)
        trials += [OwnTrial(own, (seed, number), row, made) for number, row in values]
    cases = {"": [Piece(one) for one in trials]}
    rows = scored(rows_of, cases, order, progress, ("tuned", "log"))[""]
    where = "a motion made for it" if log is None else f"{one_line(log.name)}"
    noise = "a hundredth of how much each column varies" if log is None else "the log's"
    head = f"{one_line(source.name)} along {where}, {len(trials)} logs simulated with it; "
    yield Part("", own_table(rows, f"{head}values {origin}; noise: {noise}."), rows)


def own_table(rows: Sequence[Row], head: str) -> str:
    """Tabulate: a line for each parameter, then what cannot be told, and the verdicts."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        if "address" in row:
            groups.setdefault(row["address"], []).append(row)
    heads = ["parameter", "truth", "median error", "of truth", "95 % intervals that hold it"]
    lines = [[*heads, "told by", "to a tenth after"]]
    remarks: list[str] = []
    for address, own in groups.items():
        unit = "" if own[0]["unit"] == "1" else f" {own[0]['unit']}"
        truth, value, low, high = (
            np.array([row[name] for row in own], float)
            for name in ("truth", "value", "low", "high")
        )
        errors, held = np.abs(value - truth), int(np.sum((low <= truth) & (truth <= high)))
        untold = [row for row in own if not row["is_told"]]
        share = figure(errors / np.maximum(np.abs(truth), 1e-300), np.median)
        needed = figure([row["needed_s"] for row in own], np.median)
        is_reached = np.mean(np.isfinite([row["needed_s"] for row in own])) > 0.5
        ends = f"{truth.min():.4g} to {truth.max():.4g}{unit}"
        lines.append(
            [
                address,
                ends,
                f"{np.median(errors):.2g}",
                f"{100 * (share or 0.0):.2g} %",
                f"{held} of {len(own)}",
                f"{len(own) - len(untold)} of {len(own)}",
                f"{decimals(needed)} s" if is_reached else "not in this log",
            ]
        )
        if untold:
            names = Counter(name for row in untold for name in row["partners"])
            partners = [name for name, count in names.items() if count > len(untold) / 2]
            along = f", only together with {listed(partners, 3)}" if partners else ""
            what = f"{address}: {len(untold)} of {len(own)} logs cannot tell it{along}"
            remarks.append(f"{what}; {excitation(address, partners)}")
    tries = {(row["seed"], row["log"]): row for row in rows}
    verdicts = Counter(row["verdict"] for row in tries.values())
    told = ", ".join(f"{verdict} {count}" for verdict, count in verdicts.most_common())
    spent = [row["rollouts"] for row in tries.values() if "rollouts" in row]
    seconds = [row["seconds"] for row in tries.values() if "seconds" in row]
    remarks.append(f"verdicts: {told}")
    if spent:
        each = f"{figure(spent, np.median):.0f} rollouts, {figure(seconds, np.median):.1f} s"
        remarks[-1] += f"; each {each} of CPU (median)"
    doubts = Counter(row["reason"] for row in tries.values() if row["reason"])
    remarks += [f"  {count} x {one_line(reason)[:300]}" for reason, count in doubts.most_common(2)]
    return "\n".join([table(lines, head), *remarks])
