"""Words of others on a terminal: names and texts of a log, and paths, as characters that print."""

from __future__ import annotations

from collections.abc import Iterable

_MOST_CHARACTERS = 60
"""Of a name in a line that has more to say."""

_MOST_NAMES = 20
"""In one sentence; the rest is counted."""


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


def listed(names: Iterable[str]) -> str:
    """Names one after the other; of very many the first, and how many more there are."""
    every = list(names)
    more = len(every) - _MOST_NAMES
    return ", ".join(every[:_MOST_NAMES]) + (f" and {more} more" if more > 0 else "")
