"""Decode messages of any type, by the definition in the log or by their own content (JSON)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from tunenet_logs.formats.base import DAMAGED, Decode, MessageError, RawChannel, UnusableError
from tunenet_logs.formats.base import described as described_error
from tunenet_logs.formats.compression import MAX_PART_BYTES
from tunenet_logs.formats.json_messages import any_json
from tunenet_logs.formats.protobuf import (
    MAX_REPEATED_BYTES,
    MAX_SCHEMA_BYTES,
    descriptor_of,
    has_lists,
)
from tunenet_logs.formats.ros import SCHEMA_ENCODINGS, known_types, ros_name
from tunenet_logs.formats.ros_any import any_ros_type
from tunenet_logs.formats.ros_definitions import parsed
from tunenet_logs.formats.structure import Listed, Node, Plain, Structure

if TYPE_CHECKING:
    from google.protobuf.descriptor import Descriptor, FieldDescriptor

_MAX_DEPTH = 8  # of parts within parts that are looked at, in types that may hold themselves
_MAX_NODES = 5000  # parts of a type that are looked at
# How much longer a byte of IDL takes to read than one of another definition, and of protobuf.
_IDL_WEIGHT, _PROTOBUF_WEIGHT = 8.0, 1 / 16

_WEIGHTS = {"ros2idl": _IDL_WEIGHT, "omgidl": _IDL_WEIGHT, "protobuf": _PROTOBUF_WEIGHT}

# Where a part of a message is: names of fields, and numbers in lists from 0.
Steps = tuple[str | int, ...]


@dataclass
class SchemaBudget:
    """Bytes of untrusted definitions that may be read in one log.

    Attributes:
        left_bytes: of definitions.
        left_guesses: bytes of messages that may be decoded to infer their structure.
    """

    left_bytes: int = 2 * 1024 * 1024
    left_guesses: int = 4 * 1024 * 1024

    def spend(self, channel: RawChannel) -> None:
        """Charge the definition of a channel's type to the budget.

        Raises:
            UnusableError: the budget is exhausted.
        """
        weight = _WEIGHTS.get(channel.schema_encoding, 1.0)
        count = int(weight * len(channel.schema))
        if count > self.left_bytes:
            raise UnusableError("the log has more definitions than are read")
        self.left_bytes -= count


@dataclass(frozen=True)
class AnyType:
    """Structure and decoder of the messages of one type.

    Attributes:
        structure: fields of the type; None where only a message shows them (JSON).
        decode: decoder of one message.
        checks_presence: whether an absent field reads as zero, as in protobuf.
    """

    structure: Structure | None
    decode: Decode
    checks_presence: bool = False

    def getter(self, steps: Steps) -> Callable[[Any], Any]:
        """Return a function that gets the field at ``steps`` of a message.

        The function raises LookupError or AttributeError where it is absent.
        """
        if self.checks_presence:
            return lambda message: _present(message, steps)
        if steps and not any(isinstance(step, int) or "." in step for step in steps):
            return attrgetter(".".join(map(str, steps)))
        return lambda message: _at(message, steps)


def _at(message: Any, steps: Steps) -> Any:
    for step in steps:
        message = message[step] if isinstance(step, int) else getattr(message, step)
    return message


def _present(message: Any, steps: Steps) -> Any:
    for step in steps:
        if isinstance(step, int):
            message = message[step]
            continue
        field = message.DESCRIPTOR.fields_by_name[step]
        if field.has_presence and not message.HasField(step):
            raise LookupError(f"it has no {step}")
        message = getattr(message, step)
    return message


def any_type(channel: RawChannel, budget: SchemaBudget) -> AnyType:
    """Return structure and decoder of a channel's messages of any type.

    Raises:
        UnusableError: their encoding or definition is not supported.
    """
    budget.spend(channel)
    if channel.encoding in SCHEMA_ENCODINGS:
        return _ros(channel)
    if channel.encoding == "protobuf" and channel.schema_encoding == "protobuf":
        return _protobuf(channel)
    if channel.encoding == "json":
        return AnyType(None, any_json)
    raise UnusableError(f"message encoding {channel.encoding[:20]!r} is not read")


def _ros(channel: RawChannel) -> AnyType:
    name, is_ros1 = ros_name(channel.type_name), channel.encoding == "ros1"
    types = dict(known_types(is_ros1=is_ros1))
    encodings = SCHEMA_ENCODINGS[channel.encoding]
    if channel.schema_encoding in encodings:
        types |= parsed(channel.schema, channel.schema_encoding, name)
        plain = channel.type_name.replace("::", "/")
        name = name if name in types or plain not in types else plain
    elif name not in types and channel.schema_encoding:
        raise UnusableError(
            f"its definition is in {channel.schema_encoding[:20]!r}, which is not read "
            f"(only {', '.join(encodings)})"
        )
    elif name not in types:
        raise UnusableError("its type is not known here, and the log does not define it")
    structure, decode = any_ros_type(types, name, is_ros1=is_ros1)
    return AnyType(structure, decode)


def _protobuf(channel: RawChannel) -> AnyType:
    if len(channel.schema) > MAX_SCHEMA_BYTES:
        raise UnusableError("its schema is too large")
    from google.protobuf.message import Error
    from google.protobuf.message_factory import GetMessageClass

    try:
        descriptor = descriptor_of(channel.schema, channel.type_name)
        structure = _Proto().structure(descriptor, 0)
        parse = GetMessageClass(descriptor).FromString
        most = MAX_REPEATED_BYTES if has_lists(descriptor) else MAX_PART_BYTES
    except (Error, *DAMAGED) as error:
        raise UnusableError(f"its schema is damaged: {described_error(error)}") from error

    def decode(data: bytes | memoryview) -> Any:
        if len(data) > most:
            raise MessageError(f"a message of {len(data)} bytes is over the limit of {most}")
        try:
            return parse(bytes(data))
        except (Error, *DAMAGED) as error:
            raise MessageError(f"a message is damaged: {described_error(error)}") from error

    return AnyType(structure, decode, checks_presence=True)


class _Proto:
    """Structure of a protobuf type, bounded in depth and in number of fields."""

    def __init__(self) -> None:
        self._nodes = 0

    def structure(self, descriptor: Descriptor, depth: int) -> Structure:
        fields = {field.name: self._field(field, depth) for field in descriptor.fields}
        return Structure(descriptor.full_name, fields)

    def _field(self, field: FieldDescriptor, depth: int) -> Node:
        self._nodes += 1
        one = self._one(field, depth)
        return Listed(one) if field.is_repeated else one

    def _one(self, field: FieldDescriptor, depth: int) -> Node:
        if field.message_type is not None:
            is_map = field.message_type.GetOptions().map_entry
            if is_map or depth > _MAX_DEPTH or self._nodes > _MAX_NODES:
                return Plain.OTHER
            return self.structure(field.message_type, depth + 1)
        if field.type in (field.TYPE_DOUBLE, field.TYPE_FLOAT):
            return Plain.NUMBER
        if field.type == field.TYPE_STRING:
            return Plain.TEXT
        if field.type == field.TYPE_BOOL:
            return Plain.FLAG
        return Plain.OTHER if field.type == field.TYPE_BYTES else Plain.WHOLE


def structure_of(message: Any) -> Structure:
    """Infer the structure of a decoded JSON message from its values."""
    node = _node(message, [0], 0)
    return node if isinstance(node, Structure) else Structure("", {})


def _node(value: Any, seen: list[int], depth: int) -> Node:
    seen[0] += 1
    if depth > _MAX_DEPTH or seen[0] > _MAX_NODES:
        return Plain.OTHER
    if isinstance(value, SimpleNamespace):
        fields = {name: _node(one, seen, depth + 1) for name, one in vars(value).items()}
        return Structure("", fields)
    if isinstance(value, list):
        of = _node(value[0], seen, depth + 1) if value else Plain.OTHER
        return Listed(of, None if isinstance(of, Structure) else len(value))
    if isinstance(value, bool):
        return Plain.FLAG
    if isinstance(value, int | float):
        return Plain.WHOLE if isinstance(value, int) else Plain.NUMBER
    return Plain.TEXT if isinstance(value, str) else Plain.OTHER
