"""Row of one log in the ledger: flat, every column a number or a text."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from analysis.record import Estimate, Record
from tunenet_logs.addresses import Address
from tunenet_logs.formats.registry import file_bytes
from tunenet_logs.regular_file import real_path

Cell = str | int | float | bool | None

# Cells by the names of their columns; those without a value may be left out.
LedgerRow = Mapping[str, Cell]


@dataclass(frozen=True)
class LogState:
    """Size and modification time of a log, to detect cheaply whether it changed.

    Attributes:
        size: Of all of its files [bytes]; -1 if unknown.
        modified_ns: The last change of any of them, on the file system's clock.
    """

    size: int = -1
    modified_ns: int = 0

    @classmethod
    def of(cls, log: Path) -> LogState:
        """Read the state of a log on this machine; -1 and 0 if it cannot be read."""
        try:
            files = [log, *(log.iterdir() if log.is_dir() else ())]
            return cls(file_bytes(log), max(one.stat().st_mtime_ns for one in files))
        except (OSError, ValueError):
            return cls()


def ledger_key(log: Path | Address) -> str:
    """Return a log's key in the ledger: its absolute path, or its address without secrets."""
    text = str(log if isinstance(log, Address) else real_path(log))
    return os.fsencode(text).decode(errors="replace")


def ledger_row(
    log: Path | Address, name: Path, record: Record, state: LogState, error: str | None
) -> dict[str, Cell]:
    """Build the ledger's row of one log.

    Args:
        log: Where it is.
        name: Where its results go, without the suffix.
        record: Its result, with the provenance.
        state: Of the log when it was read.
        error: Why it failed; None otherwise, even if it was rejected.
    """
    provenance, fit = record.provenance, record.motion.fit
    row: dict[str, Cell] = {
        "log": ledger_key(log),
        "verdict": record.verdict,
        "reason": record.reason,
        "error": error,
        "task": record.task,
        "method": record.method,
        "ball": record.ball,
        "topic": record.topic,
        "rollouts": record.rollouts,
        "seconds": record.seconds.get("total"),
        "sha256": None if provenance is None else provenance.log_sha256,
        "bytes": state.size,
        "modified_ns": state.modified_ns,
        "results": ledger_key(name),
        "tuned": None if provenance is None else provenance.date,
        "version": None if provenance is None else provenance.version,
        "engine": None if provenance is None else provenance.engine,
    }
    for estimate in record.estimates:
        row.update(_cells(estimate))
    if fit is not None and record.estimates:
        row |= {
            "fit_rms_percent": fit.rms_percent,
            "fit_worst_percent": fit.worst_percent,
            "fit_noise_percent": fit.noise_percent,
            "fit_excess_percent": fit.excess_percent,
            "fit_held_out_percent": fit.held_out_percent,
        }
    return row


def _cells(estimate: Estimate) -> dict[str, Cell]:
    """Flatten a value, its interval as `_low` and `_high`, a vector by its axes."""
    unit = re.sub(r"[^A-Za-z0-9]+", "_", estimate.unit).strip("_")
    ending = "" if estimate.unit == "1" else f"_{unit}"
    cells: dict[str, Cell] = {}
    for part in estimate.components:
        name = part.name + ending
        cells[name] = part.value
        if part.interval95 is not None:
            cells |= dict(zip((f"{name}_low", f"{name}_high"), part.interval95, strict=True))
    return cells
