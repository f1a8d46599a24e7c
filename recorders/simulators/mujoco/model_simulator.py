"""A user's MuJoCo model as a simulator: driven as a log was, and seen as the log saw the robot."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recorders.simulators.base import Parameter
from recorders.simulators.installed import named_version
from recorders.simulators.mujoco.library import mujoco
from recorders.simulators.mujoco.model_parameters import DELAY, ModelParameter
from recorders.simulators.mujoco.model_sensors import SensedSignal, Sensor, put_sensors
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.errors import UsageError

MOST_STEPS = 300_000
"""Of one rollout: five minutes at 1 ms."""

_MOST_BATCH_BYTES = 200_000_000
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
        step_s: of its integrator; None for the model's own.
    """

    spec: Any
    tuned: tuple[ModelParameter, ...]
    sensed: tuple[SensedSignal, ...]
    drives: tuple[Drive, ...]
    initial: InitialState
    end_ns: int
    step_s: float | None = None

    @property
    def engine(self) -> str:
        """See `Simulator`."""
        return named_version("mujoco")

    @property
    def step_hz(self) -> float:
        """See `Simulator`."""
        return 1.0 / self._model.opt.timestep

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those that are tuned, and what of the initial state is unsure."""
        return (*(one.parameter for one in self.tuned), *self.initial.unsure)

    def finer(self) -> ModelSimulator:
        """The same with half the step: what its step does to its answer can be told by it."""
        return replace(self, step_s=self._model.opt.timestep / 2)

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """One episode with the signals of `sensed`, at their own stamps; see `Simulator`."""
        row = [one.checked(values.get(one.name, one.initial)) for one in self.parameters]
        return self.rollouts(np.array([row]))[0]

    def rollouts(self, values: Array) -> list[Episode]:
        """Several episodes at once, on all cores.

        Args:
            values: of all parameters, shape (N, P).

        Returns:
            N of them; from where a rollout diverges its values are NaN.
        """
        each_bytes = 8 * (self._steps + 1) * (self._model.nsensordata + self._state_size + 40)
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
        begins, reached, _, good = self._rolled(values[None])
        count = int(good.sum())
        states = np.concatenate([begins, reached[0, :count]])
        seconds = self._model.opt.timestep * np.arange(self._steps + 1)
        qpos = states[:, 1 : 1 + self._model.nq]
        return seconds, qpos[np.minimum(np.arange(self._steps + 1), count)]

    @cached_property
    def _model(self) -> Any:
        """The compiled model, with sensors of what is compared alone."""
        spec = self.spec.copy()
        put_sensors(spec, self._distinct)
        model = spec.compile()
        if self.step_s is not None:
            model.opt.timestep = self.step_s
        if (self.end_ns - self.initial.stamp_ns) * 1e-9 / model.opt.timestep > MOST_STEPS:
            seconds = MOST_STEPS * model.opt.timestep
            raise UsageError(
                f"the log is longer than {MOST_STEPS} steps of {model.opt.timestep:g} s",
                f"choose a part of at most {seconds:.0f} s with --start and --end",
            )
        return model

    @cached_property
    def _distinct(self) -> list[Sensor]:
        """Each sensor once, without its axis."""
        return list(
            dict.fromkeys(sensor.whole for sensed in self.sensed for sensor in sensed.sensors)
        )

    @cached_property
    def _steps(self) -> int:
        seconds = (self.end_ns - self.initial.stamp_ns) * 1e-9
        return int(np.ceil(seconds / self._model.opt.timestep)) + 2

    @cached_property
    def _state_size(self) -> int:
        return mujoco().mj_stateSize(self._model, mujoco().mjtState.mjSTATE_FULLPHYSICS)

    def _batch(self, values: Array) -> list[Episode]:
        _, _, sensed, good = self._rolled(values)
        sensed[~good] = np.nan
        return [self._episode(seen, row) for seen, row in zip(sensed, values, strict=True)]

    def _rolled(self, values: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        """States before and after the steps, sensors, and which steps are before it diverges."""
        library = mujoco()
        from mujoco import rollout

        _silence()
        threads = min(os.cpu_count() or 1, len(values))
        models = [self._with(row) for row in values]
        states = np.stack(
            [self._state(model, row) for model, row in zip(models, values, strict=True)]
        )
        spec = library.mjtState
        control_spec = spec.mjSTATE_CTRL | spec.mjSTATE_QFRC_APPLIED
        control = np.stack([self._control(row) for row in values])
        with rollout.Rollout(nthread=threads if threads > 1 else 0) as pool:
            found = pool.rollout(
                models,
                [library.MjData(models[0]) for _ in range(threads)],
                states,
                control,
                control_spec=int(control_spec),
            )
        reached, sensed = (np.asarray(one, np.float64) for one in found)
        step_s = self._model.opt.timestep
        expected_s = step_s * np.arange(1, self._steps + 1)
        reached, sensed = np.asarray(reached), np.asarray(sensed)
        kept = np.isclose(reached[:, :, 0], expected_s, rtol=0, atol=step_s / 2)
        return states, reached, sensed, np.logical_and.accumulate(kept, axis=1)

    def _with(self, row: Array) -> Any:
        """A copy of the model with these values."""
        model = self._model.__copy__()
        for one, value in zip(self.tuned, row, strict=False):
            one.put(model, float(value))
        mujoco().mj_setConst(model, mujoco().MjData(model))
        return model

    def _state(self, model: Any, row: Array) -> Array:
        library = mujoco()
        data = library.MjData(model)
        data.qpos[:], data.qvel[:] = self.initial.qpos, self.initial.qvel
        unsure = row[len(self.tuned) :]
        for value, (is_speed, place) in zip(unsure, self.initial.places, strict=True):
            (data.qvel if is_speed else data.qpos)[place] = value
        if self._is_late:  # so that the speed at the first stamp is the one that is meant
            library.mj_forward(model, data)
            data.qvel[:] -= data.qacc * model.opt.timestep / 2
        state = np.zeros(self._state_size)
        library.mj_getState(model, data, state, library.mjtState.mjSTATE_FULLPHYSICS)
        return state

    def _control(self, row: Array) -> Array:
        """What drives each step, shape (steps, nu + nv)."""
        model, step_s = self._model, self._model.opt.timestep
        delay_s = next(
            (
                float(value)
                for one, value in zip(self.tuned, row, strict=False)
                if one.parameter.name == DELAY
            ),
            0.0,
        )
        # a step kicks speeds of half a step before to those of half a step after its begin
        edges_s = step_s * (np.arange(self._steps + 1) - 0.5 * self._is_late)
        control = np.zeros((self._steps, model.nu + model.nv))
        for drive in self.drives:
            since_ns = drive.signal.stamps_ns - self.initial.stamp_ns
            at_s = np.asarray(since_ns, np.float64) * 1e-9
            for column, target in zip(drive.columns, drive.targets, strict=True):
                values = drive.signal.values[:, column]
                good = np.isfinite(values)
                seconds, values = at_s[good], values[good]
                if drive.is_effort:
                    middle_s = edges_s[:-1] + step_s / 2
                    held = np.interp(middle_s, seconds, values)
                    control[:, model.nu + target] = held
                else:
                    control[:, target] = held_means(seconds, values, edges_s - delay_s)
        return control

    @property
    def _is_late(self) -> bool:
        kinds = mujoco().mjtIntegrator
        return self._model.opt.integrator in [getattr(kinds, one) for one in _LATE_BY_HALF_A_STEP]

    def _episode(self, seen: Array, row: Array) -> Episode:
        """Sensor values after each step, shape (steps, S), as the log's signals."""
        step_s = self._model.opt.timestep
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
        return Episode(EpisodeInfo(source=self.engine, truth=truth), signals)


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


def _silence() -> None:
    """MuJoCo's warnings go nowhere: a rollout that diverges is told by its values."""
    mujoco().set_mju_user_warning(lambda _: None)
