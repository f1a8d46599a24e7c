"""A restitution at another impact's speed, so that two drops are compared at one."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from analysis.checks import Verdict
from analysis.record import Interval, Record
from recorders.simulators.speed_law import SLOWEST_M_S

_SAME_RATIO = 1.02
"""Of two speeds: a ball's restitution changes by a thousandth between them."""


@dataclass(frozen=True)
class ComparedValue:
    """What one log says of one number.

    Attributes:
        label: of the log.
        value: in the quantity's unit.
        interval95: None where none is honest.
        verdict: of the log.
        sha256: of the recording; "" where that is not known.
        is_restitution: whether it holds at one speed only.
        speed_m_s: of the impact that it holds for; None where that is not known.
        slowest_m_s: of the impacts that this log shows; None where that is not known.
        slope: p of e(v) = e (v / speed)^-p; None where that is not known.
        slope_half: half of its 95 % interval; None where it has none.
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
    """With what the record says of speeds: those of its impacts, and how it falls with them.

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
    """The same ball's restitution at another speed, e (v / v_1)^-p.

    The record has no correlation of e and p, so their errors are added as if they always went
    together: the interval is at least as wide as it has to be.
    """
    assert value.speed_m_s is not None
    assert value.slope is not None
    assert value.slope_half is not None
    change = math.log(max(speed_m_s, SLOWEST_M_S) / max(value.speed_m_s, SLOWEST_M_S))
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
    """Two restitutions at the lower of their speeds, which the faster ball has later, too.

    Returns:
        Both, the speed if there is one for both, and what to bear in mind.
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
