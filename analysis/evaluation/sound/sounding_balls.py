"""Balls and tables that sound: sizes, masses, contacts, and the modes that ring."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recorders.simulators.balls import Ball
from tunenet_logs.arrays import Array

Range = tuple[float, float]

_AIR_KG_M3 = 1.2


@dataclass(frozen=True)
class SoundingBall:
    """Kind of ball.

    Attributes:
        name: in tables.
        diameter_m: range that one is drawn from.
        density_kg_m3: of the whole ball, likewise.
        drag_coefficient: Cd at the speeds of a drop.
        contact_s: range of a contact's duration at 1 m/s.
        strike_s: range of the time in which a touch gets to its full strength.
        ball_hz: range of the ball's own modes.
        ball_ring_s: range of the time in which one falls to 1/e.
        slap: range of the strength of the noise of the touch, over the modes'.
    """

    name: str
    diameter_m: Range
    density_kg_m3: Range
    drag_coefficient: float
    contact_s: Range
    strike_s: Range
    ball_hz: Range
    ball_ring_s: Range
    slap: Range


# Contacts from .3 to 8 ms, drags from .0013 to .13 per m.
SOUNDING_BALLS = (
    SoundingBall(
        *("table tennis", (0.0398, 0.0402), (79.0, 82.5), 0.47, (0.0008, 0.0013)),
        *((0.0001, 0.0003), (4500.0, 9500.0), (0.001, 0.004), (0.3, 1.0)),
    ),
    SoundingBall(
        *("golf", (0.0427, 0.0430), (1090.0, 1128.0), 0.50, (0.0005, 0.0008)),
        *((0.0001, 0.0003), (2500.0, 8000.0), (0.001, 0.004), (0.2, 0.8)),
    ),
    SoundingBall(
        *("tennis", (0.0654, 0.0686), (355.0, 385.0), 0.55, (0.0045, 0.0065)),
        *((0.0003, 0.0010), (250.0, 1400.0), (0.003, 0.012), (0.5, 1.5)),
    ),
    SoundingBall(
        *("racquetball", (0.0567, 0.0577), (395.0, 415.0), 0.47, (0.0045, 0.0080)),
        *((0.0003, 0.0010), (300.0, 1800.0), (0.003, 0.012), (0.5, 1.5)),
    ),
    SoundingBall(
        *("steel", (0.012, 0.040), (7750.0, 7900.0), 0.47, (0.0003, 0.0004)),
        *((0.00005, 0.0002), (9000.0, 16000.0), (0.0005, 0.002), (0.1, 0.6)),
    ),
    SoundingBall(
        *("marble", (0.014, 0.025), (2450.0, 2550.0), 0.47, (0.0003, 0.0004)),
        *((0.00005, 0.0002), (7000.0, 16000.0), (0.0005, 0.002), (0.1, 0.6)),
    ),
    SoundingBall(
        *("rubber", (0.025, 0.050), (1000.0, 1250.0), 0.47, (0.0025, 0.0050)),
        *((0.0002, 0.0008), (500.0, 3000.0), (0.002, 0.008), (0.4, 1.2)),
    ),
    SoundingBall(
        *("wood", (0.025, 0.060), (600.0, 800.0), 0.47, (0.0005, 0.0010)),
        *((0.0001, 0.0004), (1500.0, 6000.0), (0.001, 0.004), (0.2, 0.8)),
    ),
    SoundingBall(
        *("hollow plastic", (0.060, 0.075), (100.0, 150.0), 0.50, (0.0020, 0.0040)),
        *((0.0002, 0.0006), (700.0, 4000.0), (0.002, 0.010), (0.3, 1.0)),
    ),
)


@dataclass(frozen=True)
class SoundingTable:
    """Kind of table or floor.

    Attributes:
        name: for a reader.
        modes: how many there are, at least and at most.
        table_hz: range of their frequencies.
        table_ring_s: range of the time in which one falls to 1/e.
    """

    name: str
    modes: tuple[int, int]
    table_hz: Range
    table_ring_s: Range


SOUNDING_TABLES = (
    SoundingTable("wooden table", (8, 14), (120.0, 3500.0), (0.006, 0.040)),
    SoundingTable("laminate floor", (8, 14), (150.0, 2500.0), (0.004, 0.025)),
    SoundingTable("stone", (5, 10), (700.0, 9000.0), (0.001, 0.010)),
    SoundingTable("glass", (5, 10), (500.0, 7000.0), (0.010, 0.080)),
    SoundingTable("metal plate", (8, 14), (300.0, 6000.0), (0.030, 0.150)),
)


@dataclass(frozen=True, eq=False)
class ImpactVoice:
    """Sound of one ball on one table.

    Attributes:
        modes_hz: frequencies, shape (M,).
        rings_s: time in which each falls to 1/e, shape (M,).
        gains: of each in an impact at 1 m/s, before the strike's own low pass, shape (M,).
        strike_s: in which a touch at 1 m/s gets to its full strength.
        slap_gain: of the noise of the touch.
        slap_s: in which that falls to 1/e.
        slap_hz: its band.
        loudness: power of the speed that all grows with.
        uneven: by which the strength of each mode differs from impact to impact (log, one sd).
    """

    modes_hz: Array
    rings_s: Array
    gains: Array
    strike_s: float
    slap_gain: float
    slap_s: float
    slap_hz: Range
    loudness: float
    uneven: float


@dataclass(frozen=True)
class SampledBall:
    """One ball of a kind.

    Attributes:
        kind: its name.
        told: what a user can say of it: size and mass of the kind's middle.
        drag_1_m: of this one.
        contact_s: of it at 1 m/s.
    """

    kind: str
    told: Ball
    drag_1_m: float
    contact_s: float


# By which a ball's drag differs from what its size and mass say (log, one sd): seams, nap, air.
_DRAG_SD = 0.05


def draw_ball(kind: SoundingBall, rng: np.random.Generator) -> SampledBall:
    """Draw a ball of this kind: a user weighs and measures it to 1 %."""
    diameter_m = float(rng.uniform(*kind.diameter_m))
    mass_kg = float(rng.uniform(*kind.density_kg_m3)) * np.pi / 6 * diameter_m**3
    area_m2 = np.pi / 4 * diameter_m**2
    drag = _AIR_KG_M3 * kind.drag_coefficient * area_m2 / (2 * mass_kg)
    off = np.exp(rng.normal(0.0, [0.01, 0.01, _DRAG_SD]))
    told = Ball(float(diameter_m * off[0]), float(mass_kg * off[1]), kind.drag_coefficient)
    contact_s = float(np.exp(rng.uniform(*np.log(kind.contact_s))))
    return SampledBall(kind.name, told, float(drag * off[2]), contact_s)


def draw_voice(
    kind: SoundingBall, table: SoundingTable, loudness: float, rng: np.random.Generator
) -> ImpactVoice:
    """Draw the sound of a ball of this kind on such a table."""
    of_ball, of_table = int(rng.integers(3, 7)), int(rng.integers(*table.modes, endpoint=True))
    hz = np.concatenate(
        [_log_drawn(kind.ball_hz, of_ball, rng), _log_drawn(table.table_hz, of_table, rng)]
    )
    rings = np.concatenate(
        [_log_drawn(kind.ball_ring_s, of_ball, rng), _log_drawn(table.table_ring_s, of_table, rng)]
    )
    gains = np.exp(rng.normal(0.0, 0.6, of_ball + of_table)) * rng.choice([-1.0, 1.0], len(hz))
    gains[:of_ball] *= rng.uniform(0.2, 1.5)
    gains /= np.sqrt(np.sum(gains**2))
    return ImpactVoice(
        modes_hz=hz,
        rings_s=rings,
        gains=gains,
        strike_s=float(_log_drawn(kind.strike_s, 1, rng)[0]),
        slap_gain=float(rng.uniform(*kind.slap)),
        slap_s=float(rng.uniform(0.0008, 0.004)),
        slap_hz=(float(rng.uniform(600, 2000)), float(rng.uniform(4000, 12000))),
        loudness=loudness,
        uneven=float(rng.uniform(0.05, 0.25)),
    )


def _log_drawn(ends: Range, count: int, rng: np.random.Generator) -> Array:
    return np.exp(rng.uniform(np.log(ends[0]), np.log(ends[1]), count))
