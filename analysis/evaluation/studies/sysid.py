"""Tune users' models of machines that no engine simulated, and beside them by `mujoco.sysid`.

MuJoCo's own toolbox gets the same logs and is used as well as it can be. It needs absl-py,
colorama, PyYAML and tabulate beside MuJoCo and SciPy; plotly and imageio, which draw its reports,
may be missing.
"""

from __future__ import annotations

import io
import os
import re
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from tunenet_logs.analysis.evaluation.study import Order, Part, Row, figure, scored, table
from tunenet_logs.analysis.evaluation.worlds.machines import (
    MACHINES,
    HeldCommands,
    Machine,
    ModelLog,
)
from tunenet_logs.analysis.evaluation.worlds.servos import servo_log, slow_servo_log
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import Piece
from tunenet_logs.analysis.sysid.experiment import ROLLOUTS, SimulatorExperiment
from tunenet_logs.analysis.sysid.fit import SimulatorFit
from tunenet_logs.analysis.sysid.source import ModelSource
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array, Episode, Signal
from tunenet_logs.errors import NotFoundError
from tunenet_logs.recorders.simulators.mujoco import mujoco
from tunenet_logs.terminal import Progress

# ---- Input of `mujoco.sysid` from a log: model sensors, samples, and a first state.

STATES, COMMANDS = "/joint_states", "/joint_commands.position"

_START_S = 0.1  # the first samples, by which the first state is told
# Each of a signal's columns counts as having this share of their largest standard deviation.
_MIN_SHARE = 0.05

_QUANTITIES = {
    "position": "mjSENS_JOINTPOS",
    "velocity": "mjSENS_JOINTVEL",
    "effort": "mjSENS_JOINTACTFRC",
}


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurements of a log."""

    seconds: Array  # of the samples, after the first of all that are simulated, shape (T,)
    values: Array  # in the order of the model's sensors, shape (T, C)
    weights: dict[str, float] | None  # by sensor; None where all columns have one noise
    start: Array  # positions, then velocities, of the joints or in the plane, shape (S,)
    start_reach: Array  # how far that can be off, shape (S,)
    commands: HeldCommands | None  # of the model's actuators; None without any

    def count(self, step_s: float) -> int:
        """Return the number of steps until the last sample, and one more."""
        return int(np.ceil(self.seconds[-1] / step_s)) + 2


def measured(episode: Episode, spec: Any, *, with_efforts: bool) -> Measured:
    """Convert the log's samples; `spec` gets a sensor for each quantity of the joints."""
    pose = next((one for one in episode.signals.values() if one.is_position), None)
    if pose is not None:
        return _posed(pose, spec)
    joints = [joint.name for joint in spec.joints]
    columns: list[Array] = []
    weights: dict[str, float] = {}
    for quantity, kind in _QUANTITIES.items():
        signal = episode.signals.get(f"{STATES}.{quantity}")
        if signal is None or (quantity == "effort" and not with_efforts):
            continue
        spread = np.std(signal.values, axis=0)
        spread = np.maximum(spread, _MIN_SHARE * np.max(spread))
        for joint in joints:
            at = signal.columns.index(joint)
            name = f"{quantity} of {joint}"
            sensor_type = getattr(mujoco().mjtSensor, kind)
            joint_type = mujoco().mjtObj.mjOBJ_JOINT
            spec.add_sensor(name=name, type=sensor_type, objtype=joint_type, objname=joint)
            columns.append(signal.values[:, at])
            weights[name] = 1.0 / float(spread[at])
    positions, velocities = (episode.signals[f"{STATES}.{one}"] for one in ("position", "velocity"))
    start, reach = (
        np.array([of(positions, velocities, joint) for joint in joints]).T.ravel()
        for of in (_state, _reach)
    )
    commands, signal = None, episode.signals.get(COMMANDS)
    if signal is not None:
        seconds = (signal.stamps_ns - int(positions.stamps_ns[0])).astype(np.float64) * 1e-9
        order = [signal.columns.index(joint) for joint in joints]
        commands = HeldCommands(seconds, signal.values[:, order])
    samples = np.column_stack(columns)
    return Measured(positions.seconds, samples, weights, start, reach, commands)


