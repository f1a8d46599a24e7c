"""The paper's o: what a network looks at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Observation:
    """A curve on a fixed grid.

    Attributes:
        values: float64, shape (L, C); NaN where the episode shows nothing.
        axis: the L places of the grid, increasing.
        axis_name: what the axis is, with its unit.
        value_names: what the C channels are, with their units.

    Raises:
        ValueError: shapes disagree.
    """

    values: NDArray[np.float64]
    axis: NDArray[np.float64]
    axis_name: str
    value_names: tuple[str, ...]

    def __post_init__(self) -> None:
        expected = (len(self.axis), len(self.value_names))
        if self.values.shape != expected:
            raise ValueError(f"values have shape {self.values.shape}, expected {expected}")
        self.values.flags.writeable = False
        self.axis.flags.writeable = False


def resample(
    axis: NDArray[np.float64], values: NDArray[np.float64], wanted: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Linear interpolation at `wanted`, NaN outside (Resample of algorithm 1).

    Args:
        axis: shape (T,), increasing.
        values: shape (T,).
        wanted: shape (L,).
    """
    return np.interp(wanted, axis, values, left=np.nan, right=np.nan)
