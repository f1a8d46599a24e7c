"""Lay out columns as text: all of them, or what fits a narrow terminal."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from textwrap import wrap

from tunenet_logs.terminal import short_name

_BETWEEN = "  "

# Which columns leave last, in this order; log, verdict and value never do.
_LAST = ("fits", "95 % interval")

# Of a log in a table that is too wide: so many while columns can leave, so few when none can.
_NAME_CHARACTERS = 28, 10

# Of a column's name in a table that is too wide: longer ones take several lines.
_HEAD_CHARACTERS = 20

# Where a name goes on in the next line: `joint/`, `elbow`, `.damping `, `[N·m]`; within `left_arm`
# where it has to.
_MARKS, _WEAK_MARKS = re.compile(r"(?<=[/ ])|(?=[.(])"), re.compile(r"(?<=_)")

_MIN_COUNT = 20  # characters of a line: a terminal that says less is taken for one of these


def laid_out(
    columns: Mapping[str, Sequence[str]], below: Sequence[Sequence[str]], most: int | None
) -> str:
    """Format a table: a header, a line per row, and lines indented below each row.

    If it is wider than the terminal, a single row is transposed, a line per column; of several,
    long heads are wrapped, then the least important columns are left out, and named.

    Args:
        columns: Cells by the column's name, N each; the most important columns come first.
        below: Of each row, N.
        most: Characters of a line; None for any number.
    """
    if most is None:
        return _lines(columns, below, None)
    most = max(most, _MIN_COUNT)
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
    heads = [name.split("\n") for name in columns]
    height = max(map(len, heads))
    standing = [[""] * (height - len(head)) + head for head in heads]
    widths = _widths(columns)
    lines = [
        _BETWEEN.join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in zip(
            *([*head, *cells] for head, cells in zip(standing, columns.values(), strict=True)),
            strict=True,
        )
    ]
    out = lines[:height]
    for line, words in zip(lines[height:], below, strict=True):
        out += [line, *_indented(words, most)]
    return "\n".join(out)


def _upright(columns: Mapping[str, Sequence[str]], below: Sequence[str], most: int) -> str:
    """Format one row transposed; only the log's path is shortened."""
    _, *cells = (cell for cell, *_ in columns.values())
    room = max(most - len(_BETWEEN) - max(map(len, cells), default=0), _MIN_COUNT)
    names = [short_name(name, room) for name in columns]
    width = max(map(len, names))
    lines = [
        f"{name.ljust(width)}{_BETWEEN}{cell}"
        for name, (cell, *_) in zip(names, columns.values(), strict=True)
    ]
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
    """Return the columns that fit, and the names of the others in their order."""
    log, *_ = never = list(columns)[:3]
    many, few = _NAME_CHARACTERS
    kept = {**columns, log: [short_name(cell, many) for cell in columns[log]]}
    heads = {name: "\n".join(_head(name)) for name in columns}
    order = [name for name in reversed(list(columns)) if name not in (*_LAST, *never)]
    order += [name for name in _LAST if name in columns and name not in never]
    for name in order:
        if _width({heads[one]: cells for one, cells in kept.items()}) <= most:
            break
        del kept[name]
    shown = {heads[name]: cells for name, cells in kept.items()}
    room = most - _width(shown) + _widths(shown)[0]
    shown[heads[log]] = [short_name(cell, max(few, room)) for cell in columns[log]]
    return shown, [name for name in columns if name not in kept]


def _head(name: str) -> list[str]:
    """Wrap a column's name at its marks."""
    lines = [""]
    for part in _MARKS.split(name):
        is_short = len(part.rstrip()) <= _HEAD_CHARACTERS
        for piece in [part] if is_short else _WEAK_MARKS.split(part):
            if lines[-1] and len(lines[-1]) + len(piece.rstrip()) > _HEAD_CHARACTERS:
                lines.append("")
            lines[-1] += short_name(piece, _HEAD_CHARACTERS)
    return [line.rstrip() for line in lines]


def _widths(columns: Mapping[str, Sequence[str]]) -> list[int]:
    return [max(*map(len, name.split("\n")), *map(len, cells)) for name, cells in columns.items()]


def _width(columns: Mapping[str, Sequence[str]]) -> int:
    return sum(_widths(columns)) + len(_BETWEEN) * (len(columns) - 1)
