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
    "pybullet": "tunenet_logs.analysis.export.templated:PYBULLET",
    "mujoco": "tunenet_logs.analysis.export.mujoco",
    "sdf": "tunenet_logs.analysis.export.templated:SDF",
    "urdf": "tunenet_logs.analysis.export.templated:URDF",
    "drake": "tunenet_logs.analysis.export.drake",
    "newton": "tunenet_logs.analysis.export.templated:NEWTON",
    "isaac": "tunenet_logs.analysis.export.templated:ISAAC",
    "yaml": "tunenet_logs.analysis.export.cards:YAML_CARD",
    "json": "tunenet_logs.analysis.export.cards:JSON_CARD",
}

# What a simulator of one's own is exported as: its model's own file, or data.
MODEL_FORMATS = ("mjcf", "urdf", "yaml", "json")


class ExportFormat(Protocol):
    """File format of an engine, such as a module with these names.

    Optional: `companion` (`HasCompanion`), `dropped` (`CanDrop`), and `HAS_AIR = True` if the file
    expresses the air's drag: it is then given `ExportedBall.in_air`.
    """

    NAME: str  # as `--to` takes it
    SUFFIX: str  # of the exported file, with its dot
    STEP_S: float | None  # default of the engine's time step; None if the file holds none
    LIBRARY: str | None  # module that Python imports to run the engine; None if it cannot

    def ball_text(self, ball: ExportedBall) -> str:
        """Write the file for a ball, beginning with `ball_lines`; comments say why."""
        ...

    def payload_text(self, payload: ExportedPayload) -> str:
        """Write the file for a payload, beginning with `payload_lines`."""
        ...


class HasCompanion(Protocol):
    """Engine whose file needs another one beside it."""

    COMPANION_SUFFIX: str  # of the other file, which has the same name otherwise

    def companion(self, item: ExportedBall | ExportedPayload) -> str:
        """Return its text."""
        ...


class CanDrop(Protocol):
    """Engine that Python can run, in a child process."""

    def dropped(self, path: Path, height_m: float, seconds: float) -> tuple[Array, Array]:
        """Drop the ball of the exported file, as its user would, from rest.

        Heights are of its underside over the floor. Returns seconds since the release, evenly
        spaced from 0 on, and heights, (T,) each. The engine's library is imported only here.
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
