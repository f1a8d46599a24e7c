"""The paper's table 3 for a terminal, its figures beside ours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from analysis.experiments.motion_rows import MotionRow

_LABEL = 18
_PROTOCOL = 16


def motion_lines(rows: Sequence[MotionRow], seeds: Sequence[int], targets: int) -> str:
    """The table: percent and centimetres, mean over the seeds and [lowest..highest] of them."""
    drawn = f"seed {seeds[0]}" if len(seeds) == 1 else f"seeds {seeds[0]} to {seeds[-1]}"
    lines = [
        f"Error of the predicted height of the ball, Easy; {drawn}, {targets} targets each.",
        "In brackets: the paper's. [lowest..highest]: of the seeds. A dash: not measured.",
        f"{'method':<{_LABEL}}{'given':<{_PROTOCOL}}{'error, %':<33}error, cm",
    ]
    notes = []
    for row in rows:
        mark = ""
        if row.note:
            notes.append(row.note)
            mark = f" *{len(notes)}"
        percent = _figure(
            [one.percent for one in row.ours or ()], row.paper.percent if row.paper else None
        )
        cm = _figure([one.cm for one in row.ours or ()], row.paper.cm if row.paper else None)
        lines.append(f"{row.label:<{_LABEL}}{row.protocol:<{_PROTOCOL}}{percent:<33}{cm}{mark}")
    lines += [f"*{index} {note}" for index, note in enumerate(notes, start=1)]
    return "\n".join(lines)


def _figure(ours: Sequence[float], paper: float | None) -> str:
    published = f" ({paper:g})" if paper is not None else ""
    if not ours:
        return f"-{published}"
    spread = f" [{_short(min(ours))}..{_short(max(ours))}]" if len(ours) > 1 else ""
    return f"{_short(float(np.mean(ours)))}{published}{spread}"


def _short(value: float) -> str:
    return f"{value:.2f}" if value >= 0.995 else f"{value:.2g}"
