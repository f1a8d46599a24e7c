"""Decode ROS messages, in ROS 2 CDR and in ROS 1 serialization.

`ros_decoder` decodes known types: a log's own definitions are compared with ours and never
compiled, which would run untrusted code. `any_ros_type` decodes all others, by the log's
definition: parsed as text, it becomes a tree of functions. `stacked_decoder` decodes many messages
of one type at once.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from rosbags.typesys.store import Typestore

from tunenet_logs import messages
from tunenet_logs.formats.base import (
    DAMAGED,
    BeyondLimitError,
    Decode,
    Listed,
    MessageError,
    Node,
    Plain,
    RawChannel,
    Structure,
    UnusableError,
    described,
)

MAX_SCHEMA_BYTES = 256 * 1024  # the types that are used, with all their parts, have a tenth at most
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


# ---- Decode any type: each part is read by a function of its own.
# A message's memory is bounded by its own bytes: a type whose parts hold no bytes is refused.

_MAX_DEPTH = 24  # of types within types
_MAX_NODES = 5000  # parts of one message, lists of any length aside
_MAX_PARTS = 20_000  # messages in the lists of one message
_BYTES_BEHIND = 3  # that may follow a message: some writers pad to a multiple of 4
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


# Size of each number [bytes], by its `struct` code.
_SIZES: Mapping[str, int] = {code: struct.calcsize(f"<{code}") for code in "?bBhHiIqQfd"}


# ---- Decode known types, by the definitions of ROS and ours.

# Foxglove's types as ROS messages; they begin alike.
_FRAME = "builtin_interfaces/Time timestamp\nstring frame_id\n"
_TRANSFORM = (
    "builtin_interfaces/Time timestamp\nstring parent_frame_id\nstring child_frame_id\n"
    "geometry_msgs/Vector3 translation\n"
)

# Definitions that are read, by the encoding of the messages.
SCHEMA_ENCODINGS = {"cdr": ("ros2msg", "ros2idl", "omgidl"), "ros1": ("ros1msg",)}

# Parsers of definitions, by schema encoding; they build field lists and run nothing.
_PARSERS = {
    "ros2msg": get_types_from_msg,
    "ros1msg": get_types_from_msg,
    "ros2idl": lambda text, _name: idl_types(text),
    "omgidl": lambda text, _name: idl_types(text),
}

# Types that no distribution of ROS defines: of Kinova's driver, ros2_control, ours, Foxglove's.
_FOREIGN = {
    "kinova_msgs": dict.fromkeys(
        ("JointAngles", "JointTorque", "JointVelocity"), messages.SEVEN_JOINTS
    ),
    "control_msgs": {
        "InterfaceValue": "string[] interface_names\nfloat64[] values",
        "DynamicJointState": "std_msgs/Header header\nstring[] joint_names\n"
        "control_msgs/InterfaceValue[] interface_values",
    },
    "tunenet_msgs": {"TaskOutcome": messages.OUTCOME_FIELDS},
    "foxglove_msgs": {
        "PoseInFrame": f"{_FRAME}geometry_msgs/Pose pose",
        "Point3InFrame": f"{_FRAME}geometry_msgs/Point point",
        "FrameTransform": f"{_TRANSFORM}geometry_msgs/Quaternion rotation",
        "FrameTransforms": "foxglove_msgs/FrameTransform[] transforms",
        "CompressedImage": f"{_FRAME}uint8[] data\nstring format",
        "CompressedVideo": f"{_FRAME}uint8[] data\nstring format",
        "RawAudio": messages.AUDIO_FIELDS,
        "RawImage": f"{_FRAME}uint32 width\nuint32 height\nstring encoding\nuint32 step\n"
        "uint8[] data",
    },
}

# Old names of types: ROS 1 moved this one to another package.
_SAME_TYPE = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}


def ros_name(type_name: str) -> str:
    """Return a type name as ROS 2 writes it: "sensor_msgs/msg/JointState".

    So becomes "sensor_msgs/JointState", and "sensor_msgs::msg::JointState" of the OMG's IDL.
    """
    package, _, name = type_name.replace("::", "/").partition("/")
    if name and "/" not in name:
        name = f"msg/{name}"
    full = f"{package}/{name}" if name else package
    return _SAME_TYPE.get(full, full)


def plain_type(type_name: str) -> str:
    """Return a type name without its package: "JointState"."""
    return re.split(r"[/.:]", type_name)[-1]


def ros_decoder(channel: RawChannel) -> Decode:
    """Return a decoder of ROS 2 CDR, or of ROS 1 serialization, by the channel's encoding.

    Raises:
        UnusableError: the channel's own definition of its type is damaged, or its layout differs
            from ours.
    """
    name = ros_name(channel.type_name)
    is_ros1 = channel.encoding == "ros1"
    stores = Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE
    store = _typestore(stores)
    if not channel.schema_encoding and not is_ros1:  # a .db3 may give no more than the type's name
        if name not in store.types:
            raise UnusableError("its type is not known here")
    else:
        encodings = SCHEMA_ENCODINGS[channel.encoding]
        if channel.schema_encoding not in encodings:
            raise UnusableError(
                f"schema encoding {channel.schema_encoding[:20]!r} is not read "
                f"(only {', '.join(encodings)})"
            )
        if len(channel.schema) > MAX_SCHEMA_BYTES:
            raise UnusableError("its schema is too large")
        is_same = _is_same(channel.schema, channel.schema_encoding, name, stores)
        if is_same is None:
            raise UnusableError("its schema is damaged")
        if not is_same:
            raise UnusableError(f"its schema is not the usual {channel.type_name}")
    deserialize = store.deserialize_ros1 if is_ros1 else store.deserialize_cdr

    def decode(data: bytes | memoryview) -> Any:
        if not is_ros1 and len(data) > 1 and not data[0] and data[1] > 1:
            return _other_cdr(name)(data)
        try:
            return deserialize(data, name)  # type: ignore[arg-type]
        except (SerdeError, *DAMAGED) as error:
            raise MessageError(f"a {name} message is damaged: {error}") from error

    return decode


@cache
def _other_cdr(name: str) -> Decode:
    """Return a decoder of a known type in CDR of another version than that of ROS 2."""
    return any_ros_type(known_types(is_ros1=False), name, is_ros1=False)[1]


@lru_cache(maxsize=64)
def _is_same(schema: bytes, encoding: str, name: str, stores: Stores) -> bool | None:
    """Return whether a definition is ours; None for a damaged one. Cached over channels."""
    try:
        theirs = _PARSERS[encoding](schema.decode(), name)
    except (TypesysError, *DAMAGED):
        return None
    ours = _typestore(stores).fielddefs
    return name in theirs and all(
        inner in ours and list(ours[inner][1]) == list(parsed[1])
        for inner, parsed in theirs.items()
    )


@cache
def known_types(*, is_ros1: bool) -> RosTypes:
    """Return the fields of all known types."""
    stores = Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE
    found: RosTypes = {}
    for name, fields in _typestore(stores).fielddefs.items():
        with suppress(LookupError):  # one with wide texts, which are not read
            found |= types_of({name: fields})
    return found


@cache
def _typestore(stores: Stores) -> Typestore:
    """Return the known types: those of a ROS distribution, and `_FOREIGN`."""
    store = get_typestore(stores)
    if stores is Stores.ROS1_NOETIC:
        transforms = "geometry_msgs/TransformStamped[] transforms"
        store.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))
    for package, types in _FOREIGN.items():
        for name, text in types.items():
            store.register(get_types_from_msg(text, f"{package}/msg/{name}"))
    return store


# ---- Decode many messages of one layout at once: each number of a type becomes an array.
# Messages that differ in their numbers alone (equal texts, lists of equal length) share a layout:
# the first one is parsed, and of the others only bytes are compared.

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


_FILLED = 4  # bytes to whose multiple some writers pad
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
        if field.kind in _SIZES:
            return self._numbers(field.kind, (count,))
        if count > len(self._first):
            raise ValueError(f"a list claims {count} parts")
        parts = [self._one(field.kind) for _ in range(count)]
        return lambda rows: [take(rows) for take in parts]

    def _one(self, kind: str) -> _Take:
        if kind in _SIZES:
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
