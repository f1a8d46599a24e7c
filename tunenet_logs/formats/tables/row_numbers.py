"""Tables without a clock: a row is a frame where the user says how many there are in a second."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from tunenet_logs.formats.tables.layout import TableLayout, table_layout_of
from tunenet_logs.formats.tables.said import CLOCKS, said_reading

ROW = "frame"
"""The column of their numbers, behind the others."""


def said_layout(
    places: Mapping[int, str], names: Sequence[str], separator: str | None, counts_rows: bool
) -> tuple[TableLayout, bool]:
    """The layout of columns of which a user says what they are, and whether rows are its frames.

    Args:
        places: what the columns are, by index.
        names: of all columns.
        separator: of cells.
        counts_rows: whether a row may be a frame.

    Raises:
        ValueError: there is no time among them, or one has a unit of something else.
    """
    layout = table_layout_of(names, separator, said_reading(places))
    if layout is not None:
        return layout, False
    if counts_rows and set(CLOCKS).isdisjoint(places.values()):
        more = {**places, len(names): "frame"}
        layout = table_layout_of([*names, ROW], separator, said_reading(more))
    if layout is None:
        raise ValueError(
            "none of its columns is known as a time; say it as well: t=COLUMN, or frame=COLUMN; "
            "where a row is a frame, say how many there are in a second, for example --fps 30"
        )
    return layout, True


def numbered(
    rows: Iterable[tuple[int, str | None]], layout: TableLayout
) -> Iterator[tuple[int, str | None]]:
    """Rows with their number from 0 in a cell behind the others; lines without a row have none."""
    separator = layout.separator or " "
    count = 0
    for line_number, line in rows:
        if line is None or (line.strip() and not line.startswith(("#", "%"))):
            yield line_number, None if line is None else f"{line.rstrip()}{separator}{count}"
            count += 1
        else:
            yield line_number, line
