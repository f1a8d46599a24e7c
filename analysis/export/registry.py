"""The engines by name, and what the file of each offers."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

if TYPE_CHECKING:
    from analysis.export.exported import ExportedBall, ExportedPayload
    from tunenet_logs.arrays import Array

FORMATS: Mapping[str, str] = {
    "pybullet": "analysis.export.pybullet",
    "mujoco": "analysis.export.mujoco",
    "sdf": "analysis.export.sdf",
    "urdf": "analysis.export.urdf",
    "drake": "analysis.export.drake",
    "newton": "analysis.export.newton",
    "isaac": "analysis.export.isaac",
    "yaml": "analysis.export.yaml_card",
    "json": "analysis.export.json_card",
}
"""Modules by the name that `--to` takes; each has what `ExportFormat` names."""


class ExportFormat(Protocol):
    """The file of an engine, such as a module with these names.

    Three more are there where they apply: `companion` (`HasCompanion`), `dropped` (`CanDrop`), and
    `HAS_AIR = True` where the file expresses the air's drag: it is given `ExportedBall.in_air`.

    Attributes:
        NAME: as `--to` takes it.
        SUFFIX: of the exported file, with its dot.
        STEP_S: the engine's time step that the file holds unless the user names one [s]; None
            where the file holds none.
        LIBRARY: what Python imports to run the engine; None where it cannot.
    """

    NAME: str
    SUFFIX: str
    STEP_S: float | None
    LIBRARY: str | None

    def ball_text(self, ball: ExportedBall) -> str:
        """The file for a ball. It begins with `head.ball_lines`, and says why of each line."""
        ...

    def payload_text(self, payload: ExportedPayload) -> str:
        """The file for a payload. It begins with `head.payload_lines`."""
        ...


class HasCompanion(Protocol):
    """An engine whose file needs another one beside it."""

    COMPANION_SUFFIX: str
    """Of the other file, which has the same name otherwise."""

    def companion(self, item: ExportedBall | ExportedPayload) -> str:
        """Its text."""
        ...


class CanDrop(Protocol):
    """An engine that Python can run. It is called in a process of its own."""

    def dropped(self, path: Path, height_m: float, seconds: float) -> tuple[Array, Array]:
        """Let the ball of the exported file fall, as whoever uses the file would.

        The engine's library is imported here, and nowhere else in the engine's file.

        Args:
            path: the exported file.
            height_m: of the ball's underside over the floor, at rest.
            seconds: to simulate.

        Returns:
            Seconds since the release, evenly spaced from 0 on, and heights of the underside [m];
            each shape (T,).
        """
        ...


def export_format(name: str) -> ExportFormat:
    """One of `FORMATS`, imported when first needed."""
    return cast("ExportFormat", import_module(FORMATS[name]))


def usual_suffix(engine: ExportFormat) -> str:
    """What an exported file's name ends with: `.mujoco.xml`, `.sdf`, `.card.json`."""
    if engine.SUFFIX in (".json", ".yaml"):  # the tuning itself is NAME.json
        return f".card{engine.SUFFIX}"
    named = f".{engine.NAME}"
    return named if named == engine.SUFFIX else named + engine.SUFFIX


def texts(engine: ExportFormat, item: ExportedBall | ExportedPayload) -> dict[str, str]:
    """What an engine's files hold, by suffix; the engine's own comes first."""
    from analysis.export.exported import ExportedBall

    is_ball = isinstance(item, ExportedBall)
    made = {engine.SUFFIX: engine.ball_text(item) if is_ball else engine.payload_text(item)}
    if hasattr(engine, "companion"):
        other = cast("HasCompanion", engine)
        made[other.COMPANION_SUFFIX] = other.companion(item)
    return made
