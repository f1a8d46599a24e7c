"""Compile and run a model in the sandbox.

MuJoCo believes the counts in a file: some make it allocate all memory there is, or work for hours
on one step. The functions here are requests to one child, which keeps the model that was loaded.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from copy import copy
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.formats.sandbox import limit
from tunenet_logs.recorders.simulators.model.servo import ServoSteps, needs_steps

MEMORY_BYTES = 400_000_000  # beyond what the libraries have

# CPU time: of reading and compiling; and of the next few steps, less than 0.2 s as a rule.
COMPILING_S, PIECE_S = 10, 5

MAX_ROLLOUT_S = 60.0  # CPU time of one rollout, foreseen from its first 5 s
_MAX_MODEL_MB = 30  # compiled

# A row to roll out: values of the model's arrays by name, qpos, qvel, and its control's index.
Row = tuple[Sequence[tuple[str, Any]], NDArray[Any], NDArray[Any], int]
Arrays = dict[str, NDArray[Any]]

# A copy of a model, its data, and the arrays in which it may differ, each beside the model's own.
_Spare = tuple[Any, Any, list[tuple[Any, Any]]]

_PARENT = os.getppid()
_loaded: list[Any] = []  # the one model that `run` rolls out
_spares: list[_Spare] = []  # its copies
_MAX_CHANGED = 100_000  # numbers of an array that rollouts change; meshes have more


class _TooSlowError(Exception):
    """A rollout would last too long."""


def saved(model: Any) -> Arrays:
    """Return a compiled model's bytes, for `load`."""
    mujoco: Any = import_module("mujoco")
    data = np.zeros(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, data)
    return {"model": data}


def packed(rows: Sequence[Row], controls: Sequence[Any]) -> tuple[list[Any], Arrays]:
    """Return rows and controls as words and arrays, for `run`."""
    words: list[Any] = []
    arrays = {f"control {number}": np.asarray(one) for number, one in enumerate(controls)}
    for number, (values, qpos, qvel, control) in enumerate(rows):
        words.append(([name for name, _ in values], control))
        arrays |= {f"{number} {name}": np.asarray(value) for name, value in values}
        arrays |= {f"{number} qpos": np.asarray(qpos), f"{number} qvel": np.asarray(qvel)}
    return words, arrays


def compile_model(models: Sequence[str], arrays: Arrays) -> Iterator[tuple[Any, Arrays]]:
    """Compile a model of its XML ("") and files, describe it, and step it once."""
    mujoco: Any = import_module("mujoco")
    mujoco.set_mju_user_warning(lambda _: None)  # each rollout tells its own
    texts = {name: data.tobytes() for name, data in arrays.items()}
    xml = texts.pop("").decode()
    files = {name: texts[name] for name in texts if name not in models}
    file_bytes = sum(map(len, files.values()))
    limit(min(MEMORY_BYTES + 16 * file_bytes, 3_000_000_000))  # what an honest mesh takes
    include = {name: texts[name] for name in models}
    model = mujoco.MjSpec.from_string(xml, include=include, assets=files).compile()
    found = _described(mujoco, model, file_bytes)
    if not found["beyond"]:
        with suppress(mujoco.FatalError):  # its rollouts tell when, and of what
            mujoco.mj_step(model, mujoco.MjData(model))
    yield found, {}


def load(arrays: Arrays) -> Iterator[tuple[Any, Arrays]]:
    """Take the compiled model to run from here on."""
    mujoco: Any = import_module("mujoco")
    mujoco.set_mju_user_warning(lambda _: None)
    data = {"model.mjb": arrays["model"].tobytes()}
    _spares.clear()
    _loaded[:] = [mujoco.MjModel.from_binary_path("model.mjb", data)]
    yield {}, {}


