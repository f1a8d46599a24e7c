"""Decode the messages of a channel, in any encoding: bounded, every field checked that is read.

`Decoders.any_type` decodes by the definition in the log, or a JSON message by its own content.
Neither definition nor content proves what a type is called: of the `TYPES` that are read by their
name, `listed_type` asks for the fields, of the definition once, of JSON message by message.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from graphlib import TopologicalSorter
from importlib import import_module
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from tunenet_logs.formats.base import (
    DAMAGED,
    MAX_NODES,
    STAMP_FIELDS,
    AnyType,
    Listed,
    Maybe,
    MessageError,
    Node,
    Plain,
    RawChannel,
    Structure,
    UnusableError,
    described,
    type_key,
)
from tunenet_logs.formats.compressed import MAX_PART_BYTES
from tunenet_logs.formats.message_types import TYPES, MessageType
from tunenet_logs.formats.ros import ros_type

if TYPE_CHECKING:
    from google.protobuf.descriptor import Descriptor


@dataclass
class Decoders:
    """Decoders of the channels of one log, within a budget of a stranger's bytes."""

    left_bytes: int = 2 * 1024 * 1024  # of definitions
    # bytes of messages that may be decoded to infer their structure
    left_guesses: int = 4 * 1024 * 1024
    _made: dict[tuple[str, str, str, bytes], AnyType | str] = field(default_factory=dict)

    def any_type(self, channel: RawChannel) -> AnyType:
        """Return structure and decoder of a channel's messages, else raise UnusableError."""
        self._spend(channel)
        return _type_of(channel, None)

    def _spend(self, channel: RawChannel) -> None:
        # Time to read a byte of IDL and of protobuf, relative to one of another language.
        weight = {"ros2idl": 8.0, "omgidl": 8.0, "protobuf": 1 / 16}
        count = int(weight.get(channel.schema_encoding, 1.0) * len(channel.schema))
        if count > self.left_bytes:
            raise UnusableError("the log has more definitions than are read")
        self.left_bytes -= count

    def listed_type(self, channel: RawChannel) -> AnyType:
        """Return what `listed_type` does, made once for all channels of the same definition."""
        key = (channel.encoding, channel.schema_encoding, channel.type_name, channel.schema)
        if key not in self._made:
            try:
                self._spend(channel)
                self._made[key] = listed_type(channel)
            except UnusableError as reason:
                self._made[key] = str(reason)
        made = self._made[key]
        if isinstance(made, str):
            raise UnusableError(made)
        return made


def listed_type(channel: RawChannel) -> AnyType:
    """Return structure and decoder of a channel of one of `TYPES`, else raise UnusableError."""
    listed = TYPES.get(type_key(channel.type_name))
    if channel.encoding in ENCODINGS and listed is None:
        raise UnusableError(f"its type is not read in {channel.encoding}")
    kind = _type_of(channel, listed)
    if listed is not None and kind.structure is not None:
        _check(kind.structure, listed.fields, channel.type_name)
    return kind


def _type_of(channel: RawChannel, listed: MessageType | None) -> AnyType:
    if channel.encoding not in ENCODINGS:
        known = ", ".join(ENCODINGS)
        raise UnusableError(
            f"message encoding {channel.encoding[:20]!r} is not read (only {known})"
        )
    return ENCODINGS[channel.encoding](channel, listed)


def _check(structure: Structure, wanted: Structure, path: str) -> None:
    """Check that a type has the fields that are read, else raise UnusableError."""
    for name, inner in wanted.fields.items():
        if isinstance(inner, Maybe):
            continue
        node = structure.fields.get(name)
        can_lack = structure.can_lack is None or name in structure.can_lack
        if node is None or not _fits(node, inner) or (inner is Plain.OPTIONAL and not can_lack):
            raise UnusableError(f"its schema is not the usual one: {path} has no usable {name!r}")
        part, of = (one.of if isinstance(one, Listed) else one for one in (node, inner))
        if isinstance(part, Structure) and isinstance(of, Structure):
            _check(part, of, f"{path}.{name}")


