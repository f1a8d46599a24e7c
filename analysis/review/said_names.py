"""Shorten parameter names for a review while they stay distinct."""

from __future__ import annotations

from collections.abc import Iterable, Mapping


def said_names(names: Iterable[str]) -> Mapping[str, str]:
    """Shorten each parameter's name: "restitution slope", "elbow.damping".

    Args:
        names: Of all parameters; addresses such as `joint/elbow.damping` lose the kind if no other
            one ends the same.
    """
    every = list(dict.fromkeys(names))
    ends = [_end(name) for name in every]
    return {
        name: end if ends.count(end) == 1 else name for name, end in zip(every, ends, strict=True)
    }


def _end(name: str) -> str:
    """Return an address without its kind, or another name in words."""
    _, kind, rest = name.partition("/")
    if kind:
        return rest if "." in rest else name
    return name.replace("_", " ")
