"""Export the payload's figures as JSON and CSV."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from analysis.evaluation.export import csv_text, json_text
from analysis.evaluation.payload.logs import LogRow
from analysis.evaluation.payload.masses import SETS, MassOrder, MassRow
from analysis.evaluation.payload.stranger_conventions import ConventionRow
from analysis.evaluation.payload.strangers import StrangerRow


def mass_records(rows: Sequence[MassRow], order: MassOrder) -> list[dict[str, Any]]:
    """Return one record for each method, set and seed."""
    sets = list(SETS)
    return [
        {
            "method": row.method.name,
            "iterations": row.method.iterations,
            "set": row.which,
            "seed": seed,
            "mae_kg": float(errors.mean()),
            "percent": float(percents.mean()),
            "paper_mae_kg": row.method.paper[sets.index(row.which)],
        }
        for row in rows
        for seed, errors, percents in zip(order.seeds, row.errors, row.percents, strict=True)
    ]


def log_records(rows: Sequence[LogRow]) -> list[dict[str, Any]]:
    """Return one record for each case."""
    records = []
    for row in rows:
        record = asdict(row)
        record["case"] = row.case.label
        records.append(record)
    return records


def stranger_records(rows: Sequence[StrangerRow]) -> list[dict[str, Any]]:
    """Return one record for each cell, without the tares and with them."""
    records = []
    for row in rows:
        record = asdict(row)
        record["case"], record["size"] = row.case.label, row.case.size
        records.append(record)
    return records


def payload_json(
    masses: Sequence[MassRow],
    logs: Sequence[LogRow],
    order: MassOrder,
    strangers: Sequence[StrangerRow] = (),
    conventions: Sequence[ConventionRow] = (),
) -> str:
    """Serialise `masses` for each seed, with the mean over all, and the rows of the others."""
    summary = [
        {
            "method": row.method.name,
            "set": row.which,
            "mae_kg": float(np.mean(row.errors)),
            "percent": float(np.mean(row.percents)),
        }
        for row in masses
    ]
    content = {
        "seeds": list(order.seeds),
        "targets": order.targets,
        "summary": summary,
        "masses": mass_records(masses, order),
        "logs": log_records(logs),
        "strangers": stranger_records(strangers),
        "conventions": [asdict(row) for row in conventions],
    }
    return json_text(content)


def payload_csv(masses: Sequence[MassRow], order: MassOrder) -> str:
    """Format table 1 in long form."""
    records = mass_records(masses, order)
    return csv_text(list(records[0]) if records else ["method"], records)
