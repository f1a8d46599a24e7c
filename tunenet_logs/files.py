"""Read and write small files safely: XML, CSV and JSON, within bounds, and regular files alone.

What others give us is parsed within bounds of size and depth, without the traps of its format, and
opening it never waits. What we write holds no cell that a spreadsheet runs, and no character that
changes a terminal, regardless of the names in a log.
"""

from __future__ import annotations

import errno
import math
import os
import re
import stat
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from io import BufferedReader
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.terminal import short_name

if TYPE_CHECKING:
    import xml.etree.ElementTree as ET

# More than any robot's file has; what has more is refused before it costs.
MAX_XML_BYTES, _MAX_XML_TAGS, _MAX_XML_DEPTH = 4_000_000, 100_000, 200


def parse_xml(data: bytes, path: Path, kind: str, wanted: str) -> ET.Element:
    """Parse at most `MAX_XML_BYTES` of XML; return the root element.

    UsageError names `path`, the `kind` it should be, such as "URDF", and `wanted`, a remedy.
    """
    import xml.etree.ElementTree as ET

    try:
        text = data.decode("utf-8-sig").lstrip()
    except UnicodeDecodeError as error:
        raise UsageError(
            f"{path}: is no text in UTF-8, so no {kind} that can be read", wanted
        ) from error
    if text.count("<") > _MAX_XML_TAGS:
        raise UsageError(f"{path}: over {_MAX_XML_TAGS} tags, so no {kind} of a robot", wanted)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise UsageError(
            f"{path}: has a document type, which no {kind} needs; remove <!DOCTYPE ...>"
        )
    try:
        root = ET.fromstring(text)  # noqa: S314  (bounded, and without a document type)
    except (ET.ParseError, ValueError) as error:
        raise UsageError(f"{path}: is not XML ({error})", wanted) from error
    check_depth(root, path)
    return root


def check_depth(root: ET.Element, path: Path) -> None:
    """Refuse elements that are over 200 deep."""
    level, depth = [root], 1
    while level := [child for element in level for child in element]:
        depth += 1
        if depth > _MAX_XML_DEPTH:
            raise UsageError(
                f"{path}: has elements in elements, over {_MAX_XML_DEPTH} deep",
                "make them fewer",
            )


def refuse_xacro(root: ET.Element, path: Path) -> None:
    """Refuse an unexpanded xacro file."""
    is_xacro = any(
        "xacro" in element.tag or any("${" in value for value in element.attrib.values())
        for element in root.iter()
    )
    if is_xacro:
        stem = path.name.removesuffix(".xacro").removesuffix(".urdf")
        expanded = f"{stem}.urdf" if path.suffix == ".xacro" else f"{stem}_expanded.urdf"
        raise UsageError(f"{path}: is xacro; expand it first: xacro {path.name} > {expanded}")


# ---- CSV: no cell is a formula
# A spreadsheet runs a cell that begins with `=`, `+`, `-` or `@`, be it a topic's name
# (https://owasp.org/www-community/attacks/CSV_Injection).

# How a text begins that a spreadsheet may run, with the wide forms that some read as well.
_RUN = re.compile(r"[\s\x00'\u200b\ufeff]*[=+\-@\uff1d\uff0b\uff0d\uff20]|[\t\r\n\x00]")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)


def csv_line(cells: Iterable[object]) -> str:
    """Write cells as one line of CSV, with its end; None and NaN are empty.

    A text that a spreadsheet would run has an apostrophe before it, which shows that it is text.
    """
    return ",".join(map(_cell, cells)) + "\n"


def text_of(cell: str) -> str:
    """Return the text given to `csv_line` from the cell that a CSV reader returns."""
    return cell[1:] if cell[:1] == "'" and _RUN.match(cell[1:]) else cell


