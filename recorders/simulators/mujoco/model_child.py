"""Compiles a model in a process of its own, with little memory and time, and says what came out.

MuJoCo believes the counts in a file: some make it allocate all memory there is, or work for hours.
Here the system ends that, and a crash stays here. Run as a script: it reads a line of JSON with the
lengths of what follows (the model, the models in it, its other files) and those bytes, and writes a
line of JSON: what the model has, or {"error": WHY}.
"""

from __future__ import annotations

import json
import resource
import sys
from contextlib import suppress
from importlib import import_module
from typing import Any

import numpy as np

MEMORY_BYTES = 3 * 1024**3
"""More than the libraries themselves have."""

CPU_S = 20
"""Of reading, compiling and a first step."""

MOST_DOF, MOST_BODIES, MOST_GEOMS = 200, 2000, 10_000
MOST_STATE_MB = 1000
"""Of a model's working memory, which each of its rollouts takes."""


def main() -> None:
    """Serves one model; see the module."""
    mujoco: Any = import_module("mujoco")
    _limit()
    lengths = json.loads(sys.stdin.buffer.readline())
    xml, models, files = (
        {name: sys.stdin.buffer.read(length) for name, length in group} for group in lengths
    )
    try:
        (text,) = xml.values()
        spec = mujoco.MjSpec.from_string(text.decode(), include=models, assets=files)
        model = spec.compile()
        found = _described(model)
        if not found["beyond"]:
            mujoco.mj_step(model, mujoco.MjData(model))
    except MemoryError:
        found = {"error": "Could not allocate memory"}
    except Exception as error:  # noqa: BLE001 (whatever it is, it is said)
        found = {"error": str(error)[:2000] or type(error).__name__}
    sys.stdout.write("\n" + json.dumps(found) + "\n")
    sys.stdout.flush()


def _limit() -> None:
    """No more time and, where /proc tells what is used, memory, whatever the file claims."""
    with suppress(OSError), open("/proc/self/statm") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_BYTES, used + MEMORY_BYTES))
    spent = resource.getrusage(resource.RUSAGE_SELF)
    seconds = int(spent.ru_utime + spent.ru_stime) + CPU_S
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _described(model: Any) -> dict[str, Any]:
    """What is beyond the bounds, in words; arrays that are not finite; and the step [s]."""
    bounds = {
        "degrees of freedom": (int(model.nv), MOST_DOF),
        "bodies": (int(model.nbody), MOST_BODIES),
        "geoms": (int(model.ngeom), MOST_GEOMS),
        "MB of working memory": (int(model.narena) // 1_000_000, MOST_STATE_MB),
    }
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
