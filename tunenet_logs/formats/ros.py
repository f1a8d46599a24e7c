"""Decode ROS messages of any type, in ROS 2 CDR and in ROS 1 serialization.

A log's own definition is parsed as text and becomes a tree of functions (`ros_type`): nothing is
compiled that a file contains. `stacked_decoder` decodes many messages of one layout at once.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_typestore

from tunenet_logs import messages
from tunenet_logs.formats.base import (
    DAMAGED,
    MAX_NODES,
    AnyType,
    BeyondLimitError,
    Decode,
    Listed,
    MessageError,
    Node,
    Plain,
    RawChannel,
    StackedDecoder,
    Structure,
    UnusableError,
    described,
    ros_name,
)
from tunenet_logs.formats.message_types import TYPES, MessageType

# ---- Definitions: types with their fields, as text or in IDL.

MAX_SCHEMA_BYTES = 256 * 1024  # the types that are used, with all their parts, have a tenth at most
_MAX_IDL_BYTES = 64 * 1024  # the same in IDL, whose parser is slow
_IDL = ("ros2idl", "omgidl")
# Definitions that are read, by the encoding of the messages.
SCHEMA_ENCODINGS = {"cdr": ("ros2msg", *_IDL), "ros1": ("ros1msg",)}
# A field or a constant: `float64[3] position`, `int32 X=1`, `string<=8 name "ball"`.
_FIELD = re.compile(
    r"(?P<type>[A-Za-z][\w/]*)(?:<=\d+)?(?P<list>\[(?:<=\d+|\d*)\])?\s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)"
)
# What stands between the definition of a type and those that it is made of.
_PART = re.compile(r"^={10,}\r?\n(?:MSG|IDL): +(\S+)[ \t]*\r?$", re.MULTILINE)
# What is left out of IDL: texts and comments, which may hold anything (a text that is not closed
# ends its line); annotations and constants; modules of these, once they are gone.
_IDL_ASIDE = (
    re.compile(r'"(?:[^"\\\n]|\\.)*+"?|//[^\n]*|^[ \t]*#[^\n]*', re.MULTILINE),
    re.compile(r"@\w+[ \t]*(?:\([^()]*\))?|\bconst\b[^;{}]{0,500};"),
    re.compile(r"\bmodule\s+\w+\s*\{\s*\}\s*;"),
)
_IDL_DEEP = re.compile(r"[(]|<[^<>]*<[^<>]*<|\]\s*\[")  # in IDL without these, what no message has
# Numbers of ROS, what `struct` calls them, and their sizes [bytes].
_NUMBERS = {"bool": "?", "byte": "B", "char": "B", "float32": "f", "float64": "d"}
_NUMBERS |= {"int8": "b", "int16": "h", "int32": "i", "int64": "q"}
_NUMBERS |= {"uint8": "B", "uint16": "H", "uint32": "I", "uint64": "Q"}
_SIZES: Mapping[str, int] = {code: struct.calcsize(f"<{code}") for code in _NUMBERS.values()}
# Other types that are nothing but a word; in ROS 1, a time is one.
_WORDS = {"string": "string", "wstring": "wstring", "Header": "std_msgs/msg/Header", **_NUMBERS}
_WORDS |= {"time": "builtin_interfaces/msg/Time", "duration": "builtin_interfaces/msg/Duration"}


@dataclass(frozen=True)
class RosField:
    """A field of a type."""

    name: str
    kind: str  # a number as `struct` calls it, "string", or a type's full name
    count: int = -1  # 0 for a list of any length, else the fixed length


# Types with their fields, by full name ("geometry_msgs/msg/Point").
RosTypes = dict[str, tuple[RosField, ...]]
_TIMES = {  # what no definition of ROS 1 defines
    _WORDS[word]: (RosField("sec", "i"), RosField("nanosec", "I")) for word in ("time", "duration")
}


@lru_cache(maxsize=64)
def parsed(schema: bytes, encoding: str, name: str) -> RosTypes:
    """Parse a definition, in one of `SCHEMA_ENCODINGS`, with all types that it is made of."""
    if len(schema) > (_MAX_IDL_BYTES if encoding in _IDL else MAX_SCHEMA_BYTES):
        raise UnusableError("its definition is too large")
    try:
        text = schema.decode()
        return _types_of(idl_types(text)) if encoding in _IDL else _parsed(text, name)
    except (TypesysError, *DAMAGED) as error:
        raise UnusableError("its definition is damaged") from error


def idl_types(text: str) -> dict[str, Any]:
    """Parse the types that a log defines in IDL, as rosbags holds them."""
    found: dict[str, Any] = {}
    for part in _PART.split(text)[2::2] or [text]:
        bare = part
        for aside in _IDL_ASIDE:
            bare = aside.sub("", bare)
        if len(part) > _MAX_IDL_BYTES or _IDL_DEEP.search(bare):  # its parser takes for ever
            raise ValueError("brackets within brackets")
        found |= get_types_from_idl(bare.strip())
    return found


def _types_of(fielddefs: Mapping[str, Any]) -> RosTypes:
    """Convert types from rosbags' representation."""
    found: RosTypes = {}
    for name, (_, fields) in fielddefs.items():
        converted: list[RosField] = []
        for label, (node, of) in fields:
            (inner, kind), count = ((node, of), -1)
            if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                (inner, kind), count = of
                count = count if node == Nodetype.ARRAY else 0
            if inner == Nodetype.BASE:
                kind = "string" if kind[0] == "string" else _NUMBERS[kind[0]]
            converted.append(RosField(label, kind, count))
        found[name] = tuple(converted)
    return found


