"""What a terminal shows: the words of others as characters that print, and progress bars."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

_MOST_CHARACTERS = 60
"""Of a name: with them, the rest of its line still fits a wide terminal."""

_MOST_NAMES = 20
"""In one sentence; the rest is counted: nobody reads more of them."""


def one_line(text: object) -> str:
    r"""A text as one line; whatever does not print is shown as its escape (`\x1b`, `\u202e`).

    So no name in a log can move the cursor, change colours, begin a new line or turn the direction
    of what follows.
    """
    line = str(text)
    if line.isprintable():
        return line
    return "".join(
        character if character.isprintable() else repr(character)[1:-1] for character in line
    )


def short_name(name: object, most: int = _MOST_CHARACTERS) -> str:
    """A name as one line of at most `most` characters, without its middle if it is longer."""
    line = one_line(name)
    if len(line) <= most:
        return line
    head = most // 2
    return f"{line[:head]}…{line[head + 1 - most :]}"


def terminal_columns() -> int | None:
    """Characters of a line where standard output is a terminal; None for a pipe or a file."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def listed(names: Iterable[str]) -> str:
    """Names one after the other; of very many the first, and how many more there are."""
    every = list(names)
    more = len(every) - _MOST_NAMES
    return ", ".join(every[:_MOST_NAMES]) + (f" and {more} more" if more > 0 else "")


class Bar(Protocol):
    """What work in progress reports to."""

    def update(self, done: int, /) -> object:
        """`done` more units are done."""
        ...

    def set_postfix_str(self, text: str, /, *, refresh: bool) -> object:
        """Show something beside the count, from the next `update` on."""
        ...


class _NoBar:
    def update(self, *_: object, **__: object) -> None:
        """Show nothing."""

    set_postfix_str = update


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Tells of work in progress on standard error.

    Bars are shown where that is a terminal; else there are stand-ins that show nothing.
    """

    quiet: bool = False

    @property
    def shows_bars(self) -> bool:
        """Whether bars are seen by anybody."""
        return not self.quiet and sys.stderr.isatty()

    def say(self, text: str) -> None:
        """A line on standard error, above a bar that is shown there."""
        if self.quiet:
            return
        if not sys.stderr.isatty():
            print(one_line(text), file=sys.stderr, flush=True)
            return
        from tqdm import tqdm

        tqdm.write(one_line(text), file=sys.stderr)

    @contextmanager
    def bar(self, total: int | None, what: str, unit: str) -> Iterator[Bar]:
        """A bar over `total` units of work; count and rate alone where that is not known."""
        if not self.shows_bars:
            yield _NoBar()
            return
        from tqdm import tqdm

        with tqdm(
            total=total, desc=short_name(what), unit=unit, file=sys.stderr, leave=False
        ) as bar:
            yield bar
