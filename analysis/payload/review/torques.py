"""Torques over the log's time, a row a joint: observed with all iterations, and what is left."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from analysis.payload.review.story import PayloadReviewData, Torques
from analysis.review.colors import MUTED, OBSERVED
from analysis.review.sending import screen_radius, send_scalars

_MANY = 150
"""Samples above which dots would hide the lines."""

_USUAL, _HEADROOM = 0.98, 1.3
"""Of what is left: what the axis must show, and room around it."""

_LEAST_SPAN_NM = 2.0
"""Of a torque's axis: less would make noise look like torque."""

_SAMPLE = 0.3
"""Length of a line in the key, of what an entry takes up."""

_LEAST_REACH_NM = 0.05


def log_torques(stream: rr.RecordingStream, story: PayloadReviewData) -> None:
    """Send the entities of `torque_views` and `residual_views`."""
    size = 1.0 if len(story.seconds) > _MANY else 1.5
    for joint in story.order:
        torque, residual = _entity("torque", joint), _entity("residual", joint)
        observed = story.observed_nm[:, joint]
        curves = {"iterations": story.simulated}
        if story.fitted is not None:
            curves["fit"] = (story.fitted,)
        for name, some in curves.items():
            values = np.column_stack([one.effort_nm[:, joint] for one in some])
            _log_lines(stream, f"{torque}/{name}", some, story.seconds, values)
            off = values - observed[:, None]
            _log_lines(stream, f"{residual}/{name}", some, story.seconds, off)
        points = rr.SeriesPoints(colors=[OBSERVED], names=["observed"], marker_sizes=[size])
        stream.log(f"{torque}/observed", points, static=True)
        send_scalars(stream, f"{torque}/observed", story.seconds, observed)


def log_key(stream: rr.RecordingStream, story: PayloadReviewData) -> None:
    """Send the entities of `key_view`: what the curves are, where it hides none of them."""
    entries = [("observed", [OBSERVED])]
    entries.append(("rigid arm, k=0 to the result", [one.color for one in story.simulated]))
    if story.fitted is not None:
        entries.append((story.fitted.label, [story.fitted.color]))
    strips, colors, labels = [], [], []
    for place, (text, samples) in enumerate(entries):
        width = _SAMPLE / len(samples)
        for number, color in enumerate(samples):
            left = place - _SAMPLE / 2 + number * width
            strips.append([[left, 0.0], [left + width, 0.0]])
            colors.append(color)
        labels.append(([float(place), 0.02], text))
    lines = rr.LineStrips2D(strips, colors=colors, radii=screen_radius(2.0))
    stream.log("key/lines", lines, static=True)
    words = rr.Points2D(
        [place for place, _ in labels],
        labels=[text for _, text in labels],
        colors=[MUTED],
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log("key/words", words, static=True)


def key_view(story: PayloadReviewData) -> rrb.View:
    """A strip above the curves."""
    last = 1.0 if story.fitted is None else 2.0
    return rrb.Spatial2DView(
        origin="/key",
        name="key",
        titlebar=False,
        visual_bounds=rrb.VisualBounds2D(x_range=(-0.5, last + 0.5), y_range=(-0.06, 0.18)),
    )


def torque_views(story: PayloadReviewData) -> list[rrb.View]:
    """A joint each: observed dots under the lines of all iterations."""
    return [
        rrb.TimeSeriesView(
            origin=f"/{_entity('torque', joint)}",
            name=f"{story.title(joint)}, {_told(story, joint)}",
            axis_y=rrb.ScalarAxis(range=_span(story, joint)),
            plot_legend=rrb.PlotLegend(visible=False),
        )
        for joint in story.order
    ]


def residual_views(story: PayloadReviewData) -> list[rrb.View]:
    """A joint each: simulated less observed, to the scale of the result's of most joints."""
    off = np.abs(story.result.effort_nm - story.observed_nm)
    usual = np.quantile(off, _USUAL, axis=0)
    least = max(float(np.median(usual[story.used])), _LEAST_REACH_NM)
    views: list[rrb.View] = []
    for joint in story.order:
        reach = _HEADROOM * max(float(usual[joint]), least)
        views.append(
            rrb.TimeSeriesView(
                origin=f"/{_entity('residual', joint)}",
                name=story.title(joint, "residual"),
                axis_y=rrb.ScalarAxis(range=(-reach, reach)),
                plot_legend=rrb.PlotLegend(visible=False),
            )
        )
    return views


def _told(story: PayloadReviewData, joint: int) -> str:
    """What a joint tells of the payload."""
    if not story.used[joint]:
        return "not used"
    return f"{story.felt_nm_per_kg[joint]:.2f} per kg"


def _span(story: PayloadReviewData, joint: int) -> tuple[float, float]:
    """Of a joint's axis: what was observed and the result; guesses before it may run off."""
    best = story.fitted or story.result
    shown = np.concatenate([story.observed_nm[:, joint], best.effort_nm[:, joint]])
    low, high = float(shown.min()), float(shown.max())
    reach = max(1.1 * (high - low), _LEAST_SPAN_NM) / 2
    return (low + high) / 2 - reach, (low + high) / 2 + reach


def _entity(kind: str, joint: int) -> str:
    return f"{kind}/joint_{joint + 1}"


def _log_lines(
    stream: rr.RecordingStream,
    entity: str,
    curves: Sequence[Torques],
    seconds: NDArray[np.float64],
    values: NDArray[np.float64],
) -> None:
    """Several curves as one entity, values of shape (T, curves)."""
    style = rr.SeriesLines(
        colors=[one.color for one in curves],
        names=[one.label for one in curves],
        widths=[one.width for one in curves],
        aggregation_policy="Off",
    )
    stream.log(entity, style, static=True)
    send_scalars(stream, entity, seconds, values)
