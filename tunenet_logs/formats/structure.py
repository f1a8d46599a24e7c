"""Encoding-independent structure of message types: fields, lists, numbers, texts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from tunenet_logs.formats.stamps import STAMP_FIELDS

_MAX_LISTED = 200  # fields that are listed of a type


class Plain(Enum):
    """A leaf of a structure."""

    NUMBER = "a number"
    WHOLE = "a whole number"
    FLAG = "a flag"
    TEXT = "a text"
    OTHER = "nothing that is read"


@dataclass(frozen=True, eq=False)
class Structure:
    """A message, or a part of one, with fields.

    Attributes:
        name: of its type, "" where it has none.
        fields: by name, in their order.
    """

    name: str
    fields: Mapping[str, Node]

    @property
    def is_time(self) -> bool:
        """Whether it is a time in seconds and nanoseconds."""
        return any(set(self.fields) == set(pair) for pair in STAMP_FIELDS)

    @property
    def is_place(self) -> bool:
        """Whether it is a position x, y, z, and no quaternion."""
        return "w" not in self.fields and all(
            self.fields.get(axis) in NUMBERS for axis in ("x", "y", "z")
        )


@dataclass(frozen=True, eq=False)
class Listed:
    """A list of equal parts.

    Attributes:
        of: each part.
        count: fixed length; None where it varies.
    """

    of: Node
    count: int | None = None


Node = Structure | Listed | Plain  # a message, or a part of one
NUMBERS = (Plain.NUMBER, Plain.WHOLE)  # what may be measured


class NotThereError(LookupError):
    """A field that a type lacks, named by the message."""


def node_at(top: Structure, steps: tuple[str | int, ...]) -> Node:
    """Return the part of a type at a path.

    Args:
        top: the type.
        steps: names of fields, and numbers in lists from 0.

    Raises:
        NotThereError: the type has no such part.
    """
    node: Node = top
    for step in steps:
        if isinstance(step, int):
            if not isinstance(node, Listed) or (node.count is not None and step >= node.count):
                raise NotThereError(f"[{step}]")
            node = node.of
        else:
            if not isinstance(node, Structure) or step not in node.fields:
                raise NotThereError(step)
            node = node.fields[step]
    return node


def numbers_in(node: Node, prefix: str = "") -> list[str]:
    """List the numeric and time fields of a type, as `--columns` names them; 200 at most."""
    found: list[str] = []
    for path in _numbers(node, prefix):
        if len(found) == _MAX_LISTED:
            break
        found.append(path)
    return found


def likely_field(fields: Sequence[str]) -> str:
    """Return the field most likely meant: the first z, else the last."""
    return next((field for field in fields if field.split(".")[-1] == "z"), fields[-1])


def _numbers(node: Node, path: str) -> Iterator[str]:
    if isinstance(node, Listed):
        yield from _numbers(node.of, f"{path}[0]")
    elif isinstance(node, Structure) and node.is_time:
        yield path
    elif isinstance(node, Structure):
        for name, inner in node.fields.items():
            yield from _numbers(inner, f"{path}.{name}" if path else name)
    elif node in NUMBERS:
        yield path
