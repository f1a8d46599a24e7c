"""URDF: a ball's link with its restitution, or a payload's with its inertia."""

from __future__ import annotations

from tunenet_logs.analysis.export.exported import (
    ExportedBall,
    ExportedPayload,
    filled,
    one_restitution_lines,
    xml_comment,
)

NAME, SUFFIX, STEP_S, LIBRARY = "urdf", ".urdf", None, None


def ball_text(ball: ExportedBall) -> str:
    """See `ExportFormat`."""
    return filled("urdf_ball.urdf", xml_comment, ball, one_restitution_lines(ball))


def payload_text(payload: ExportedPayload) -> str:
    """See `ExportFormat`."""
    return filled("urdf_payload.urdf", xml_comment, payload)
