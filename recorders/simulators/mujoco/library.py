"""MuJoCo's module, imported when first needed: that takes most of a second."""

from __future__ import annotations

from functools import cache
from types import ModuleType


@cache
def mujoco() -> ModuleType:
    """The library's module, whose names its own type stubs leave out."""
    import mujoco as module

    return module
