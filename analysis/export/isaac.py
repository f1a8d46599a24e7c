"""USD for Isaac Sim: a scene with material and ball, or a payload's mass."""

from __future__ import annotations

from tunenet_logs.analysis.export.exported import (
    ExportedBall,
    ExportedPayload,
    filled,
    hash_comment,
    one_restitution_lines,
)

NAME, SUFFIX, LIBRARY = "isaac", ".usda", None
STEP_S = 1 / 240  # four steps for each frame at 60 Hz
_WARNINGS = ("This file has not been run in Isaac Sim by its writer.",)


def ball_text(ball: ExportedBall) -> str:
    """See `ExportFormat`."""
    rate_hz = max(round(1 / (STEP_S if ball.step_s is None else ball.step_s)), 1)
    threshold_m_s = round(1.2 * 9.80665 / rate_hz, 4)
    lines = [*one_restitution_lines(ball), *_WARNINGS]
    return filled(
        "isaac_ball.usda", hash_comment, ball, lines, rate=rate_hz, threshold=threshold_m_s
    )


def payload_text(payload: ExportedPayload) -> str:
    """See `ExportFormat`."""
    return filled("isaac_payload.usda", hash_comment, payload)
