"""Convert a restitution to another impact speed, so that two drops are compared at one."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from analysis.checks import Verdict
from analysis.record import Interval, Record
from recorders.simulators.speed_law import MIN_SPEED_M_S

_SAME_RATIO = 1.02  # of two speeds: a ball's restitution changes by a thousandth between them


@dataclass(frozen=True)
class ComparedValue:
    """One log's value of one scalar.

    Attributes:
        label: Of the log.
        value: In the quantity's unit.
        interval95: None if no valid one exists.
        verdict: Of the log.
        sha256: Of the recording; "" if unknown.
        is_restitution: Whether it holds at one speed only.
        speed_m_s: Impact speed that it holds for; None if unknown.
        slowest_m_s: Least impact speed in this log; None if unknown.
        slope: p of e(v) = e (v / speed)^-p; None if unknown.
        slope_half: Half of its 95 % interval; None if it has none.
    """

    label: str
    value: float
    interval95: Interval | None
    verdict: Verdict
    sha256: str = ""
    is_restitution: bool = False
    speed_m_s: float | None = None
    slowest_m_s: float | None = None
    slope: float | None = None
    slope_half: float | None = None


def restitution_value(value: ComparedValue, record: Record) -> ComparedValue:
    """Add the record's impact speeds and slope to a restitution.

    The restitution is that of the impact nearest to the window's: a record may show other bounces
    of the same ball before and after it.
    """
    value = replace(value, is_restitution=True)
    rebounds = record.rebounds
    if rebounds:
        at_s = (record.window or {}).get("impact_s", rebounds[0].impact_s)
        own = min(rebounds, key=lambda rebound: abs(rebound.impact_s - at_s))
        known = [one.impact_speed_m_s for one in rebounds if (one.impact_speed_m_s or 0) > 0]
        if own.impact_speed_m_s is not None and own.impact_speed_m_s > 0:
            slowest_m_s = min(speed_m_s for speed_m_s in known if speed_m_s is not None)
            value = replace(value, speed_m_s=own.impact_speed_m_s, slowest_m_s=slowest_m_s)
    slope = record.estimate("restitution_slope")
    if slope is not None and isinstance(slope.value, float) and abs(slope.value) <= 1:
        value = replace(value, slope=slope.value)
        if slope.interval95 is not None:
            low, high = slope.interval95
            assert isinstance(low, float)
            assert isinstance(high, float)
            half = max(slope.value - low, high - slope.value)
            value = replace(value, slope_half=half)
    return value


def moved(value: ComparedValue, speed_m_s: float) -> ComparedValue:
    """Convert a ball's restitution to another speed by the power law e (v / v_1)^-p.

    The record has no correlation of e and p, so their errors are added as if fully correlated: the
    interval is conservative.
    """
    assert value.speed_m_s is not None
    assert value.slope is not None
    assert value.slope_half is not None
    change = math.log(max(speed_m_s, MIN_SPEED_M_S) / max(value.speed_m_s, MIN_SPEED_M_S))
    factor = math.exp(-value.slope * change)
    middle, ends = value.value * factor, None
    if value.interval95 is not None:
        more = abs(change) * value.slope_half * middle
        low, high = value.interval95
        ends = low * factor - more, high * factor + more
    return replace(value, value=middle, interval95=ends, speed_m_s=speed_m_s)


def at_one_speed(
    first: ComparedValue, second: ComparedValue
) -> tuple[ComparedValue, ComparedValue, float | None, str]:
    """Convert two restitutions to the lower of their speeds, which the faster ball also reaches.

    Returns:
        Both, the common speed if there is one, and a caution.
    """
    if first.speed_m_s is None or second.speed_m_s is None:
        return first, second, None, "no impact speed is known: a difference may be the speed's"
    speed_m_s = min(first.speed_m_s, second.speed_m_s)
    fast = first if first.speed_m_s > speed_m_s else second
    is_far = fast.speed_m_s is not None and fast.speed_m_s > _SAME_RATIO * speed_m_s
    if fast.slope is None or fast.slope_half is None:
        if not is_far:
            return first, second, speed_m_s, ""
        words = f"at {first.speed_m_s:.2f} and {second.speed_m_s:.2f} m/s"
        return first, second, None, f"{words}, slope not known: a difference may be the speed's"
    caution = ""
    if is_far and fast.slowest_m_s is not None and fast.slowest_m_s > _SAME_RATIO * speed_m_s:
        caution = f"no bounce of {fast.label} is so slow: by its law over speed"
    if fast is first:
        return moved(first, speed_m_s), second, speed_m_s, caution
    return first, moved(second, speed_m_s), speed_m_s, caution
