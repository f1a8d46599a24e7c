"""Decode protobuf by the descriptors in the log: bounded, checked, in a descriptor pool apart."""

from __future__ import annotations

from functools import cache
from graphlib import TopologicalSorter
from importlib import import_module
from typing import TYPE_CHECKING, Any

from tunenet_logs.formats.base import (
    DAMAGED,
    Decode,
    MessageError,
    RawChannel,
    UnusableError,
    described,
)
from tunenet_logs.formats.compression import MAX_PART_BYTES
from tunenet_logs.formats.shapes import Fields, Leaf, Many, Maybe, Shape, shape_of
from tunenet_logs.formats.stamps import STAMP_FIELDS

if TYPE_CHECKING:
    from google.protobuf.descriptor import Descriptor, FieldDescriptor

# The descriptors of a type with all that it is made of have some kilobytes.
MAX_SCHEMA_BYTES = 4 * 1024 * 1024

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
