"""Tune the same logs with `mujoco.sysid`, MuJoCo's own toolbox, used as well as it can be.

It needs absl-py, colorama, PyYAML and tabulate beside MuJoCo and SciPy; plotly and imageio, which
draw its reports, may be missing.
"""

from __future__ import annotations

import io
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from analysis.evaluation.sysid.baseline_measured import Measured, measured
from analysis.evaluation.sysid.model_log import ModelLog
from recorders.simulators.mujoco.library import mujoco
from tunenet_logs.arrays import Array
from tunenet_logs.errors import NotFoundError

# Modules that `mujoco.sysid` imports; without one of them its names are missing.
NEEDED = ("absl", "colorama", "tabulate", "yaml")

_PLACE = re.compile(r"(?P<kind>[a-z]+)/(?P<name>.+)\.(?P<field>[a-z]+)(?P<index>\[\d\])?")
_DELAY = "delay/commands"
_START = "start"
# Of finite differences, in place of 1.5e-8, at which the solver's own tolerance is seen.
_STEP = 1e-6

# In which a delay is tuned, so that its differences are over 2 ms, and not within a step.
_DELAY_UNIT_S = 2000.0

# Of the parameters, over all of them, at which it ends: 2 microseconds of a delay.
_MIN_CHANGE = 1e-9

# The same where a contact is simulated, whose small hops are other ones at any other value.
_CONTACT_STEP = 5e-3

_MAX_ITERATIONS = 100


@dataclass(frozen=True, eq=False)
class ToolboxAnswer:
    """Answer of `mujoco.sysid` to a log.

    Attributes:
        values: by address.
        intervals: of 95 %, by address; infinite where it says so.
        rollouts: simulated in all, those of finite differences too.
        seconds: CPU time that it took.
    """

    values: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]
    rollouts: int
    seconds: float


def toolbox_answer(log: ModelLog, *, tunes_start: bool = False, threads: int = 1) -> ToolboxAnswer:
    """Estimate the log's parameters with `mujoco.sysid`.

    Residuals are over each signal's standard deviation, which the noise is in proportion to.
    Torques are left out where a delay is tuned: they jump with every command, so that least
    squares over them have a minimum in each 10 ms of it, and the toolbox stays in the nearest.

    Args:
        log: with the owner's model.
        tunes_start: whether the state at the log's start is estimated with the parameters, for
            which the toolbox has no means of its own but a rollout that is handed to it; else it
            is what the log's first samples say.
        threads: that simulate.

    Raises:
        NotFoundError: a module that the toolbox imports is not installed.
    """
    sysid = _toolbox()
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
    sequence = sysid.ModelSequences(
        "log",
        spec,
        "log",
        _full_state(sysid, model, seen.start),
        sysid.TimeSeries(ticks_s, np.zeros((len(ticks_s), model.nu))),
        samples,
    )
    transform = sysid.SignalTransform(normalize=False)
    if seen.weights is not None:
        transform.set_sensor_weights(seen.weights)
    rollouts = _Rollouts(sysid, seen, samples.signal_mapping)
    residual = sysid.build_residual_fn(
        models_sequences=[sequence],
        modify_residual=transform.apply,
        custom_rollout=rollouts,
        n_threads=threads,
        resample_true=False,
    )
    found, result = sysid.optimize(
        parameters.move_off_bounds(),
        residual,
        "mujoco",
        verbose=False,
        max_iters=_MAX_ITERATIONS,
        eps=_STEP if seen.weights is not None else _CONTACT_STEP,
        xtol=_MIN_CHANGE,
        x_scale="jac",
        output=io.StringIO(),
    )
    last, _, _ = residual(found.as_vector(), found)
    _, halves = sysid.calculate_intervals(last, result.jac)
    addresses = [text.partition("=")[0] for text in log.tune]
    units = np.array([_DELAY_UNIT_S if one == _DELAY else 1.0 for one in addresses])
    values = units * found.as_vector()[: len(units)]
    halves = units * halves[: len(units)]
    ends = np.column_stack([values - halves, values + halves])
    intervals = {
        one: (low, high) for one, (low, high) in zip(addresses, ends.tolist(), strict=True)
    }
    return ToolboxAnswer(
        dict(zip(addresses, values.tolist(), strict=True)),
        intervals,
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
                delay_s = _seconds(parameters[_DELAY].value) if _DELAY in parameters else 0.0
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


def _toolbox() -> Any:
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise NotFoundError(
            f"mujoco.sysid cannot be imported without {', '.join(missing)}",
            "pip install absl-py colorama PyYAML tabulate",
        )
    return import_module("mujoco.sysid")


def _full_state(sysid: Any, model: Any, start: Array) -> Array:
    """Return the simulator's state: of joints, or of a body in the plane."""
    places, speeds = np.split(np.asarray(start), 2)
    positions, velocities = np.array(model.qpos0), np.zeros(model.nv)
    positions[: len(places)], velocities[: len(speeds)] = places, speeds
    return sysid.create_initial_state(model, positions, velocities)


def _seconds(delay: Array) -> float:
    return _DELAY_UNIT_S * float(delay[0])


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
