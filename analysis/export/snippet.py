"""Exported files that are Python: their own `drop` is run, as a user would run it."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np

from tunenet_logs.arrays import Array


def dropped_by(path: Path, height_m: float, seconds: float) -> tuple[Array, Array]:
    """What the function `drop` of a Python file returns; see `CanDrop`."""
    times_s, heights_m = runpy.run_path(str(path))["drop"](height_m, seconds)
    return np.asarray(times_s, np.float64), np.asarray(heights_m, np.float64)