def _cell(value: object) -> str:
    if value is None or value != value:  # noqa: PLR0124 (NaN)
        return ""
    text = str(value)
    if isinstance(value, str) and _RUN.match(text) and not _NUMBER.fullmatch(text):
        text = f"'{text}"
    # It needs quotes by whatever separator the table is opened.
    return '"' + text.replace('"', '""') + '"' if re.search(r'[,;|"\s]', text) else text


# ---- JSON for scripts: one object a line


def json_line(fields: Mapping[str, Any]) -> str:
    """Serialise an object as one line of ASCII, without its end.

    Every character that is not ASCII or does not print is written as its escape, so that no name
    can change a terminal or break the line; bytes of a path that are no UTF-8 come back with
    `os.fsencode`. A number that is not finite is null: JSON has none.
    """
    import json

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


# ---- Opening: regular files alone, so that no opening ever waits


def open_regular(path: Path | str, *, follows: bool = True) -> BufferedReader:
    """Open a regular file, or a link to one where it `follows`, for reading bytes.

    A file that states a size of 0 is read as empty: those under /proc state it too, and reading one
    may wait for ever, as a pipe or a device (LogError).
    """
    return open(path, "rb", opener=_opened if follows else partial(_opened, flag=os.O_NOFOLLOW))


def open_regular_text(
    path: Path | str, encoding: str, *, errors: str = "strict", newline: str | None = None
) -> TextIO:
    """Open a regular file as `open_regular` does, for reading text, with `open`'s arguments."""
    return open(path, encoding=encoding, errors=errors, newline=newline, opener=_opened)


def real_path(path: Path | str) -> Path:
    """Resolve links and dots, to compare paths; one that no file can have stays as it is."""
    try:
        return Path(os.path.realpath(path))
    except ValueError:  # a zero byte
        return Path(path)


def _opened(path: str, _flags: int, flag: int = 0) -> int:
    """Open a descriptor; its own state is asked, so that nobody exchanges the file in between."""
    _check(path, Path(path).stat().st_mode)  # before it is opened: that alone starts some devices
    # A pipe or a terminal that took the file's name meanwhile holds nobody up.
    flags = os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
    descriptor = os.open(path, flags | flag)
    try:
        state = os.fstat(descriptor)
        _check(path, state.st_mode)
        os.set_blocking(descriptor, True)
    except BaseException:
        os.close(descriptor)
        raise
    if state.st_size:
        return descriptor
    os.close(descriptor)
    return os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)


def _check(path: str, mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), path)
    if not stat.S_ISREG(mode):
        raise LogError(f"{path}: is no regular file; copy it to one first")


# ---- Small files, and JSON without its traps

# Brackets, and strings, each to its end or the text's: looked for again at every quotation mark of
# one that does not end, they would take the square of its length.
_BRACKETS = re.compile(r'"(?:[^"\\]++|\\.)*+"?|([\[{])|[\]}]', re.DOTALL)


def read_small_file(path: Path, most_bytes: int) -> bytes:
    """Read a regular file of at most `most_bytes`; ValueError where it is larger."""
    with open_regular(path) as file:
        known_bytes = os.fstat(file.fileno()).st_size
        if known_bytes > most_bytes:
            size = f"{most_bytes / 1e3:g} kB" if most_bytes < 1e6 else f"{most_bytes / 1e6:g} MB"
            raise ValueError(f"is larger than {size}")
        return file.read(known_bytes)


def parse_json(data: bytes | str) -> Any:
    """Parse JSON with finite numbers, integers of 64 bits, and each key once; else ValueError."""
    import json

    text = data.decode("utf-8") if isinstance(data, bytes) else data
    depth = 0
    for found in _BRACKETS.finditer(text):
        if not found[0].startswith('"'):
            depth += 1 if found[1] else -1
        if depth > 32:  # four times what any file of ours has
            raise ValueError("has brackets in brackets, over 32 deep")
    return json.loads(
        text,
        parse_int=_whole,
        parse_float=_finite,
        parse_constant=_refuse,
        object_pairs_hook=_object,
    )


def _whole(text: str) -> int:
    value = int(text) if len(text) <= 20 else 1 << 63
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
