"""Export tunings of users' models as JSON and CSV."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from analysis.evaluation.export import csv_text, json_text
from analysis.evaluation.sysid.outcomes import SysidOutcome
from analysis.evaluation.sysid.run import SysidOrder
from analysis.evaluation.sysid.targets import MACHINES

# Of the CSV: one row for each log and parameter.
COLUMNS = (
    *("section", "machine", "seed", "noise", "what", "verdict", "rollouts", "seconds"),
    *("address", "truth", "value", "low", "high", "range", "is_told", "can_be_told"),
)


def sysid_json(outcomes: Sequence[SysidOutcome], order: SysidOrder) -> str:
    """Serialise every log and parameter."""
    head = {"experiment": "sysid", "seeds": list(order.seeds), "logs": order.logs}
    return json_text({**head, "rows": list(_rows(outcomes))})


def sysid_csv(outcomes: Sequence[SysidOutcome]) -> str:
    """Format every log and parameter as a table."""
    return csv_text(COLUMNS, _rows(outcomes))


def _rows(outcomes: Sequence[SysidOutcome]) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for one in outcomes:
        head = {
            "section": one.trial.section,
            "machine": MACHINES[one.trial.machine].name,
            "seed": one.trial.seed,
            "noise": one.trial.noise,
            "what": one.what,
            "verdict": one.verdict,
            "rollouts": one.rollouts,
            "seconds": round(one.seconds, 2),
        }
        for found in one.found:
            figures = {
                name: None if isinstance(value, float) and not math.isfinite(value) else value
                for name, value in asdict(found).items()
            }
            rows.append({**head, **figures})
        if not one.found:
            rows.append(head)
    return rows
