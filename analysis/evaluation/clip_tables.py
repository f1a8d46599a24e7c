"""What came of drawn clips, as tables for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.evaluation.clip_file import VERSIONS
from analysis.evaluation.clips import ClipResult, TransformedClip
from analysis.evaluation.tables import short

_WIDTHS = (10, 10, 9, 10, 10, 10, 10, 12, 12)


def clip_table(results: Sequence[ClipResult]) -> str:
    """How many were answered, how well, and how well the ball was followed."""
    answered = [one for one in results if one.estimate is not None]
    off = np.array([abs(one.estimate - one.truth) for one in answered if one.estimate is not None])
    bounded = [one for one in answered if one.interval is not None]
    held = [one.interval[0] <= one.truth <= one.interval[1] for one in bounded if one.interval]
    tracked = [one.off_px for one in results if one.off_px is not None]
    head = ["clips", "answered", "ok", "MAE", "median", "95 %", "worst", "held", "track, px"]
    row = [
        str(len(results)),
        str(len(answered)),
        str(sum(one.verdict == "ok" for one in results)),
        *(short(float(one)) if len(off) else "-" for one in _errors(off)),
        f"{sum(held)} of {len(held)}" if held else "-",
        f"{np.median(tracked):.2f}" if tracked else "-",
    ]
    return "\n".join(["Drawn clips, as a stranger films them", _line(head), _line(row)])


def transformed_table(results: Sequence[TransformedClip]) -> str:
    """How much the answer depends on what changes nothing of the ball."""
    spreads = [one.spread for one in results if one.spread is not None]
    whole = sum(one.answered == len(VERSIONS) for one in results)
    head = ["clips", "all told", "", "mean", "median", "95 %", "worst"]
    errors = _errors(np.array(spreads))
    row = [str(len(results)), str(whole), "", *(short(one) if spreads else "-" for one in errors)]
    title = f"Spread of the answers for one clip: {', '.join(VERSIONS)}"
    return "\n".join([title, _line(head), _line(row)])


def _errors(off: np.ndarray) -> list[float]:
    """Mean, median, 95th percentile and largest; nothing of nothing."""
    if not len(off):
        return [0.0] * 4
    return [float(one) for one in (off.mean(), np.median(off), np.quantile(off, 0.95), off.max())]


def _line(cells: Sequence[str]) -> str:
    fitted = [cell.ljust(width) for cell, width in zip(cells, _WIDTHS, strict=False)]
    return "".join(fitted).rstrip()
