"""PyBullet: a Python file that sets up contacts and drops the ball, with the ball's URDF beside it.

The settings are the calibrated ones of `tunenet_logs.recorders.simulators.base`, for a plain
stepping loop as users write.
"""

from __future__ import annotations

from tunenet_logs.analysis.export import urdf
from tunenet_logs.analysis.export.exported import (
    ExportedBall,
    ExportedPayload,
    dropped_by,
    filled,
    hash_comment,
    one_restitution_lines,
)

NAME, SUFFIX, COMPANION_SUFFIX, LIBRARY = "pybullet", ".py", ".urdf", "pybullet"
# The ball sinks in by speed times step before it bounces. When a ball of .3 falls .3 to 3 m, it is
# .034 off at PyBullet's own 1/240 s, and .006 with this step (`python -m tests.bench.engines`).
STEP_S = 1 / 960
dropped = dropped_by


def ball_text(ball: ExportedBall) -> str:
    """See `ExportFormat`."""
    # For a dull ball a shorter step: what it sinks in is a larger part of a low rebound.
    step_s = STEP_S if ball.restitution >= 0.25 else 1 / 3840
    return filled("pybullet_ball.py", hash_comment, ball, one_restitution_lines(ball), step=step_s)


def payload_text(payload: ExportedPayload) -> str:
    """See `ExportFormat`."""
    return filled("pybullet_payload.py", hash_comment, payload)


def companion(item: ExportedBall | ExportedPayload) -> str:
    """Return the text of the URDF beside it."""
    return urdf.ball_text(item) if isinstance(item, ExportedBall) else urdf.payload_text(item)