def _parsed(text: str, name: str) -> RosTypes:
    own, *parts = _PART.split(text)  # of the parts, name and text stand in turns
    found = {name: tuple(_fields(own, name))}
    for part, body in zip(parts[::2], parts[1::2], strict=True):
        full = _full(part, "")
        fields = tuple(_fields(body, full))
        found.setdefault(full, fields)
    return _TIMES | found


def _fields(text: str, owner: str) -> Iterator[RosField]:
    for line in text.splitlines():
        if not (bare := line.split("#", 1)[0].strip()):
            continue
        match = _FIELD.fullmatch(bare)
        if match is None:
            raise ValueError(f"{line[:60]!r} is no field")
        if match["rest"].startswith("="):
            continue  # a constant
        digits = (match["list"] or "").strip("[]")
        count = int(digits) if digits.isdecimal() else 0 if match["list"] else -1
        if digits == "0":
            raise ValueError("a list of nothing")
        kind = _WORDS.get(match["type"]) or _full(match["type"], owner.partition("/")[0])
        yield RosField(match["name"], kind, count)


def _full(written: str, package: str) -> str:
    parts = written.split("/")
    if len(parts) == 1:
        parts = [package, *parts]
    return f"{parts[0]}/msg/{parts[-1]}" if len(parts) == 2 else written


@cache
def known_types(*, is_ros1: bool) -> RosTypes:
    """Return the fields of all known types: of a ROS distribution, and of `TYPES`."""
    found: RosTypes = {}
    store = get_typestore(Stores.ROS1_NOETIC) if is_ros1 else messages.typestore()
    for name, fields in store.fielddefs.items():
        with suppress(LookupError):  # one with wide texts, which are not read
            found |= _types_of({name: fields})
    for key, kind in TYPES.items():
        if kind.definition:
            name = key.replace("foxglove.", "foxglove_msgs/msg/")
            found = _parsed(kind.definition, name) | found
    return found


# ---- Decode any type: each part is read by a function of its own.
# A message's memory is bounded by its own bytes: a type whose parts hold no bytes is refused.

