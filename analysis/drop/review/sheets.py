"""The charts of the iterations, drawn so that they stay in view on either timeline."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.drop.review.story import Curve, ReviewData
from analysis.review.colors import OBSERVED
from analysis.review.grid import chart_view, log_grid, ticks
from analysis.review.iterates import Iterates, iterates_view, log_iterates
from analysis.review.sending import at_iterations, at_seconds, screen_radius
from tunenet_logs.arrays import Array

_HEIGHTS_WIDTH = 1.7


def log_sheets(stream: rr.RecordingStream, story: ReviewData) -> None:
    """Send the entities of `height_sheet_view`, `step_view` and `convergence_view`."""
    _log_heights(stream, story)
    log_iterates(stream, _iterates(story), float(story.observed.seconds[0]))


def height_sheet_view() -> rrb.View:
    """The observed curve fixed, the simulated one of the iteration over it."""
    title = "height above the table: observed (dots), simulated (line)"
    return chart_view("heights", title, _HEIGHTS_WIDTH)


def convergence_view(story: ReviewData) -> rrb.View:
    """Restitution against iteration, the current one ringed, the result's interval as a band."""
    return iterates_view(_iterates(story))


def step_view() -> rrb.View:
    """The iteration in words."""
    return rrb.TextDocumentView(origin="/step", name="iteration")


def _log_heights(stream: rr.RecordingStream, story: ReviewData) -> None:
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
    log_grid(stream, "sheets/heights", _HEIGHTS_WIDTH, rows, marks, hang=0.035)
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


def _iterates(story: ReviewData) -> Iterates:
    return Iterates(
        parameter="restitution",
        unit="1",
        names=tuple(one.name for one in story.simulated),
        values=tuple(one.value for one in story.simulated),
        colors=tuple(one.color for one in story.simulated),
        span=(0.0, 1.0),
        interval95=story.interval95,
    )


def _words(story: ReviewData, k: int) -> str:
    off = story.simulated[k].minus(story.observed).heights_m
    return (
        f"# k = {k}\n\nrestitution **{story.simulated[k].value:.4f}**\n\n"
        f"{1000 * float(np.sqrt(np.mean(off**2))):.2f} mm rms from the observed curve"
    )
