"""How a review says what its parameters are called: as shortly as they stay apart."""

from __future__ import annotations

from collections.abc import Iterable, Mapping


def said_names(names: Iterable[str]) -> Mapping[str, str]:
    """Each parameter's name as a review says it: "restitution slope", "elbow.damping".

    Args:
        names: of all parameters; of addresses such as `joint/elbow.damping` the kind is left out
            where no other one ends the same.
    """
    every = list(dict.fromkeys(names))
    ends = [_end(name) for name in every]
    return {
        name: end if ends.count(end) == 1 else name for name, end in zip(every, ends, strict=True)
    }


def _end(name: str) -> str:
    """An address without its kind, another name in words."""
    _, kind, rest = name.partition("/")
    if kind:
        return rest if "." in rest else name
    return name.replace("_", " ")
