"""Formats that are a template for a ball, and one for a payload: SDF, URDF, USD and Python files.

SDF is a world for Gazebo, USD a scene for Isaac Sim. The Python files set up contacts and drop the
ball in a plain stepping loop, as users of PyBullet and Newton (with its XPBD solver) write it;
PyBullet's settings are the calibrated ones of `tunenet_logs.recorders.simulators.base`, and the
ball's URDF stands beside its file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tunenet_logs.analysis.export.exported import (
    ExportedBall,
    ExportedPayload,
    dropped_by,
    filled,
    hash_comment,
    one_restitution_lines,
    xml_comment,
)
from tunenet_logs.episode import Array


@dataclass
class Templated:
    """A format; see `ExportFormat`. Its templates are NAME_ball.SUFFIX and NAME_payload.SUFFIX."""

    NAME: str
    SUFFIX: str
    comment: Callable[[Iterable[str]], str]
    STEP_S: float | None = None
    LIBRARY: str | None = None
    remarks: tuple[str, ...] = ()
    numbers: Callable[[ExportedBall], dict[str, float]] = lambda _: {}  # for its template

    def ball_text(self, ball: ExportedBall) -> str:
        """See `ExportFormat`."""
        lines = [*one_restitution_lines(ball), *self.remarks]
        more: dict[str, Any] = {} if self.STEP_S is None else {"step": self.STEP_S}
        more |= self.numbers(ball)
        return filled(f"{self.NAME}_ball{self.SUFFIX}", self.comment, ball, lines, **more)

    def payload_text(self, payload: ExportedPayload) -> str:
        """See `ExportFormat`."""
        return filled(f"{self.NAME}_payload{self.SUFFIX}", self.comment, payload)


class PythonFile(Templated):
    """A Python file, which is run to drop the ball."""

    def dropped(self, path: Path, height_m: float, seconds: float) -> tuple[Array, Array]:
        """See `CanDrop`."""
        return dropped_by(path, height_m, seconds)


class PyBulletFile(PythonFile):
    """A Python file with a URDF beside it."""

    COMPANION_SUFFIX = ".urdf"

    def companion(self, item: ExportedBall | ExportedPayload) -> str:
        """See `HasCompanion`."""
        return URDF.ball_text(item) if isinstance(item, ExportedBall) else URDF.payload_text(item)


def _isaac_numbers(ball: ExportedBall) -> dict[str, float]:
    rate_hz = max(round(1 / (1 / 240 if ball.step_s is None else ball.step_s)), 1)
    return {"rate": rate_hz, "threshold": round(1.2 * 9.80665 / rate_hz, 4)}


_GAZEBO = (
    "Gazebo: how the coefficients of a pair combine is not documented. DART multiplies them, ODE",
    "takes the smaller one; with 1 for the ground both give the ball's. DART takes them into",
    "account since gz-physics 2 (Citadel). This file has not been run in Gazebo by its writer.",
)

URDF = Templated("urdf", ".urdf", xml_comment)
SDF = Templated(
    "sdf",
    ".sdf",
    xml_comment,
    0.001,  # Gazebo's own
    remarks=_GAZEBO,
    # Slower impacts than the threshold [m/s], after a fall of 5 micrometres, do not bounce.
    numbers=lambda _: {"threshold": 0.01},
)
ISAAC = Templated(
    "isaac",
    ".usda",
    hash_comment,
    1 / 240,  # four steps for each frame at 60 Hz
    remarks=("This file has not been run in Isaac Sim by its writer.",),
    numbers=_isaac_numbers,
)
# The ball sinks in by speed times step before it bounces. When a ball of .3 falls .3 to 3 m, it is
# .034 off at PyBullet's own 1/240 s, and .006 with this step (`tunenet-eval exports`). For
# a dull ball it is shorter: what it sinks in is a larger part of a low rebound.
PYBULLET = PyBulletFile(
    "pybullet",
    ".py",
    hash_comment,
    1 / 960,
    "pybullet",
    numbers=lambda ball: {} if ball.restitution >= 0.25 else {"step": 1 / 3840},
)
# At 1/240 s the effective restitution is up to .014 off when the ball falls .3 to 3 m, with this
# step .004 (`tunenet-eval exports`).
NEWTON = PythonFile("newton", ".py", hash_comment, 1 / 960, "newton")
