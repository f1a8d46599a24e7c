"""Run exported files that are Python, as a user would."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np

from tunenet_logs.arrays import Array


def dropped_by(path: Path, height_m: float, seconds: float) -> tuple[Array, Array]:
    """Run the function `drop` of a Python file; see `CanDrop`."""
    times_s, heights_m = runpy.run_path(str(path))["drop"](height_m, seconds)
    return np.asarray(times_s, np.float64), np.asarray(heights_m, np.float64)
