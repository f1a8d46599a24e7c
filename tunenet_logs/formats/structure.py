"""What the messages of a type are made of, in whatever encoding: fields, lists, numbers, texts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from tunenet_logs.formats.stamps import STAMP_FIELDS

_MOST_LISTED = 200
"""Fields that are listed of a type."""


class Plain(Enum):
    """A part without parts of its own."""

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
        """Whether it is x, y and z, and no quaternion."""
        return "w" not in self.fields and all(
            self.fields.get(axis) in NUMBERS for axis in ("x", "y", "z")
        )


@dataclass(frozen=True, eq=False)
class Listed:
    """A list of one thing.

    Attributes:
        of: each part.
        count: how many there are; None where that differs.
    """

    of: Node
    count: int | None = None


Node = Structure | Listed | Plain
"""A message, or a part of one."""

NUMBERS = (Plain.NUMBER, Plain.WHOLE)
"""What may be measured."""


class NotThereError(LookupError):
    """A field that is not in a type; the message names it."""


def node_at(top: Structure, steps: tuple[str | int, ...]) -> Node:
    """The part of a type at a place.

    Args:
        top: the type.
        steps: names of fields, and numbers in lists from 0.

    Raises:
        NotThereError: there is none.
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
    """The numbers and times of a type, as `--columns` names them; 200 at most."""
    found: list[str] = []
    for path in _numbers(node, prefix):
        if len(found) == _MOST_LISTED:
            break
        found.append(path)
    return found


def likely_field(fields: Sequence[str]) -> str:
    """The field of a type that is most likely meant."""
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
