"""Tabulate the tuning of filmed drops: a table for each kind of track."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from analysis.evaluation.text import seeds_in_words, short, short_or_dash, table_line
from analysis.evaluation.video.run import WRONG, VideoFigures, VideoOrder, VideoRow, figures_of
from analysis.evaluation.video.sections import BAD, DRAG, SETS, Section

Column = tuple[str, int, Callable[[VideoFigures], str]]


def video_blocks(
    order: VideoOrder, sections: Iterable[tuple[Section, Sequence[VideoRow]]]
) -> Iterator[str]:
    """Yield the protocol, each section's table as soon as it is there, and overall figures."""
    yield _protocol(order)
    good: dict[str, Sequence[VideoRow]] = {}
    for section, rows in sections:
        yield section_table(section, rows)
        if section in SETS:
            good[section.name] = rows
            if len(good) == len(SETS):
                yield overall([row for one in good.values() for row in one])


def section_table(section: Section, rows: Sequence[VideoRow]) -> str:
    """Tabulate one line for each kind of track."""
    columns = _columns(section)
    lines = [section.title, _line(section, "", [name for name, _, _ in columns])]
    for row in rows:
        figures = row.figures
        lines.append(_line(section, row.label, [show(figures) for _, _, show in columns]))
    return "\n".join(lines)


def overall(rows: Sequence[VideoRow]) -> str:
    """Describe coverage and width over all good tracks, and the worst line's coverage."""
    figures = figures_of(np.concatenate([row.outcomes for row in rows]))
    text = f"A, B and C: {figures.targets} tracks, {_percent(figures.rejected)} % rejected."
    cells = [one.covered for one in (row.figures for row in rows) if one.covered is not None]
    if cells:
        text += (
            f"\n95 % intervals: {_percent(figures.covered)} % contain the truth, in the worst line "
            f"{_percent(min(cells))} %; median width {short_or_dash(figures.width)}."
            f"\n{_percent(figures.shown)} % of the answers show theirs; of these "
            f"{_percent(figures.shown_covered)} % do."
        )
    return text


def _protocol(order: VideoOrder) -> str:
    return (
        "Restitution at the first impact, from tracks of 320 x 240 px; "
        f"{seeds_in_words(order.seeds)}, {order.targets} tracks each.\n"
        "Fractions in percent. Errors and intervals are of all answers: verdict ok or suspect.\n"
        "A dash: there is none."
    )


def _percent(fraction: float | None) -> str:
    return "-" if fraction is None else f"{100 * fraction:.1f}"


def _signed(error: float | None) -> str:
    return "-" if error is None else ("-" if error < 0 else "+") + short(abs(error))


_TARGETS: Column = ("tracks", 7, lambda one: str(one.targets))
_REJECTED: Column = ("rejected", 10, lambda one: _percent(one.rejected))
_SUSPECT: Column = ("suspect", 9, lambda one: _percent(one.suspect))
_VERDICTS: tuple[Column, ...] = (
    _TARGETS,
    ("answered", 10, lambda one: _percent(one.answered)),
    _REJECTED,
    _SUSPECT,
)
_BIAS: Column = ("bias", 8, lambda one: _signed(one.bias))
_ERRORS: tuple[Column, ...] = (
    ("mean", 7, lambda one: short_or_dash(one.mae)),
    ("median", 7, lambda one: short_or_dash(one.median)),
    ("95th", 7, lambda one: short_or_dash(one.p95)),
    ("held", 6, lambda one: _percent(one.covered)),
    ("width", 5, lambda one: short_or_dash(one.width)),
)
_BAD: tuple[Column, ...] = (
    _TARGETS,
    ("ok", 7, lambda one: _percent(one.ok)),
    (f"ok, off by > {WRONG:g}", 19, lambda one: _percent(one.wrong)),
    _REJECTED,
    _SUSPECT,
)


def _columns(section: Section) -> tuple[Column, ...]:
    if section is BAD:
        return _BAD
    bias = (_BIAS,) if section is DRAG else ()
    return (*_VERDICTS, *bias, *_ERRORS)


def _line(section: Section, label: str, cells: Sequence[str]) -> str:
    first = max(len(kind.label) for kind in section.kinds) + 2
    widths = [width for _, width, _ in _columns(section)]
    return table_line([label, *cells], [first, *widths])
