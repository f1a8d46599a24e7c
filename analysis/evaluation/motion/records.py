"""Export table 3 as JSON and CSV, one record a row and seed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from analysis.evaluation.export import csv_text, json_text
from analysis.evaluation.motion.rows import MotionRow

# Of the CSV.
COLUMNS = (
    "experiment",
    "method",
    "protocol",
    "seed",
    "percent",
    "cm",
    "paper_percent",
    "paper_cm",
)


def motion_rows(rows: Sequence[MotionRow], seeds: Sequence[int]) -> list[dict[str, Any]]:
    """Return one record for each row and seed; see `COLUMNS`."""
    records = []
    for row in rows:
        paper = {
            "paper_percent": row.paper.percent if row.paper else None,
            "paper_cm": row.paper.cm if row.paper else None,
        }
        keys = {"experiment": "motion", "method": row.name, "protocol": row.protocol}
        measured = dict(zip(seeds, row.ours, strict=True)) if row.ours else {None: None}
        for seed, one in measured.items():
            ours = {"percent": one.percent if one else None, "cm": one.cm if one else None}
            records.append({**keys, "seed": seed, **ours, **paper})
    return records


def motion_json(rows: Sequence[MotionRow], seeds: Sequence[int], targets: int) -> str:
    """Serialise the rows of `motion_rows`, and what stands beside each."""
    words = [
        {"method": row.name, "label": row.label, "protocol": row.protocol, "note": row.note}
        for row in rows
    ]
    return json_text(
        {
            "experiment": "motion",
            "seeds": list(seeds),
            "targets": targets,
            "methods": words,
            "rows": motion_rows(rows, seeds),
        }
    )


def motion_csv(rows: Sequence[MotionRow], seeds: Sequence[int]) -> str:
    """Format `motion_rows` as a table; an empty field where there is no figure."""
    return csv_text(COLUMNS, motion_rows(rows, seeds))
