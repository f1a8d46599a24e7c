"""Registry of export formats by engine, and their interface."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

if TYPE_CHECKING:
    from tunenet_logs.analysis.export.exported import ExportedBall, ExportedPayload
    from tunenet_logs.episode import Array

# Modules, or a member of one, by the name that `--to` takes; each has what `ExportFormat` names.
FORMATS: Mapping[str, str] = {
    "pybullet": "tunenet_logs.analysis.export.pybullet",
    "mujoco": "tunenet_logs.analysis.export.mujoco",
    "sdf": "tunenet_logs.analysis.export.sdf",
    "urdf": "tunenet_logs.analysis.export.urdf",
    "drake": "tunenet_logs.analysis.export.drake",
    "newton": "tunenet_logs.analysis.export.newton",
    "isaac": "tunenet_logs.analysis.export.isaac",
    "yaml": "tunenet_logs.analysis.export.cards:YAML_CARD",
    "json": "tunenet_logs.analysis.export.cards:JSON_CARD",
}


class ExportFormat(Protocol):
    """File format of an engine, such as a module with these names.

    Optional: `companion` (`HasCompanion`), `dropped` (`CanDrop`), and `HAS_AIR = True` if the file
    expresses the air's drag: it is then given `ExportedBall.in_air`.

    Attributes:
        NAME: As `--to` takes it.
        SUFFIX: Of the exported file, with its dot.
        STEP_S: Default of the engine's time step in the file [s]; None if the file holds none.
        LIBRARY: Module that Python imports to run the engine; None if it cannot.
    """

    NAME: str
    SUFFIX: str
    STEP_S: float | None
    LIBRARY: str | None

    def ball_text(self, ball: ExportedBall) -> str:
        """Write the file for a ball, beginning with `ball_lines`; comments say why."""
        ...

    def payload_text(self, payload: ExportedPayload) -> str:
        """Write the file for a payload, beginning with `payload_lines`."""
        ...


class HasCompanion(Protocol):
    """Engine whose file needs another one beside it."""

    COMPANION_SUFFIX: str
    """Of the other file, which has the same name otherwise."""

    def companion(self, item: ExportedBall | ExportedPayload) -> str:
        """Return its text."""
        ...


class CanDrop(Protocol):
    """Engine that Python can run, in a child process."""

    def dropped(self, path: Path, height_m: float, seconds: float) -> tuple[Array, Array]:
        """Drop the ball of the exported file, as its user would.

        The engine's library is imported here, and nowhere else in the engine's module.

        Args:
            path: The exported file.
            height_m: Of the ball's underside over the floor, at rest.
            seconds: To simulate.

        Returns:
            Seconds since the release, evenly spaced from 0 on, and heights of the underside [m];
            each of shape (T,).
        """
        ...


def export_format(name: str) -> ExportFormat:
    """Import one of `FORMATS`."""
    module, _, member = FORMATS[name].partition(":")
    found = import_module(module)
    return cast("ExportFormat", getattr(found, member) if member else found)


def usual_suffix(engine: ExportFormat) -> str:
    """Return the default ending of an exported file: `.mujoco.xml`, `.sdf`, `.card.json`."""
    if engine.SUFFIX in (".json", ".yaml"):  # the tuning itself is NAME.json
        return f".card{engine.SUFFIX}"
    named = f".{engine.NAME}"
    return named if named == engine.SUFFIX else named + engine.SUFFIX


def texts(engine: ExportFormat, item: ExportedBall | ExportedPayload) -> dict[str, str]:
    """Return the texts of an engine's files by suffix; the engine's own comes first."""
    from tunenet_logs.analysis.export.exported import ExportedBall

    is_ball = isinstance(item, ExportedBall)
    made = {engine.SUFFIX: engine.ball_text(item) if is_ball else engine.payload_text(item)}
    if hasattr(engine, "companion"):
        other = cast("HasCompanion", engine)
        made[other.COMPANION_SUFFIX] = other.companion(item)
    return made
