"""Tunings for other engines, as JSON."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

# A log's name that would end every kind of comment and text.
HOSTILE = (
    "a--b-->\"\"\"'''\n import os; os.remove('x') \x1b[31m\u2028\ud800${x}{y}%s]]>&<#\\ ü.mcap"
)


def ball_tuning(
    path: Path,
    restitution: float = 0.8,
    slope: float | None = None,
    drag: float | None = None,
    height_m: float = 1.0,
    first: float | None = None,
    **changed: Any,
) -> Path:
    """A dropped ball's tuning; with `first`, the restitution that stands for it without air."""
    speed_m_s = math.sqrt(2 * GRAVITY_M_S2 * height_m)
    numbers = {"restitution": restitution, "restitution_slope": slope, "drag": drag}
    parameters = {
        name: {"value": value, "interval95": [value - 0.01, value + 0.01], "unit": "1"}
        for name, value in numbers.items()
        if value is not None
    }
    equivalent = first and {
        name: {"restitution": value, "rms_percent": 1.0, "speeds_m_s": [speed_m_s]}
        for name, value in (("first", first), ("all", first + 0.01))
    }
    fields = {
        "log": "drop.mcap",
        "task": "drop",
        "verdict": "ok",
        "reason": None,
        "parameters": parameters,
        "bounces": [
            {
                "restitution": restitution,
                "interval95": None,
                "impact_speed": speed_m_s,
                "unit": "m/s",
                "time_s": 0.5,
            }
        ],
        "equivalent": equivalent,
        "provenance": {
            "version": "0.1.0",
            "log_sha256": "ab" * 32,
            "options": {},
            "tare": None,
            "date": "2026-01-02T03:04:05+00:00",
            "engine": "pybullet 3.2.7",
        },
    }
    path.write_text(json.dumps(fields | changed))
    return path


def payload_tuning(
    path: Path,
    mass_kg: float = 0.8,
    com_m: tuple[float, float, float] | None = (0.01, -0.02, 0.03),
    **changed: Any,
) -> Path:
    """A held mass's tuning; without a centre where the log does not tell it."""
    known: dict[str, Any] = {
        "payload_mass": {"value": mass_kg, "interval95": [0.7, 0.9], "unit": "kg"}
    }
    if com_m is not None:
        ends = [[part - 0.001, part + 0.001] for part in com_m]
        known["payload_com"] = {"value": list(com_m), "interval95": ends, "unit": "m"}
    fields = {"log": "held.mcap", "task": "payload", "verdict": "ok", "parameters": known}
    path.write_text(json.dumps(fields | {"reason": None} | changed))
    return path
