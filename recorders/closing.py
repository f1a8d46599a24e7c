"""Close half-made objects where making them fails."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Protocol


class _Closable(Protocol):
    def close(self) -> None: ...


@contextmanager
def closed_on_failure(thing: _Closable) -> Iterator[None]:
    """Close `thing` if the block raises; else leave it open."""
    with ExitStack() as failed:
        failed.callback(thing.close)
        yield
        failed.pop_all()
