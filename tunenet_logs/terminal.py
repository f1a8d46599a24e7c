"""Report to a person at a terminal: progress of slow work, and others' words as printable text.

Slow work reports by `teller` or `told`, whoever listens (`heard_by`); `Progress` listens, and shows
bars or, without a terminal, a line now and then. `one_line` lets no name in a log move the cursor.
"""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from tunenet_logs.addresses import without_secrets

Item = TypeVar("Item")
# Takes what is being done, in words, and which fraction of it is done: 0 to 1, 0 at first.
Listener = Callable[[str, float], object]
_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)
_SOON_S = 0.1  # between two reports: a terminal shows no more, and a callback may be slow


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
        tell(min(done / max(total, 1), 0.999))  # what is not done yet
        yield item
    tell(1.0)


# ---- Printable text, and bars

FEW_NAMES = 6  # names that a reason lists: it is one line


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


def short_name(name: object, most: int = 60) -> str:
    """Shorten a name to one line of at most `most` characters by cutting its middle.

    With 60 of them, the rest of its line still fits a wide terminal.
    """
    line = one_line(name)
    if len(line) <= most:
        return line
    head = most // 2
    return f"{line[:head]}…{line[head + 1 - most :]}"


def terminal_columns() -> int | None:
    """Return the terminal width of standard output; None for a pipe or a file."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def listed(names: Iterable[str], most: int = 20) -> str:
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


def _shown_on(bar: Any) -> Listener:
    """Show stages on a bar, one after the other."""
    shown = ""

    def show(what: str, fraction: float) -> None:
        nonlocal shown
        if what != shown:
            shown = what
            bar.reset(total=1.0)
            bar.set_description_str(short_name(what), refresh=False)
        bar.update(fraction - bar.n)

    return show


def _announced(name: str, say: Callable[[str], None]) -> Listener:
    """Announce, now and then, how much longer a stage will last at its pace so far."""
    stage, since_s, next_s = "", 0.0, 0.0

    def announce(what: str, fraction: float) -> None:
        nonlocal stage, since_s, next_s
        now_s = time.monotonic()
        if what != stage:  # it is watched for two seconds first
            stage, since_s, next_s = what, now_s, now_s + 2.0
        if now_s < next_s or not fraction:
            return
        left_s = (now_s - since_s) * (1 - fraction) / fraction
        if left_s > 5.0:  # which is worth a word, and again after a while
            next_s = now_s + 30.0
            say(f"{name}: {what}: about {about(left_s)} more")

    return announce


def about(seconds: float) -> str:
    """Format an approximate duration: "40 s", "3 min"."""
    if seconds < 90:
        return f"{max(round(seconds, -1), 1):.0f} s" if seconds >= 10 else f"{seconds:.0f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes < 90 else f"{minutes / 60:.1f} h"


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Progress reports on standard error: bars where that is a terminal."""

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
        """Show the stages of the work in this block: on a bar, else by a line now and then."""
        with ExitStack() as stack:
            listener = self.listener
            if listener is None and self.shows_bars:
                from tqdm import tqdm

                form = "{desc}: {percentage:3.0f} %|{bar}| {remaining} left"
                bar = tqdm(total=1.0, file=sys.stderr, leave=False, bar_format=form)
                listener = _shown_on(stack.enter_context(bar))
            elif listener is None and not self.quiet:
                listener = _announced(name, self.say)
            if listener is not None:
                stack.enter_context(heard_by(listener))
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
