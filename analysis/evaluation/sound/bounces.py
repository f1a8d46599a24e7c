"""Compute touches, speeds and contact times of a bounce: the truth behind a sound.

Between two contacts the ball flies in air that slows it by the square of its speed, k v². With the
final speed V = sqrt(g / k), a rise from speed v takes V / g atan(v / V) and gets to the height
ln(1 + v² / V²) / 2k; a fall from height h takes V / g arcosh(exp(k h)). The next flight begins when
the contact ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tunenet_logs.arrays import Array

GRAVITY_M_S2 = 9.81

MIN_SPEED_M_S = 0.06  # a ball that touches more slowly is left lying: nobody hears it
_MAX_IMPACTS = 60
_MAX_RESTITUTION = 0.975
_HERTZ = -0.2  # a contact lasts as the speed to this power (Hertz 1881)
_MIN_DRAG_1_M = 1e-7


@dataclass(frozen=True)
class BounceOrder:
    """Specification of a bounce.

    Attributes:
        height_m: of the fall.
        restitution: at the first impact.
        slope: p of e_n = e_1 (v_n / v_1)^-p.
        drag_1_m: deceleration by the air over speed squared.
        contact_s: how long a contact at 1 m/s lasts.
        uneven: standard deviation of an impact's own restitution about that law (log).
        seed: of what each impact is off by.
    """

    height_m: float
    restitution: float
    slope: float
    drag_1_m: float
    contact_s: float
    uneven: float = 0.0
    seed: int = 0


@dataclass(frozen=True, eq=False)
class BounceHistory:
    """Impacts of a bounce, shape (N,) each.

    Attributes:
        order: what was dropped.
        touches_s: when contacts begin, after the release.
        contacts_s: how long they last.
        speeds_m_s: at touch, downward.
        restitutions: speed after over speed before.
        by_law: what they were without being uneven.
    """

    order: BounceOrder
    touches_s: Array
    contacts_s: Array
    speeds_m_s: Array
    restitutions: Array
    by_law: Array

    def heights_m(self, seconds: Array) -> Array:
        """Return heights over the table, shape (T,); in a contact a little below 0."""
        order, drag = self.order, max(self.order.drag_1_m, _MIN_DRAG_1_M)
        heights = np.full(len(seconds), order.height_m)
        falling = (seconds > 0) & (seconds < self.touches_s[0])
        heights[falling] -= _fallen_m(seconds[falling], drag)
        starts = self.touches_s + self.contacts_s
        ends = np.append(self.touches_s[1:], np.inf)
        ups = self.speeds_m_s * self.restitutions
        for touch, start, end, speed, up in zip(
            self.touches_s, starts, ends, self.speeds_m_s, ups, strict=True
        ):
            pressed = (seconds >= touch) & (seconds < start)
            phase = (seconds[pressed] - touch) / (start - touch)
            heights[pressed] = -speed * (start - touch) / np.pi * np.sin(np.pi * phase)
            flying = (seconds >= start) & (seconds < end)
            if np.isfinite(end):
                heights[flying] = _flight_m(seconds[flying] - start, up, drag)
            else:
                heights[flying] = 0.0
        return heights


def bounced(order: BounceOrder) -> BounceHistory:
    """Drop a ball and compute its impacts until it is slow."""
    drag = max(order.drag_1_m, _MIN_DRAG_1_M)
    clock, speed = fall_of(order.height_m, drag)
    first = speed
    own = np.random.default_rng(order.seed).normal(0.0, order.uneven, _MAX_IMPACTS)
    rows: list[tuple[float, float, float, float, float]] = []
    while speed > MIN_SPEED_M_S and len(rows) < _MAX_IMPACTS:
        by_law = min(order.restitution * (speed / first) ** -order.slope, _MAX_RESTITUTION)
        kept = min(by_law * float(np.exp(own[len(rows)])), _MAX_RESTITUTION)
        contact = order.contact_s * speed**_HERTZ
        rows.append((clock, contact, speed, kept, by_law))
        rise_s, apex_m = rise_of(kept * speed, drag)
        fall_s, speed = fall_of(apex_m, drag)
        clock += contact + rise_s + fall_s
    return BounceHistory(order, *np.array(rows).reshape(-1, 5).T)


def rise_of(speed_m_s: float, drag_1_m: float) -> tuple[float, float]:
    """Return the duration [s] and height [m] of a rise in drag."""
    final = np.sqrt(GRAVITY_M_S2 / drag_1_m)
    ratio = speed_m_s / final
    return float(final / GRAVITY_M_S2 * np.arctan(ratio)), float(np.log1p(ratio**2) / 2 / drag_1_m)


def fall_of(height_m: float, drag_1_m: float) -> tuple[float, float]:
    """Return the duration [s] and final speed [m/s] of a fall from rest in drag."""
    final = np.sqrt(GRAVITY_M_S2 / drag_1_m)
    speed = final * np.sqrt(-np.expm1(-2 * drag_1_m * height_m))
    return float(final / GRAVITY_M_S2 * np.arctanh(speed / final)), float(speed)


def _fallen_m(seconds: Array, drag_1_m: float) -> Array:
    """Return how far a ball falls from rest."""
    final = np.sqrt(GRAVITY_M_S2 / drag_1_m)
    return np.log(np.cosh(GRAVITY_M_S2 * seconds / final)) / drag_1_m


def _flight_m(seconds: Array, up_m_s: float, drag_1_m: float) -> Array:
    """Return the height of a ball that left the table at this speed."""
    final = np.sqrt(GRAVITY_M_S2 / drag_1_m)
    rise_s, apex_m = rise_of(up_m_s, drag_1_m)
    left = np.clip(rise_s - seconds, 0.0, None)
    rising = apex_m + np.log(np.cos(GRAVITY_M_S2 * left / final)) / drag_1_m
    return np.where(left > 0, rising, apex_m - _fallen_m(np.maximum(seconds - rise_s, 0), drag_1_m))
