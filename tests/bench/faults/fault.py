"""Deliberate fault of the mutation tests."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Fault:
    """Small change that leaves the code running."""

    name: str  # what is wrong, in plain words
    file: str  # where
    old: str  # text of it, which is there once
    new: str  # what it becomes
    likely: tuple[str, ...]  # tests that should notice; they are run before all others
