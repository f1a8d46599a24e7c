"""Explain a tuning's figures in plain sentences."""

from __future__ import annotations

import math

from analysis.record import Estimate, Record
from analysis.speed_transport import ComparedValue, restitution_value
from recorders.simulators.base import GRAVITY_M_S2

_FIXED = {
    "payload_mass": "what the gripper holds",
    "payload_com": "centre of mass of what is held, in the frame of the tool's link",
}

# By verdict.
NEXT = {
    "ok": "The values can be used.",
    "suspect": "The values may be wrong: use them only after looking at what failed.",
    "rejected": "No value can be reported from this recording.",
}


def meaning(record: Record, known: Estimate) -> str:
    """Explain one estimate in a sentence; "" if there is no explanation."""
    if not record.physical:
        return "a number of this engine's settings under the paper's presets, not the ball's own"
    if known.name in _FIXED:
        return _FIXED[known.name]
    if not isinstance(known.value, float):
        return ""
    speed_m_s = first_speed_m_s(record)
    sentences = {
        "restitution": _restitution(known.value, speed_m_s),
        "restitution_slope": _slope(record, known.value, speed_m_s),
        "drag": _drag(known.value, speed_m_s),
    }
    return sentences.get(known.name, "")


def first_speed_m_s(record: Record) -> float | None:
    """Return the impact speed that the restitution holds for, or None."""
    blank = ComparedValue("", 0.0, None, record.verdict)
    return restitution_value(blank, record).speed_m_s


def _restitution(value: float, speed_m_s: float | None) -> str:
    at = "" if speed_m_s is None else f", at {speed_m_s:.2f} m/s"
    return f"at its first impact{at}, the ball keeps {100 * value:.1f} % of its speed"


def _slope(record: Record, slope: float, speed_m_s: float | None) -> str:
    restitution = record.estimate("restitution")
    if restitution is None or not isinstance(restitution.value, float):
        return "p: at speed v the ball keeps e (v / v first)^-p of it"
    half = min(restitution.value * math.exp(min(slope, 1.0) * math.log(2)), 1.0)
    at = "half the speed" if speed_m_s is None else f"half the speed, {speed_m_s / 2:.2f} m/s"
    return f"p: at speed v the ball keeps e (v / v first)^-p of it; at {at}, {100 * half:.1f} %"


def _drag(drag_1_m: float, speed_m_s: float | None) -> str:
    words = "k: the air slows the ball by k v²"
    if speed_m_s is None or speed_m_s > 1e3:
        return words
    slowed = drag_1_m * speed_m_s**2
    return f"{words}; at {speed_m_s:.2f} m/s that is {100 * slowed / GRAVITY_M_S2:.1f} % of gravity"