def _state(positions: Signal, velocities: Signal, joint: str) -> tuple[float, float]:
    """Fit position and velocity at the first sample by a parabola through the first of both."""
    at = positions.columns.index(joint)
    first = positions.seconds <= _START_S
    seconds = positions.seconds[first]
    spreads = np.std(positions.values[:, at]), np.std(velocities.values[:, at])
    one, none = np.ones_like(seconds), np.zeros_like(seconds)
    places = np.column_stack([one, seconds, seconds**2 / 2]) / spreads[0]
    speeds = np.column_stack([none, one, seconds]) / spreads[1]
    target = np.concatenate(
        [positions.values[first, at] / spreads[0], velocities.values[first, at] / spreads[1]]
    )
    found = np.linalg.lstsq(np.concatenate([places, speeds]), target, rcond=None)[0]
    return float(found[0]), float(found[1])


def _reach(positions: Signal, velocities: Signal, joint: str) -> tuple[float, float]:
    at = positions.columns.index(joint)
    widest = (np.std(one.values, axis=0) for one in (positions, velocities))
    place, speed = (max(float(one[at]), _MIN_SHARE * float(np.max(one))) for one in widest)
    return 0.3 * place, 0.5 * speed


def _posed(pose: Signal, spec: Any) -> Measured:
    """Convert a free body's positions; the height and the turn at the start are the model's."""
    frame, body_type = mujoco().mjtSensor.mjSENS_FRAMEPOS, mujoco().mjtObj.mjOBJ_BODY
    body = pose.name.split("/")[1]
    spec.add_sensor(name="place", type=frame, objtype=body_type, objname=body)
    first = pose.seconds <= _START_S
    curve = np.polynomial.polynomial.polyfit(pose.seconds[first], pose.values[first, :2], 2)
    start, reach = np.asarray(curve[:2].ravel(), np.float64), np.array([0.02, 0.02, 0.5, 0.5])
    return Measured(pose.seconds, pose.values, None, start, reach, None)


# ---- Estimate with `mujoco.sysid`.

_PLACE = re.compile(r"(?P<kind>[a-z]+)/(?P<name>.+)\.(?P<field>[a-z]+)(?P<index>\[\d\])?")
_DELAY = "delay/commands"
_START = "start"

# Unit in which a delay is tuned, so that its differences are over 2 ms, and not within a step.
_DELAY_UNIT_S = 2000.0


@dataclass(frozen=True, eq=False)
class ToolboxAnswer:
    """Answer of `mujoco.sysid` to a log."""

    values: Mapping[str, float]  # by address
    intervals: Mapping[str, tuple[float, float]]  # of 95 %, by address; infinite where it says so
    rollouts: int  # simulated in all, those of finite differences too
    seconds: float  # CPU time that it took


