"""Read tables without a clock: a row is a frame where the user states the frame rate."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from tunenet_logs.formats.tables.layout import TableLayout, table_layout_of
from tunenet_logs.formats.tables.said import CLOCKS, said_reading

ROW = "frame"  # the column of their numbers, behind the others


def said_layout(
    places: Mapping[int, str], names: Sequence[str], separator: str | None, counts_rows: bool
) -> tuple[TableLayout, bool]:
    """Lay out the columns that a user names; also return whether rows are frames.

    Args:
        places: meaning of the columns, by index.
        names: of all columns.
        separator: of cells.
        counts_rows: whether a row may be a frame.

    Raises:
        ValueError: no column is a time, or a unit does not fit its target.
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
    """Append to each row its number from 0 as a cell; lines without a row have none."""
    separator = layout.separator or " "
    count = 0
    for line_number, line in rows:
        if line is None or (line.strip() and not line.startswith(("#", "%"))):
            yield line_number, None if line is None else f"{line.rstrip()}{separator}{count}"
            count += 1
        else:
            yield line_number, line
