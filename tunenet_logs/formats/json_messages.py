"""Decode JSON messages of ROS and Foxglove types: bounded, with every field checked by its type."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any, NoReturn

import numpy as np

from tunenet_logs.formats.base import (
    DAMAGED,
    Decode,
    MessageError,
    RawChannel,
    UnusableError,
    described,
)
from tunenet_logs.formats.shapes import Fields, Leaf, Many, Maybe, Shape, shape_of
from tunenet_logs.formats.stamps import STAMP_FIELDS

_SCHEMAS = ("jsonschema", "")  # schema encodings of JSON; a log may give none
# Of a message that is no picture: far more than one of many joints or transforms takes.
_MAX_BYTES = 256 * 1024

# Of a message with a picture, as base64 or as a list of numbers.
_MAX_PICTURE_BYTES = 32 * 1024 * 1024

# Of one message: three bytes of it may become an object of ninety, so one as large as a picture may
# have few objects and lists.
_MAX_PICTURE_PARTS = 100

# Brackets within brackets; the types that are read have a handful, and the parser recurses.
_MAX_DEPTH = 64

# How much deeper each byte of a message leads: by one, or back by one.
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
