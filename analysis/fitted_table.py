"""Columns as lines of text: all of them, or what fits a narrow terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import wrap

from tunenet_logs.terminal import short_name

_BETWEEN = "  "

_LAST = ("fits", "95 % interval")
"""Which columns leave last, in this order; log, verdict and value never do."""

_NAME_CHARACTERS = 28, 10
"""Of a log in a table that is too wide: so many while columns can leave, so few when none can."""

_FEWEST = 20
"""Characters of a line: a terminal that says less is taken for one of these."""


def laid_out(
    columns: Mapping[str, Sequence[str]], below: Sequence[Sequence[str]], most: int | None
) -> str:
    """A header, a line for each row, and indented below it what its line has no room for.

    Where that is wider than a terminal, one row stands upright, a line a column; of several the
    least important columns are left out, and named.

    Args:
        columns: cells by the column's name, N each; the most important names come first.
        below: of each row, N.
        most: characters of a line; None for any number.
    """
    if most is None:
        return _lines(columns, below, None)
    most = max(most, _FEWEST)
    if _width(columns) <= most:
        return _lines(columns, below, most)
    if len(below) == 1:
        return _upright(columns, below[0], most)
    kept, left_out = _fitted(columns, most)
    text = _lines(kept, below, most)
    if left_out:
        words = f"(left out, too wide for this terminal: {', '.join(left_out)}; | cat shows all)"
        text += "\n" + "\n".join(wrap(words, most))
    return text


def _lines(
    columns: Mapping[str, Sequence[str]], below: Sequence[Sequence[str]], most: int | None
) -> str:
    widths = _widths(columns)
    header, *lines = (
        _BETWEEN.join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in zip(*([name, *cells] for name, cells in columns.items()), strict=True)
    )
    out = [header]
    for line, words in zip(lines, below, strict=True):
        out += [line, *_indented(words, most)]
    return "\n".join(out)


def _upright(columns: Mapping[str, Sequence[str]], below: Sequence[str], most: int) -> str:
    """One row, a line a column."""
    width = max(map(len, columns))
    lines = [f"{name.ljust(width)}{_BETWEEN}{cells[0]}" for name, cells in columns.items()]
    return "\n".join([*lines, *_indented(below, most)])


def _indented(lines: Sequence[str], most: int | None) -> list[str]:
    if most is None:
        return [f"  {line}" for line in lines]
    return [
        part
        for line in lines
        for part in wrap(
            line,
            most,
            initial_indent="  ",
            subsequent_indent="    ",
            break_long_words=False,
            break_on_hyphens=False,
        )
    ]


def _fitted(
    columns: Mapping[str, Sequence[str]], most: int
) -> tuple[dict[str, Sequence[str]], list[str]]:
    """The columns that fit, and the names of the others in their order."""
    log, *_ = never = list(columns)[:3]
    many, few = _NAME_CHARACTERS
    kept = {**columns, log: [short_name(cell, many) for cell in columns[log]]}
    order = [name for name in reversed(list(columns)) if name not in (*_LAST, *never)]
    order += [name for name in _LAST if name in columns and name not in never]
    for name in order:
        if _width(kept) <= most:
            break
        del kept[name]
    room = most - _width(kept) + _widths(kept)[0]
    kept[log] = [short_name(cell, max(few, room)) for cell in columns[log]]
    return kept, [name for name in columns if name not in kept]


def _widths(columns: Mapping[str, Sequence[str]]) -> list[int]:
    return [max(len(name), *map(len, cells)) for name, cells in columns.items()]


def _width(columns: Mapping[str, Sequence[str]]) -> int:
    return sum(_widths(columns)) + len(_BETWEEN) * (len(columns) - 1)