_MAX_PARTS = 100_000  # messages in one list: of a plan, a minute and a half at 1 kHz
_FILLED = 4  # bytes to whose multiple some writers pad a message
# Reads a part at a place; gives it, and the place behind it.
Read = Callable[[bytes, int], tuple[Any, int]]


def ros_type(channel: RawChannel, _: MessageType | None) -> AnyType:
    """Return structure and decoder of a channel's type, by its own definition."""
    name, is_ros1 = ros_name(channel.type_name), channel.encoding == "ros1"
    encodings, types = SCHEMA_ENCODINGS[channel.encoding], {}
    if channel.schema_encoding in encodings:
        types = parsed(channel.schema, channel.schema_encoding, name)
        plain = channel.type_name.replace("::", "/")
        name = plain if name not in types and plain in types else name
        if name not in types:
            raise UnusableError(f"its definition does not say what {name[:60]!r} is")
    elif channel.schema_encoding:
        raise UnusableError(
            f"its definition is in {channel.schema_encoding[:20]!r}, which is not read "
            f"(only {', '.join(encodings)})"
        )
    elif name not in known_types(is_ros1=is_ros1):
        raise UnusableError("its type is not known here, and the log does not define it")
    kinds = {field.kind for fields in types.values() for field in fields}
    if not types or not kinds <= {*_SIZES, "string", *types}:  # it leaves some to who reads it
        types = known_types(is_ros1=is_ros1) | types
    structure, decode = any_ros_type(types, name, is_ros1=is_ros1)
    return AnyType(structure, decode, stacked=stacked_decoder(types, name, is_ros1=is_ros1))


class Message:
    """A message, or a part of one, with its fields as attributes."""

    def __init__(self, names: Sequence[str], values: Sequence[Any]) -> None:
        self.__dict__ = dict(zip(names, values, strict=True))


@dataclass(frozen=True)
class _Part:
    """Reader and description of a part of a type."""

    node: Node
    read: Read
    least: int  # bytes that it takes
    nodes: int = 1  # parts within it
    codes: str = ""  # of a part of numbers alone, as `struct` calls them
    names: tuple[str, ...] = ()  # of these numbers


@dataclass(frozen=True)
class _CdrLayout:
    """Layout rules of an encoding."""

    order: str  # of bytes, as `struct` calls it
    most_mask: int = 7  # largest alignment of numbers, less one
    has_sizes: bool = False  # whether a list of other than numbers begins with its size in bytes
    is_ros1: bool = False  # where texts do not end in a zero


_ROS1 = _CdrLayout("<", 0, is_ros1=True)
# By what a message's second byte says: plain CDR, and plain XCDR2 (DDS-XTypes 1.3, 7.6.3.1.2),
# of which some writers leave the sizes of lists out.
_LAYOUTS = {
    0: (_CdrLayout(">"),),
    1: (_CdrLayout("<"),),
    6: (_CdrLayout(">", 3, has_sizes=True), _CdrLayout(">", 3)),
    7: (_CdrLayout("<", 3, has_sizes=True), _CdrLayout("<", 3)),
}


def any_ros_type(types: RosTypes, name: str, *, is_ros1: bool) -> tuple[Structure, Decode]:
    """Return the structure of a type, by its full name, and a decoder; raise UnusableError."""
    part = _Type(types, _ROS1 if is_ros1 else _LAYOUTS[1][0]).part(name)
    assert isinstance(part.node, Structure)

    if is_ros1:
        return part.node, lambda data: _decoded(name, part.read, data)
    reads = {1: [part.read]}  # the others are rare: not built before needed

    def decode(data: bytes | memoryview) -> Any:
        kind = data[1] if len(data) >= 4 and not data[0] else -1
        if kind in (2, 3, 8, 9, 10, 11):
            raise UnusableError(
                "its messages are of a DDS type that may be extended (CDR with headers), which are "
                "not read; publish it as final (@final in its IDL), or record it through ROS 2"
            )
        if kind not in _LAYOUTS:
            raise MessageError(f"a {name} message is damaged: it is no plain CDR")
        if kind not in reads:
            reads[kind] = [_Type(types, one).part(name).read for one in _LAYOUTS[kind]]
        for read in reads[kind][:-1]:
            with suppress(MessageError):
                return _decoded(name, read, data[4:])
        return _decoded(name, reads[kind][-1], data[4:])

    return part.node, decode


