"""Export the results of `tunenet-eval real-balls`: one record a line and quantity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, fields
from typing import Any

from analysis.evaluation.export import csv_text, json_text
from analysis.evaluation.real_balls.figures import RealLine, Spread
from analysis.evaluation.real_balls.run import RealOrder

_SPREADS = ("ours", "reference")
# Of the CSV: the errors without a prefix are ours.
COLUMNS = (
    *(field.name for field in fields(RealLine) if field.name not in _SPREADS),
    *(field.name for field in fields(Spread)),
    *(f"reference_{field.name}" for field in fields(Spread)),
)


def real_records(lines: Sequence[RealLine]) -> list[dict[str, Any]]:
    """Return one record for each line; see `COLUMNS`."""
    records: list[dict[str, Any]] = []
    for line in lines:
        record = asdict(line)
        ours, reference = (record.pop(name) for name in _SPREADS)
        named = {f"reference_{name}": value for name, value in reference.items()}
        records.append({**record, **ours, **named})
    return records


def real_json(lines: Sequence[RealLine], order: RealOrder) -> str:
    """Serialise every figure; null where there is none."""
    head = {"experiment": "real-balls", "seeds": list(order.seeds), "targets": order.targets}
    return json_text({**head, "rows": real_records(lines)})


def real_csv(lines: Sequence[RealLine]) -> str:
    """Format `real_records` as a table; an empty field where there is no figure."""
    return csv_text(COLUMNS, real_records(lines))
