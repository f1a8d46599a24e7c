"""Export a tuning as the texts of an engine's files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from analysis.export.exported import ExportedBall, ExportedPayload
from analysis.export.from_record import ExportOptions, exported
from analysis.export.registry import FORMATS, export_format, texts
from tunenet_logs.errors import UsageError

if TYPE_CHECKING:
    from analysis.export.registry import ExportFormat
    from analysis.record import Record


def exported_for(
    engine: ExportFormat, record: Record, said: ExportOptions
) -> ExportedBall | ExportedPayload:
    """Convert a record to what an engine's file expresses.

    Raises:
        UsageError: An option does not apply to it, or to the engine.
        TuneNetError: As `exported`.
    """
    if said.step_s is not None and engine.STEP_S is None:
        raise UsageError(f"a file for {engine.NAME} holds no time step: leave --step out")
    item = exported(record, said)
    if isinstance(item, ExportedBall) and hasattr(engine, "HAS_AIR"):
        return item.in_air()
    return item


def export_texts(
    engine: ExportFormat, item: ExportedBall | ExportedPayload, path: Path
) -> dict[Path, str]:
    """Return paths and texts of the files to write; the engine's own, which is `path`, comes first.

    Raises:
        UsageError: The name does not end as the engine's files do.
    """
    if path.suffix != engine.SUFFIX:
        raise UsageError(f"{path}: is for {engine.NAME}; give -o a name that ends {engine.SUFFIX}")
    return {path.with_suffix(suffix): text for suffix, text in texts(engine, item).items()}


def engine_format(name: str) -> ExportFormat:
    """Return the format of that name.

    Raises:
        UsageError: There is none; the message lists those that exist.
    """
    if name not in FORMATS:
        raise UsageError(f"nothing is exported to {name!r}; choose one of: {', '.join(FORMATS)}")
    return export_format(name)