def _decoded(name: str, read: Read, data: bytes | memoryview) -> Any:
    try:
        bare = bytes(data)
        message, end = read(bare, 0)
        if not 0 <= len(bare) - end < _FILLED:
            raise ValueError(f"{len(bare) - end} bytes follow it")
    except BeyondLimitError:
        raise
    except DAMAGED as error:
        raise MessageError(f"a {name} message is damaged: {described(error)}") from error
    return message


class Rows(Sequence[Message]):
    """Lazy sequence of parts of numbers alone, such as points: unpacked only on demand."""

    def __init__(self, rows: NDArray[np.void], names: tuple[str, ...]) -> None:
        self._rows = rows
        self._names = names

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, at: Any) -> Any:
        return Message(self._names, self._rows[at].item())

    def __iter__(self) -> Iterator[Message]:
        if len(self) > _MAX_PARTS:
            raise BeyondLimitError(f"over {_MAX_PARTS} parts")
        return (Message(self._names, row) for row in self._rows.tolist())


class _Type:
    """Builder of the reading functions of a type and of its parts."""

    is_packed = True  # whether lists of parts of numbers alone are kept packed

    def __init__(self, types: RosTypes, layout: _CdrLayout) -> None:
        self._types = types
        self._layout = layout
        self._known: dict[str, _Part] = {}
        self._open: list[str] = []

    def part(self, name: str) -> _Part:
        """Return the reader of a named type."""
        if name in self._known:
            return self._known[name]
        if name not in self._types:
            raise UnusableError(f"its definition does not say what {name[:60]!r} is")
        if name in self._open or len(self._open) >= 24:
            raise UnusableError("its definition has types within types without end")
        self._open.append(name)
        part = self._known[name] = self._structure(name, self._types[name])
        self._open.pop()
        return part

    def _structure(self, name: str, fields: Sequence[RosField]) -> _Part:
        if not fields and not self._layout.is_ros1:  # an empty message takes a byte in ROS 2
            fields = (RosField("structure_needs_at_least_one_member", "B"),)
        parts = [self._field(field) for field in fields]
        nodes = 1 + sum(part.nodes for part in parts)
        if nodes > MAX_NODES:
            raise UnusableError(f"its definition has over {MAX_NODES} parts")
        names = tuple(field.name for field in fields)
        if len(set(names)) < len(names):
            raise UnusableError("its definition has two fields of one name")
        # Functions that read values, or one; adjacent numbers are read at once.
        steps: list[tuple[Read, bool]] = []
        run = ""
        for field, part in zip(fields, parts, strict=True):
            is_number = field.count < 0 and field.kind in _SIZES
            is_alike = self._layout.is_ros1 or not run or _SIZES[run[0]] == _SIZES.get(field.kind)
            if run and not (is_number and is_alike):
                steps.append((self._numbers(run), True))
                run = ""
            if is_number:
                run += field.kind
            else:
                steps.append((part.read, False))
        if run:
            steps.append((self._numbers(run), True))
        is_bare = all(field.kind in _SIZES and field.count < 0 for field in fields)
        is_packed = self.is_packed and is_bare and len(steps) == 1

        def read(data: bytes, at: int) -> tuple[Any, int]:
            values: list[Any] = []
            for step, is_run in steps:
                found, at = step(data, at)
                if is_run:
                    values += found
                else:
                    values.append(found)
            return Message(names, values), at

        return _Part(
            Structure(name, dict(zip(names, (part.node for part in parts), strict=True))),
            read,
            sum(part.least for part in parts),
            nodes,
            "".join(field.kind for field in fields) if is_packed else "",
            names,
        )

    def _numbers(self, codes: str) -> Read:
        layout = struct.Struct(self._layout.order + codes)
        unpack, size = layout.unpack_from, layout.size
        mask = min(_SIZES[codes[0]] - 1, self._layout.most_mask)

        def read(data: bytes, at: int) -> tuple[Any, int]:
            at = (at + mask) & ~mask
            return unpack(data, at), at + size

        return read

    def _field(self, field: RosField) -> _Part:
        kind = field.kind
        if kind in _SIZES:
            node = Plain.FLAG if kind == "?" else Plain.NUMBER if kind in "fd" else Plain.WHOLE
            numbers = self._numbers(kind)

            def read(data: bytes, at: int) -> tuple[Any, int]:
                found, at = numbers(data, at)
                return found[0], at

            part = _Part(node, read, _SIZES[kind], codes=kind)
        elif kind == "string":
            part = _Part(Plain.TEXT, self._text, 4)
        else:
            part = self.part(kind)
        if field.count < 0:
            return part
        if field.count * max(part.least, 1) > 2**31 or not part.least:
            raise UnusableError("its definition has lists of nothing, or without end")
        node = Listed(part.node, field.count or None)
        least = field.count * part.least if field.count else 4
        if part.codes:
            return _Part(node, self._table(part.codes, part.names, field.count), least)
        nodes = max(field.count, 1) * part.nodes
        return _Part(node, self._many(part, field.count), least, nodes)

    def _length(self, data: bytes, at: int) -> tuple[int, int]:
        if not self._layout.is_ros1:
            at = (at + 3) & ~3
        return struct.unpack(f"{self._layout.order}I", data[at : at + 4])[0], at + 4

    def _text(self, data: bytes, at: int) -> tuple[str, int]:
        count, at = self._length(data, at)
        end = at + count
        if end > len(data):
            raise ValueError(f"a text claims {count} bytes")
        last = end if self._layout.is_ros1 else max(end - 1, at)
        return data[at:last].decode("utf-8", "replace"), end

    def _table(self, codes: str, names: tuple[str, ...], count: int) -> Read:
        """Return the reader of a list of numbers, or of parts of numbers alone, kept packed."""
        order = self._layout.order
        kinds: Any = [(name, order + code) for name, code in zip(names, codes, strict=False)]
        dtype = np.dtype(kinds if names else order + codes)
        mask = min(_SIZES[codes[0]] - 1, self._layout.most_mask)
        has_size = bool(names) and self._layout.has_sizes

        def read(data: bytes, at: int) -> tuple[Any, int]:
            if has_size:
                _, at = self._length(data, at)
            number, at = (count, at) if count else self._length(data, at)
            if number:
                at = (at + mask) & ~mask
            end = at + number * dtype.itemsize
            if end > len(data):
                raise ValueError(f"a list claims {number} parts")
            found = self._array(data, dtype, number, at)
            return (Rows(found, names) if names else found), end

        return read

    def _array(self, data: bytes, dtype: np.dtype, number: int, at: int) -> Any:
        return np.frombuffer(data, dtype, number, at) if number else np.empty(0, dtype)

    def _many(self, part: _Part, count: int) -> Read:
        one, least, has_size = part.read, part.least, self._layout.has_sizes

        def read(data: bytes, at: int) -> tuple[Any, int]:
            size, begin = self._length(data, at) if has_size else (0, at)
            number, at = (count, begin) if count else self._length(data, begin)
            if number * least > len(data) - at:
                raise ValueError(f"a list claims {number} parts")
            if number > _MAX_PARTS:
                raise BeyondLimitError(f"over {_MAX_PARTS} parts")
            found = []
            for _ in range(number):
                value, at = one(data, at)
                found.append(value)
            if has_size and at - begin != size:
                raise ValueError(f"a list claims {size} bytes")
            return found, at

        return read


