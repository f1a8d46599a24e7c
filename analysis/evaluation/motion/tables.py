"""Tabulate the paper's table 3 for a terminal, its figures beside ours."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap

import numpy as np

from analysis.evaluation.motion.rows import MotionRow
from analysis.evaluation.text import seeds_in_words, table_line

_WIDTHS = (17, 5, 15, 32, 0)  # of the columns [characters]
_WIDEST = 98  # characters, of a line of the notes


def motion_lines(rows: Sequence[MotionRow], seeds: Sequence[int], targets: int) -> str:
    """Tabulate percent and centimetres, mean over the seeds and [lowest–highest] of them."""
    notes = list(dict.fromkeys(row.note for row in rows if row.note))
    lines = [
        f"Error of the predicted height of the ball, Easy; {seeds_in_words(seeds)}, "
        f"{targets} targets each.",
        "In brackets: the paper's. [lowest–highest]: of the seeds. A dash: not measured.",
        "",
        table_line(("method", "note", "given", "error, %", "error, cm"), _WIDTHS),
    ]
    for row in rows:
        ours, paper = row.ours or (), row.paper
        mark = str(notes.index(row.note) + 1) if row.note else ""
        percent = _figure([error.percent for error in ours], paper and paper.percent)
        cm = _figure([error.cm for error in ours], paper and paper.cm)
        lines.append(table_line((row.label, mark, row.protocol, percent, cm), _WIDTHS))
    lines.append("")
    for index, note in enumerate(notes, start=1):
        lines += wrap(f"{index}: {note}", _WIDEST, subsequent_indent="   ")
    return "\n".join(lines)


def _figure(ours: Sequence[float], paper: float | None) -> str:
    published = f" ({paper:g})" if paper is not None else ""
    if not ours:
        return f"-{published}"
    spread = f" [{_short(min(ours))}–{_short(max(ours))}]" if len(ours) > 1 else ""
    return f"{_short(float(np.mean(ours)))}{published}{spread}"


def _short(value: float) -> str:
    return f"{value:.2f}" if value >= 0.995 else f"{value:#.2g}"
