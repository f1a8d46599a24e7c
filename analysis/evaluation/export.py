"""Write every experiment's results as JSON and CSV."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from tunenet_logs.csv_lines import csv_line


def json_text(content: Mapping[str, Any]) -> str:
    """Serialise to indented JSON; a figure that does not exist is null, never NaN.

    Raises:
        ValueError: a number is NaN or infinite.
    """
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def csv_text(columns: Sequence[str], records: Sequence[Mapping[str, Any]]) -> str:
    """Format a header and one line a record; None is an empty field."""
    rows = (csv_line(record.get(name) for name in columns) for record in records)
    return csv_line(columns) + "".join(rows)
