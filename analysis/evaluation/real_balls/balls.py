"""Balls that people drop: their masses, sizes and restitutions, and drops of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from analysis.evaluation.real_balls.drops import MAX_S, RATES_HZ, RecordedDrop, record_drop
from analysis.evaluation.real_balls.physics import MIN_SPEED_M_S, RealBall, fallen

_AIR_KG_M3 = 1.204  # at 20 degrees Celsius and 101.3 kPa
HEIGHTS_M = (0.5, 1.0, 2.0)  # that each ball is dropped from
NOISE_M = 0.001  # standard deviation of each coordinate of these drops
# From the release to the last sample of what the paper's network is given: it needs 6.7 s.
PAPER_S = 7.2


@dataclass(frozen=True)
class TableBall:
    """Kind of ball.

    Attributes:
        name: in tables.
        diameter_m: of the ball.
        mass_kg: likewise.
        drag_coefficient: Cd at the speeds of a drop.
        restitution: at an impact with `speed_m_s`.
        speed_m_s: see there.
        slope: p of the restitution's fall with speed.
    """

    name: str
    diameter_m: float
    mass_kg: float
    drag_coefficient: float
    restitution: float
    speed_m_s: float
    slope: float

    @property
    def drag_1_m(self) -> float:
        """Drag deceleration over speed squared: rho Cd A / (2 m) [1/m]."""
        area_m2 = np.pi / 4 * self.diameter_m**2
        return float(_AIR_KG_M3 * self.drag_coefficient * area_m2 / (2 * self.mass_kg))

    def dropped(self, drop_m: float) -> RealBall:
        """Drop this ball from a height, with the restitution at its impact speed."""
        falling = fallen(np.array([[0.5, 0.0, self.drag_1_m, drop_m]]), 0.0)
        speed = max(float(falling.impact_speeds_m_s[0, 0]), MIN_SPEED_M_S)
        restitution = self.restitution * (speed / self.speed_m_s) ** -self.slope
        return RealBall(restitution, self.slope, self.drag_1_m, drop_m)


# Cd .47 to .5: a smooth sphere at Reynolds numbers of 1e4 to 1e5 (Achenbach 1972). Restitutions are
# on a hard floor. Slopes are plausible rather than measured, but where a source is named.
TABLE_BALLS = (
    # ITTF, technical leaflet T3: 40 mm, 2.7 g, rebounds to 24 to 26 cm from 30.5 cm, and the
    # air takes its part.
    TableBall("table tennis", 0.0400, 0.0027, 0.47, 0.93, 2.4, 0.04),
    # ITF, rule 3: 6.54 to 6.86 cm, 56.0 to 59.4 g, 135 to 147 cm from 254 cm; Cd with the nap
    # (Mehta 2008). It falls with speed (Cross 1999, "The bounce of a ball", Am. J. Phys. 67).
    TableBall("tennis", 0.0670, 0.0577, 0.55, 0.755, 6.9, 0.06),
    # World Squash, appendix 7: 40 mm, 24 g, a cold one rebounds by 12 % at least from 254 cm.
    TableBall("squash", 0.0400, 0.0240, 0.47, 0.38, 7.0, 0.11),
    # USA Racquetball, rule 2.2: 57 mm, 39.7 g, 68 to 72 inches from 100 inches.
    TableBall("racquetball", 0.0572, 0.0397, 0.47, 0.845, 7.0, 0.03),
    # R&A and USGA: 42.67 mm, 45.93 g; Cd below the drag crisis (Bearman and Harvey 1976).
    TableBall("golf", 0.0427, 0.0459, 0.50, 0.84, 4.4, 0.05),
    # A bearing's, 1 inch, 7.8 g/cm³, on a thick plate: plastic yielding makes e fall (Johnson 1985,
    # "Contact Mechanics", section 11.5).
    TableBall("steel", 0.0254, 0.0669, 0.47, 0.90, 1.0, 0.10),
    # A hollow play ball: the lightest for its size.
    TableBall("play ball", 0.0740, 0.0100, 0.47, 0.72, 3.8, 0.03),
)


@dataclass(frozen=True, eq=False)
class TableDrop:
    """Drop of a ball of the table.

    Attributes:
        ball: which.
        view: what is recorded of it, for `MAX_S` at most.
        whole: the same and more, for the paper's network: 60 Hz, `PAPER_S`, whether it lies or not.
    """

    ball: TableBall
    view: RecordedDrop
    whole: RecordedDrop


def table_drops(ball: TableBall, seed: int, count: int) -> Iterator[TableDrop]:
    """Yield `count` drops from each of `HEIGHTS_M`, at rates in turn."""
    for at, drop_m in enumerate(HEIGHTS_M):
        for number in range(count):
            named = [seed, number, at, *ball.name.encode()]
            rate_hz = RATES_HZ[(number + at) % len(RATES_HZ)]
            real = ball.dropped(drop_m)
            view = record_drop(real, rate_hz, NOISE_M, np.random.default_rng(named), MAX_S)
            rng = np.random.default_rng([*named, 1])
            whole = record_drop(real, 60.0, NOISE_M, rng, PAPER_S, lies_s=(PAPER_S, PAPER_S))
            yield TableDrop(ball, view, whole)
