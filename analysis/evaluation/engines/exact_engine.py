"""Exact engine: a ball that touches the plane leaves it with the restitution that is set.

It has the names of `recorders.simulators.base.Engine` that a drop needs.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from recorders.simulators.contact import ContactSettings
from recorders.simulators.engines import ENGINES, simulated_by

EXACT = "exact"

name = f"{EXACT} 1.0"


class ExactBallWorld:
    """Speed and height alone, reflected on contact; see `BallWorld`."""

    engine = name

    def __init__(self, radius_m: float, contact: ContactSettings) -> None:
        self.radius_m, self.contact = radius_m, contact
        self.place(0.0, 0.0)

    def place(self, gap_m: float, restitution: float) -> None:
        """See `BallWorld`."""
        self._height_m, self._speed_m_s = self.radius_m + gap_m, 0.0
        self._restitution = restitution

    def set_restitution(self, restitution: float) -> None:
        """See `BallWorld`."""
        self._restitution = restitution

    def set_speed(self, speed_m_s: float) -> None:
        """See `BallWorld`."""
        self._speed_m_s = speed_m_s

    def step(self, period_s: float) -> tuple[float, float]:
        """See `BallWorld`."""
        self._speed_m_s -= self.contact.gravity_m_s2 * period_s
        if self._height_m <= self.radius_m and self._speed_m_s < 0:
            self._speed_m_s *= -self._restitution
        self._height_m += self._speed_m_s * period_s
        return self._height_m, self._speed_m_s


ball_world = ExactBallWorld


@contextmanager
def simulated_in(engine: str) -> Iterator[None]:
    """Simulate with one of `ENGINES` or with the exact one in a block.

    Raises:
        UsageError: it is not installed.
    """
    ENGINES[EXACT] = __name__
    try:
        with simulated_by(engine):
            yield
    finally:
        del ENGINES[EXACT]
