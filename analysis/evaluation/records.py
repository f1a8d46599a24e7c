"""The experiments' results for other programs: JSON and CSV, one record a figure."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.evaluation.intervals import Coverage
from analysis.evaluation.results import Cell, DropResults, Outcome

if TYPE_CHECKING:
    from analysis.evaluation.motion_rows import MotionRow

COLUMNS = (
    "experiment",
    "simulator",
    "set",
    "noise_m",
    "method",
    "rollouts",
    "seed",
    "mae",
    "median",
    "paper",
)
"""Of the CSV, in long form: one row for each method, budget and seed of each cell."""

MOTION_COLUMNS = (
    "experiment",
    "method",
    "protocol",
    "seed",
    "percent",
    "cm",
    "paper_percent",
    "paper_cm",
)


def drop_rows(results: DropResults) -> list[dict[str, Any]]:
    """One record for each cell, method, count of rollouts and seed; see `COLUMNS`."""
    rows: list[dict[str, Any]] = []
    for one in results.outcomes:
        for n in filter(one.knows, results.columns):
            paper = one.figures(n).paper
            for seed, errors in zip(results.seeds, one.errors_after(n), strict=True):
                figures = {"mae": float(errors.mean()), "median": float(np.median(errors))}
                rows.append({**_keys(one, n), "seed": seed, **figures, "paper": paper})
    return rows


def drop_json(results: DropResults) -> str:
    """Everything: figures over all seeds, those of each seed, and the curves of the figure."""
    summary = []
    curves = []
    for one in results.outcomes:
        for n in filter(one.knows, results.columns):
            figures = one.figures(n)
            summary.append(
                {
                    **_keys(one, n),
                    "mae": figures.mae,
                    "median": figures.median,
                    "lowest": figures.lowest,
                    "highest": figures.highest,
                    "paper": figures.paper,
                }
            )
        keys = {key: value for key, value in _keys(one, 0).items() if key != "rollouts"}
        curves.append({**keys, "label": one.label, "mae": one.errors.mean(axis=1).tolist()})
    return json_text(
        {
            "experiment": "drop",
            "seeds": list(results.seeds),
            "targets": results.targets,
            **({} if results.rollouts is None else {"most_rollouts": results.rollouts}),
            "summary": summary,
            **_intervals(results.coverage),
            **_credible(results),
            "rows": drop_rows(results),
            "curves": curves,
        }
    )


def drop_csv(results: DropResults) -> str:
    """`drop_rows` as a table; an empty field where the paper has nothing."""
    return csv_text(COLUMNS, drop_rows(results))


def intervals_json(rows: Sequence[Coverage], seeds: Sequence[int], targets: int) -> str:
    """Every figure of the intervals; null where nothing was left to tell of."""
    head = {"experiment": "intervals", "seeds": list(seeds), "targets": targets}
    return json_text({**head, **_intervals(rows)})


def intervals_csv(rows: Sequence[Coverage]) -> str:
    """One row for each kind of recording; an empty field where there is no figure."""
    return csv_text(tuple(one.name for one in fields(Coverage)), [asdict(one) for one in rows])


def motion_rows(rows: Sequence[MotionRow], seeds: Sequence[int]) -> list[dict[str, Any]]:
    """One record for each row and seed; see `MOTION_COLUMNS`."""
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
    """Everything: the rows of `motion_rows`, and what stands beside each."""
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
    """`motion_rows` as a table; an empty field where there is no figure."""
    return csv_text(MOTION_COLUMNS, motion_rows(rows, seeds))


def _intervals(rows: Sequence[Coverage]) -> dict[str, Any]:
    """Left out where none were measured."""
    return {"intervals": [asdict(one) for one in rows]} if rows else {}


def _credible(results: DropResults) -> dict[str, Any]:
    """Left out where no method has a posterior."""
    rows = []
    for one in results.credible:
        figures = {key: value for key, value in asdict(one).items() if key != "cell"}
        rows.append({**_place(one.cell), **figures})
    return {"credible": rows} if rows else {}


def _keys(one: Outcome, rollouts: int) -> dict[str, Any]:
    return {**_place(one.cell), "method": one.method, "rollouts": rollouts}


def _place(cell: Cell) -> dict[str, Any]:
    return {
        "experiment": cell.experiment,
        "simulator": cell.simulator,
        "set": cell.which,
        "noise_m": cell.noise_m,
    }


def json_text(content: dict[str, Any]) -> str:
    """As all of these files are written."""
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def csv_text(columns: tuple[str, ...], rows: list[dict[str, Any]]) -> str:
    """One line for each of `rows`."""
    text = io.StringIO()
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    return text.getvalue()
