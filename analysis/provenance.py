"""Provenance of a tuning: SHA-256 of log and tares, options, versions."""

from __future__ import annotations

from dataclasses import fields
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from analysis.record import Provenance, Tuning
from analysis.result_files import log_sha256
from analysis.selection import Options, Selection


def provenance_of(tuning: Tuning, sha256: str, options: Options) -> Provenance:
    """Build the provenance of a tuning; `sha256` of its log is "" if it could not be read."""
    return Provenance(
        version=version("tunenet-logs"),
        log_sha256=sha256,
        options={**_given(options, Options()), **_given(options.selection, Selection())},
        tares=tuple(_named(tare) for tare in options.selection.tares if isinstance(tare, Path)),
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        engine=None if tuning.simulator is None else tuning.simulator["engine"],
    )


def _named(tare: Path) -> dict[str, str]:
    """Return a tare's name and SHA-256."""
    try:
        return {"log": tare.name, "sha256": log_sha256(tare)}
    except OSError:  # the tuning was rejected for it
        return {"log": tare.name, "sha256": ""}


def _given(options: Options | Selection, defaults: Options | Selection) -> dict[str, Any]:
    """Return non-default options as JSON values; files by their names."""
    found: dict[str, Any] = {}
    for field in fields(options):
        value = getattr(options, field.name)
        if value == getattr(defaults, field.name) or field.name in ("selection", "tares"):
            continue
        if isinstance(value, Path):
            value = value.name
        elif field.name in ("hints", "ball"):
            value = {part.name: getattr(value, part.name) for part in fields(value)}
        elif field.name == "arm" and isinstance(value, tuple):
            value = {"urdf": value[0].name, "tool_link": value[1]}
        elif field.name == "source":
            value = value.told_as()
        elif field.name == "arm_card":
            value = {"file": value.file, "logs": [run["log"] for run in value.runs]}
        found[field.name] = value
    return found
