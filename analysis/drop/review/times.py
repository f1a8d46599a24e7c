"""Review of a drop that was heard: the simulated height, and the impacts on the table."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.drop.review.sound import Marks, log_on_table, log_sound, time_axis
from analysis.drop.times.checks import off_s
from analysis.drop.times.detection import TimesDetection
from analysis.drop.times.motion import simulated_m
from analysis.record import Tuning
from analysis.review.drawing import MUTED, OBSERVED, Color, ramp, send_scalars, ticked

NOT_OURS: Color = (235, 95, 75)  # of times that are no impacts
_EDGE = 0.02  # of what is shown, before it: or the first mark would be cut
_MS = 1000.0


def log_times(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container:
    """Send heights, impacts and how far these are apart; return the layout that shows them."""
    detection: TimesDetection = tuning.detection
    assert tuning.trace is not None
    heard, last = detection.heard, tuning.trace.steps[-1]
    seconds, heights_m = simulated_m(detection, last)
    color = ramp(1, 2)
    line = rr.SeriesLines(
        colors=[color], names=["simulated"], widths=[2.0], aggregation_policy="Off"
    )
    stream.log("height/simulated", line, static=True)
    send_scalars(stream, "height/simulated", seconds, heights_m)
    others_s = np.setdiff1d(detection.times_s, heard.times_s)
    missed = np.setdiff1d(np.arange(int(heard.numbers.max()) + 1), heard.numbers)
    marks = (
        Marks("noise", "not its impact", NOT_OURS, others_s),
        Marks("missed", "impact not heard", MUTED, heard.predicted_s[missed]),
        Marks("heard", "impact heard", OBSERVED, heard.times_s),
    )
    log_on_table(stream, marks)
    off_ms = _MS * off_s(detection, last)
    told_s = heard.predicted_s[heard.told :]
    known = np.isfinite(off_ms)
    dots = rr.SeriesPoints(colors=[color], names=["simulated - heard"], marker_sizes=[5.0])
    stream.log("residual/impacts", dots, static=True)
    send_scalars(stream, "residual/impacts", told_s[known], off_ms[known])
    reach_ms = 1.3 * max(float(np.abs(off_ms[known]).max(initial=0.0)), 2 * _MS * heard.jitter_s)
    jitter_ms = _MS * heard.jitter_s
    limits = rr.SeriesLines(
        colors=[MUTED] * 2, names=["jitter"] * 2, widths=[1.0] * 2, aggregation_policy="Off"
    )
    stream.log("residual/jitter", limits, static=True)
    ends_s = seconds[[0, -1]]
    send_scalars(stream, "residual/jitter", ends_s, np.array([[jitter_ms, -jitter_ms]] * 2))
    begin_s, end_s = float(min(seconds[0], heard.times_s[0])), float(seconds[-1])
    begin_s -= _EDGE * (end_s - begin_s)
    shown = time_axis(begin_s, end_s)
    most_m = float(heights_m.max())
    height_view = rrb.TimeSeriesView(
        origin="/height",
        name="simulated height [m], and impacts heard (at 0)",
        axis_x=shown,
        axis_y=rrb.ScalarAxis(range=(-0.05 * most_m, 1.1 * most_m)),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
    )
    residual_view = rrb.TimeSeriesView(
        origin="/residual",
        name="impacts: simulated - heard [ms], grey: the times' jitter",
        axis_x=shown,
        axis_y=rrb.ScalarAxis(range=ticked(-reach_ms, reach_ms)),
        plot_legend=rrb.PlotLegend(visible=False),
    )
    result = rrb.TextDocumentView(origin="/result", name="result")
    curves = rrb.Vertical(height_view, residual_view, row_shares=[3, 2])
    if detection.listened is not None:
        said = "white: its impacts, red: other knocks"
        sound = detection.listened.sound
        sound_view = log_sound(stream, sound, 0.0, (begin_s, end_s), marks, said)
        if sound_view is not None:
            curves = rrb.Vertical(height_view, sound_view, residual_view, row_shares=[5, 4, 3])
    return rrb.Horizontal(curves, result, column_shares=[3, 2])