# ---- Decode many messages of one layout at once: each number of a type becomes an array.
# Messages that differ in their numbers alone (equal texts, lists of equal length) share a layout:
# the first one is parsed, and of the others only bytes are compared.


class _Alike:
    """Messages as rows of bytes, shape (N, L), and the ranges of these that must be alike."""

    def __init__(self, rows: NDArray[np.uint8]) -> None:
        self.rows = rows
        self._first = rows[0].tobytes()
        self._fixed = [(0, 0)]

    def __len__(self) -> int:
        return len(self._first)

    def __getitem__(self, place: slice) -> bytes:
        """Return bytes of the first message, in which the others must be alike."""
        begin = place.start
        if self._fixed[-1][1] + _FILLED > begin:  # what fills is alike, too
            begin = self._fixed.pop()[0]
        self._fixed.append((begin, place.stop))
        return self._first[place]

    @property
    def same(self) -> NDArray[np.bool_]:
        """Which rows are of the first one's layout, as far as it was read."""
        same = np.ones(len(self.rows), np.bool_)
        for begin, end in self._fixed:
            same &= (self.rows[:, begin:end] == self.rows[0, begin:end]).all(axis=1)
        return same


class _StackedType(_Type):
    """Builder of functions that read an `_Alike`."""

    is_packed = False

    def _text(self, data: Any, at: int) -> tuple[str, int]:
        count, at = self._length(data, at)
        found, end = data[at : at + count], at + count
        if len(found) < count or not (self._layout.is_ros1 or found.endswith(b"\0")):
            raise ValueError("a text does not end")
        return (found if self._layout.is_ros1 else found[:-1]).decode(), end

    def _numbers(self, codes: str) -> Read:
        dtypes = [np.dtype(self._layout.order + code) for code in codes]
        mask = min(_SIZES[codes[0]] - 1, self._layout.most_mask)

        def read(data: Any, at: int) -> tuple[Any, int]:
            at = (at + mask) & ~mask
            found = []
            for dtype in dtypes:
                found.append(self._array(data, dtype, 1, at)[:, 0])
                at += dtype.itemsize
            return found, at

        return read

    def _array(self, data: Any, dtype: np.dtype, number: int, at: int) -> Any:
        end = at + number * dtype.itemsize
        if end > len(data):
            raise ValueError(f"a list claims {number} parts")
        found = np.ascontiguousarray(data.rows[:, at:end]).view(dtype)
        is_whole = dtype.kind == "i" or (dtype.kind == "u" and dtype.itemsize < 8)
        found = found.astype(np.int64) if is_whole else found
        return found.reshape(len(found), number)