def toolbox_answer(log: ModelLog, *, tunes_start: bool = False) -> ToolboxAnswer:
    """Estimate the log's parameters with `mujoco.sysid`.

    Residuals are over each signal's standard deviation, which the noise is in proportion to.
    Torques are left out where a delay is tuned: they jump with every command, so that least
    squares over them have a minimum in each 10 ms of it, and the toolbox stays in the nearest.

    Args:
        log: with the owner's model.
        tunes_start: whether the state at the log's start is estimated with the parameters, for
            which the toolbox has no means of its own but a rollout that is handed to it; else it
            is what the log's first samples say.

    Raises:
        NotFoundError: a module that the toolbox imports is not installed.
    """
    # without one of these, names of `mujoco.sysid` are missing
    missing = [one for one in ("absl", "colorama", "tabulate", "yaml") if find_spec(one) is None]
    if missing:
        raise NotFoundError(
            f"mujoco.sysid cannot be imported without {', '.join(missing)}",
            "pip install absl-py colorama PyYAML tabulate",
        )
    sysid = import_module("mujoco.sysid")
    began_s = time.process_time()
    spec = mujoco().MjSpec.from_string(log.model)
    delayed = any(text.startswith(_DELAY) for text in log.tune)
    seen = measured(log.episode, spec, with_efforts=not delayed)
    parameters = sysid.ParameterDict()
    for text in log.tune:
        parameters.add(_parameter(sysid, spec, text))
    if tunes_start:
        low, high = seen.start - seen.start_reach, seen.start + seen.start_reach
        parameters.add(sysid.Parameter(_START, seen.start, low, high))
    model = spec.compile()
    ticks_s = np.arange(seen.count(model.opt.timestep) + 1) * model.opt.timestep
    samples = sysid.TimeSeries.from_names(seen.seconds, seen.values, model)
    controls = sysid.TimeSeries(ticks_s, np.zeros((len(ticks_s), model.nu)))
    start = _full_state(sysid, model, seen.start)
    sequence = sysid.ModelSequences("log", spec, "log", start, controls, samples)
    transform = sysid.SignalTransform(normalize=False)
    if seen.weights is not None:
        transform.set_sensor_weights(seen.weights)
    rollouts = _Rollouts(sysid, seen, samples.signal_mapping)
    residual = sysid.build_residual_fn(
        models_sequences=[sequence],
        modify_residual=transform.apply,
        custom_rollout=rollouts,
        n_threads=1,
        resample_true=False,
    )
    found, result = sysid.optimize(
        parameters.move_off_bounds(),
        residual,
        "mujoco",
        verbose=False,
        max_iters=100,
        # Step of finite differences. At the usual 1.5e-8 the solver's own tolerance is seen; a
        # contact's small hops are other ones at any other value.
        eps=1e-6 if seen.weights is not None else 5e-3,
        xtol=1e-9,  # change over all parameters at which it ends: 2 microseconds of a delay
        x_scale="jac",
        output=io.StringIO(),
    )
    last, _, _ = residual(found.as_vector(), found)
    _, halves = sysid.calculate_intervals(last, result.jac)
    addresses = [text.partition("=")[0] for text in log.tune]
    units = np.array([_DELAY_UNIT_S if one == _DELAY else 1.0 for one in addresses])
    values = units * found.as_vector()[: len(units)]
    halves = units * halves[: len(units)]
    ends = map(tuple, np.column_stack([values - halves, values + halves]).tolist())
    return ToolboxAnswer(
        dict(zip(addresses, values.tolist(), strict=True)),
        dict(zip(addresses, ends, strict=True)),
        rollouts.count,
        time.process_time() - began_s,
    )


class _Rollouts:
    """Rollouts for the toolbox.

    It obeys commands late, starts where a parameter says, and puts sensors' samples at their times:
    MuJoCo takes them at a step's start, and the toolbox has them at its end.
    """

    def __init__(self, sysid: Any, seen: Measured, sensors: Any) -> None:
        self.count = 0
        self._sysid, self._seen, self._sensors = sysid, seen, sensors

    def __call__(
        self,
        *,
        models: Sequence[Any],
        datas: Sequence[Any],
        initial_states: Sequence[Array],
        param_dicts: Sequence[Any],
        **rest: Any,
    ) -> list[Any]:
        """Simulate each model with its parameters."""
        self.count += len(models)
        seen, series = self._seen, self._sysid.TimeSeries
        controls, states = [], list(initial_states)
        for at, (model, parameters) in enumerate(zip(models, param_dicts, strict=True)):
            step_s = model.opt.timestep
            count = seen.count(step_s)
            control = np.zeros((count + 1, model.nu))
            if seen.commands is not None:
                delay_s = 0.0
                if _DELAY in parameters:
                    delay_s = _DELAY_UNIT_S * float(parameters[_DELAY].value[0])
                control = seen.commands.over_steps(step_s, count + 1, delay_s)
            controls.append(series(np.arange(count + 1) * step_s, control))
            if _START in parameters:
                states[at] = _full_state(self._sysid, model, parameters[_START].value)
        rest["control_signal"], rest["initial_states"] = controls, states
        rolled = self._sysid.sysid_rollout(models=models, datas=datas, **rest)
        return [self._on_time(one) for one in rolled]

    def _on_time(self, rolled: Any) -> Any:
        times_s = rolled.sensordata.times - rolled.model.opt.timestep
        # the very map of what is measured: the toolbox compares them with !=
        series = self._sysid.TimeSeries(times_s, rolled.sensordata.data, self._sensors)
        return rolled.replace(sensordata=series)


