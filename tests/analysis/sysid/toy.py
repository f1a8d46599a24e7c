"""A simulator that is a plain function of time, and a log of it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tunenet_logs.analysis.sysid.fit import Column, ComparedColumns, Run, noise_of
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.base import Parameter

SECONDS = np.linspace(0, 10, 400)
Shape = Callable[[Array], Array]


def target_of(values: Array) -> ComparedColumns:
    spread = float(np.std(values))
    return ComparedColumns(0, (Column("s", "c", "m", SECONDS, values, noise_of(values), spread),))


def run_of(shape: Shape) -> Run:
    return lambda rows: np.stack([shape(row) for row in rows])


def parameter(name: str, low: float = -5.0, high: float = 5.0) -> Parameter:
    return Parameter(name, "1", (low, high), (low, high), (low + high) / 2)


def line(values: Array) -> Array:
    return values[0] + values[1] * np.sin(SECONDS)
