"""Curves over the log's time: heights, and residuals of each iteration."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.review.sending import send_scalars
from analysis.review.story import OBSERVED, Curve, Story

_MANY = 400
"""Samples above which dots would hide the lines."""


def log_plots(stream: rr.RecordingStream, story: Story) -> None:
    """Send the entities of `height_view` and `residual_view`."""
    for k, curve in enumerate(story.simulated):
        _log_line(stream, f"height/k{k}", curve)
        _log_line(stream, f"residual/k{k}", curve.minus(story.observed))
    dense = len(story.observed.seconds) > _MANY
    size = 1.0 if dense else 2.0
    points = rr.SeriesPoints(colors=[OBSERVED], names=["observed"], marker_sizes=[size])
    stream.log("height/observed", points, static=True)
    send_scalars(stream, "height/observed", story.observed.seconds, story.observed.heights_m)
    mark = rr.SeriesPoints(
        colors=[(255, 90, 90)], names=["first impact"], markers=["diamond"], marker_sizes=[6.0]
    )
    stream.log("height/impact", mark, static=True)
    send_scalars(stream, "height/impact", np.array([story.impact_s]), np.zeros(1))


def height_view(story: Story) -> rrb.View:
    """Observed dots under the lines of all iterations."""
    top = story.drop_height_m
    return rrb.TimeSeriesView(
        origin="/height",
        name="height above the table [m]",
        axis_y=rrb.ScalarAxis(range=(-0.05 * top, 1.1 * top)),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
    )


def residual_view(story: Story) -> rrb.View:
    """Simulated less observed, scaled to what matters: the first guess may run off the chart."""
    later = [np.abs(one.minus(story.observed).heights_m).max() for one in story.simulated[1:]]
    reach = max(1.2 * max(later, default=story.drop_height_m), 0.002 * story.drop_height_m)
    return rrb.TimeSeriesView(
        origin="/residual",
        name="residual: simulated - observed [m]",
        axis_y=rrb.ScalarAxis(range=(-float(reach), float(reach))),
        plot_legend=rrb.PlotLegend(visible=False),
    )


def _log_line(stream: rr.RecordingStream, entity: str, curve: Curve) -> None:
    style = rr.SeriesLines(
        colors=[curve.color],
        names=[curve.label],
        widths=[curve.width],
        aggregation_policy="Off",
    )
    stream.log(entity, style, static=True)
    send_scalars(stream, entity, curve.seconds, curve.heights_m)
