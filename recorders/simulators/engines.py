"""The physics engines by name, and which one simulates."""

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

ENGINES = {
    "pybullet": "recorders.simulators.pybullet.engine",
    "mujoco": "recorders.simulators.mujoco.engine",
}
"""Modules by the engine's name, which is its library's too; each has what `Engine` names, and is
imported when needed. The first that is installed is the default."""

ENGINE_VARIABLE = "TUNENET_ENGINE"
"""Of the environment: the engine that `simulated_by` chose, for this process and its children."""


def engine(name: str | None = None) -> Engine:
    """One of `ENGINES`, imported when first needed.

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
    """A ball over a plane in the engine that simulates: the last few are kept for the next rollout.

    A world costs more than many rollouts, and nothing of one remains in the next.
    """
    return _ball_world(engine(), radius_m, contact)


@lru_cache(maxsize=4)
def _ball_world(simulates: Engine, radius_m: float, contact: ContactSettings) -> BallWorld:
    return simulates.ball_world(radius_m, contact)


@contextmanager
def simulated_by(name: str | None) -> Iterator[None]:
    """Simulate with this engine in a block, in the processes that start in it too.

    Args:
        name: None for what is chosen already.

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