def _full_state(sysid: Any, model: Any, start: Array) -> Array:
    """Return the simulator's state: of joints, or of a body in the plane."""
    places, speeds = np.split(np.asarray(start), 2)
    positions, velocities = np.array(model.qpos0), np.zeros(model.nv)
    positions[: len(places)], velocities[: len(speeds)] = places, speeds
    return sysid.create_initial_state(model, positions, velocities)


def _parameter(sysid: Any, spec: Any, text: str) -> Any:
    address, _, ends = text.partition("=")
    low, high = map(float, ends.split(":"))
    if address == _DELAY:
        low, high = low / _DELAY_UNIT_S, high / _DELAY_UNIT_S
        return sysid.Parameter(address, (low + high) / 2, low, high)
    place = _PLACE.fullmatch(address)
    assert place is not None
    found = place["kind"], place["name"], place["field"]

    def modify(changed: Any, parameter: Any) -> None:
        _put(changed, *found, float(parameter.value[0]))

    now = min(max(_get(spec, *found), low), high)
    return sysid.Parameter(address, now, low, high, modifier=modify)


def _holder(spec: Any, kind: str, name: str) -> Any:
    """Return the element with the number; of a body without its own mass, its only geom."""
    element = getattr(spec, kind)(name)
    return element.geoms[0] if kind == "body" and not element.mass > 0 else element


def _get(spec: Any, kind: str, name: str, field: str) -> float:
    return float(np.ravel(getattr(_holder(spec, kind, name), field))[0])


def _put(spec: Any, kind: str, name: str, field: str, value: float) -> None:
    """Write a number, the first of an array; with a body's mass go its moments of inertia."""
    holder = _holder(spec, kind, name)
    now = getattr(holder, field)
    if kind == "body" and hasattr(holder, "inertia"):
        holder.inertia = holder.inertia * (value / holder.mass)
    if isinstance(now, np.ndarray) and now.size > 1:
        now[0] = value
    else:
        setattr(holder, field, value)


# ---- One log: tuned by ours, by the toolbox, and by the network's first step.


# Methods that are compared, and how many rollouts each may spend; fits end by themselves.
_METHODS = {"fit": 5, "tunenet": 5, "tunenet+refine": 5, "cma-es": 200}
_WRONG_END = 0.05  # of a parameter's range: an answer that is farther off is another minimum's

# Those of all sections, then what the section of servos asks about: sizes in place of noise.
_MACHINES = (*MACHINES, Machine("servo", servo_log, servo_log, slow_servo_log, lambda _: {}))


@dataclass(frozen=True)
class MachineTrial:
    """Log to be tuned."""

    section: str  # what is asked of it
    machine: int  # its number in `MACHINES`
    seed: int  # of it
    noise: float = 1.0  # times the usual one


def rows_of(trial: MachineTrial) -> list[Row]:
    """Run a trial: a row for each model and parameter, or one alone where none was found."""
    machine = _MACHINES[trial.machine]
    if trial.section == "untold":
        return _tuned(trial, machine.unidentifiable(trial.seed, trial.noise))
    log = machine.log(trial.seed, trial.noise)
    if trial.section in ("tuned", "servos"):
        return _tuned(trial, log)
    if trial.section == "together":
        other = machine.again(trial.seed, trial.noise).episode
        return [*_tuned(trial, log, "one"), *_tuned(trial, log, "both", together=(other,))]
    if trial.section == "network":
        return _first_steps(trial, log)
    if trial.section == "methods":
        rng = np.random.default_rng((trial.seed, 78))
        ranges = _ranges(log)
        far = tuple(float(rng.uniform(*ends)) for ends in ranges)
        return [
            row
            for method, most in _METHODS.items()
            for what, start in (("given", None), ("anywhere", far))
            for row in _tuned(
                trial, log, f"{method} from {what}", method=method, iterations=most, initial=start
            )
        ]
    if trial.section == "toolbox":
        answer = toolbox_answer(log, tunes_start=True)
        found = [
            _estimate(address, truth, answer.values[address], *answer.intervals[address])
            for address, truth in log.truth.items()
        ]
        return _rows(trial, found, "", answer.rollouts, answer.seconds, "")
    return [
        row
        for what, model in machine.wrong(log).items()
        for row in _tuned(trial, replace(log, model=model), what)
    ]


