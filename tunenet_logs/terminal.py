"""Report to a person at a terminal: progress of slow work, and others' words as printable text.

Slow work reports by `teller` or `told`, whoever listens (`heard_by`); `Progress` listens, and shows
bars or, without a terminal, a line now and then. `one_line` lets no name in a log move the cursor.
"""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from tunenet_logs.addresses import without_secrets

Item = TypeVar("Item")

# Takes what is being done, in words, and which fraction of it is done: 0 to 1, 0 at first.
Listener = Callable[[str, float], object]

_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)

_SOON_S = 0.1  # between two reports: a terminal shows no more, and a callback may be slow
_NEARLY = 0.999  # reported at most of what is not done yet


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


# ---- Printable text, and bars

_MAX_CHARACTERS = 60  # of a name: with them, the rest of its line still fits a wide terminal
FEW_NAMES = 6  # names that a reason lists: it is one line
_MAX_NAMES = 20  # in one sentence; the rest is counted: nobody reads more of them
_STAGE_FORMAT = "{desc}: {percentage:3.0f} %|{bar}| {remaining} left"

# A stage is watched so long before it is said how much longer it lasts; that is said if it is worth
# a word, and again after a while.
_WATCHED_S, _WORTH_A_WORD_S, _AGAIN_S = 2.0, 10.0, 30.0

_IN_SECONDS_S = 90.0  # times below it are told in seconds; so many minutes in minutes


def one_line(text: object) -> str:
    r"""Format a text as one line, escaping what does not print (`\x1b`, `\u202e`).

    So no name in a log can move the cursor, change colours, begin a new line or turn the direction
    of what follows. Logins and signatures of addresses are left out.
    """
    line = without_secrets(str(text))
    if line.isprintable():
        return line
    return "".join(
        character if character.isprintable() else repr(character)[1:-1] for character in line
    )


def short_name(name: object, most: int = _MAX_CHARACTERS) -> str:
    """Shorten a name to one line of at most `most` characters by cutting its middle."""
    line = one_line(name)
    if len(line) <= most:
        return line
    head = most // 2
    return f"{line[:head]}…{line[head + 1 - most :]}"


def terminal_columns() -> int | None:
    """Return the terminal width of standard output; None for a pipe or a file."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def listed(names: Iterable[str], most: int = _MAX_NAMES) -> str:
    """Join names with commas; beyond `most` of them, say how many more there are."""
    every = list(names)
    more = len(every) - most
    return ", ".join(every[:most]) + (f" and {more} more" if more > 0 else "")


class Bar(Protocol):
    """Progress bar."""

    def update(self, done: int, /) -> object:
        """Advance by `done` units."""
        ...

    def set_postfix_str(self, text: str, /, *, refresh: bool) -> object:
        """Show something beside the count, from the next `update` on."""
        ...


class _NoBar:
    """Bar that is not shown: a listener hears of it, or nobody."""

    def __init__(self, listener: Listener | None = None, what: str = "", total: int = 1) -> None:
        self._listener, self._what, self._total = listener, what, total
        self._done = 0

    def update(self, done: int, /) -> None:
        """Count `done` more items."""
        self._done += done
        if self._listener is not None:
            self._listener(self._what, self._done / max(self._total, 1))

    def set_postfix_str(self, text: str, /, *, refresh: bool) -> None:
        """Show nothing."""


class _Shown:
    """Stages on a bar, one after the other."""

    def __init__(self, bar: Any) -> None:
        self._bar = bar
        self._what = ""

    def __call__(self, what: str, fraction: float) -> None:
        """Show the progress of a stage."""
        if what != self._what:
            self._what = what
            self._bar.reset(total=1.0)
            self._bar.set_description_str(short_name(what), refresh=False)
        self._bar.update(fraction - self._bar.n)


class _Announced:
    """Announcements, now and then, of how much longer a stage will last at its pace so far."""

    def __init__(self, name: str, say: Callable[[str], None]) -> None:
        self._name, self._say = name, say
        self._what = ""
        self._since_s = self._next_s = 0.0

    def __call__(self, what: str, fraction: float) -> None:
        """Announce the remaining time if it is due."""
        now_s = time.monotonic()
        if what != self._what:
            self._what, self._since_s, self._next_s = what, now_s, now_s + _WATCHED_S
        if now_s < self._next_s or not fraction:
            return
        left_s = (now_s - self._since_s) * (1 - fraction) / fraction
        if left_s > _WORTH_A_WORD_S:
            self._next_s = now_s + _AGAIN_S
            self._say(f"{self._name}: {what}: about {about(left_s)} more")


def about(seconds: float) -> str:
    """Format an approximate duration: "40 s", "3 min"."""
    if seconds < _IN_SECONDS_S:
        return f"{max(round(seconds, -1), 1):.0f} s" if seconds >= 10 else f"{seconds:.0f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes < _IN_SECONDS_S else f"{minutes / 60:.1f} h"


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Progress reports on standard error.

    Bars are shown where that is a terminal; else there are stand-ins that show nothing.
    """

    quiet: bool = False  # nothing is reported at all
    # None are shown without, as where results come meanwhile, often on that terminal
    has_bars: bool = True
    listener: Listener | None = None  # hears of all progress in place of the terminal

    @property
    def shows_bars(self) -> bool:
        """Whether bars are visible."""
        return self.has_bars and not self.quiet and sys.stderr.isatty()

    def say(self, text: str) -> None:
        """Print a line on standard error, above a bar that is shown there."""
        if self.quiet:
            return
        if not sys.stderr.isatty():
            print(one_line(text), file=sys.stderr, flush=True)
            return
        from tqdm import tqdm

        tqdm.write(one_line(text), file=sys.stderr)

    @contextmanager
    def stages(self, name: str) -> Generator[None]:
        """Show the stages of the work in this block: on a bar, else by a line now and then.

        Args:
            name: whose work it is, for that line.
        """
        if self.listener is not None:
            with heard_by(self.listener):
                yield
        elif self.quiet:
            yield
        elif not self.shows_bars:
            with heard_by(_Announced(name, self.say)):
                yield
        else:
            from tqdm import tqdm

            with (
                tqdm(total=1.0, file=sys.stderr, leave=False, bar_format=_STAGE_FORMAT) as bar,
                heard_by(_Shown(bar)),
            ):
                yield

    @contextmanager
    def bar(self, total: int | None, what: str, unit: str) -> Iterator[Bar]:
        """Open a bar over `total` units of work; count and rate alone where that is unknown."""
        if not self.shows_bars:
            yield _NoBar(self.listener, what, total or 0)
            return
        from tqdm import tqdm

        with tqdm(
            total=total, desc=short_name(what), unit=unit, file=sys.stderr, leave=False
        ) as bar:
            yield bar
