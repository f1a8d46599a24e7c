"""Export the second experiment's results as JSON and CSV, one record a figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from analysis.evaluation.drop.intervals import Coverage
from analysis.evaluation.drop.results import Cell, DropResults, MethodErrors
from analysis.evaluation.export import csv_text, json_text

# Of the CSV, in long form: one row for each method, budget and seed of each cell.
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


def drop_rows(results: DropResults) -> list[dict[str, Any]]:
    """Return one record for each cell, method, number of rollouts and seed; see `COLUMNS`."""
    rows: list[dict[str, Any]] = []
    for one in results.outcomes:
        for n in filter(one.knows, results.columns):
            paper = one.figures(n).paper
            for seed, errors in zip(results.seeds, one.errors_after(n), strict=True):
                figures = {"mae": float(errors.mean()), "median": float(np.median(errors))}
                rows.append({**_keys(one, n), "seed": seed, **figures, "paper": paper})
    return rows


def drop_json(results: DropResults) -> str:
    """Serialise figures over all seeds, those of each seed, and the curves of the figure."""
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
    """Format `drop_rows` as a table; an empty field where the paper has nothing."""
    return csv_text(COLUMNS, drop_rows(results))


def intervals_json(rows: Sequence[Coverage], seeds: Sequence[int], targets: int) -> str:
    """Serialise every figure of the intervals; null where there is none."""
    head = {"experiment": "intervals", "seeds": list(seeds), "targets": targets}
    return json_text({**head, **_intervals(rows)})


def intervals_csv(rows: Sequence[Coverage]) -> str:
    """Format one row for each kind of recording; an empty field without a figure."""
    return csv_text(tuple(one.name for one in fields(Coverage)), [asdict(one) for one in rows])


def _intervals(rows: Sequence[Coverage]) -> dict[str, Any]:
    """Return the intervals' records; left out where none were measured."""
    return {"intervals": [asdict(one) for one in rows]} if rows else {}


def _credible(results: DropResults) -> dict[str, Any]:
    """Return the credible intervals' records; left out where no method has a posterior."""
    rows = []
    for one in results.credible:
        figures = {key: value for key, value in asdict(one).items() if key != "cell"}
        rows.append({**_cell_keys(one.cell), **figures})
    return {"credible": rows} if rows else {}


def _keys(one: MethodErrors, rollouts: int) -> dict[str, Any]:
    return {**_cell_keys(one.cell), "method": one.method, "rollouts": rollouts}


def _cell_keys(cell: Cell) -> dict[str, Any]:
    return {
        "experiment": cell.experiment,
        "simulator": cell.simulator,
        "set": cell.which,
        "noise_m": cell.noise_m,
    }
