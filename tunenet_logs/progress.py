"""How far slow work is, told from where it is done to whoever listens: nobody, unless one asks."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

Item = TypeVar("Item")

Listener = Callable[[str, float], object]
"""Is given what is being done, in words, and which fraction of it is done: 0 to 1, 0 at first."""

_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)

_SOON_S = 0.1
"""Between two tellings: a terminal shows no more, and a callback may be slow."""


@contextmanager
def heard_by(listener: Listener | None) -> Generator[None]:
    """Let `listener` hear of the work in this block; nobody if it is None."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def told(items: Iterable[Item], what: str, total: int) -> Iterator[Item]:
    """The items, telling how many of `total` are done with.

    Args:
        items: which are worked through, one after the other.
        what: is done to them, in words.
        total: how many there are, at least roughly.
    """
    listener = _listener.get()
    if listener is None:
        yield from items
        return
    listener(what, 0.0)
    next_s = time.monotonic() + _SOON_S
    for done, item in enumerate(items):
        now_s = time.monotonic()
        if now_s >= next_s:
            listener(what, min(done / max(total, 1), 1.0))
            next_s = now_s + _SOON_S
        yield item
    listener(what, 1.0)
