"""Tabulate the results of synthetic clips for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.evaluation.clips.file import VERSIONS
from analysis.evaluation.clips.run import ClipResult, TransformedClip
from analysis.evaluation.text import short, table_line
from tunenet_logs.arrays import Array

_WIDTHS = (10, 10, 9, 10, 10, 10, 10, 12, 12)  # of the columns [characters]


def clip_table(results: Sequence[ClipResult]) -> str:
    """Tabulate how many clips were answered, the errors, and the track's accuracy."""
    errors = np.array(
        [abs(clip.estimate - clip.truth) for clip in results if clip.estimate is not None]
    )
    covered = [
        clip.interval[0] <= clip.truth <= clip.interval[1]
        for clip in results
        if clip.estimate is not None and clip.interval is not None
    ]
    tracked = [clip.off_px for clip in results if clip.off_px is not None]
    head = ["clips", "answered", "ok", "MAE", "median", "95 %", "worst", "held", "track, px"]
    row = [
        str(len(results)),
        str(len(errors)),
        str(sum(clip.verdict == "ok" for clip in results)),
        *_error_cells(errors),
        f"{sum(covered)} of {len(covered)}" if covered else "-",
        f"{np.median(tracked):.2f}" if tracked else "-",
    ]
    return "\n".join(
        [
            "Drawn clips, as a stranger films them",
            table_line(head, _WIDTHS),
            table_line(row, _WIDTHS),
        ]
    )


def transformed_table(results: Sequence[TransformedClip]) -> str:
    """Tabulate how much the estimate depends on transforms that leave the ball unchanged."""
    spreads = [clip.spread for clip in results if clip.spread is not None]
    whole = sum(clip.answered == len(VERSIONS) for clip in results)
    head = ["clips", "answered", "", "mean", "median", "95 %", "worst"]
    row = [str(len(results)), str(whole), "", *_error_cells(np.array(spreads))]
    title = f"Spread of the answers for one clip: {', '.join(VERSIONS)}"
    return "\n".join([title, table_line(head, _WIDTHS), table_line(row, _WIDTHS)])


def _error_cells(errors: Array) -> list[str]:
    """Format mean, median, 95th percentile and maximum of errors, shape (N,); dashes for none."""
    if not len(errors):
        return ["-"] * 4
    figures = (errors.mean(), np.median(errors), np.quantile(errors, 0.95), errors.max())
    return [short(float(figure)) for figure in figures]
