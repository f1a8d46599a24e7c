"""Deliberate fault of the mutation tests."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Fault:
    """Small change that leaves the code running.

    Attributes:
        name: what is wrong, in plain words.
        file: where.
        old: text of it, which is there once.
        new: what it becomes.
        likely: tests that should notice; they are run before all others.
    """

    name: str
    file: str
    old: str
    new: str
    likely: tuple[str, ...]
