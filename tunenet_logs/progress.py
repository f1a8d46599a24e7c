"""Report the progress of slow work from where it is done to a listener, if there is one."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

Item = TypeVar("Item")

# Is given what is being done, in words, and which fraction of it is done: 0 to 1, 0 at first.
Listener = Callable[[str, float], object]

_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)

_SOON_S = 0.1  # between two tellings: a terminal shows no more, and a callback may be slow


_NEARLY = 0.999  # told of what is not done yet


@contextmanager
def heard_by(listener: Listener | None) -> Generator[None]:
    """Let `listener` hear of the work in this block; nobody if it is None."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def teller(what: str) -> Callable[[float], object]:
    """Make a callback that reports the fraction done of `what`, rate-limited for the listener."""
    listener = _listener.get()
    if listener is None:
        return silent
    listener(what, 0.0)
    next_s = time.monotonic() + _SOON_S

    def tell(fraction: float) -> None:
        nonlocal next_s
        now_s = time.monotonic()
        if now_s >= next_s or fraction >= 1.0:
            listener(what, min(fraction, 1.0))
            next_s = now_s + _SOON_S

    return tell


def silent(_fraction: float) -> None:
    """Report to nobody."""


def told(items: Iterable[Item], what: str, total: int) -> Iterator[Item]:
    """Yield the items, reporting `what` and how many of roughly `total` are done."""
    tell = teller(what)
    for done, item in enumerate(items):
        tell(min(done / max(total, 1), _NEARLY))
        yield item
    tell(1.0)