def run(
    words: Sequence[Any], settings: Mapping[str, Any], wants_qpos: bool, arrays: Arrays
) -> Iterator[tuple[Any, Arrays]]:
    """Roll out each of the `packed` rows.

    Values are NaN from where a rollout stops; its number of steps and the reason are returned.
    """
    mujoco: Any = import_module("mujoco")
    (model,) = _loaded
    controls = [one for name, one in arrays.items() if name.startswith("control ")]
    rows: list[Row] = []
    for number, (names, control) in enumerate(words):
        values = [(name, arrays[f"{number} {name}"]) for name in names]
        rows.append((values, arrays[f"{number} qpos"], arrays[f"{number} qvel"], control))
    steps = settings["steps"]
    limit(cpu_s=PIECE_S)
    sensed = np.empty((len(rows), steps, model.nsensordata))
    qpos = np.empty((len(rows) if wants_qpos else 0, steps + 1, model.nq))
    if not _spares:
        _spares.append(_copied(model))
    each_bytes = mujoco.mj_sizeModel(model) + model.narena + _spares[0][1].nbuffer
    count = int(np.clip(MEMORY_BYTES // each_bytes, 1, 16))
    count = min(count, os.cpu_count() or 1, len(rows))
    limit(2 * MEMORY_BYTES)

    def one(place: int) -> tuple[int, str]:
        shown = qpos[place] if wants_qpos else None
        spare = _copied(model)
        kept, why = _rolled(spare[:2], rows[place], controls, sensed[place], shown, **settings)
        _spares.append(spare)
        sensed[place, kept:] = np.nan
        if wants_qpos:
            qpos[place, kept + 1 :] = np.nan
        return kept, why

    if count == 1:
        done = [one(place) for place in range(len(rows))]
    else:
        threading.stack_size(2 << 20)
        with ThreadPoolExecutor(count) as pool:
            done = list(pool.map(one, range(len(rows))))
    kept, why = zip(*done, strict=True)
    yield {"kept": kept, "why": why}, {"sensed": sensed} | ({"qpos": qpos} if wants_qpos else {})


def _copied(model: Any) -> _Spare:
    """Return a copy of the loaded model, one used before where there is one.

    To copy meshes, or to allocate data, takes longer than many a rollout.
    """
    try:
        own, data, pairs = _spares.pop()
    except IndexError:  # all are in use: rollouts go side by side
        own = copy(model)
        holders = (own, model), (own.opt, model.opt), (own.stat, model.stat)
        names = [(*both, name) for both in holders for name in dir(both[0]) if name[0] != "_"]
        pairs = [(getattr(mine, name), getattr(given, name)) for mine, given, name in names]
        pairs = [
            both
            for both in pairs
            if isinstance(both[0], np.ndarray) and both[0].size <= _MAX_CHANGED
        ]
        return own, import_module("mujoco").MjData(own), pairs
    for mine, given in pairs:
        mine[...] = given
    for ours, theirs in ((own.opt, model.opt), (own.stat, model.stat)):
        for name in _numbers(type(ours)):
            setattr(ours, name, getattr(theirs, name))
    return own, data, pairs


@cache
def _numbers(kind: type) -> tuple[str, ...]:
    """Return the names of what is a number in options and statistics."""
    ours = next(one for one in (_loaded[0].opt, _loaded[0].stat) if isinstance(one, kind))
    return tuple(name for name in dir(ours) if isinstance(getattr(ours, name), float))


def _begun(model: Any, data: Any, row: Row, step_s: float, is_late: bool) -> Any:
    """Prepare a row's own model and its data; return the initial state."""
    mujoco: Any = import_module("mujoco")
    values, qpos, qvel, _ = row
    model.opt.timestep = step_s
    for name, array in values:
        put_array(model, name, array)
    mujoco.mj_resetData(model, data)
    set_constants(model, data)
    mujoco.mj_resetData(model, data)
    data.qpos[:], data.qvel[:] = qpos, qvel
    if is_late:  # so that the speed at the first stamp is the one that is meant
        mujoco.mj_forward(model, data)
        data.qvel[:] -= data.qacc * step_s / 2
    physics = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.zeros(mujoco.mj_stateSize(model, physics))
    mujoco.mj_getState(model, data, state, physics)
    mujoco.mj_resetData(model, data)
    return state


def _rolled(
    spare: tuple[Any, Any],
    row: Row,
    controls: Sequence[Any],
    sensed: Any,
    qpos: Any,
    *,
    steps: int,
    step_s: float,
    is_late: bool,
    columns: Sequence[int],
    switches: Sequence[int] = (),
    judged_s: float = 5.0,
) -> tuple[int, str]:
    """Roll out one row; return its steps, and the MuJoCo warning or error that stopped it.

    `switches` are actuators whose power is in the control's last columns.
    """
    rollout = import_module("mujoco.rollout")
    mujoco: Any = import_module("mujoco")
    pace = _Pace(steps, judged_s)
    model, data = spare
    try:
        state = _begun(model, data, row, step_s, is_late)
    except mujoco.FatalError as error:
        return 0, str(error)
    nq, control = model.nq, controls[row[-1]]
    if needs_steps(model, switches):
        return _stepped(model, data, state, control, sensed, qpos, columns, switches, steps, pace)
    if qpos is not None:
        qpos[0] = state[1 : 1 + nq]
    driven = int(mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED)
    width = len(state) + model.nu + model.nv + model.nsensordata
    most = max(4_000_000 // (8 * width), 1)  # bytes of a piece
    roller, warmstart = rollout.Rollout(nthread=0), np.zeros(model.nv)
    # In pieces from which its end can be foreseen: of 16 steps first, then of .02 s; where bodies
    # touch, a step may take fifty times as long.
    done, count, why = 0, 16, ""
    while done < steps and not why:
        count = min(count, steps - done, most)
        block = np.zeros((1, count, model.nu + model.nv))
        block[0][:, np.array(columns, np.intp)] = control[done : done + count]
        piece_s = time.monotonic()
        try:
            reached, seen = roller.rollout(
                model,
                data,
                state[None],
                block,
                control_spec=driven,
                initial_warmstart=warmstart[None],
            )
        except mujoco.FatalError as error:
            if count == 1:
                return done, str(error)
            # step by step to where it is, which no length of a piece may tell
            mujoco.mj_resetData(model, data)
            count = most = 1
            continue
        count *= 1 + (time.monotonic() - piece_s < 0.02)
        # The steps before time stops advancing: after a warning, all times are one.
        expected_s = step_s * np.arange(done + 1, done + len(block[0]) + 1)
        is_good = np.isclose(reached[0, :, 0], expected_s, rtol=0, atol=step_s / 2)
        good = len(is_good) if is_good.all() else int(np.argmin(is_good))
        sensed[done : done + good] = seen[0, :good]
        if qpos is not None:
            qpos[done + 1 : done + good + 1] = reached[0, :good, 1 : 1 + nq]
        done += good
        why = ", ".join(_warnings(data)) or ("time" if good < len(block[0]) else "")
        state, warmstart = reached[0, -1], data.qacc_warmstart.copy()
        pace.foresee(done)
    return done, why


def _stepped(
    model: Any,
    data: Any,
    state: Any,
    control: Any,
    sensed: Any,
    qpos: Any,
    columns: Sequence[int],
    switches: Sequence[int],
    steps: int,
    pace: _Pace,
) -> tuple[int, str]:
    """Roll out one row step by step, with what its servos have beyond MuJoCo's."""
    mujoco: Any = import_module("mujoco")
    mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    nq, nu = model.nq, model.nu
    if qpos is not None:
        qpos[0] = data.qpos
    count = len(columns)
    # Single numbers are set one by one: to index an array by an array takes as long as a step.
    held, driven = control[:, :count].tolist(), list(zip(range(count), columns, strict=True))
    controls = [(at, place) for at, place in driven if place < nu]
    efforts = [(at, place - nu) for at, place in driven if place >= nu]
    servos, powered = ServoSteps(model, data), np.ones(nu, np.bool_)
    powers = control[:, count:] > 0.5
    changes = set((1 + np.flatnonzero((powers[1:] != powers[:-1]).any(axis=1))).tolist()) | {0}
    seen, places_now, ctrl, applied = data.sensordata, data.qpos, data.ctrl, data.qfrc_applied
    for done, row in enumerate(held):
        for at, place in controls:
            ctrl[place] = row[at]
        for at, place in efforts:
            applied[place] = row[at]
        if len(switches) and done in changes:
            powered[np.array(switches, np.intp)] = powers[done]
            servos.power(powered)
        try:
            servos.step()
        except mujoco.FatalError as error:
            return done, str(error)
        sensed[done] = seen
        if qpos is not None:
            qpos[done + 1] = places_now[:nq]
        if done % 64 == 0 or done + 1 == steps:
            if why := _warnings(data):
                return max(done - 64, 0), ", ".join(why)
            pace.foresee(done + 1)
    return steps, ""


def _warnings(data: Any) -> list[str]:
    """Return the names of what MuJoCo has warned of."""
    (raised,) = np.nonzero(data.warning.number)
    kinds = import_module("mujoco").mjtWarning
    return [kinds(number).name for number in raised.tolist()]


class _Pace:
    """How fast a rollout goes, so that one that would last too long is aborted."""

    def __init__(self, steps: int, judged_s: float) -> None:
        self._steps, self._judged_s = steps, judged_s
        self._began_s = time.monotonic()
        # CPU time, and how far it was, once half of that is over: a thread's clock is slow to read.
        self._since: tuple[float, int] | None = None

    def foresee(self, done: int) -> None:
        """Raise if it would last too long, and exit if the parent is gone."""
        if os.getppid() != _PARENT:
            os._exit(0)
        if self._since is not None:
            spent_s = time.thread_time() - self._since[0]
            needed_s = spent_s * self._steps / max(done - self._since[1], 1)
            if spent_s > self._judged_s / 2 and needed_s > MAX_ROLLOUT_S:
                raise _TooSlowError(f"slow: {needed_s:.0f} s for {self._steps} steps")
        elif time.monotonic() - self._began_s > self._judged_s / 2:
            self._since = time.thread_time(), done
        limit(cpu_s=PIECE_S)


def set_constants(model: Any, data: Any) -> None:
    """Compute what follows from changed numbers, as compiling a file with them does.

    `mj_setConst` leaves out the mean inertia, by which the solver's tolerance is scaled.
    """
    mujoco: Any = import_module("mujoco")
    is_own = model.nv and model.stat.meaninertia == _mean(model.dof_M0)  # not the user's
    mujoco.mj_setConst(model, data)
    if is_own:
        model.stat.meaninertia = _mean(model.dof_M0)


def _mean(values: NDArray[Any]) -> float:
    """Return the mean of a running sum, which is MuJoCo's to the last bit."""
    return float(np.cumsum(values)[-1] / len(values))


def put_array(model: Any, name: str, value: Any) -> None:
    """Set a model's array in place, or a scalar; options are prefixed by `opt.`."""
    owner = model.opt if name.startswith("opt.") else model
    name = name.removeprefix("opt.")
    if isinstance(getattr(owner, name), np.ndarray):
        getattr(owner, name)[:] = value
    else:
        setattr(owner, name, float(value))


def _described(mujoco: Any, model: Any, file_bytes: int) -> dict[str, Any]:
    """Describe what exceeds the bounds, non-finite arrays, and the time step [s]."""
    others = 2000
    bounds = {
        "degrees of freedom": (int(model.nv), 200),
        "bodies": (int(model.nbody), 2000),
        "geoms": (int(model.ngeom), 10_000),
        "actuators": (int(model.nu), others),
        "tendons": (int(model.ntendon), others),
        "equality constraints": (int(model.neq), others),
        # <size memory>, of which each rollout takes as much as its contacts need.
        "MB of working memory": (int(model.narena) // 1_000_000, 300),
        "MB when compiled": (
            int(mujoco.mj_sizeModel(model)) // 1_000_000,
            _MAX_MODEL_MB + 12 * file_bytes // 1_000_000,
        ),
    }
    if all(count <= most for count, most in bounds.values()):
        state_mb = int(mujoco.MjData(model).nbuffer) // 1_000_000
        bounds["MB of state"] = (state_mb, _MAX_MODEL_MB)
    arrays = {name: getattr(model, name) for name in dir(model) if name[0] != "_"}
    arrays |= {f"option {name}": getattr(model.opt, name) for name in dir(model.opt)}
    return {
        "beyond": [
            f"{count} {what}, over the limit of {most}"
            for what, (count, most) in bounds.items()
            if count > most
        ],
        "infinite": [
            name
            for name, array in arrays.items()
            if isinstance(array, np.ndarray | float)
            and np.asarray(array).dtype.kind == "f"
            and not np.isfinite(array).all()
        ],
        "timestep_s": float(model.opt.timestep),
    }
