"""Select a physics engine by name."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from typing import TYPE_CHECKING, cast

from tunenet_logs.errors import UsageError

if TYPE_CHECKING:
    from recorders.simulators.base import BallWorld, Engine
    from recorders.simulators.contact import ContactSettings

# Modules by the engine's name, which is its library's too; each has what `Engine` names, and is
# imported when needed. The first that is installed is the default.
ENGINES = {
    "pybullet": "recorders.simulators.pybullet.engine",
    "mujoco": "recorders.simulators.mujoco.engine",
}

# Of the environment: the engine that `simulated_by` chose, for this process and its children.
ENGINE_VARIABLE = "TUNENET_ENGINE"


def engine(name: str | None = None) -> Engine:
    """Import an engine when first needed.

    Args:
        name: None for the one that `simulated_by` chose, else the first that is installed.

    Raises:
        UsageError: no such engine, or it is not installed.
    """
    wanted = name or os.environ.get(ENGINE_VARIABLE)
    if wanted is not None and wanted not in ENGINES:
        raise UsageError(f"no engine is named {wanted!r}; there is: {', '.join(ENGINES)}")
    for known in ENGINES if wanted is None else (wanted,):
        try:
            return cast("Engine", import_module(ENGINES[known]))
        except ModuleNotFoundError as error:
            if error.name != known:
                raise
    raise UsageError(
        f"{wanted or 'an engine'} is not installed; pip install {wanted or 'mujoco'} (PyBullet has "
        "wheels for CPython 3.11 on Linux x86-64 alone, MuJoCo for all)"
    )


def ball_world(radius_m: float, contact: ContactSettings) -> BallWorld:
    """Return a ball over a plane in the chosen engine; the last few worlds are cached.

    A world costs more than many rollouts, and nothing of one remains in the next.
    """
    return _ball_world(engine(), radius_m, contact)


@lru_cache(maxsize=4)
def _ball_world(simulates: Engine, radius_m: float, contact: ContactSettings) -> BallWorld:
    return simulates.ball_world(radius_m, contact)


@contextmanager
def simulated_by(name: str | None) -> Iterator[None]:
    """Choose the engine within a block, also for processes started in it.

    Args:
        name: None keeps the current choice.

    Raises:
        UsageError: no such engine, or it is not installed.
    """
    before = os.environ.get(ENGINE_VARIABLE)
    if name is not None:
        engine(name)
        os.environ[ENGINE_VARIABLE] = name
    try:
        yield
    finally:
        os.environ.pop(ENGINE_VARIABLE, None)
        if before is not None:
            os.environ[ENGINE_VARIABLE] = before
