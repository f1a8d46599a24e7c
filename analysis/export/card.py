"""Card: a tuning as plain data, for engines without a file format here."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from analysis.export.exported import ExportedBall, ExportedPayload, ExportOrigin
from analysis.record import Estimate
from tunenet_logs.terminal import one_line


def ball_card(ball: ExportedBall, notes: list[str]) -> dict[str, Any]:
    """Build the card of a ball; `notes` are the remarks that other files have as comments."""
    known = ball.equivalents
    return {
        "kind": "ball",
        "verdict": ball.origin.verdict,
        "reason": ball.origin.reason,
        "restitution": {
            "value": ball.restitution,
            "unit": "1",
            "at_speed": asdict(ball.speed_m_s) | {"unit": "m/s"},
            "meaning": ball.meaning,
        },
        "tuned": {
            known.name: _estimate(known) for known in (ball.tuned, ball.slope, ball.drag) if known
        },
        "law": {
            "restitution": ball.law.restitution,
            "slope": ball.law.slope,
            "at_speed_m_s": ball.first_speed_m_s,
            "formula": "restitution * (speed / at_speed)**-slope",
        },
        "equivalent": known
        and {
            name: {"restitution": one.restitution, "rms_percent": one.rms_percent}
            for name, one in (("first", known.first), ("all", known.all))
        },
        "ball": {
            "radius": asdict(ball.radius_m) | {"unit": "m"},
            "mass": asdict(ball.mass_kg) | {"unit": "kg"},
            "drop_height": asdict(ball.drop_height_m) | {"unit": "m"},
            "friction": ball.friction,
        },
        "provenance": _provenance(ball.origin),
        "notes": notes,
    }


def payload_card(payload: ExportedPayload, notes: list[str]) -> dict[str, Any]:
    """Build the card of a payload; `notes` as in `ball_card`."""
    xx, xy, xz, yy, yz, zz = payload.inertial.inertia_kg_m2
    return {
        "kind": "payload",
        "verdict": payload.origin.verdict,
        "reason": payload.origin.reason,
        "tuned": {known.name: _estimate(known) for known in (payload.mass, payload.com) if known},
        "payload": {
            "mass_kg": payload.mass_kg,
            "com_m": list(payload.com_m),
            "frame": "the arm's tool frame",
            "inertia_kg_m2": {"ixx": xx, "ixy": xy, "ixz": xz, "iyy": yy, "iyz": yz, "izz": zz},
            "inertia_of": f"a solid ball of {payload.radius_m:g} m radius, assumed",
        },
        "provenance": _provenance(payload.origin),
        "notes": notes,
    }


def _estimate(known: Estimate) -> dict[str, Any]:
    return {
        "value": _plain(known.value),
        "interval95": _plain(known.interval95),
        "unit": one_line(known.unit),
    }


def _plain(value: Any) -> Any:
    """Convert tuples to lists, which every format has."""
    return [_plain(one) for one in value] if isinstance(value, tuple) else value


def _provenance(origin: ExportOrigin) -> dict[str, str]:
    return {
        "log": origin.log,
        "log_sha256": origin.log_sha256,
        "date": origin.date,
        "tuned_by": origin.tuned_by,
        "exported_by": origin.version,
    }
