"""Parse definitions of unknown ROS message types in a log.

They are read as text and never compiled: that would run untrusted code.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import TypesysError, get_types_from_idl

from tunenet_logs.formats.base import DAMAGED, UnusableError

# Of the types that are used, with all that they are made of, none has a tenth of that.
MAX_SCHEMA_BYTES = 256 * 1024

_MAX_IDL_BYTES = 64 * 1024  # the same in IDL, whose parser is slow
# A field or a constant: `float64[3] position`, `int32 X=1`, `string<=8 name "ball"`.
_FIELD = re.compile(
    r"(?P<type>[A-Za-z][\w/]*)(?:<=\d+)?(?P<list>\[(?:<=\d+|\d*)\])?\s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)"
)

# What stands between the definition of a type and those that it is made of.
_PART = re.compile(r"^={10,}\r?\n(?:MSG|IDL): +(\S+)[ \t]*\r?$", re.MULTILINE)

# In IDL, texts and comments, which may hold anything; a text that is not closed ends its line.
_IDL_WORDS = re.compile(r'"(?:[^"\\\n]|\\.)*+"?|//[^\n]*|^[ \t]*#[^\n]*', re.MULTILINE)

# In IDL without these, what says nothing of fields: annotations, constants.
_IDL_ASIDE = re.compile(r"@\w+[ \t]*(?:\([^()]*\))?|\bconst\b[^;{}]{0,500};")

# A module of constants, once these are gone.
_IDL_EMPTY = re.compile(r"\bmodule\s+\w+\s*\{\s*\}\s*;")

_IDL_DEEP = re.compile(r"[(]|<[^<>]*<[^<>]*<|\]\s*\[")  # in IDL without these, what no message has
# Numbers of ROS, and what `struct` calls them.
_NUMBERS = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}


_OWN = ("string", "wstring", "time", "duration")  # other types that are nothing but a word


@dataclass(frozen=True)
class RosField:
    """A field of a type.

    Attributes:
        name: its own.
        kind: a number as `struct` calls it, "string", or a type's full name.
        count: -1 for one, 0 for a list of any length, else the fixed length.
    """

    name: str
    kind: str
    count: int = -1


# Types with their fields, by full name ("geometry_msgs/msg/Point").
RosTypes = dict[str, tuple[RosField, ...]]


@lru_cache(maxsize=64)
def parsed(schema: bytes, encoding: str, name: str) -> RosTypes:
    """Parse a definition with all types that it is made of.

    Args:
        schema: the text.
        encoding: "ros2msg", "ros1msg", "ros2idl" or "omgidl".
        name: of the type, in full.

    Raises:
        UnusableError: it is too large or invalid.
    """
    is_idl = encoding in ("ros2idl", "omgidl")
    most = _MAX_IDL_BYTES if is_idl else MAX_SCHEMA_BYTES
    if len(schema) > most:
        raise UnusableError("its definition is too large")
    try:
        text = schema.decode()
        if is_idl:
            return types_of(idl_types(text))
        return _parsed(text, name)
    except (TypesysError, *DAMAGED) as error:
        raise UnusableError("its definition is damaged") from error


def idl_types(text: str) -> dict[str, Any]:
    """Parse the types that a log defines in IDL, as rosbags holds them.

    Raises:
        TypesysError, ValueError: it is invalid.
    """
    found: dict[str, Any] = {}
    for part in _PART.split(text)[2::2] or [text]:
        bare = part
        for aside in (_IDL_WORDS, _IDL_ASIDE, _IDL_EMPTY):
            bare = aside.sub("", bare)
        bare = bare.strip()
        if len(part) > _MAX_IDL_BYTES or _IDL_DEEP.search(bare):  # its parser takes for ever
            raise ValueError("brackets within brackets")
        found |= get_types_from_idl(bare)
    return found


def types_of(fielddefs: Any) -> RosTypes:
    """Convert types from rosbags' representation."""
    return {
        name: tuple(_field(label, node[0], node[1]) for label, node in fields)
        for name, (_, fields) in fielddefs.items()
    }


def _field(name: str, node: Any, of: Any) -> RosField:
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        (inner, kind), count = of
        count = count if node == Nodetype.ARRAY else 0
    else:
        inner, kind, count = node, of, -1
    if inner == Nodetype.BASE:
        kind = "string" if kind[0] == "string" else _NUMBERS[kind[0]]
    return RosField(name, kind, count)


def _parsed(text: str, name: str) -> RosTypes:
    names_and_texts = [name, *_PART.split(text)]
    # The first text has the type's own name; of the others, name and text stand in turns.
    texts = [(name, names_and_texts[1])]
    texts += [
        (_full(part, ""), body)
        for part, body in zip(names_and_texts[2::2], names_and_texts[3::2], strict=True)
    ]
    found: RosTypes = {}
    for full, body in texts:
        found.setdefault(full, tuple(_fields(body, full)))
    return found


def _fields(text: str, owner: str) -> Iterator[RosField]:
    package = owner.partition("/")[0]
    for line in text.splitlines():
        if not (bare := line.split("#", 1)[0].strip()):
            continue
        match = _FIELD.fullmatch(bare)
        if match is None:
            raise ValueError(f"{line[:60]!r} is no field")
        if match["rest"].startswith("="):
            continue  # a constant
        listed = match["list"]
        count = -1
        if listed:
            digits = listed.strip("[]")
            count = int(digits) if digits.isdecimal() else 0
            if digits == "0":
                raise ValueError("a list of nothing")
        yield RosField(match["name"], _kind(match["type"], package), count)


def _kind(written: str, package: str) -> str:
    if written in _NUMBERS:
        return _NUMBERS[written]
    if written in _OWN:
        return written
    return "std_msgs/msg/Header" if written == "Header" else _full(written, package)


def _full(written: str, package: str) -> str:
    parts = written.split("/")
    if len(parts) == 1:
        parts = [package, *parts]
    return f"{parts[0]}/msg/{parts[-1]}" if len(parts) == 2 else written
