"""YAML card, for people and for configurations."""

from __future__ import annotations

import io
from typing import Any

from tunenet_logs.analysis.export.exported import (
    ExportedBall,
    ExportedPayload,
    ball_card,
    ball_lines,
    hash_comment,
    one_restitution_lines,
    payload_card,
    payload_lines,
)

NAME, SUFFIX, STEP_S, LIBRARY = "yaml", ".yaml", None, None


def ball_text(ball: ExportedBall) -> str:
    """See `ExportFormat`."""
    return _text(ball_card(ball, []), [*ball_lines(ball), *one_restitution_lines(ball)])


def payload_text(payload: ExportedPayload) -> str:
    """See `ExportFormat`."""
    return _text(payload_card(payload, []), payload_lines(payload))


def _text(card: dict[str, Any], lines: list[str]) -> str:
    from ruamel.yaml import YAML

    del card["notes"]  # they are comments here
    body = io.StringIO()
    writer = YAML()
    writer.width = 4096  # a text stays on its line
    writer.dump(card, body)
    return f"{hash_comment(lines)}\n{body.getvalue()}"
