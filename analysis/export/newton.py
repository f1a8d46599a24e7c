"""Newton: a Python file that builds the ball and its ground and drops it with the XPBD solver."""

from __future__ import annotations

from tunenet_logs.analysis.export.exported import (
    ExportedBall,
    ExportedPayload,
    dropped_by,
    filled,
    hash_comment,
    one_restitution_lines,
)

NAME, SUFFIX, LIBRARY = "newton", ".py", "newton"
# At 1/240 s the effective restitution is up to .014 off when the ball falls .3 to 3 m, with this
# step .004 (`python -m tests.bench.engines`).
STEP_S = 1 / 960
dropped = dropped_by


def ball_text(ball: ExportedBall) -> str:
    """See `ExportFormat`."""
    return filled("newton_ball.py", hash_comment, ball, one_restitution_lines(ball), step=STEP_S)


def payload_text(payload: ExportedPayload) -> str:
    """See `ExportFormat`."""
    return filled("newton_payload.py", hash_comment, payload)