def _ranges(log: ModelLog) -> list[tuple[float, float]]:
    with tempfile.TemporaryDirectory() as folder:
        return [one.training_range for one in _source(log, folder).parameters]


def _source(log: ModelLog, folder: str) -> ModelSource:
    path = Path(folder) / "model.xml"
    path.write_text(log.model)
    return ModelSource(path, log.tune)


def _rows(
    trial: MachineTrial,
    found: Sequence[Row],
    verdict: str,
    rollouts: int,
    seconds: float,
    what: str,
) -> list[Row]:
    """Say of each estimate what it is of; `seconds` are the processor's."""
    log = {
        "section": trial.section,
        "machine": _MACHINES[trial.machine].name,
        "seed": trial.seed,
        "noise": trial.noise,
        "what": what,  # of several models of one log
        "verdict": verdict,  # "" of the toolbox, which gives none
        "rollouts": rollouts,
        "seconds": round(seconds, 2),
    }
    return [{**log, **one} for one in found] or [log]


def _tuned(trial: MachineTrial, log: ModelLog, what: str = "", **options: Any) -> list[Row]:
    with tempfile.TemporaryDirectory() as folder:
        began_s = sum(os.times()[:4])
        source = _source(log, folder)
        tuning = tune_episode(log.episode, TuneOptions(source=source, **options))
        source.process.close()  # what it took is known when it has ended
        seconds = sum(os.times()[:4]) - began_s
    found: list[Row] = []
    if tuning.trace is not None and tuning.trace.fit is None:  # only fits give intervals
        found = [
            {
                **_estimate(one.name, log.truth[one.name], value),
                "range": float(np.ptp(one.training_range)),
            }
            for one, value in zip(tuning.parameters, tuning.trace.estimate, strict=True)
        ]
    elif tuning.trace is not None and tuning.trace.fit is not None:
        fit: SimulatorFit = tuning.trace.fit.detail
        unidentifiable = {one.name for one in fit.unidentifiable}
        for one, value, ends in zip(
            tuning.parameters, tuning.trace.estimate, tuning.trace.fit.interval95, strict=True
        ):
            # another machine's model has none; a servo lacks what it does not name
            is_wrong = trial.section == "wrong"
            truth = np.nan if is_wrong else log.truth.get(one.name, 0.0)
            found.append(
                {
                    **_estimate(one.name, truth, value, *ends),
                    "range": float(np.ptp(one.training_range)),
                    "is_told": one.name not in unidentifiable,  # reported as identifiable
                    "can_be_told": one.name not in log.unidentifiable,
                }
            )
    return _rows(trial, found, tuning.verdict, tuning.rollouts, seconds, what)


def _estimate(
    address: str, truth: float, value: float, low: float = np.nan, high: float = np.nan
) -> Row:
    numbers = {"truth": truth, "value": value, "low": low, "high": high}
    return {"address": address, **{name: float(number) for name, number in numbers.items()}}


def _first_steps(trial: MachineTrial, log: ModelLog) -> list[Row]:
    """Take one step of the network from each of many random starts: a row a start and value."""
    from tunenet_logs.analysis.estimators.methods import next_values

    with tempfile.TemporaryDirectory() as folder:
        began_s = time.process_time()
        experiment = SimulatorExperiment(_source(log, folder))
        detection = experiment.detect(log.episode, TuneOptions(), "default")
        parameters = experiment.source.parameters
        problem = experiment.problem(detection, np.array([one.initial for one in parameters]))
        assert problem.train is not None
        model = problem.train()
        seconds = time.process_time() - began_s
    rng = np.random.default_rng((trial.seed, 77))
    found: list[Row] = []
    for _ in range(20):
        start = np.array([rng.uniform(*one.training_range) for one in parameters])
        seen = problem.evaluate(start).observation.values
        stepped = next_values(model, problem, start, seen)
        found += [
            {
                **_estimate(one.name, log.truth[one.name], value),
                "range": float(np.ptp(one.training_range)),
            }
            for one, value in zip(parameters, stepped, strict=True)
        ]
    return _rows(trial, found, "", ROLLOUTS, seconds, "")


