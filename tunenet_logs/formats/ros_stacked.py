"""Decode many ROS messages of one layout at once: each number of a type becomes an array.

Messages that differ in their numbers alone (equal texts, lists of equal length) share a layout:
the first one is parsed, and of the others only bytes are compared.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.formats.ros_definitions import RosField, RosTypes

# A message whose numbers are arrays of shape (N, ...), and of which rows these are, shape (R,).
Stacked = tuple[Any, NDArray[np.bool_]]


def stacked_decoder(
    types: RosTypes, name: str, *, is_ros1: bool
) -> Callable[[NDArray[np.uint8]], Stacked]:
    """Build a vectorized decoder of messages of one size.

    Args:
        types: with all that it is made of.
        name: of the type, in full.
        is_ros1: whether the messages are of ROS 1; else CDR of ROS 2.

    Returns:
        A decoder from messages as rows of bytes, shape (R, L), to those that share the first one's
        layout. It raises ValueError, LookupError or struct.error where that one is damaged.
    """

    def decode(rows: NDArray[np.uint8]) -> Stacked:
        walk = _FirstMessage(types, rows, is_ros1=is_ros1)
        message = walk.part(name)
        if not 0 <= rows.shape[1] - walk.at < _FILLED:
            raise ValueError("it is of another size")
        same = np.ones(len(rows), np.bool_)
        for begin, end in walk.fixed:
            same &= (rows[:, begin:end] == rows[0, begin:end]).all(axis=1)
        return message(rows if same.all() else rows[same]), same

    return decode


_FILLED = 4  # bytes up to whose next multiple some writers fill
_Take = Callable[[NDArray[np.uint8]], Any]  # takes a part out of messages of one layout


class _FirstMessage:
    """Parser of the first of several messages.

    Attributes:
        at: the place behind what was read.
        fixed: byte ranges, end excluded, that are equal in all messages of its layout.
    """

    def __init__(self, types: RosTypes, rows: NDArray[np.uint8], *, is_ros1: bool) -> None:
        self._types = types
        self._first = rows[0].tobytes()
        self._is_ros1 = is_ros1
        self._order = "<"
        self.at = 0
        self.fixed: list[tuple[int, int]] = []
        if not is_ros1:
            if self._first[:2] not in (b"\0\0", b"\0\1"):
                raise ValueError("it is no plain CDR")
            self._order = "<" if self._first[1] else ">"
            self._same(2)
            self.at = 4

    def part(self, name: str) -> _Take:
        """Return the reader of a named type."""
        fields = {field.name: self._field(field) for field in self._types[name]}
        return lambda rows: SimpleNamespace(**{key: take(rows) for key, take in fields.items()})

    def _field(self, field: RosField) -> _Take:
        if field.count < 0:
            return self._one(field.kind)
        count = field.count or self._length()
        if field.kind in _NUMBERS:
            return self._numbers(field.kind, (count,))
        if count > len(self._first):
            raise ValueError(f"a list claims {count} parts")
        parts = [self._one(field.kind) for _ in range(count)]
        return lambda rows: [take(rows) for take in parts]

    def _one(self, kind: str) -> _Take:
        if kind in _NUMBERS:
            return self._numbers(kind, ())
        if kind == "string":
            text = self._text()
            return lambda _: text
        if kind in ("time", "duration"):
            seconds, rest = (
                self._numbers("I" if kind == "time" else "i", ()),
                self._numbers("I", ()),
            )
            return lambda rows: SimpleNamespace(sec=seconds(rows), nanosec=rest(rows))
        return self.part(kind)

    def _numbers(self, kind: str, shape: tuple[int, ...]) -> _Take:
        dtype = np.dtype(self._order + kind)
        count = shape[0] if shape else 1
        if count:
            self._align(dtype.itemsize)
        begin = self.at
        self.at = end = begin + count * dtype.itemsize
        if end > len(self._first):
            raise ValueError(f"a list claims {count} parts")
        wide = np.int64 if dtype.kind == "i" or (dtype.kind == "u" and dtype.itemsize < 8) else None

        def take(rows: NDArray[np.uint8]) -> NDArray[Any]:
            found = np.ascontiguousarray(rows[:, begin:end]).view(dtype).reshape(len(rows), *shape)
            return found if wide is None else found.astype(wide)

        return take

    def _text(self) -> str:
        count = self._length()
        text = self._first[self.at : self.at + count]
        if len(text) < count:
            raise ValueError(f"a text claims {count} bytes")
        self._same(count)
        return (text if self._is_ros1 else text[:-1]).decode()

    def _length(self) -> int:
        self._align(4)
        (count,) = struct.unpack_from(f"{self._order}I", self._first, self.at)
        self._same(4)
        return count

    def _same(self, size: int) -> None:
        begin, self.at = self.at, self.at + size
        if self.fixed and self.fixed[-1][1] + _FILLED > begin:  # what fills is alike, too
            begin = self.fixed.pop()[0]
        self.fixed.append((begin, self.at))

    def _align(self, size: int) -> None:
        if not self._is_ros1:
            self.at += -(self.at - 4) % size


_NUMBERS = frozenset("?bBhHiIqQfd")  # what `struct` calls them
