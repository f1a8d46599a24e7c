"""Import MuJoCo when first needed: that takes most of a second."""

from __future__ import annotations

import warnings
from functools import cache
from types import ModuleType


@cache
def mujoco() -> ModuleType:
    """Import the library's module, untyped: its stubs leave names out."""
    import mujoco as module

    # what a stranger's model says in an old way, MuJoCo says at each compilation
    warnings.filterwarnings("ignore", "compiler attribute .* is deprecated", UserWarning)
    return module
