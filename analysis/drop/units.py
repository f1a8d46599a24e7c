"""Units of a recorded track: named, inferred from gravity, or not to be determined.

Restitution needs no unit and no clock, because a bounce is one curve in drop heights and fall
times. Gravity tells more: what falls with 9,810 is in mm, with 981 in cm, with 386 in inches; with
another figure it is in pixels, has a scale, or the clock is wrong. Then speeds stay unknown.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.drop.gravity import Gravity
from analysis.motion import Units
from recorders.simulators.base import GRAVITY_M_S2
from tunenet_logs.arrays import Array
from tunenet_logs.episode import FRAME_NS, UNSTATED, Signal

# Of lengths, and their metres, the likeliest first.
_UNITS = (("m", 1.0), ("cm", 0.01), ("mm", 0.001), ("ft", 0.3048), ("in", 0.0254))

# Units in which times may be that were taken as seconds.
_CLOCKS = (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9), ("min", 60.0))

# Fraction that a fall's acceleration may be off gravity for its unit to be known: the air.
_NEAR = 0.12

# Of what records a ball; another rate that gravity would tell is a wrong unit's.
_RATES_HZ = (5.0, 50_000.0)

# A drop of which neither unit nor rate is known is simulated as one of this height.
_NOMINAL_DROP_M = 1.0


def units_words(units: Units) -> str:
    """Describe the units that were inferred, for a user; "" where all was named."""
    if units.doubt:
        return ""
    parts: list[str] = []
    if units.length_by == "gravity":
        unit = next((name for name, size in _UNITS if size == units.length_m), "")
        parts.append(f"lengths name no unit; by the fall they are in {unit}")
    elif units.length_by is None:
        parts.append("the unit of length is not known, so heights and speeds are not told")
    if units.rate_by == "gravity":
        parts.append(f"no rate is named; by the fall it is {units.rate_hz:.4g} frames a second")
    elif units.rate_by is None:
        parts.append("the frame rate is not known (see --fps)")
    return "; ".join(parts)


def named_units(signal: Signal) -> Units:
    """Return the units of a signal in metres, by its own clock."""
    by = "named" if signal.unit == "m" else "gravity"
    return Units(1.0, by, signal.rate_hz, "clock")


@dataclass(frozen=True, eq=False)
class Scaled:
    """Track in metres and seconds, as far as these can be known.

    Attributes:
        signal: its values in m, its stamps in ns from the same first stamp.
        size: its metres in one unit of the log.
        units: what is known of the log's.
    """

    signal: Signal
    size: float
    units: Units


def scaled_by_gravity(signal: Signal, gravity: Gravity, height: float) -> Scaled:
    """Scale a track to units in which it falls with the gravity of the earth.

    Args:
        signal: positions in any unit.
        gravity: of its free flights, in its own units and the seconds of its stamps.
        height: of its first drop, in its own unit.
    """
    ratio = GRAVITY_M_S2 / gravity.size  # metres in a unit, where the seconds are true
    near = next((one for one in _UNITS if abs(one[1] / ratio - 1) < _NEAR), None)
    if signal.counts_frames:
        return _with_rate_by_gravity(signal, ratio, height)
    rate_hz = signal.rate_hz
    if signal.unit == "m":
        if near is not None and near[1] == 1.0:
            return Scaled(signal, 1.0, Units(1.0, "named", rate_hz, "clock"))
        return _contradicted(signal, ratio, near)
    if signal.unit == UNSTATED and near is not None:
        units = Units(near[1], "gravity", rate_hz, "clock")
        return _scaled(signal, near[1], 1.0, units)
    if signal.unit == UNSTATED:
        for _, size in _CLOCKS:
            if abs(size**2 * ratio - 1) < 2 * _NEAR:
                return _scaled(signal, 1.0, size, Units(1.0, "gravity", rate_hz / size, "gravity"))
    return scaled_alone(signal, gravity)


def scaled_alone(signal: Signal, gravity: Gravity) -> Scaled:
    """Scale a track whose unit cannot be determined, by its own clock: of pixels, or of a scale."""
    ratio = GRAVITY_M_S2 / gravity.size
    return _scaled(signal, ratio, 1.0, Units(None, None, signal.rate_hz, "clock"))


def _with_rate_by_gravity(signal: Signal, ratio: float, height: float) -> Scaled:
    """Infer the rate of a track that counts frames, 1e9 / FRAME_NS of them a second."""
    if signal.unit == "m":
        stretch = float(np.sqrt(1 / ratio))  # true seconds in one of the stamps
        rate_hz = 1e9 / FRAME_NS / stretch
        if _RATES_HZ[0] < rate_hz < _RATES_HZ[1]:
            units = Units(1.0, "named", rate_hz, "gravity")
            return _scaled(signal, 1.0, stretch, units)
    size = _NOMINAL_DROP_M / height
    stretch = float(np.sqrt(size / ratio))
    return _scaled(signal, size, stretch, Units(None, None, None, None))


def _contradicted(signal: Signal, ratio: float, near: tuple[str, float] | None) -> Scaled:
    """Scale a track in "metres" that does not fall as metres do."""
    rate_hz = signal.rate_hz
    falls = f"falls with {GRAVITY_M_S2 / ratio:.4g} m/s²"
    if near is not None:
        name, size = near
        doubt = f"{falls}: the lengths are in {name}, it seems"
        units = Units(size, "gravity", rate_hz, "clock", doubt, f"say --length-unit {name}")
        return _scaled(signal, size, 1.0, units)
    for name, size in _CLOCKS:
        if abs(size**2 * ratio - 1) < 2 * _NEAR:
            doubt = f"{falls}: the stamps are in {name}, it seems, not in s"
            remedy = "record true times" if signal.unit == "m" else "name their unit"
            units = Units(1.0, "named", rate_hz / size, "gravity", doubt, remedy)
            return _scaled(signal, 1.0, size, units)
    doubt = f"{falls}: lengths are in pixels or scaled, or the clock is wrong"
    units = Units(None, None, rate_hz, "clock", doubt, "record lengths in m and the true times")
    return _scaled(signal, ratio, 1.0, units)


def _scaled(signal: Signal, size: float, stretch: float, units: Units) -> Scaled:
    """Multiply values by `size`, and times since the first stamp by `stretch`."""
    stamps_ns = signal.stamps_ns
    if stretch != 1.0 and len(stamps_ns):
        since: Array = (stamps_ns - stamps_ns[0]).astype(np.float64) * stretch
        stamps_ns = stamps_ns[0] + np.round(since).astype(np.int64)
    scaled = replace(signal, stamps_ns=stamps_ns, values=signal.values * size, unit="m")
    return Scaled(scaled, size, units)
