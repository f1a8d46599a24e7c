"""PyBullet, imported when first needed and without its greeting on standard error."""

from __future__ import annotations

import os
import sys
from functools import cache
from importlib.metadata import version
from types import ModuleType


@cache
def pybullet() -> ModuleType:
    """The engine's module."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        import pybullet as module  # prints its build time, past Python's own streams
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
    return module


@cache
def engine_name() -> str:
    """Engine and version, as a log and a tuning state them."""
    return f"pybullet {version('pybullet')}"
