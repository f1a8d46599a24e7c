"""Decode JSON and protobuf messages of ROS and Foxglove types: bounded, every field checked.

Neither encoding proves a message's type, so both are checked against `shape_of` their channel: JSON
message by message, protobuf once, by the descriptor in the log.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable
from functools import cache, partial
from graphlib import TopologicalSorter
from importlib import import_module
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from tunenet_logs.formats.base import (
    DAMAGED,
    STAMP_FIELDS,
    Decode,
    MessageError,
    RawChannel,
    UnusableError,
    described,
)
from tunenet_logs.formats.compressed import MAX_PART_BYTES
from tunenet_logs.formats.message_types import Fields, Leaf, Many, Maybe, Shape, shape_of

if TYPE_CHECKING:
    from google.protobuf.descriptor import Descriptor, FieldDescriptor


_SCHEMAS = ("jsonschema", "")  # schema encodings of JSON; a log may give none
_MAX_BYTES = 256 * 1024  # of a message without image: far more than many joints or transforms take
_MAX_PICTURE_BYTES = 32 * 1024 * 1024  # of one with an image, as base64 or a list of numbers
# Objects and lists of one with an image: three bytes may become an object of ninety.
_MAX_PICTURE_PARTS = 100

# Brackets within brackets; the types that are read have a handful, and the parser recurses.
_MAX_DEPTH = 64

# Change of depth at each byte of a message.
_STEPS = np.zeros(256, np.int8)
_STEPS[list(b"[{")] = 1
_STEPS[list(b"]}")] = -1


def json_decoder(channel: RawChannel) -> Decode:
    """Return a JSON decoder. The schema is not needed: each message is checked by itself."""
    if channel.schema_encoding not in _SCHEMAS:
        raise UnusableError(
            f"schema encoding {channel.schema_encoding[:20]!r} is not read (only jsonschema)"
        )
    shape = shape_of(channel)
    return partial(_decode, shape, Leaf.DATA in shape.fields.values())


def _decode(shape: Fields, is_picture: bool, data: bytes | memoryview) -> Any:
    most = _MAX_PICTURE_BYTES if is_picture else _MAX_BYTES
    try:
        return _built(_loaded(data, most, is_picture=is_picture), shape)
    except DAMAGED as error:
        raise MessageError(f"a message is damaged: {described(error)}") from error


def any_json(data: bytes | memoryview) -> Any:
    """Decode a message of any type: its objects have their fields as attributes.

    Raises:
        MessageError: it is damaged, or over the limits of size or nesting.
    """
    try:
        return _loaded(data, _MAX_BYTES, hook=lambda fields: SimpleNamespace(**fields))
    except DAMAGED as error:
        raise MessageError(f"a message is damaged: {described(error)}") from error


def _loaded(
    data: bytes | memoryview,
    most: int,
    *,
    is_picture: bool = False,
    hook: Callable[[dict[str, Any]], Any] | None = None,
) -> Any:
    """Parse JSON within bounds of size and nesting; raise MessageError or one of DAMAGED."""
    if len(data) > most:
        raise MessageError(f"a message of {len(data)} bytes is over the limit of {most}")
    raw = bytes(data)
    if is_picture and _parts(raw) > _MAX_PICTURE_PARTS:
        raise MessageError(f"a picture has over {_MAX_PICTURE_PARTS} objects and lists")
    if _is_deep(raw):
        raise MessageError(f"a message is nested more than {_MAX_DEPTH} deep")
    return json.loads(raw.decode(), parse_constant=_refuse, object_hook=hook)


def _refuse(name: str) -> NoReturn:
    raise ValueError(f"{name} is not JSON")


def _parts(raw: bytes) -> int:
    """Bound the number of objects and lists in a message."""
    return raw.count(b"[") + raw.count(b"{")


def _is_deep(raw: bytes) -> bool:
    """Return whether brackets outside strings nest too deep for the recursive parser."""
    if _parts(raw) <= _MAX_DEPTH:
        return False
    bare = b"".join(raw.replace(b"\\\\", b"").replace(b'\\"', b"").split(b'"')[::2])
    depths = np.cumsum(_STEPS[np.frombuffer(bare, np.uint8)], dtype=np.int32)
    return bool(depths.size and depths.max() > _MAX_DEPTH)


def _built(value: Any, shape: Shape) -> Any:
    """Build an object with the fields of a shape; raise ValueError for a missing or wrong one."""
    if isinstance(shape, Fields):
        if not isinstance(value, dict):
            raise ValueError("no object where one must be")
        return SimpleNamespace(
            **{name: _field(value, name, inner) for name, inner in shape.fields.items()}
        )
    if isinstance(shape, Maybe):
        try:
            return _built(value, shape.of)
        except ValueError:
            return None
    if isinstance(shape, Many):
        if not isinstance(value, list):
            raise ValueError("no list where one must be")
        return [_built(item, shape.of) for item in value]
    built = _LEAVES[shape](value)
    if built is None and shape is not Leaf.OPTIONAL:
        raise ValueError(f"something else where {shape.value} must be")
    return built


def _field(value: dict[str, Any], name: str, shape: Shape) -> Any:
    if name in value:
        return _built(value[name], shape)
    if shape is Leaf.OPTIONAL or isinstance(shape, Maybe):
        return None
    raise ValueError(f"it has no {name!r}")


def _number(value: Any) -> float | None:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return None
    number = float(value)
    return number if math.isfinite(number) else None  # 1e999 reads as infinity


def _optional(value: Any) -> float | None:
    if value is None:
        return None
    number = _number(value)
    if number is None:
        raise ValueError("something else where a number must be")
    return number


def _whole(value: Any) -> int | None:
    number = _number(value)
    return int(value) if number is not None and number.is_integer() else None


def _flag(value: Any) -> bool | None:
    return bool(value) if value in (0, 1) else None


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) else None


def _data(value: Any) -> bytes | None:
    """Decode bytes as Foxglove and rosbridge write them: base64, or a list of numbers."""
    if isinstance(value, str):
        return base64.b64decode(value, validate=True)
    return bytes(value) if isinstance(value, list) else None


def _time(value: Any) -> SimpleNamespace | None:
    if not isinstance(value, dict):
        return None
    for names in STAMP_FIELDS:
        if all(name in value for name in names):
            seconds, nanoseconds = (_whole(value[name]) for name in names)
            if seconds is None or nanoseconds is None or not 0 <= nanoseconds < 10**9:
                return None
            return SimpleNamespace(sec=seconds, nanosec=nanoseconds)
    return None


# What reads each kind of field; None where the value is of another kind.
_LEAVES = {
    Leaf.NUMBER: _number,
    Leaf.OPTIONAL: _optional,
    Leaf.WHOLE: _whole,
    Leaf.FLAG: _flag,
    Leaf.TEXT: _text,
    Leaf.DATA: _data,
    Leaf.TIME: _time,
}


# ---- Protobuf, by the descriptors in the log, each in a descriptor pool of its own.

MAX_SCHEMA_BYTES = 4 * 1024 * 1024  # a type with all that it is made of has some kilobytes
# Of a message whose type has lists: two bytes of it may become an object of ninety.
MAX_REPEATED_BYTES = 4 * 1024 * 1024

# Files of Google's that writers leave out of their descriptors.
_WELL_KNOWN = (
    "any",
    "descriptor",
    "duration",
    "empty",
    "field_mask",
    "struct",
    "timestamp",
    "wrappers",
)


def protobuf_decoder(channel: RawChannel) -> Decode:
    """Return a protobuf decoder for the channel's own schema.

    Raises:
        UnusableError: the schema is damaged, too large, or not the usual one of its type.
    """
    if channel.schema_encoding != "protobuf":
        raise UnusableError(
            f"schema encoding {channel.schema_encoding[:20]!r} is not read (only protobuf)"
        )
    if len(channel.schema) > MAX_SCHEMA_BYTES:
        raise UnusableError(f"its schema is larger than {MAX_SCHEMA_BYTES} bytes")
    shape = shape_of(channel)
    from google.protobuf.message import Error
    from google.protobuf.message_factory import GetMessageClass

    try:
        descriptor = descriptor_of(channel.schema, channel.type_name)
        _check(descriptor, shape, channel.type_name)
        parse = GetMessageClass(descriptor).FromString
        most = MAX_REPEATED_BYTES if has_lists(descriptor) else MAX_PART_BYTES
    except (Error, *DAMAGED) as error:
        raise UnusableError(f"its schema is damaged: {described(error)}") from error

    def decode(data: bytes | memoryview) -> Any:
        if len(data) > most:
            raise MessageError(f"a message of {len(data)} bytes is over the limit of {most}")
        try:
            message = parse(bytes(data))
            _check_present(message, shape)
        except (Error, *DAMAGED) as error:
            raise MessageError(f"a message is damaged: {described(error)}") from error
        return message

    return decode


def descriptor_of(schema: bytes, type_name: str) -> Descriptor:
    """Build the message type's descriptor from a set of files in any order.

    Raises:
        UnusableError: a file that it needs is missing.
        google.protobuf.message.Error, LookupError, TypeError, ValueError: the set is damaged.
    """
    from google.protobuf.descriptor_pb2 import FileDescriptorSet
    from google.protobuf.descriptor_pool import DescriptorPool

    files = {file.name: file for file in FileDescriptorSet.FromString(schema).file}
    needs = {name: set(file.dependency) for name, file in files.items()}
    pool = DescriptorPool()
    for name in TopologicalSorter(needs).static_order():
        serialized = files[name].SerializeToString() if name in files else _well_known(name)
        pool.AddSerializedFile(serialized)
    return pool.FindMessageTypeByName(type_name)


@cache
def _own_files() -> dict[str, bytes]:
    modules = (import_module(f"google.protobuf.{name}_pb2") for name in _WELL_KNOWN)
    return {module.DESCRIPTOR.name: module.DESCRIPTOR.serialized_pb for module in modules}


def _well_known(name: str) -> bytes:
    if name not in _own_files():
        raise UnusableError(f"its schema lacks the file {name[:60]!r}")
    return _own_files()[name]


def _check(descriptor: Descriptor, shape: Fields, path: str) -> None:
    """Check that a message type has the fields that are read, else raise UnusableError."""
    for name, inner in shape.fields.items():
        if isinstance(inner, Maybe):
            continue
        field = descriptor.fields_by_name.get(name)
        if field is None or not _fits(field, inner):
            raise UnusableError(f"its schema is not the usual one: {path} has no usable {name!r}")
        nested = inner.of if isinstance(inner, Many) else inner
        if isinstance(nested, Fields):
            assert field.message_type is not None
            _check(field.message_type, nested, f"{path}.{name}")


def _fits(field: FieldDescriptor, shape: Shape) -> bool:
    if isinstance(shape, Many):
        return field.is_repeated and _fits_one(field, shape.of)
    return not field.is_repeated and _fits_one(field, shape)


def _fits_one(field: FieldDescriptor, shape: Shape) -> bool:
    if isinstance(shape, Leaf):
        if shape is Leaf.TIME:
            return field.message_type is not None and _is_time(field.message_type)
        presence = field.has_presence or shape is not Leaf.OPTIONAL
        return presence and field.type in _types(shape)
    return field.message_type is not None


def _is_time(descriptor: Descriptor) -> bool:
    fields = descriptor.fields_by_name
    return any(
        all(name in fields and _fits(fields[name], Leaf.WHOLE) for name in pair)
        for pair in STAMP_FIELDS
    )


@cache
def _types(leaf: Leaf) -> frozenset[int]:
    from google.protobuf.descriptor import FieldDescriptor as Field

    whole = {Field.TYPE_INT32, Field.TYPE_INT64, Field.TYPE_UINT32, Field.TYPE_UINT64}
    whole |= {Field.TYPE_FIXED32, Field.TYPE_FIXED64, Field.TYPE_SFIXED32, Field.TYPE_SFIXED64}
    whole |= {Field.TYPE_SINT32, Field.TYPE_SINT64}
    types: dict[Leaf, set[int]] = {
        Leaf.WHOLE: whole,
        Leaf.NUMBER: {Field.TYPE_DOUBLE, Field.TYPE_FLOAT, *whole},
        Leaf.OPTIONAL: {Field.TYPE_DOUBLE, Field.TYPE_FLOAT, *whole},
        Leaf.FLAG: {Field.TYPE_BOOL, *whole},
        Leaf.TEXT: {Field.TYPE_STRING},
        Leaf.DATA: {Field.TYPE_BYTES},
    }
    return frozenset(types[leaf])


def has_lists(top: Descriptor) -> bool:
    """Return whether messages of a type can hold a list or a map, at any depth."""
    seen: set[str] = set()
    waiting = [top]
    while waiting:
        descriptor = waiting.pop()
        if descriptor.full_name in seen:
            continue
        seen.add(descriptor.full_name)
        if any(field.is_repeated for field in descriptor.fields):
            return True
        waiting += [
            field.message_type for field in descriptor.fields if field.message_type is not None
        ]
    return False


def _check_present(message: Any, shape: Fields) -> None:
    """Raise ValueError where a submessage is absent: it would read as unmeasured zeros."""
    for name, inner in shape.fields.items():
        if isinstance(inner, Fields):
            if not message.HasField(name):
                raise ValueError(f"it has no {name}")
            _check_present(getattr(message, name), inner)
        elif isinstance(inner, Many) and isinstance(inner.of, Fields):
            for part in getattr(message, name):
                _check_present(part, inner.of)
