"""Read small files that people hand us beside logs: bounded, and JSON without its traps."""

from __future__ import annotations

import json
import math
import os
import re
from pathlib import Path
from typing import Any, NoReturn

from tunenet_logs.regular_file import open_regular
from tunenet_logs.terminal import short_name

_MAX_DEPTH = 32  # brackets in brackets: four times what any file of ours has
_MAX_DIGITS = 20  # of a whole number: those of a stamp in ns, and one more
# And strings, each to its end or the text's: looked for again at every quotation mark of one that
# does not end, they would take the square of its length.
_BRACKETS = re.compile(r'"(?:[^"\\]++|\\.)*+"?|([\[{])|[\]}]', re.DOTALL)


def read_small_file(path: Path, most_bytes: int) -> bytes:
    """Read a file of at most `most_bytes`.

    Raises:
        LogError: it is no regular file: a pipe could wait for ever.
        OSError: it cannot be read.
        ValueError: it is larger.
    """
    with open_regular(path) as file:
        known_bytes = os.fstat(file.fileno()).st_size
        if known_bytes > most_bytes:
            raise ValueError(f"is larger than {_size(most_bytes)}")
        return file.read(known_bytes)


def parse_json(data: bytes | str) -> Any:
    """Parse JSON with finite numbers, integers of 64 bits, and each key once.

    Raises:
        ValueError: it is no JSON, or holds what ours do not; in one short line.
    """
    text = data.decode("utf-8") if isinstance(data, bytes) else data
    _check_depth(text)
    return json.loads(
        text,
        parse_int=_whole,
        parse_float=_finite,
        parse_constant=_refuse,
        object_pairs_hook=_object,
    )


def _size(count: int) -> str:
    return f"{count / 1e6:g} MB" if count >= 1_000_000 else f"{count / 1e3:g} kB"


def _check_depth(text: str) -> None:
    depth = 0
    for found in _BRACKETS.finditer(text):
        if found.group(1):
            depth += 1
            if depth > _MAX_DEPTH:
                raise ValueError(f"has brackets in brackets, over {_MAX_DEPTH} deep")
        elif not found.group().startswith('"'):
            depth -= 1


def _whole(text: str) -> int:
    value = int(text) if len(text) <= _MAX_DIGITS else 1 << 63
    if not -(1 << 63) <= value < 1 << 63:
        raise ValueError(f"{short_name(text)} is beyond any number here")
    return value


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{short_name(text)} is beyond any number here")
    return value


def _refuse(word: str) -> NoReturn:
    raise ValueError(f"{word} is no number of JSON")


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise ValueError(f"{short_name(name)!r} is there twice")
        found[name] = value
    return found
