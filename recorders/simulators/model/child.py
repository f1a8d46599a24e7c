"""Compile and run a model in a process of its own, with limited memory and time.

MuJoCo believes the counts in a file: some make it allocate all memory there is, or work for hours
on one step. Here the system ends that, and a crash stays here. Run as a script: it reads requests,
each a pickle (kind, arguments) of its parent's, and answers each with a line of JSON, if it failed
{"error": WHY}, and the bytes of the float64 arrays whose shapes that line names.
"""

from __future__ import annotations

import json
import os
import pickle
import resource
import sys
import threading
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from copy import copy
from importlib import import_module
from typing import Any

import numpy as np

MEMORY_BYTES, MAX_MEMORY_BYTES = 400_000_000, 3_000_000_000  # beyond what the libraries have
MEMORY_PER_BYTE = 16  # of the model's files: what compiling an honest mesh takes

# CPU time: of reading and compiling; and of the next few steps, less than 0.2 s as a rule.
COMPILING_S, PIECE_S = 10, 5

MAX_ROLLOUT_S = 60.0  # CPU time of one rollout, foreseen from its first `_JUDGED_S`
_JUDGED_S = 5.0

MAX_DOF, MAX_BODIES, MAX_GEOMS, MAX_OTHERS = 200, 2000, 10_000, 2000
MAX_MODEL_MB, MAX_MODEL_MB_PER_MB = 30, 12  # compiled; and of each MB of its files
MAX_WORKING_MB = 300  # <size memory>, of which each rollout takes as much as its contacts need

_MAX_THREADS, _STACK_BYTES = 16, 2 << 20
# Pieces of a rollout, from which its end can be foreseen: first and usual length, and most memory.
_FIRST_STEPS, _PIECE_S, _PIECE_BYTES = 16, 0.1, 4_000_000


class _TooSlowError(Exception):
    """A rollout would last too long."""


