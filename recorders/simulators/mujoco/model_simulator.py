"""A user's MuJoCo model as a simulator: driven as a log was, and seen as the log saw the robot."""

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

MOST_STEPS = 300_000
"""Of one rollout: five minutes at 1 ms."""

STOPPED = "stopped"
"""In a rollout's notes: what stopped it before its end; "" where nothing did."""

_MEMORY_IS_FULL = "its working memory is full"
_STOPS = {
    "mjWARN_INERTIA": "a mass or inertia is next to nothing",
    "mjWARN_BAD": "it moves beyond all bounds",
    "time": "it stops",
}
"""By how MuJoCo's names of what stops a rollout begin; what else there is, is of memory."""

_MOST_BATCH_BYTES = 50_000_000
_MOST_BATCH = 64

_LATE_BY_HALF_A_STEP = ("mjINT_EULER", "mjINT_IMPLICIT", "mjINT_IMPLICITFAST")
"""Integrators that step speeds first, then positions with them: their speeds are those of half a
step before, to second order."""


@dataclass(frozen=True, eq=False)
class Drive:
    """What moves the model.

    Attributes:
        signal: of the log.
        columns: numbers of its columns that drive something, shape (C,).
        targets: the actuator or degree of freedom that each drives, shape (C,).
        is_effort: whether its values are measured efforts, applied at joints as they are between
            two samples; else commands to actuators, each of which holds until the next one.
    """

    signal: Signal
    columns: NDArray[np.intp]
    targets: NDArray[np.intp]
    is_effort: bool


@dataclass(frozen=True, eq=False)
class InitialState:
    """Where a rollout begins, and how well that is known.

    Attributes:
        stamp_ns: when.
        qpos: shape (nq,).
        qvel: shape (nv,).
        unsure: parameters of what the log leaves unsure, each with its prior.
        places: where each goes: whether it is a speed, and its number in `qpos` or `qvel`.
    """

    stamp_ns: int
    qpos: Array
    qvel: Array
    unsure: tuple[Parameter, ...] = ()
    places: tuple[tuple[bool, int], ...] = ()


