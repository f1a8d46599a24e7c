"""Write results as JSON for scripts: one object a line, regardless of the names in a log."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from numbers import Integral
from typing import Any


def json_line(fields: Mapping[str, Any]) -> str:
    """Serialise an object as one line of ASCII, without its end.

    Every character that is not ASCII or does not print is written as its escape, so that no name
    can change a terminal or break the line; bytes of a path that are no UTF-8 come back with
    `os.fsencode`. A number that is not finite is null: JSON has none.
    """
    return json.dumps(_plain(fields), ensure_ascii=True, allow_nan=False)


def _plain(value: Any) -> Any:
    """Convert to JSON's own types, with null for each number that is not finite."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Integral) and not isinstance(value, bool):
        return int(value)  # be it NumPy's
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(one) for one in value]
    return value