def main() -> None:
    """Serve one parent's requests; see the module."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # MuJoCo prints what it likes
    mujoco: Any = import_module("mujoco")
    mujoco.set_mju_user_warning(lambda _: None)  # each rollout tells its own
    threading.stack_size(_STACK_BYTES)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    serving = _Serving(mujoco)
    while True:
        try:
            kind, arguments = pickle.load(sys.stdin.buffer)  # noqa: S301 (our parent's)
        except EOFError:
            return
        _more_time(COMPILING_S)
        arrays: dict[str, np.ndarray[Any, Any]] = {}
        try:
            found, arrays = getattr(serving, kind)(**arguments)
        except MemoryError:
            found = {"error": "Could not allocate memory"}
        except Exception as error:  # noqa: BLE001 (whatever it is, it is said)
            found = {"error": str(error)[:2000] or type(error).__name__}
        shapes = {name: array.shape for name, array in arrays.items()}
        answers.write(json.dumps({**found, "arrays": shapes}).encode() + b"\n")
        for array in arrays.values():
            answers.write(np.ascontiguousarray(array, np.float64).tobytes())
        answers.flush()


class _Serving:
    """Requests by name; each returns the fields of its line of JSON, and arrays."""

    def __init__(self, mujoco: Any) -> None:
        self._mujoco = mujoco
        self._model: Any = None
        self._parent = os.getppid()

    def compile(
        self, xml: bytes, models: Mapping[str, bytes], files: Mapping[str, bytes]
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Compile a model, describe it, and step it once."""
        file_bytes = sum(map(len, files.values()))
        _limit_memory(min(MEMORY_BYTES + MEMORY_PER_BYTE * file_bytes, MAX_MEMORY_BYTES))
        spec = self._mujoco.MjSpec.from_string(xml.decode(), include=models, assets=files)
        model = spec.compile()
        found = _described(self._mujoco, model, file_bytes)
        if not found["beyond"]:
            with suppress(self._mujoco.FatalError):  # its rollouts tell when, and of what
                self._mujoco.mj_step(model, self._mujoco.MjData(model))
        return found, {}

    def load(self, model: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Take the compiled model to run from here on."""
        self._model = model
        return {}, {}

    def run(
        self, rows: list[Any], controls: list[Any], wants_qpos: bool, **settings: Any
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Roll out each row: values of the model's arrays, qpos, qvel, and the control's index.

        Values are NaN from where a rollout stops; its number of steps and the reason are returned.
        """
        mujoco, model = self._mujoco, self._model
        steps = settings["steps"]
        _more_time(PIECE_S)
        sensed = np.empty((len(rows), steps, model.nsensordata))
        qpos = np.empty((len(rows) if wants_qpos else 0, steps + 1, model.nq))
        each_bytes = mujoco.mj_sizeModel(model) + model.narena + mujoco.MjData(model).nbuffer
        count = int(np.clip(MEMORY_BYTES // each_bytes, 1, _MAX_THREADS))
        count = min(count, os.cpu_count() or 1, len(rows))
        _limit_memory(2 * MEMORY_BYTES)

        def one(place: int) -> tuple[int, str]:
            shown = qpos[place] if wants_qpos else None
            kept, why = self._rolled(rows[place], controls, sensed[place], shown, **settings)
            sensed[place, kept:] = np.nan
            if wants_qpos:
                qpos[place, kept + 1 :] = np.nan
            return kept, why

        if count == 1:
            done = [one(place) for place in range(len(rows))]
        else:
            with ThreadPoolExecutor(count) as pool:
                done = list(pool.map(one, range(len(rows))))
        kept, why = zip(*done, strict=True)
        found = {"sensed": sensed} | ({"qpos": qpos} if wants_qpos else {})
        return {"kept": kept, "why": why}, found

    def _begun(self, row: Any, step_s: float, is_late: bool) -> tuple[Any, Any, Any]:
        """Prepare a row's model, its data, and the initial state."""
        mujoco = self._mujoco
        values, qpos, qvel, _ = row
        model = copy(self._model)
        model.opt.timestep = step_s
        for name, array in values:
            put_array(model, name, array)
        data = mujoco.MjData(model)
        mujoco.mj_setConst(model, data)
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = qpos, qvel
        if is_late:  # so that the speed at the first stamp is the one that is meant
            mujoco.mj_forward(model, data)
            data.qvel[:] -= data.qacc * step_s / 2
        physics = mujoco.mjtState.mjSTATE_FULLPHYSICS
        state = np.zeros(mujoco.mj_stateSize(model, physics))
        mujoco.mj_getState(model, data, state, physics)
        mujoco.mj_resetData(model, data)
        return model, data, state

    def _rolled(
        self,
        row: Any,
        controls: list[Any],
        sensed: Any,
        qpos: Any,
        *,
        steps: int,
        step_s: float,
        is_late: bool,
        columns: Any,
    ) -> tuple[int, str]:
        """Roll out one row; return its steps, and the MuJoCo warning or error that stopped it."""
        rollout = import_module("mujoco.rollout")
        mujoco, began_s = self._mujoco, time.thread_time()
        try:
            model, data, state = self._begun(row, step_s, is_late)
        except mujoco.FatalError as error:
            return 0, str(error)
        nq, control = model.nq, controls[row[-1]]
        if qpos is not None:
            qpos[0] = state[1 : 1 + nq]
        driven = int(mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED)
        width = len(state) + model.nu + model.nv + model.nsensordata
        most = max(_PIECE_BYTES // (8 * width), 1)
        roller, warmstart = rollout.Rollout(nthread=0), np.zeros(model.nv)
        done, count, why = 0, _FIRST_STEPS, ""
        while done < steps and not why:
            count = min(count, steps - done, most)
            block = np.zeros((1, count, model.nu + model.nv))
            block[0][:, columns] = control[done : done + count]
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
            count *= 1 + (time.monotonic() - piece_s < _PIECE_S)
            good = _good_steps(reached[0, :, 0], done, step_s)
            sensed[done : done + good] = seen[0, :good]
            if qpos is not None:
                qpos[done + 1 : done + good + 1] = reached[0, :good, 1 : 1 + nq]
            done += good
            why = _warnings(mujoco, data) or ("time" if good < len(block[0]) else "")
            state, warmstart = reached[0, -1], data.qacc_warmstart.copy()
            self._foresee(time.thread_time() - began_s, done, steps)
        return done, why

    def _foresee(self, spent_s: float, done: int, steps: int) -> None:
        """Abort a rollout that would last too long, and exit if the parent is gone."""
        if os.getppid() != self._parent:
            os._exit(0)
        needed_s = spent_s * steps / max(done, 1)
        if spent_s > _JUDGED_S and needed_s > MAX_ROLLOUT_S:
            raise _TooSlowError(f"slow: {needed_s:.0f} s for {steps} steps")
        _more_time(PIECE_S)


def put_array(model: Any, name: str, value: Any) -> None:
    """Set a model's array in place, or a scalar; options are prefixed by `opt.`."""
    owner = model.opt if name.startswith("opt.") else model
    name = name.removeprefix("opt.")
    if isinstance(getattr(owner, name), np.ndarray):
        getattr(owner, name)[:] = value
    else:
        setattr(owner, name, float(value))


def _good_steps(times_s: Any, done: int, step_s: float) -> int:
    """Count the steps before time stops advancing: after a warning, all times are one."""
    expected_s = step_s * np.arange(done + 1, done + len(times_s) + 1)
    good = np.isclose(times_s, expected_s, rtol=0, atol=step_s / 2)
    return len(times_s) if good.all() else int(np.argmin(good))


def _warnings(mujoco: Any, data: Any) -> str:
    """Return the names of MuJoCo's warnings in the last piece."""
    kinds = [one for one in mujoco.mjtWarning.__members__.values() if one.name != "mjNWARNING"]
    return ", ".join(one.name for one in kinds if data.warning[int(one)].number)


def _limit_memory(more_bytes: int) -> None:
    """Limit the address space beyond what is in use, where /proc tells that."""
    with suppress(OSError), open("/proc/self/statm") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        resource.setrlimit(resource.RLIMIT_AS, (used + more_bytes, hard))


def _more_time(more_s: int) -> None:
    """Let the system end this process after so much more CPU time, unless called again."""
    spent = resource.getrusage(resource.RUSAGE_SELF)
    seconds = int(spent.ru_utime + spent.ru_stime) + 1 + more_s
    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    with suppress(ValueError):  # a user's own limit is lower
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, hard))


def _described(mujoco: Any, model: Any, file_bytes: int) -> dict[str, Any]:
    """Describe what exceeds the bounds, non-finite arrays, and the time step [s]."""
    most_mb = MAX_MODEL_MB + MAX_MODEL_MB_PER_MB * file_bytes // 1_000_000
    bounds = {
        "degrees of freedom": (int(model.nv), MAX_DOF),
        "bodies": (int(model.nbody), MAX_BODIES),
        "geoms": (int(model.ngeom), MAX_GEOMS),
        "actuators": (int(model.nu), MAX_OTHERS),
        "tendons": (int(model.ntendon), MAX_OTHERS),
        "equality constraints": (int(model.neq), MAX_OTHERS),
        "MB of working memory": (int(model.narena) // 1_000_000, MAX_WORKING_MB),
        "MB when compiled": (int(mujoco.mj_sizeModel(model)) // 1_000_000, most_mb),
    }
    if all(count <= most for count, most in bounds.values()):
        state_mb = int(mujoco.MjData(model).nbuffer) // 1_000_000
        bounds["MB of state"] = (state_mb, MAX_MODEL_MB)
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
            if isinstance(array, np.ndarray | float) and not _is_finite(np.asarray(array))
        ],
        "timestep_s": float(model.opt.timestep),
    }


def _is_finite(array: np.ndarray[Any, Any]) -> bool:
    return array.dtype.kind != "f" or bool(np.isfinite(array).all())


if __name__ == "__main__":
    main()
