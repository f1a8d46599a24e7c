"""What is half made is closed where making it fails."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Protocol


class _Closable(Protocol):
    def close(self) -> None: ...


@contextmanager
def closed_on_failure(thing: _Closable) -> Iterator[None]:
    """Close something if the block ends by an error, whatever it is; else it stays open."""
    with ExitStack() as failed:
        failed.callback(thing.close)
        yield
        failed.pop_all()
