"""Progress bars on standard error: only on a terminal, and only unless --quiet."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from tunenet_logs.text import short_name


class Bar(Protocol):
    """What work in progress reports to."""

    def update(self, done: int, /) -> object:
        """`done` more units are done."""
        ...

    def set_postfix_str(self, text: str, /, *, refresh: bool) -> object:
        """Show something beside the count, from the next `update` on."""
        ...


class _NoBar:
    def update(self, _done: int, /) -> None:
        """Show nothing."""

    def set_postfix_str(self, _text: str, /, *, refresh: bool) -> None:
        """Show nothing."""


class Progress:
    """Makes bars, or stand-ins that show nothing."""

    def __init__(self, *, quiet: bool = False) -> None:
        self._shown = not quiet and sys.stderr.isatty()

    @contextmanager
    def bar(self, total: int | None, what: str, unit: str) -> Iterator[Bar]:
        """A bar over `total` units of work; count and rate alone where that is not known."""
        if not self._shown:
            yield _NoBar()
            return
        from tqdm import tqdm

        with tqdm(
            total=total, desc=short_name(what), unit=unit, file=sys.stderr, leave=False
        ) as bar:
            yield bar
