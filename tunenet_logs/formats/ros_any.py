"""Decode ROS messages of any type by the definition in the log: nothing is compiled.

A type becomes a tree of functions, each of which reads one part. A message's memory is bounded by
its own bytes: a type whose parts hold no bytes is refused.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.formats.base import (
    DAMAGED,
    BeyondLimitError,
    Decode,
    MessageError,
    UnusableError,
    described,
)
from tunenet_logs.formats.ros_definitions import RosField, RosTypes
from tunenet_logs.formats.structure import Listed, Node, Plain, Structure

_MAX_DEPTH = 24  # of types within types
_MAX_NODES = 5000  # parts of one message, lists of any length aside
_MAX_PARTS = 20_000  # messages in the lists of one message
_BYTES_BEHIND = 3  # that may follow a message: some writers fill up to four
_TIMES = {"time": "I", "duration": "i"}  # of ROS 1, and what their seconds are
# Reads a part at a place; gives it, and the place behind it.
Read = Callable[[bytes, int], tuple[Any, int]]


class Message:
    """A message, or a part of one, with its fields as attributes."""


@dataclass(frozen=True)
class _Part:
    """Reader and description of a part of a type.

    Attributes:
        least: minimum number of bytes.
        nodes: number of parts within it.
        codes: `struct` format of a part of numbers alone.
        names: of these numbers.
    """

    node: Node
    read: Read
    least: int
    nodes: int = 1
    codes: str = ""
    names: tuple[str, ...] = ()


def any_ros_type(
    types: RosTypes, name: str, *, is_ros1: bool
) -> tuple[Structure, Callable[[bytes | memoryview], Any]]:
    """Return the structure of a type, and a decoder of its messages.

    Args:
        types: with all that it is made of.
        name: of the type, in full.
        is_ros1: whether the messages are of ROS 1; else CDR of ROS 2.

    Raises:
        UnusableError: the definition is incomplete or invalid.
    """
    part = _Type(types, is_ros1=is_ros1, layout=_LAYOUTS[1]).part(name)
    assert isinstance(part.node, Structure)
    if is_ros1:
        return part.node, _decoder(name, part.read)
    decoders = {1: [_decoder(name, part.read, 4)]}  # the others are rare: not built before needed

    def decode(data: bytes | memoryview) -> Any:
        if len(data) < 4 or data[0] or data[1] not in _LAYOUTS:
            if len(data) >= 4 and not data[0] and data[1] in _WITH_HEADERS:
                raise UnusableError(f"its messages are {_WITH_HEADERS[data[1]]}")
            raise MessageError(f"a {name} message is damaged: it is no plain CDR")
        kind = data[1]
        if kind not in decoders:
            layouts = [_LAYOUTS[kind]]
            if layouts[0].is_xcdr2:  # some writers leave the sizes of lists out
                layouts.append(replace(layouts[0], has_sizes=False))
            made = (_Type(types, is_ros1=False, layout=one).part(name) for one in layouts)
            decoders[kind] = [_decoder(name, one.read, 4) for one in made]
        for tried in decoders[kind][:-1]:
            with suppress(MessageError):
                return tried(data)
        return decoders[kind][-1](data)

    return part.node, decode


@dataclass(frozen=True)
class _CdrLayout:
    """Layout rules of a CDR version.

    Attributes:
        order: byte order, as `struct` calls it.
        most_mask: largest alignment of numbers, less one.
        has_sizes: whether a list of other than numbers begins with its size in bytes.
    """

    order: str
    most_mask: int = 7
    has_sizes: bool = False

    @property
    def is_xcdr2(self) -> bool:
        """Whether it is XCDR version 2."""
        return self.most_mask == 3


# By what a message's second byte says: plain CDR, and plain XCDR2 (DDS-XTypes 1.3, 7.6.3.1.2).
_LAYOUTS = {
    0: _CdrLayout(">"),
    1: _CdrLayout("<"),
    6: _CdrLayout(">", 3, has_sizes=True),
    7: _CdrLayout("<", 3, has_sizes=True),
}

_WITH_HEADERS = dict.fromkeys(
    (2, 3, 8, 9, 10, 11),
    "of a DDS type that may be extended (CDR with headers), which are not read; publish it as "
    "final (@final in its IDL), or record it through ROS 2",
)


def _decoder(name: str, read: Read, begin: int = 0) -> Decode:
    def decode(data: bytes | memoryview) -> Any:
        try:
            bare = bytes(data[begin:])
            message, end = read(bare, 0)
            if not 0 <= len(bare) - end <= _BYTES_BEHIND:
                raise ValueError(f"{len(bare) - end} bytes follow it")
        except BeyondLimitError:
            raise
        except DAMAGED as error:
            raise MessageError(f"a {name} message is damaged: {described(error)}") from error
        return message

    return decode


class Rows(Sequence[Message]):
    """Lazy sequence of parts of numbers alone, such as points: unpacked only on demand."""

    def __init__(self, rows: NDArray[np.void], names: tuple[str, ...]) -> None:
        self._rows = rows
        self._names = names

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, at: Any) -> Any:
        return _message(self._names, self._rows[at].item())

    def __iter__(self) -> Iterator[Message]:
        if len(self) > _MAX_PARTS:
            raise BeyondLimitError(f"over {_MAX_PARTS} parts")
        return (_message(self._names, row) for row in self._rows.tolist())


def _message(names: Sequence[str], values: Sequence[Any]) -> Message:
    made = Message()
    made.__dict__.update(zip(names, values, strict=True))
    return made


class _Type:
    """Builder of the reading functions of a type and of its parts."""

    def __init__(self, types: RosTypes, *, is_ros1: bool, layout: _CdrLayout) -> None:
        self._types = types
        self._is_ros1 = is_ros1
        self._layout = layout
        self._order = layout.order
        self._known: dict[str, _Part] = {}
        self._open: list[str] = []

    def part(self, name: str) -> _Part:
        """Return the reader of a named type."""
        if name in self._known:
            return self._known[name]
        if name not in self._types:
            raise UnusableError(f"its definition does not say what {name[:60]!r} is")
        if name in self._open or len(self._open) >= _MAX_DEPTH:
            raise UnusableError("its definition has types within types without end")
        self._open.append(name)
        part = self._structure(name, self._types[name])
        self._open.pop()
        self._known[name] = part
        return part

    def _structure(self, name: str, fields: Sequence[RosField]) -> _Part:
        if not fields and not self._is_ros1:  # an empty message takes a byte in ROS 2
            fields = (RosField("structure_needs_at_least_one_member", "B"),)
        parts = [self._field(field) for field in fields]
        nodes = 1 + sum(part.nodes for part in parts)
        if nodes > _MAX_NODES:
            raise UnusableError(f"its definition has over {_MAX_NODES} parts")
        least = sum(part.least for part in parts)
        names = tuple(field.name for field in fields)
        if len(set(names)) < len(names):
            raise UnusableError("its definition has two fields of one name")
        structure = Structure(name, dict(zip(names, (part.node for part in parts), strict=True)))
        steps = self._steps(fields, parts)
        codes = "".join(field.kind for field in fields) if len(steps) == 1 else ""
        is_bare = bool(codes) and all(field.kind in _SIZES and field.count < 0 for field in fields)

        def read(data: bytes, at: int) -> tuple[Any, int]:
            values: list[Any] = []
            for step in steps:
                found, at = step(data, at)
                values += found
            return _message(names, values), at

        return _Part(structure, read, least, nodes, codes if is_bare else "", names)

    def _steps(self, fields: Sequence[RosField], parts: Sequence[_Part]) -> list[Read]:
        """Return functions that read lists of values; adjacent numbers are read at once."""
        steps: list[Read] = []
        run = ""
        for field, part in zip(fields, parts, strict=True):
            is_number = field.count < 0 and field.kind in _SIZES
            same = self._is_ros1 or not run or (is_number and _SIZES[run[0]] == _SIZES[field.kind])
            if run and not (is_number and same):
                steps.append(self._numbers(run))
                run = ""
            if is_number:
                run += field.kind
            else:
                steps.append(_one(part.read))
        return [*steps, self._numbers(run)] if run else steps

    def _mask(self, codes: str) -> int:
        """Return the alignment of numbers, less one."""
        return 0 if self._is_ros1 else min(_SIZES[codes[0]] - 1, self._layout.most_mask)

    def _numbers(self, codes: str) -> Read:
        layout = struct.Struct(self._order + codes)
        unpack, size = layout.unpack_from, layout.size
        mask = self._mask(codes)

        def read(data: bytes, at: int) -> tuple[Any, int]:
            at = (at + mask) & ~mask
            return unpack(data, at), at + size

        return read

    def _field(self, field: RosField) -> _Part:
        part = self._one(field.kind)
        if field.count < 0:
            return part
        if field.count * max(part.least, 1) > 2**31 or not part.least:
            raise UnusableError("its definition has lists of nothing, or without end")
        node = Listed(part.node, field.count or None)
        least = field.count * part.least if field.count else 4
        if codes := field.kind if field.kind in _SIZES else part.codes:
            return _Part(node, self._table(codes, part.names, field.count), least)
        nodes = max(field.count, 1) * part.nodes
        return _Part(node, self._many(part, field.count), least, nodes)

    def _one(self, kind: str) -> _Part:
        if kind in _SIZES:
            node = Plain.FLAG if kind == "?" else Plain.NUMBER if kind in "fd" else Plain.WHOLE
            numbers = self._numbers(kind)

            def read(data: bytes, at: int) -> tuple[Any, int]:
                found, at = numbers(data, at)
                return found[0], at

            return _Part(node, read, _SIZES[kind])
        if kind == "string":
            return _Part(Plain.TEXT, self._text, 4)
        if kind in _TIMES and self._is_ros1:
            fields = (RosField("sec", _TIMES[kind]), RosField("nanosec", "I"))
            return self._structure(f"builtin_interfaces/msg/{kind.title()}", fields)
        return self.part(kind)

    def _length(self, data: bytes, at: int) -> tuple[int, int]:
        if not self._is_ros1:
            at = (at + 3) & ~3
        return struct.unpack_from(f"{self._order}I", data, at)[0], at + 4

    def _text(self, data: bytes, at: int) -> tuple[str, int]:
        count, at = self._length(data, at)
        end = at + count
        if end > len(data):
            raise ValueError(f"a text claims {count} bytes")
        last = end if self._is_ros1 else max(end - 1, at)
        return data[at:last].decode("utf-8", "replace"), end

    def _table(self, codes: str, names: tuple[str, ...], count: int) -> Read:
        """Return the reader of a list of numbers, or of parts of numbers alone, kept packed."""
        kinds: Any = [(name, self._order + code) for name, code in zip(names, codes, strict=False)]
        dtype = np.dtype(kinds if names else self._order + codes)
        size = dtype.itemsize
        mask = self._mask(codes)
        has_size = bool(names) and self._layout.has_sizes

        def read(data: bytes, at: int) -> tuple[Any, int]:
            if has_size:
                _, at = self._length(data, at)
            number = count
            if not count:
                number, at = self._length(data, at)
            if number:
                at = (at + mask) & ~mask
            end = at + number * size
            if end > len(data):
                raise ValueError(f"a list claims {number} parts")
            found = np.frombuffer(data, dtype, number, at) if number else np.empty(0, dtype)
            return (Rows(found, names) if names else found), end

        return read

    def _many(self, part: _Part, count: int) -> Read:
        one, least = part.read, part.least

        has_size = self._layout.has_sizes

        def read(data: bytes, at: int) -> tuple[Any, int]:
            size, begin = self._length(data, at) if has_size else (0, at)
            number, at = count, begin
            if not count:
                number, at = self._length(data, at)
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


def _one(read: Read) -> Read:
    def read_one(data: bytes, at: int) -> tuple[Any, int]:
        value, at = read(data, at)
        return (value,), at

    return read_one


# Bytes of numbers, by what `struct` calls them.
_SIZES: Mapping[str, int] = {code: struct.calcsize(f"<{code}") for code in "?bBhHiIqQfd"}
