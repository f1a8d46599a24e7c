"""Records that tests make up: what a tuning would have said."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from tunenet_logs.analysis.record import Estimate, Provenance, Rebound, Record
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

HALF = 1.959964  # standard deviations in half of a 95 % interval


def drop_record(
    value: float = 0.7,
    sd: float | None = 0.001,
    *,
    log: str = "drop.mcap",
    sha256: str = "",
    speed_m_s: float | None = 4.0,
    slope: tuple[float, float] | None = None,
    slowest_m_s: float | None = None,
    **more: Any,
) -> Record:
    """A drop's.

    Args:
        value: its restitution.
        sd: of it; None for no interval.
        slope: p and its standard deviation; None where it was not estimated.
        slowest_m_s: of a second impact.
        more: any other field of a record.
    """
    estimates = [Estimate("restitution", "1", value, _ends(value, sd))]
    if slope is not None:
        estimates.append(Estimate("restitution_slope", "1", slope[0], _ends(*slope)))
    speeds = [speed_m_s] + ([slowest_m_s] if slowest_m_s is not None else [])
    fields = {
        "log": log,
        "task": "drop",
        "verdict": "ok",
        "reason": None,
        "estimates": tuple(estimates),
        "rebounds": tuple(Rebound(0.5 + k, value, None, one) for k, one in enumerate(speeds)),
        "window": {"start_s": 0.0, "impact_s": 0.5, "end_s": 2.0},
        "simulator": {"engine": "pybullet 3.2.7", "preset": "default", "step_hz": 240.0},
        "provenance": Provenance("0.1.0", sha256, {}, (), "2026-11-02T10:00:00+00:00", "pybullet"),
    }
    return Record(**(fields | more))


def payload_record(mass_kg: float, sd: float, com_m: tuple[float, ...], com_sd: float) -> Record:
    """A payload's."""
    com = Estimate("payload_com", "m", com_m, tuple(_ends(one, com_sd) for one in com_m))  # type: ignore[arg-type]
    mass = Estimate("payload_mass", "kg", mass_kg, _ends(mass_kg, sd))
    record = drop_record(log="held.mcap", rebounds=(), task="payload")
    return replace(record, estimates=(mass, com))


def rejected_record(reason: str = "no bounce is seen", **more: Any) -> Record:
    """A log's in which nothing was found."""
    fields = {"estimates": (), "rebounds": (), "verdict": "rejected", "reason": reason}
    return drop_record(**(fields | more))


def _ends(value: float, sd: float | None) -> tuple[float, float] | None:
    return None if sd is None else (value - HALF * sd, value + HALF * sd)


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
    """A dropped ball's JSON; with `first`, the restitution that stands for it without air."""
    speed_m_s = math.sqrt(2 * GRAVITY_M_S2 * height_m)
    numbers = {"restitution": restitution, "restitution_slope": slope, "drag": drag}
    bounce = {"restitution": restitution, "interval95": None, "impact_speed": speed_m_s}
    fields = {
        "log": "drop.mcap",
        "task": "drop",
        "verdict": "ok",
        "reason": None,
        "parameters": {
            name: {"value": value, "interval95": [value - 0.01, value + 0.01], "unit": "1"}
            for name, value in numbers.items()
            if value is not None
        },
        "bounces": [{**bounce, "unit": "m/s", "time_s": 0.5}],
        "equivalent": first
        and {
            name: {"restitution": value, "rms_percent": 1.0, "speeds_m_s": [speed_m_s]}
            for name, value in (("first", first), ("all", first + 0.01))
        },
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
    """A held mass's JSON; without a centre where the log does not tell it."""
    known: dict[str, Any] = {
        "payload_mass": {"value": mass_kg, "interval95": [0.7, 0.9], "unit": "kg"}
    }
    if com_m is not None:
        ends = [[part - 0.001, part + 0.001] for part in com_m]
        known["payload_com"] = {"value": list(com_m), "interval95": ends, "unit": "m"}
    fields = {"log": "held.mcap", "task": "payload", "verdict": "ok", "parameters": known}
    path.write_text(json.dumps(fields | {"reason": None} | changed))
    return path
