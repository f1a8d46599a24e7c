"""The charts of the iterations, drawn so that they stay in view on either timeline."""

from __future__ import annotations

import math

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from analysis.report import interval_words
from analysis.review.grid import WIDTH, chart_view, log_grid, ticks
from analysis.review.sending import at_iterations, at_seconds, screen_radius
from analysis.review.story import MUTED, OBSERVED, Curve, Story

Array = NDArray[np.float64]

_HEIGHTS_WIDTH = 1.7

_ROOM = 0.36
"""That a figure takes up."""

_LEAST_BAND = 0.008
"""Of restitution: what can be seen."""


def log_sheets(stream: rr.RecordingStream, story: Story) -> None:
    """Send the entities of `height_sheet_view`, `step_view` and `convergence_view`."""
    _log_heights(stream, story)
    _log_convergence(stream, story)


def height_sheet_view() -> rrb.View:
    """The observed curve fixed, the simulated one of the iteration over it."""
    title = "height above the table: observed (dots), simulated (line)"
    return chart_view("heights", title, _HEIGHTS_WIDTH)


def convergence_view(story: Story) -> rrb.View:
    """Restitution against iteration, the current one ringed, the result's interval as a band."""
    title = "restitution by iteration"
    if story.interval95 is not None:
        title += f", band: 95 %, {interval_words(*story.interval95)}"
    return chart_view("convergence", title)


def step_view() -> rrb.View:
    """The iteration in words."""
    return rrb.TextDocumentView(origin="/step", name="iteration")


def _log_heights(stream: rr.RecordingStream, story: Story) -> None:
    start_s = story.release_s - 0.05 * (story.end_s - story.release_s)
    width_s, top = story.end_s - start_s, story.drop_height_m

    def places(curve: Curve) -> Array:
        inside = (curve.seconds >= start_s) & (curve.seconds <= story.end_s)
        x = (curve.seconds[inside] - start_s) / width_s * _HEIGHTS_WIDTH
        return np.column_stack([x, -curve.heights_m[inside] / top])

    rows = [(-height / top, f"{height:g} m") for height in ticks(0.0, top)]
    marks = [
        ((second - start_s) / width_s * _HEIGHTS_WIDTH, f"{second:g} s")
        for second in ticks(start_s, story.end_s)
    ]
    log_grid(stream, "sheets/heights", _HEIGHTS_WIDTH, rows, marks)
    dots = rr.Points2D(places(story.observed), colors=[OBSERVED], radii=screen_radius(1.8))
    stream.log("sheets/heights/observed", dots, static=True)
    style = rr.LineStrips2D.from_fields(radii=screen_radius(1.2))
    stream.log("sheets/heights/simulated", style, static=True)
    stream.log("step", rr.TextDocument.from_fields(media_type="text/markdown"), static=True)
    count = len(story.simulated)
    last_only = at_seconds(story.observed.seconds[:1])
    for index, chosen in ((at_iterations(count), range(count)), (last_only, [count - 1])):
        curves = [story.simulated[k] for k in chosen]
        strips = rr.LineStrips2D.columns(
            strips=[places(one) for one in curves], colors=[one.color for one in curves]
        )
        stream.send_columns("sheets/heights/simulated", indexes=[index], columns=strips)
        words = rr.TextDocument.columns(text=[_words(story, k) for k in chosen])
        stream.send_columns("step", indexes=[index], columns=words)


def _log_convergence(stream: rr.RecordingStream, story: Story) -> None:
    count = len(story.simulated)
    x = (np.arange(count) + 0.5) / count * WIDTH
    dots = np.column_stack([x, [-one.value for one in story.simulated]])
    rows = [(-value, f"{value:g}") for value in (0.0, 0.25, 0.5, 0.75, 1.0)]
    every = math.ceil(_ROOM * count / WIDTH)
    shown = range(count - 1, -1, -every)  # the last is the result
    marks = [(float(x[k]), story.simulated[k].name) for k in shown]
    log_grid(stream, "sheets/convergence", WIDTH, rows, marks)
    if story.interval95 is not None:
        low, high = story.interval95
        band = rr.LineStrips2D(
            [[[0.0, -(low + high) / 2], [WIDTH, -(low + high) / 2]]],
            colors=[(*story.simulated[-1].color, 110)],
            radii=[max(high - low, _LEAST_BAND) / 2],
        )
        stream.log("sheets/convergence/interval", band, static=True)
    line = rr.LineStrips2D([dots], colors=[MUTED], radii=screen_radius(0.8))
    stream.log("sheets/convergence/line", line, static=True)
    values = rr.Points2D(
        dots,
        colors=[one.color for one in story.simulated],
        radii=screen_radius(5.0),
        draw_order=20.0,
    )
    stream.log("sheets/convergence/values", values, static=True)
    figures = rr.Points2D(
        [dots[k] - [0, 0.2] for k in shown],
        labels=[f"{story.simulated[k].value:.4f}" for k in shown],
        colors=[story.simulated[k].color for k in shown],
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log("sheets/convergence/figures", figures, static=True)
    ring = rr.Points2D.from_fields(colors=[OBSERVED], radii=screen_radius(8.0), draw_order=10.0)
    stream.log("sheets/convergence/current", ring, static=True)
    last_only = at_seconds(story.observed.seconds[:1])
    for index, chosen in ((at_iterations(count), dots), (last_only, dots[-1:])):
        columns = rr.Points2D.columns(positions=chosen)
        stream.send_columns("sheets/convergence/current", indexes=[index], columns=columns)


def _words(story: Story, k: int) -> str:
    off = story.simulated[k].minus(story.observed).heights_m
    return (
        f"# k = {k}\n\nrestitution **{story.simulated[k].value:.4f}**\n\n"
        f"{1000 * float(np.sqrt(np.mean(off**2))):.2f} mm rms from the observed curve"
    )