def _fits(node: Node, wanted: Node) -> bool:
    if wanted is Plain.DATA and isinstance(node, Listed):
        return node.of is Plain.WHOLE  # bytes, in ROS
    if isinstance(wanted, Listed):
        return isinstance(node, Listed) and _fits(node.of, wanted.of)
    if isinstance(wanted, Structure):
        return isinstance(node, Structure)
    if wanted is Plain.TIME:
        return (
            isinstance(node, Structure)
            and node.is_time
            and all(inner is Plain.WHOLE for inner in node.fields.values())
        )
    if wanted in (Plain.NUMBER, Plain.OPTIONAL):
        return node in (Plain.NUMBER, Plain.WHOLE)
    return node is wanted or (wanted is Plain.FLAG and node is Plain.WHOLE)


# ---- JSON: what a message holds shows in the message itself.

_SCHEMAS = ("jsonschema", "")  # schema encodings of JSON; a log may give none
_MAX_BYTES = 256 * 1024  # of a message without image: far more than many joints or transforms take
_MAX_PICTURE_BYTES = 32 * 1024 * 1024  # of one with an image, as base64 or a list of numbers
# Objects and lists of one with an image: three bytes may become an object of ninety.
_MAX_PICTURE_PARTS = 100
# Brackets within brackets; the types that are read have a handful, and the parser recurses.
_MAX_DEPTH = 64
_STEPS = np.zeros(256, np.int8)  # change of depth at each byte of a message
_STEPS[list(b"[{")], _STEPS[list(b"]}")] = 1, -1


def json_type(channel: RawChannel, listed: MessageType | None) -> AnyType:
    """Return a decoder of JSON: fields become attributes, checked where the type is listed."""
    wanted = listed.fields if listed else None
    if wanted and channel.schema_encoding not in _SCHEMAS:
        raise UnusableError(
            f"schema encoding {channel.schema_encoding[:20]!r} is not read (only jsonschema)"
        )
    is_picture = wanted is not None and Plain.DATA in wanted.fields.values()
    most = _MAX_PICTURE_BYTES if is_picture else _MAX_BYTES
    hook = None if wanted else lambda fields: SimpleNamespace(**fields)

    def decode(data: bytes | memoryview) -> Any:
        if len(data) > most:
            raise MessageError(f"a message of {len(data)} bytes is over the limit of {most}")
        raw = bytes(data)
        parts = raw.count(b"[") + raw.count(b"{")
        if is_picture and parts > _MAX_PICTURE_PARTS:
            raise MessageError(f"a picture has over {_MAX_PICTURE_PARTS} objects and lists")
        if parts > _MAX_DEPTH:  # outside of texts, it may nest too deep for the parser
            bare = b"".join(raw.replace(b"\\\\", b"").replace(b'\\"', b"").split(b'"')[::2])
            depths = np.cumsum(_STEPS[np.frombuffer(bare, np.uint8)], dtype=np.int32)
            if depths.max(initial=0) > _MAX_DEPTH:
                raise MessageError(f"a message is nested more than {_MAX_DEPTH} deep")
        try:
            value = json.loads(raw.decode(), parse_constant=_refuse, object_hook=hook)
            return _built(value, wanted) if wanted else value
        except DAMAGED as error:
            raise MessageError(f"a message is damaged: {described(error)}") from error

    return AnyType(None, decode)


def _refuse(name: str) -> NoReturn:
    raise ValueError(f"{name} is not JSON")