def stacked_decoder(types: RosTypes, name: str, *, is_ros1: bool) -> StackedDecoder:
    """Build a decoder of many messages of one size at once; arguments as of `any_ros_type`.

    It raises ValueError, LookupError or struct.error where the first message is damaged.
    """
    begin = 0 if is_ros1 else 4
    reads: dict[int, Read] = {}

    def decode(rows: NDArray[np.uint8]) -> tuple[Any, NDArray[np.bool_]]:
        kind = 1 if is_ros1 else rows[0, 1]
        if rows.shape[1] < begin or kind > 1 or (begin and rows[0, 0]):
            raise ValueError("it is no plain CDR")
        if kind not in reads:
            layout = _ROS1 if is_ros1 else _LAYOUTS[int(kind)][0]
            reads[kind] = _StackedType(types, layout).part(name).read
        alike = _Alike(rows[:, begin:])
        message, end = reads[kind](alike, 0)  # type: ignore[arg-type]
        if not 0 <= len(alike) - end < _FILLED:
            raise ValueError("it is of another size")
        same = alike.same
        if begin:
            same &= (rows[:, :2] == rows[0, :2]).all(axis=1)
        if not same.all():
            message, _ = reads[kind](_Alike(rows[same, begin:]), 0)  # type: ignore[arg-type]
        return message, same

    return decode
