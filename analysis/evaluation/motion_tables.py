"""The paper's table 3 for a terminal, its figures beside ours."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from analysis.evaluation.motion_rows import MotionRow

_WIDTHS = (17, 5, 15, 32, 0)
_WIDEST = 98


def motion_lines(rows: Sequence[MotionRow], seeds: Sequence[int], targets: int) -> str:
    """The table: percent and centimetres, mean over the seeds and [lowest–highest] of them."""
    drawn = f"seed {seeds[0]}" if len(seeds) == 1 else f"seeds {seeds[0]} to {seeds[-1]}"
    notes = list(dict.fromkeys(row.note for row in rows if row.note))
    lines = [
        f"Error of the predicted height of the ball, Easy; {drawn}, {targets} targets each.",
        "In brackets: the paper's. [lowest–highest]: of the seeds. A dash: not measured.",
        "",
        _line(("method", "note", "given", "error, %", "error, cm")),
    ]
    for row in rows:
        ours, paper = row.ours or (), row.paper
        mark = str(notes.index(row.note) + 1) if row.note else ""
        percent = _figure([one.percent for one in ours], paper and paper.percent)
        cm = _figure([one.cm for one in ours], paper and paper.cm)
        lines.append(_line((row.label, mark, row.protocol, percent, cm)))
    lines.append("")
    for index, note in enumerate(notes, start=1):
        lines += wrap(f"{index}: {note}", _WIDEST, subsequent_indent="   ")
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    fitted = [cell.ljust(width) for cell, width in zip(cells, _WIDTHS, strict=True)]
    return "".join(fitted).rstrip()


def _figure(ours: Sequence[float], paper: float | None) -> str:
    published = f" ({paper:g})" if paper is not None else ""
    if not ours:
        return f"-{published}"
    spread = f" [{_short(min(ours))}–{_short(max(ours))}]" if len(ours) > 1 else ""
    return f"{_short(float(np.mean(ours)))}{published}{spread}"


def _short(value: float) -> str:
    return f"{value:.2f}" if value >= 0.995 else f"{value:#.2g}"
