"""Curves over the log's time: heights, and residuals of each iteration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.drop.review.story import Curve, ReviewData
from analysis.review.colors import OBSERVED
from analysis.review.sending import send_scalars

_MANY = 400
"""Samples above which dots would hide the lines."""

_MM = 1000.0
"""The unit of residuals: an axis does not show numbers as small as theirs in m."""

_USUAL, _HEADROOM, _LEAST_REACH = 0.98, 1.8, 0.002
"""Of the residuals: what the axis must show, and room around it; in drop heights, the least."""


def log_plots(stream: rr.RecordingStream, story: ReviewData) -> None:
    """Send the entities of `height_view` and `residual_view`."""
    for k, curve in enumerate(story.simulated):
        _log_line(stream, f"height/k{k}", curve)
        off = curve.minus(story.observed)
        _log_line(stream, f"residual/k{k}", replace(off, heights_m=_MM * off.heights_m))
    dense = len(story.observed.seconds) > _MANY
    size = 1.0 if dense else 2.0
    points = rr.SeriesPoints(colors=[OBSERVED], names=["observed"], marker_sizes=[size])
    stream.log("height/observed", points, static=True)
    send_scalars(stream, "height/observed", story.observed.seconds, story.observed.heights_m)
    mark = rr.SeriesPoints(
        colors=[(255, 90, 90)], names=["impacts"], markers=["diamond"], marker_sizes=[6.0]
    )
    stream.log("height/impact", mark, static=True)
    send_scalars(stream, "height/impact", story.impacts_s, np.zeros(len(story.impacts_s)))


def height_view(story: ReviewData) -> rrb.View:
    """Observed dots under the lines of all iterations."""
    top = story.drop_height_m
    return rrb.TimeSeriesView(
        origin="/height",
        name="height above the table [m]",
        axis_y=rrb.ScalarAxis(range=(-0.05 * top, 1.1 * top)),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
    )


def residual_view(story: ReviewData) -> rrb.View:
    """Simulated less observed, scaled to the result's: guesses before it run off the chart."""
    off = np.abs(story.simulated[-1].minus(story.observed).heights_m)
    usual = float(np.quantile(off, _USUAL)) if len(off) else 0.0
    reach_mm = _MM * max(_HEADROOM * usual, _LEAST_REACH * story.drop_height_m)
    return rrb.TimeSeriesView(
        origin="/residual",
        name=f"residual: simulated - observed [mm], axis to ±{reach_mm:.2g}",
        axis_y=rrb.ScalarAxis(range=(-reach_mm, reach_mm)),
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
