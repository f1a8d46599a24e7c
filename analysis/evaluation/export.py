"""How every experiment's results are written for other programs: JSON and CSV."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from tunenet_logs.csv_lines import csv_line


def json_text(content: Mapping[str, Any]) -> str:
    """Indented JSON; a figure that does not exist is null, never NaN.

    Raises:
        ValueError: a number is NaN or infinite.
    """
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def csv_text(columns: Sequence[str], records: Sequence[Mapping[str, Any]]) -> str:
    """A header and one line a record; None is an empty field.

    Args:
        columns: the keys of each record, in the order of the table.
        records: the rows.
    """
    rows = (csv_line(record.get(name) for name in columns) for record in records)
    return csv_line(columns) + "".join(rows)
