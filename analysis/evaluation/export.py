"""How every experiment's results are written for other programs: JSON and CSV."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from typing import Any


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
    text = io.StringIO()
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    table.writerows(records)
    return text.getvalue()
