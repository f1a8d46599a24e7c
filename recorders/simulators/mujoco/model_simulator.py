"""Simulate a user's MuJoCo model, driven by a log's commands and sensed as the log was."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recorders.simulators.base import Parameter
from recorders.simulators.installed import named_version
from recorders.simulators.mujoco.library import mujoco
from recorders.simulators.mujoco.model_child import put_array
from recorders.simulators.mujoco.model_fields import TUNED_ARRAYS
from recorders.simulators.mujoco.model_parameters import DELAY, ModelParameter
from recorders.simulators.mujoco.model_process import ModelProcess
from recorders.simulators.mujoco.model_sensors import SensedSignal, Sensor, put_sensors
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.errors import LogError, UsageError

MAX_STEPS = 300_000  # of one rollout: five minutes at 1 ms
STOPPED = "stopped"  # in a rollout's notes: what stopped it before its end; "" where nothing did
_MEMORY_IS_FULL = "its working memory is full"
# By how MuJoCo's names of what stops a rollout begin; what else there is, is of memory.
_STOPS = {
    "mjWARN_INERTIA": "a mass or inertia is next to nothing",
    "mjWARN_BAD": "it moves beyond all bounds",
    "time": "it stops",
}

_MAX_BATCH_BYTES = 50_000_000
_MAX_BATCH = 64

# Integrators that step speeds first, then positions with them: their speeds are those of half a
# step before, to second order.
_LATE_BY_HALF_A_STEP = ("mjINT_EULER", "mjINT_IMPLICIT", "mjINT_IMPLICITFAST")


@dataclass(frozen=True, eq=False)
class Drive:
    """A signal that drives the model.

    Attributes:
        columns: indices of its columns that drive something, shape (C,).
        targets: the actuator or degree of freedom that each drives, shape (C,).
        is_effort: whether its values are measured efforts, interpolated and applied at joints; else
            commands to actuators, each of which holds until the next one (zero-order hold).
    """

    signal: Signal
    columns: NDArray[np.intp]
    targets: NDArray[np.intp]
    is_effort: bool


@dataclass(frozen=True, eq=False)
class InitialState:
    """The initial state of a rollout, and its uncertainty.

    Attributes:
        qpos: shape (nq,).
        qvel: shape (nv,).
        unsure: parameters of what the log leaves uncertain, each with its prior.
        places: where each goes: whether it is a speed, and its index in `qpos` or `qvel`.
    """

    stamp_ns: int
    qpos: Array
    qvel: Array
    unsure: tuple[Parameter, ...] = ()
    places: tuple[tuple[bool, int], ...] = ()


@dataclass(frozen=True, eq=False)
class ModelSimulator:
    """A compiled model, driven and sensed as in a log.

    Attributes:
        spec: the model; not compiled with `sensed` yet.
        tuned: its tuned parameters.
        sensed: signals to compare.
        drives: signals that drive it.
        process: where it is run.
        step_s: of its integrator; None for the model's own.
    """

    spec: Any
    tuned: tuple[ModelParameter, ...]
    sensed: tuple[SensedSignal, ...]
    drives: tuple[Drive, ...]
    initial: InitialState
    end_ns: int
    process: ModelProcess
    step_s: float | None = None

    @property
    def engine(self) -> str:
        """See `Simulator`."""
        return named_version("mujoco")

    @property
    def step_hz(self) -> float:
        """See `Simulator`."""
        return 1.0 / self._step_s

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Tuned parameters, and uncertain ones of the initial state."""
        return (*(one.parameter for one in self.tuned), *self.initial.unsure)

    def finer(self) -> ModelSimulator:
        """Copy with half the step, to measure the discretisation error."""
        half = replace(self, step_s=self._step_s / 2)
        half.__dict__["_model"] = self._model  # compiled once
        return half

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """Roll out one episode: signals of `sensed` at their stamps; see `Simulator`."""
        row = [one.checked(values.get(one.name, one.initial)) for one in self.parameters]
        found = self.rollouts(np.array([row]))[0]
        if found.info.notes[STOPPED].startswith(_MEMORY_IS_FULL):
            raise LogError(
                f"{self.process.path}: {found.info.notes[STOPPED]}",
                f'give it more, such as <size memory="{_more_memory(self._model.narena)}"/>',
            )
        return found

    def rollouts(self, values: Array) -> list[Episode]:
        """Roll out several episodes at once, on all cores.

        Args:
            values: of all parameters, shape (N, P).

        Returns:
            N of them; from where MuJoCo stops a rollout its values are NaN, and `STOPPED` in its
            notes says why.
        """
        each_bytes = 8 * self._steps * (self._model.nsensordata + len(self._driven))
        count = int(np.clip(_MAX_BATCH_BYTES // each_bytes, 1, _MAX_BATCH))
        found: list[Episode] = []
        for first in range(0, len(values), count):
            found += self._batch(values[first : first + count])
        return found

    def coordinates(self, values: Array) -> tuple[Array, Array]:
        """Roll out at `values` of shape (P,); return the coordinates after each step.

        Returns:
            Seconds since the initial stamp, shape (T,); qpos then, shape (T, nq), which stays as it
            is where the rollout diverges.
        """
        (kept,), _, found = self._rolled(values[None], wants_qpos=True)
        places = np.arange(self._steps + 1)
        seconds = np.asarray(self._step_s * places, np.float64)
        return seconds, found["qpos"][0][np.minimum(places, kept)]

    @cached_property
    def _model(self) -> Any:
        """Compiled model, with sensors of the compared signals alone."""
        spec = self.spec.copy()
        put_sensors(spec, self._distinct)
        return spec.compile()

    @property
    def _step_s(self) -> float:
        return float(self._model.opt.timestep if self.step_s is None else self.step_s)

    @cached_property
    def _distinct(self) -> list[Sensor]:
        """Each vector sensor once."""
        return list(
            dict.fromkeys(sensor.whole for sensed in self.sensed for sensor in sensed.sensors)
        )

    @cached_property
    def _steps(self) -> int:
        seconds, step_s = (self.end_ns - self.initial.stamp_ns) * 1e-9, self._step_s
        if seconds / step_s > MAX_STEPS:
            raise UsageError(
                f"the log is longer than {MAX_STEPS} steps of {step_s:g} s",
                f"choose a part of at most {MAX_STEPS * step_s:.0f} s with --start and --end",
            )
        return int(np.ceil(seconds / step_s)) + 2

    @cached_property
    def _driven(self) -> NDArray[np.intp]:
        """Indices of what is driven, among controls and then the efforts of joints."""
        targets = [one.targets + self._model.nu * one.is_effort for one in self.drives]
        return np.unique(np.concatenate([np.zeros(0, np.intp), *targets]))

    def _batch(self, values: Array) -> list[Episode]:
        kept, why, found = self._rolled(values)
        rolled = zip(found["sensed"], values, kept, why, strict=True)
        return [
            self._episode(seen, row, _in_words(stop, steps * self._step_s))
            for seen, row, steps, stop in rolled
        ]

    def _rolled(
        self, values: Array, *, wants_qpos: bool = False
    ) -> tuple[list[int], list[str], dict[str, Array]]:
        """Roll out rows; return the steps of each, what stopped it, and sensor values."""
        delays = [self._delay_s(row) for row in values]
        known = sorted(set(delays))
        rows = [
            (self._changed(row), *self._state(row), known.index(delay_s))
            for row, delay_s in zip(values, delays, strict=True)
        ]
        return self.process.run(
            self._model,
            rows=rows,
            controls=[self._control(delay_s) for delay_s in known],
            columns=self._driven,
            steps=self._steps,
            step_s=self._step_s,
            is_late=self._is_late,
            wants_qpos=wants_qpos,
        )

    def _changed(self, row: Array) -> list[tuple[str, Array]]:
        """Return the model's arrays that these values change, by name."""
        model = self._model
        before = {name: np.array(attrgetter(name)(model)) for name in TUNED_ARRAYS}
        for one, value in zip(self.tuned, row, strict=False):
            one.put(model, float(value))
        after = {name: np.array(attrgetter(name)(model)) for name in TUNED_ARRAYS}
        for name, values in before.items():
            put_array(model, name, values)
        return [(name, after[name]) for name in before if (after[name] != before[name]).any()]

    def _state(self, row: Array) -> tuple[Array, Array]:
        """Return the initial qpos and qvel."""
        qpos, qvel = self.initial.qpos.copy(), self.initial.qvel.copy()
        unsure = row[len(self.tuned) :]
        for value, (is_speed, place) in zip(unsure, self.initial.places, strict=True):
            (qvel if is_speed else qpos)[place] = value
        return qpos, qvel

    def _delay_s(self, row: Array) -> float:
        named = zip(self.tuned, row, strict=False)
        return next((float(value) for one, value in named if one.parameter.name == DELAY), 0.0)

    def _control(self, delay_s: float) -> Array:
        """Compute the controls of each step, shape (steps, `_driven`)."""
        step_s = self._step_s
        # a step kicks speeds of half a step before to those of half a step after its begin
        edges_s = np.arange(self._steps + 1, dtype=np.float64)
        edges_s = step_s * (edges_s - 0.5 * self._is_late)
        control = np.zeros((self._steps, len(self._driven)))
        for drive in self.drives:
            since_ns = drive.signal.stamps_ns - self.initial.stamp_ns
            at_s = np.asarray(since_ns, np.float64) * 1e-9
            places = np.searchsorted(self._driven, drive.targets + self._model.nu * drive.is_effort)
            for column, place in zip(drive.columns, places, strict=True):
                values = drive.signal.values[:, column]
                good = np.isfinite(values)
                seconds, values = at_s[good], values[good]
                if drive.is_effort:
                    middle_s = edges_s[:-1] + step_s / 2
                    control[:, place] = np.interp(middle_s, seconds, values)
                else:
                    control[:, place] = held_means(seconds, values, edges_s - delay_s)
        return control

    @property
    def _is_late(self) -> bool:
        kinds = mujoco().mjtIntegrator
        return self._model.opt.integrator in [getattr(kinds, one) for one in _LATE_BY_HALF_A_STEP]

    def _episode(self, seen: Array, row: Array, stopped: str) -> Episode:
        """Resample sensor values, shape (steps, S), as the log's signals."""
        step_s = self._step_s
        at_s = step_s * np.arange(self._steps)  # sensors see the state that a step begins with
        signals: dict[str, Signal] = {}
        for sensed in self.sensed:
            wanted_s = (sensed.signal.stamps_ns - self.initial.stamp_ns) * 1e-9
            values = np.empty((len(wanted_s), len(sensed.columns)))
            for place, sensor in enumerate(sensed.sensors):
                number = self._distinct.index(sensor.whole)
                track = sensor.sign * seen[:, self._model.sensor_adr[number] + sensor.axis]
                late_s = step_s / 2 if sensor.kind == "jointvel" and self._is_late else 0.0
                values[:, place] = np.interp(wanted_s, at_s - late_s, track, right=np.nan)
            signal = sensed.signal
            signals[signal.name] = Signal(
                signal.name, signal.stamps_ns, values, sensed.columns, signal.unit
            )
        names = [one.name for one in self.parameters]
        truth = dict(zip(names, map(float, row), strict=True))
        info = EpisodeInfo(source=self.engine, truth=truth, notes={STOPPED: stopped})
        return Episode(info, signals)


def held_means(at_s: Array, values: Array, edges_s: Array) -> Array:
    """Average a zero-order-hold signal between edges.

    Args:
        at_s: when each value begins, shape (T,), increasing; the first holds before it, too.
        values: shape (T,).
        edges_s: shape (N + 1,), increasing.

    Returns:
        Shape (N,), continuous in a shift of the edges.
    """
    if not len(at_s):
        return np.zeros(len(edges_s) - 1)
    area = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(at_s))])
    place = np.clip(np.searchsorted(at_s, edges_s, "right") - 1, 0, len(at_s) - 1)
    until = area[place] + values[place] * (edges_s - at_s[place])
    return np.diff(until) / np.diff(edges_s)


def _in_words(stop: str, at_s: float) -> str:
    """Describe why a rollout stopped; "" where it did not."""
    if not stop:
        return ""
    words = (said for begin, said in _STOPS.items() if stop.startswith(begin))
    what = next(words, _MEMORY_IS_FULL)
    rest = ", and MuJoCo leaves contacts out" if what == _MEMORY_IS_FULL else ""
    return f"{what} after {at_s:.3g} s of the rollout{rest}"


def _more_memory(now_bytes: int) -> str:
    """Suggest a <size memory>."""
    return f"{max(now_bytes * 4 // 1_000_000, 10)}M"
