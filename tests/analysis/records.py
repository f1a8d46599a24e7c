"""Records that tests make up: what a tuning would have said."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from tunenet_logs.analysis.record import Estimate, Provenance, Rebound, Record

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