def _built(value: Any, wanted: Node) -> Any:
    """Build an object with the fields of a type; raise ValueError for a missing or wrong one."""
    if isinstance(wanted, Structure):
        found: dict[str, Any] = {}
        for name, inner in wanted.fields.items():
            if not isinstance(value, dict):
                raise ValueError("no object where one must be")
            if name in value:
                found[name] = _built(value[name], inner)
            elif inner is Plain.OPTIONAL or isinstance(inner, Maybe):
                found[name] = None
            else:
                raise ValueError(f"it has no {name!r}")
        return SimpleNamespace(**found)
    if isinstance(wanted, Maybe):
        try:
            return _built(value, wanted.of)
        except ValueError:
            return None
    if isinstance(wanted, Listed):
        if not isinstance(value, list):
            raise ValueError("no list where one must be")
        return [_built(item, wanted.of) for item in value]
    if value is None and wanted is Plain.OPTIONAL:
        return None
    built = _LEAVES[wanted](value)
    if built is None:
        raise ValueError(f"something else where {wanted.value} must be")
    return built


def _number(value: Any) -> float | None:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return None
    number = float(value)
    return number if math.isfinite(number) else None  # 1e999 reads as infinity


def _whole(value: Any) -> int | None:
    number = _number(value)
    return int(value) if number is not None and number.is_integer() else None


def _data(value: Any) -> bytes | None:
    """Decode bytes as Foxglove and rosbridge write them: base64, or a list of numbers."""
    if isinstance(value, str):
        return base64.b64decode(value, validate=True)
    return bytes(value) if isinstance(value, list) else None


def _time(value: Any) -> SimpleNamespace | None:
    for names in STAMP_FIELDS:
        if isinstance(value, dict) and all(name in value for name in names):
            seconds, nanoseconds = (_whole(value[name]) for name in names)
            if seconds is None or nanoseconds is None or not 0 <= nanoseconds < 10**9:
                return None
            return SimpleNamespace(sec=seconds, nanosec=nanoseconds)
    return None


# What reads each kind of field; None where the value is of another kind.
_LEAVES: dict[Plain, Callable[[Any], Any]] = {
    Plain.NUMBER: _number,
    Plain.OPTIONAL: _number,
    Plain.WHOLE: _whole,
    Plain.FLAG: lambda value: bool(value) if value in (0, 1) else None,
    Plain.TEXT: lambda value: value if isinstance(value, str) else None,
    Plain.DATA: _data,
    Plain.TIME: _time,
}


# ---- Protobuf, by the descriptors in the log, each in a descriptor pool of its own.

_MAX_SCHEMA_BYTES = 4 * 1024 * 1024  # a type with all that it is made of has some kilobytes
# Of a message whose type has lists: two bytes of it may become an object of ninety.
_MAX_REPEATED_BYTES = 4 * 1024 * 1024
MAX_TYPE_DEPTH = 8  # of parts within parts that are looked at: a type may hold itself


def protobuf_type(channel: RawChannel, listed: MessageType | None) -> AnyType:
    """Return structure and decoder of a protobuf type, by the channel's own schema."""
    if channel.schema_encoding != "protobuf":
        raise UnusableError(
            f"schema encoding {channel.schema_encoding[:20]!r} is not read (only protobuf)"
        )
    if len(channel.schema) > _MAX_SCHEMA_BYTES:
        raise UnusableError(f"its schema is larger than {_MAX_SCHEMA_BYTES} bytes")
    from google.protobuf.message import Error
    from google.protobuf.message_factory import GetMessageClass

    try:
        descriptor = _descriptor_of(channel.schema, channel.type_name)
        structure = _protobuf_structure(descriptor, [0], 0)
        parse = GetMessageClass(descriptor).FromString
        most = _MAX_REPEATED_BYTES if _has_lists(descriptor) else MAX_PART_BYTES
    except (Error, *DAMAGED) as error:
        raise UnusableError(f"its schema is damaged: {described(error)}") from error

    def decode(data: bytes | memoryview) -> Any:
        if len(data) > most:
            raise MessageError(f"a message of {len(data)} bytes is over the limit of {most}")
        try:
            message = parse(bytes(data))
            if listed:
                _check_present(message, listed.fields)
        except (Error, *DAMAGED) as error:
            raise MessageError(f"a message is damaged: {described(error)}") from error
        return message

    return AnyType(structure, decode, checks_presence=True)


