"""SDF for Gazebo: a world with the ball and a ground, or a payload's model."""

from __future__ import annotations

from tunenet_logs.analysis.export.exported import (
    ExportedBall,
    ExportedPayload,
    filled,
    one_restitution_lines,
    xml_comment,
)

NAME, SUFFIX, LIBRARY = "sdf", ".sdf", None
STEP_S = 0.001  # Gazebo's own
_WARNINGS = (
    "Gazebo: how the coefficients of a pair combine is not documented. DART multiplies them, ODE",
    "takes the smaller one; with 1 for the ground both give the ball's. DART takes them into",
    "account since gz-physics 2 (Citadel). This file has not been run in Gazebo by its writer.",
)


def ball_text(ball: ExportedBall) -> str:
    """See `ExportFormat`."""
    lines = [*one_restitution_lines(ball), *_WARNINGS]
    # Slower impacts than the threshold [m/s], after a fall of 5 micrometres, do not bounce.
    return filled("sdf_ball.sdf", xml_comment, ball, lines, step=STEP_S, threshold=0.01)


def payload_text(payload: ExportedPayload) -> str:
    """See `ExportFormat`; every reader of SDF understands it."""
    return filled("sdf_payload.sdf", xml_comment, payload)
