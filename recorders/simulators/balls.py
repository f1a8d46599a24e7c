"""Balls that people drop, and what the air does to them."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

AIR_KG_M3 = 1.2
"""At 20 degrees Celsius and sea level."""


@dataclass(frozen=True)
class Ball:
    """What is known of a ball.

    Attributes:
        diameter_m: None where it is not known.
        mass_kg: None likewise.
        drag_coefficient: Cd at the speeds of a drop from a table's height.
    """

    diameter_m: float | None = None
    mass_kg: float | None = None
    drag_coefficient: float = 0.47

    @property
    def drag_1_m(self) -> float | None:
        """Deceleration by the air over speed squared [1/m]; None where mass or size is unknown."""
        if self.diameter_m is None or self.mass_kg is None:
            return None
        area_m2 = pi / 4 * self.diameter_m**2
        return AIR_KG_M3 * self.drag_coefficient * area_m2 / (2 * self.mass_kg)


BALLS = {
    "table-tennis": Ball(0.040, 0.0027),
}
