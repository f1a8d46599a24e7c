"""Cards: a tuning as plain data, for engines without a file format here.

YAML is for people and configurations; its remarks are comments. JSON is for scripts; it has no
comments, so that its remarks are under `notes`.
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from tunenet_logs.analysis.export.exported import (
    ExportedBall,
    ExportedPayload,
    ExportOrigin,
    ball_lines,
    hash_comment,
    one_restitution_lines,
    payload_lines,
)
from tunenet_logs.analysis.record import Estimate
from tunenet_logs.terminal import one_line


@dataclass
class Card:
    """A card in one language; see `ExportFormat`."""

    NAME: str
    SUFFIX: str
    STEP_S: float | None = None
    LIBRARY: str | None = None

    def ball_text(self, ball: ExportedBall) -> str:
        """See `ExportFormat`."""
        return self.text(_ball_card(ball), [*ball_lines(ball), *one_restitution_lines(ball)])

    def payload_text(self, payload: ExportedPayload) -> str:
        """See `ExportFormat`."""
        return self.text(_payload_card(payload), payload_lines(payload))

    def text(self, card: dict[str, Any], notes: list[str]) -> str:
        """Write data and remarks on it."""
        if self.NAME == "json":
            card["notes"] = notes
            return json.dumps(card, indent=1, ensure_ascii=True, allow_nan=False) + "\n"
        from ruamel.yaml import YAML

        body = io.StringIO()
        writer = YAML()
        writer.width = 4096  # a text stays on its line
        writer.dump(card, body)
        return f"{hash_comment(notes)}\n{body.getvalue()}"


JSON_CARD, YAML_CARD = Card("json", ".json"), Card("yaml", ".yaml")


def _ball_card(ball: ExportedBall) -> dict[str, Any]:
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
            "friction": None,  # a drop does not identify it
        },
        "provenance": provenance_card(ball.origin),
    }


def _payload_card(payload: ExportedPayload) -> dict[str, Any]:
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
        "provenance": provenance_card(payload.origin),
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


def flat(numbers: Sequence[float] | None) -> list[float] | None:
    """Return numbers as a list that YAML writes on one line; None as it is."""
    if numbers is None:
        return None
    from ruamel.yaml.comments import CommentedSeq

    found = CommentedSeq(numbers)
    found.fa.set_flow_style()
    return found


def provenance_card(origin: ExportOrigin) -> dict[str, str]:
    """Return whose values they are, as data."""
    return {
        "log": origin.log,
        "log_sha256": origin.log_sha256,
        "date": origin.date,
        "tuned_by": origin.tuned_by,
        "exported_by": origin.version,
    }
