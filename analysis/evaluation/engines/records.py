"""Export the pairs of engines as JSON and CSV."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from analysis.evaluation.engines.run import ROLLOUTS, EngineLine, EngineOrder
from analysis.evaluation.export import csv_text, json_text

# Of the CSV: one row for each range, pair of engines and method.
COLUMNS = (
    "set",
    "source",
    "engine",
    "method",
    "missing",
    "targets",
    "answered",
    "ok",
    "mean",
    "worst",
    "worst_ok",
    "promised",
    "is_kept",
    "motion_mean_percent",
    "motion_worst_percent",
)


def engines_json(lines: Sequence[EngineLine], order: EngineOrder) -> str:
    """Serialise every figure, and every target behind it."""
    rows = [{**_record(line), "outcomes": [asdict(one) for one in line.outcomes]} for line in lines]
    head = {"experiment": "engines", "seeds": list(order.seeds), "targets": order.targets}
    return json_text({**head, "rollouts": ROLLOUTS, "rows": rows})


def engines_csv(lines: Sequence[EngineLine]) -> str:
    """Format the figures alone; an empty field where there is none."""
    return csv_text(COLUMNS, [_record(line) for line in lines])


def _record(line: EngineLine) -> dict[str, Any]:
    errors = [one.error for one in line.outcomes]
    apart = [one.apart_percent for one in line.outcomes]
    figures = (
        line.promise.name,
        line.source,
        line.engine,
        line.method,
        line.missing,
        line.targets,
        len(line.outcomes),
        len(line.ok_errors),
        float(np.mean(errors)) if errors else None,
        max(errors, default=None),
        max(line.ok_errors, default=None),
        line.promise.worst,
        line.is_kept,
        float(np.mean(apart)) if apart else None,
        max(apart, default=None),
    )
    return dict(zip(COLUMNS, figures, strict=True))
