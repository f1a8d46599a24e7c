"""JSON card, for scripts; remarks are under `notes`, as JSON has no comments."""

from __future__ import annotations

import json

from tunenet_logs.analysis.export.exported import (
    ExportedBall,
    ExportedPayload,
    ball_card,
    ball_lines,
    one_restitution_lines,
    payload_card,
    payload_lines,
)

NAME, SUFFIX, STEP_S, LIBRARY = "json", ".json", None, None


def ball_text(ball: ExportedBall) -> str:
    """See `ExportFormat`."""
    return _text(ball_card(ball, [*ball_lines(ball), *one_restitution_lines(ball)]))


def payload_text(payload: ExportedPayload) -> str:
    """See `ExportFormat`."""
    return _text(payload_card(payload, payload_lines(payload)))


def _text(card: object) -> str:
    return json.dumps(card, indent=1, ensure_ascii=True, allow_nan=False) + "\n"
