"""What every simulator is to those who tune it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from tunenet_logs.episode import Episode
from tunenet_logs.errors import UsageError

GRAVITY_M_S2 = 9.80665
"""Standard gravity (ISO 80000-3); at sea level it is 9.780 (equator) to 9.832 (poles)."""


@dataclass(frozen=True)
class Parameter:
    """A physical parameter of a simulator.

    Attributes:
        name: the field's standard term, e.g. "restitution".
        unit: "1" where it has none.
        bounds: smallest and largest value that physics allows.
        training_range: from where training pairs are drawn.
        initial: the guess that tuning starts from.
    """

    name: str
    unit: str
    bounds: tuple[float, float]
    training_range: tuple[float, float]
    initial: float

    def checked(self, value: float) -> float:
        """`value`, if the engine may see it.

        Raises:
            UsageError: not finite, or out of bounds.
        """
        low, high = self.bounds
        if not (math.isfinite(value) and low <= value <= high):
            raise UsageError(f"{self.name} {value:g} is not a number from {low:g} to {high:g}")
        return float(value)


class Simulator(Protocol):
    """An episode source that can be asked again with other parameters."""

    @property
    def engine(self) -> str:
        """What simulates, with its version, as `EpisodeInfo.source` begins: "pybullet 3.2.7"."""
        ...

    @property
    def step_hz(self) -> float:
        """Steps of the simulator a second [Hz]."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What can be tuned."""
        ...

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """Simulate one episode. The same values give the same bits.

        Raises:
            UsageError: a value that is missing, not finite or out of bounds.
        """
        ...