def _descriptor_of(schema: bytes, type_name: str) -> Descriptor:
    """Build the message type's descriptor from a set of files in any order."""
    from google.protobuf.descriptor_pb2 import FileDescriptorSet
    from google.protobuf.descriptor_pool import DescriptorPool

    files = {file.name: file for file in FileDescriptorSet.FromString(schema).file}
    needs = {name: set(file.dependency) for name, file in files.items()}
    pool = DescriptorPool()
    for name in TopologicalSorter(needs).static_order():
        if name not in files and name not in _own_files():
            raise UnusableError(f"its schema lacks the file {name[:60]!r}")
        own = files[name].SerializeToString() if name in files else _own_files()[name]
        pool.AddSerializedFile(own)
    return pool.FindMessageTypeByName(type_name)


@cache
def _own_files() -> dict[str, bytes]:
    """Return Google's files, which writers leave out of their descriptors, by name."""
    names = "any descriptor duration empty field_mask struct timestamp wrappers"
    modules = (import_module(f"google.protobuf.{name}_pb2") for name in names.split())
    return {module.DESCRIPTOR.name: module.DESCRIPTOR.serialized_pb for module in modules}


def _protobuf_structure(descriptor: Descriptor, seen: list[int], depth: int) -> Structure:
    """Return the structure of a type, bounded in depth and in number of fields `seen`."""
    fields: dict[str, Node] = {}
    for one in descriptor.fields:
        seen[0] += 1
        if one.message_type is not None:
            is_map = one.message_type.GetOptions().map_entry
            node: Node = Plain.OTHER
            if not is_map and depth <= MAX_TYPE_DEPTH and seen[0] <= MAX_NODES:
                node = _protobuf_structure(one.message_type, seen, depth + 1)
        else:
            plain = {
                one.TYPE_DOUBLE: Plain.NUMBER,
                one.TYPE_FLOAT: Plain.NUMBER,
                one.TYPE_STRING: Plain.TEXT,
                one.TYPE_BOOL: Plain.FLAG,
                one.TYPE_BYTES: Plain.DATA,
            }
            node = plain.get(one.type, Plain.WHOLE)
        fields[one.name] = Listed(node) if one.is_repeated else node
    can_lack = frozenset(one.name for one in descriptor.fields if one.has_presence)
    return Structure(descriptor.full_name, fields, can_lack)


def _has_lists(top: Descriptor) -> bool:
    """Return whether messages of a type can hold a list or a map, at any depth."""
    seen: set[str] = set()
    waiting = [top]
    while waiting:
        descriptor = waiting.pop()
        if any(one.is_repeated for one in descriptor.fields):
            return True
        seen.add(descriptor.full_name)
        parts = (one.message_type for one in descriptor.fields)
        waiting += [part for part in parts if part is not None and part.full_name not in seen]
    return False


def _check_present(message: Any, wanted: Structure) -> None:
    """Raise ValueError where a submessage is absent: it would read as unmeasured zeros."""
    for name, inner in wanted.fields.items():
        if isinstance(inner, Structure):
            if not message.HasField(name):
                raise ValueError(f"it has no {name}")
            _check_present(getattr(message, name), inner)
        elif isinstance(inner, Listed) and isinstance(inner.of, Structure):
            for part in getattr(message, name):
                _check_present(part, inner.of)


# Encodings of messages; a new one is a function from a channel, and its row of `TYPES` or None.
ENCODINGS: dict[str, Callable[[RawChannel, MessageType | None], AnyType]] = {
    "cdr": ros_type,
    "ros1": ros_type,
    "protobuf": protobuf_type,
    "json": json_type,
}