@dataclass(frozen=True, eq=False)
class ModelSimulator:
    """A compiled model that is driven and seen as a log was.

    Attributes:
        spec: the model; not compiled with `sensed` yet.
        tuned: its parameters that are looked for.
        sensed: what is compared.
        drives: what moves it.
        initial: where it begins.
        end_ns: when it ends.
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
        """Those that are tuned, and what of the initial state is unsure."""
        return (*(one.parameter for one in self.tuned), *self.initial.unsure)

    def finer(self) -> ModelSimulator:
        """The same with half the step: what its step does to its answer can be told by it."""
        half = replace(self, step_s=self._step_s / 2)
        half.__dict__["_model"] = self._model  # compiled once
        return half

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """One episode with the signals of `sensed`, at their own stamps; see `Simulator`."""
        row = [one.checked(values.get(one.name, one.initial)) for one in self.parameters]
        found = self.rollouts(np.array([row]))[0]
        if found.info.notes[STOPPED].startswith(_MEMORY_IS_FULL):
            raise LogError(
                f"{self.process.path}: {found.info.notes[STOPPED]}",
                f'give it more, such as <size memory="{_more_memory(self._model.narena)}"/>',
            )
        return found

    def rollouts(self, values: Array) -> list[Episode]:
        """Several episodes at once, on all cores.

        Args:
            values: of all parameters, shape (N, P).

        Returns:
            N of them; from where MuJoCo stops a rollout its values are NaN, and `STOPPED` in its
            notes says why.
        """
        each_bytes = 8 * self._steps * (self._model.nsensordata + len(self._driven))
        count = int(np.clip(_MOST_BATCH_BYTES // each_bytes, 1, _MOST_BATCH))
        found: list[Episode] = []
        for first in range(0, len(values), count):
            found += self._batch(values[first : first + count])
        return found

    def coordinates(self, values: Array) -> tuple[Array, Array]:
        """How a rollout at `values` of shape (P,) moves, step by step.

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
        """The compiled model, with sensors of what is compared alone."""
        spec = self.spec.copy()
        put_sensors(spec, self._distinct)
        return spec.compile()

    @property
    def _step_s(self) -> float:
        return float(self._model.opt.timestep if self.step_s is None else self.step_s)

    @cached_property
    def _distinct(self) -> list[Sensor]:
        """Each sensor once, without its axis."""
        return list(
            dict.fromkeys(sensor.whole for sensed in self.sensed for sensor in sensed.sensors)
        )

    @cached_property
    def _steps(self) -> int:
        seconds, step_s = (self.end_ns - self.initial.stamp_ns) * 1e-9, self._step_s
        if seconds / step_s > MOST_STEPS:
            raise UsageError(
                f"the log is longer than {MOST_STEPS} steps of {step_s:g} s",
                f"choose a part of at most {MOST_STEPS * step_s:.0f} s with --start and --end",
            )
        return int(np.ceil(seconds / step_s)) + 2

    @cached_property
    def _driven(self) -> NDArray[np.intp]:
        """Numbers of what is driven, among controls and then the efforts of joints."""
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
        """Steps that each makes, what stops it, and what is seen after the steps."""
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
        """Those of the model's arrays that these values change, by name."""
        model = self._model
        before = {name: np.array(attrgetter(name)(model)) for name in TUNED_ARRAYS}
        for one, value in zip(self.tuned, row, strict=False):
            one.put(model, float(value))
        after = {name: np.array(attrgetter(name)(model)) for name in TUNED_ARRAYS}
        for name, values in before.items():
            put_array(model, name, values)
        return [(name, after[name]) for name in before if (after[name] != before[name]).any()]

    def _state(self, row: Array) -> tuple[Array, Array]:
        """Where it begins: qpos and qvel."""
        qpos, qvel = self.initial.qpos.copy(), self.initial.qvel.copy()
        unsure = row[len(self.tuned) :]
        for value, (is_speed, place) in zip(unsure, self.initial.places, strict=True):
            (qvel if is_speed else qpos)[place] = value
        return qpos, qvel

    def _delay_s(self, row: Array) -> float:
        named = zip(self.tuned, row, strict=False)
        return next((float(value) for one, value in named if one.parameter.name == DELAY), 0.0)

    def _control(self, delay_s: float) -> Array:
        """What drives each step, shape (steps, `_driven`)."""
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
        """Sensor values after each step, shape (steps, S), as the log's signals."""
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
    """Means between edges of a signal that holds each value until the next one.

    Args:
        at_s: when each value begins, shape (T,), increasing; the first holds before it, too.
        values: shape (T,).
        edges_s: shape (N + 1,), increasing.

    Returns:
        Shape (N,): it depends on a shift of the edges without jumps.
    """
    if not len(at_s):
        return np.zeros(len(edges_s) - 1)
    area = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(at_s))])
    place = np.clip(np.searchsorted(at_s, edges_s, "right") - 1, 0, len(at_s) - 1)
    until = area[place] + values[place] * (edges_s - at_s[place])
    return np.diff(until) / np.diff(edges_s)


def _in_words(stop: str, at_s: float) -> str:
    """Why a rollout stops; "" where it does not."""
    if not stop:
        return ""
    words = (said for begin, said in _STOPS.items() if stop.startswith(begin))
    what = next(words, _MEMORY_IS_FULL)
    rest = ", and MuJoCo leaves contacts out" if what == _MEMORY_IS_FULL else ""
    return f"{what} after {at_s:.3g} s of the rollout{rest}"


def _more_memory(now_bytes: int) -> str:
    """For <size memory>."""
    return f"{max(now_bytes * 4 // 1_000_000, 10)}M"