# ---- Run: section by section.

NOISES = (1.0, 0.5, 2.0)  # times the noise that the logs usually have


def run(order: Order, progress: Progress) -> Iterator[Part]:
    """Run the trials of each section."""
    for section in order.sections:
        cases = [
            Piece(trial, name=f"{_MACHINES[trial.machine].name} {trial.seed}")
            for trial in trials(section, order.seeds, order.targets)
        ]
        rows = scored(rows_of, {section: cases}, order, progress, (section, "log"))[section]
        what = f"{order.seeds_in_words}, {order.targets} logs a machine"
        yield Part(section, sysid_table(section, rows, f"{_HEADS[section]} {what}."), rows)


def trials(section: str, seeds: Sequence[int], logs: int) -> list[MachineTrial]:
    """List the trials of a section: so many logs for each seed, machine and noise.

    For the network a twentieth of them.
    """
    # Two runs of a pendulum alone: each of the others' takes minutes.
    servos = range(len(MACHINES), len(_MACHINES))
    every = {"servos": servos, "together": range(1), "untold": range(len(_MACHINES))}
    noises = NOISES if section in ("tuned", "servos", "together") else (1.0,)
    logs = max(1, logs // 20) if section == "network" else logs
    return [
        MachineTrial(section, machine, seed * 1_000_000 + log, noise)
        for machine in every.get(section, range(len(MACHINES)))
        for seed in seeds
        for noise in noises
        for log in range(logs)
    ]


# ---- Tables for a terminal.

_HEADS = {
    "tuned": "Tuned by the default method: logs of machines that SciPy integrates.",
    "together": "Two swings of one pendulum in one fit, beside the first alone.",
    "toolbox": "The same logs by mujoco.sysid, the state at the start tuned along.",
    "untold": "One more parameter is tuned, which such a log cannot tell.",
    "wrong": "Models of other machines: none should come out ok.",
    "servos": "Terms of servos chosen by each log (`--tune actuators`), of half to twice the size.",
    "network": "One step of a network trained on the spot, from 20 random starts a log.",
    "methods": f"From the given start and from anywhere; {ROLLOUTS} rollouts train a network.",
}


def sysid_table(section: str, rows: Sequence[Row], head: str) -> str:
    """Tabulate one section: a line for each machine, noise and parameter, or for each model."""
    lines: list[list[str]] = []
    if section == "wrong":
        lines.append(["machine", "model", "tries", "ok", "suspect", "rejected"])
        # a model has a row for each of its parameters
        tries = {(row["machine"], row["what"], row["seed"]): row["verdict"] for row in rows}
        for machine, what in dict.fromkeys((machine, what) for machine, what, _ in tries):
            mine = [one for key, one in tries.items() if key[:2] == (machine, what)]
            counts = [str(mine.count(name)) for name in ("ok", "suspect", "rejected")]
            lines.append([machine, what, str(len(mine)), *counts])
        return table(lines, f"{section}: {head}")
    if section in ("together", "methods"):
        lines = _together(rows) if section == "together" else _by_method(rows)
        return table(lines, f"{section}: {head}")
    heads = {
        "untold": ["machine", "parameter", "logs", "cannot be told", "said so"],
        "network": ["machine", "parameter", "logs", "median", "of the range"],
    }
    errors_heads = ["machine", "noise", "parameter", "logs", "median", "of truth", "worst"]
    lines.append(heads.get(section, [*errors_heads, "covered", "rollouts", "s"]))
    groups: dict[tuple[str, float, str], list[Row]] = {}
    for row in rows:
        if "address" in row:
            groups.setdefault((row["machine"], row["noise"], row["address"]), []).append(row)
    for (machine, noise, address), own in groups.items():
        errors = np.array([abs(row["value"] - row["truth"]) for row in own])
        if section == "untold":
            cells = ["no" if own[0]["can_be_told"] else "yes"]
            cells.append(f"{100 * np.mean([not row['is_told'] for row in own]):.1f} %")
            lines.append([machine, address, str(len(own)), *cells])
        elif section == "network":
            logs = len({row["seed"] for row in own})
            share = 100 * np.median(errors) / own[0]["range"]
            cells = [str(logs), f"{np.median(errors):.2g}", f"{share:.2f} %"]
            lines.append([machine, address, *cells])
        else:
            truths = np.abs([row["truth"] for row in own])
            shares = errors[truths > 0] / truths[truths > 0]
            covered = [row["low"] <= row["truth"] <= row["high"] for row in own]
            cells = [
                str(len(own)),
                f"{np.median(errors):.2g}",
                f"{100 * (figure(shares, np.median) or 0.0):.2f} %",
            ]
            cells += [f"{errors.max():.2g}", f"{100 * np.mean(covered):.1f} %"]
            cells.append(f"{figure([row['rollouts'] for row in own], np.median):.0f}")
            cells.append(f"{figure([row['seconds'] for row in own], np.median):.1f}")
            lines.append([machine, f"{noise:g}", address, *cells])
    return table(lines, f"{section}: {head}")


def _together(rows: Sequence[Row]) -> list[list[str]]:
    """Return lines of a table: for each machine, noise and parameter, both runs beside the one."""
    lines = [["machine", "noise", "parameter", "pairs", "width", "one covers", "both cover", "ok"]]
    groups: dict[tuple[str, float, str], dict[str, list[Row]]] = {}
    for row in rows:
        if "address" in row:
            key = row["machine"], row["noise"], row["address"]
            groups.setdefault(key, {"one": [], "both": []})[row["what"]].append(row)
    for (machine, noise, address), own in groups.items():
        widths = {
            what: {row["seed"]: row["high"] - row["low"] for row in some}
            for what, some in own.items()
        }
        ratios = [
            width / widths["one"][seed]
            for seed, width in widths["both"].items()
            if seed in widths["one"]
        ]
        covered = [
            f"{100 * np.mean([row['low'] <= row['truth'] <= row['high'] for row in some]):.1f} %"
            for some in own.values()
        ]
        oks = sum(row["verdict"] == "ok" for row in own["both"])
        cells = [str(len(ratios)), f"{np.median(ratios):.2f}", *covered, str(oks)]
        lines.append([machine, f"{noise:g}", address, *cells])
    return lines


def _by_method(rows: Sequence[Row]) -> list[list[str]]:
    """Return lines of a table: for each machine and method, how often it ends elsewhere."""
    heads = ["machine", "method", "tries", "elsewhere", "ok so", "median, of the range"]
    lines = [[*heads, "rollouts", "s"]]
    groups: dict[tuple[str, str], dict[int, list[Row]]] = {}
    for row in rows:
        tries = groups.setdefault((row["machine"], row["what"]), {})
        tries.setdefault(row["seed"], []).append(row)
    for (machine, what), tries in groups.items():
        shares = np.array(
            [
                max(abs(row["value"] - row["truth"]) / row["range"] for row in found)
                if "value" in found[0]
                else np.inf  # nothing was found
                for found in tries.values()
            ]
        )
        spent = np.array([[found[0]["rollouts"], found[0]["seconds"]] for found in tries.values()])
        rollouts, seconds = np.median(spent, axis=0)
        is_off = shares > _WRONG_END
        oks = sum(
            found[0]["verdict"] == "ok"
            for found, off in zip(tries.values(), is_off, strict=True)
            if off
        )
        cells = [str(len(shares)), str(np.count_nonzero(is_off)), str(oks)]
        cells += [f"{100 * np.median(shares):.2g} %", f"{rollouts:.0f}", f"{seconds:.1f}"]
        lines.append([machine, what, *cells])
    return lines
