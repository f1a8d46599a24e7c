"""The smallest engine there can be: a module with the names of `Engine`, for balls alone."""

from __future__ import annotations

from recorders.simulators.contact import ContactSettings

name = "toy 1.0"


class ToyBallWorld:
    """Semi-implicit Euler; a ball that is under the plane's surface is reflected."""

    engine = name

    def __init__(self, radius_m: float, contact: ContactSettings) -> None:
        self.radius_m, self.contact = radius_m, contact
        self.place(0.0, 0.0)

    def place(self, gap_m: float, restitution: float) -> None:
        self._height_m, self._speed_m_s = self.radius_m + gap_m, 0.0
        self._restitution = restitution

    def set_restitution(self, restitution: float) -> None:
        self._restitution = restitution

    def set_speed(self, speed_m_s: float) -> None:
        self._speed_m_s = speed_m_s

    def step(self, period_s: float) -> tuple[float, float]:
        self._speed_m_s -= self.contact.gravity_m_s2 * period_s
        if self._height_m - self.radius_m < 1e-6 and self._speed_m_s < 0:
            self._speed_m_s *= -self._restitution
        self._height_m += self._speed_m_s * period_s
        return self._height_m, self._speed_m_s

    def steps(self, period_s: float, count: int) -> list[float]:
        return [self.step(period_s)[0] for _ in range(count)]


ball_world = ToyBallWorld
