"""Review of positions in which no drop was found: the heights searched, and likely impacts."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.drop.recorded_height import RecordedHeight, recorded_heights
from analysis.drop.review.refused_sound import log_sound_of_heights
from analysis.record import Tuning
from analysis.review.drawing import IMPACT, OBSERVED, entity_of, send_scalars
from tunenet_logs.episode import UNSTATED
from tunenet_logs.terminal import short_name

_MAX = 3  # signals with a view of their own: those in which a drop is sought first
_MAX_LETTERS = 40  # of a signal's name in a title
_MANY = 200  # samples above which larger dots would hide each other


def log_refused_heights(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
    """Send the likeliest signals' heights, and the sound beside; None without positions."""
    found = recorded_heights(tuning.episode, _MAX) if tuning.episode else []
    views = [_log_height(stream, number, one) for number, one in enumerate(found)]
    if not views:
        return None
    likeliest = found[0]
    start_ns = int(likeliest.signal.stamps_ns[0])
    span_s = float(likeliest.seconds[0]), float(likeliest.seconds[-1])
    heard = log_sound_of_heights(stream, tuning, start_ns, span_s)
    return rrb.Vertical(*views) if heard is None else rrb.Vertical(*views, heard)


def _log_height(stream: rr.RecordingStream, number: int, height: RecordedHeight) -> rrb.View:
    origin = entity_of("sought", str(number))
    size = 1.0 if len(height.seconds) > _MANY else 2.0
    line = rr.SeriesPoints(colors=[OBSERVED], names=["height"], marker_sizes=[size])
    stream.log(f"{origin}/height", line, static=True)
    send_scalars(stream, f"{origin}/height", height.seconds, height.heights)
    at = np.array(height.impacts, np.intp)
    if len(at):
        mark = rr.SeriesPoints(
            colors=[IMPACT], names=["impact?"], markers=["diamond"], marker_sizes=[6.0]
        )
        stream.log(f"{origin}/impact", mark, static=True)
        send_scalars(stream, f"{origin}/impact", height.seconds[at], height.heights[at])
    unit = "" if height.signal.unit == UNSTATED else f" [{height.signal.unit}]"
    name = short_name(height.signal.name, _MAX_LETTERS)
    marked = f"red: {len(at)} that may be impacts" if len(at) else "nothing looks like an impact"
    free = "" if height.is_free else ", no free fall"
    return rrb.TimeSeriesView(
        origin=f"/{origin}",
        name=f"height of {name}{unit}: {marked}{free}",
        plot_legend=rrb.PlotLegend(visible=False),
    )
