"""Curves of the drop under the cursor, observed and tuned, or why it has none."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.campaign.tuned_drop import TunedDrop
from analysis.review.campaign.times import ATTEMPT, Slot, beginnings, moments
from analysis.review.drawing import (
    FAILURE,
    MUTED,
    OBSERVED,
    Color,
    chart_view,
    log_grid,
    screen_radius,
    ticks,
)
from tunenet_logs.arrays import Array

_WIDTH = 1.9  # of the chart of curves, in its heights: about the shape of its view
_SIMULATED: Color = (255, 165, 40)

# The moving dot is at every third sample: it still goes smoothly, and the file stays small.
_EVERY = 3


def overlay_view() -> rrb.View:
    """Return the view of the drop's observed and simulated height."""
    title = "its drop: height above the table, observed (dots), tuned (line)"
    return chart_view("overlay", title, _WIDTH)


class _Axes(NamedTuple):
    """Range of the chart: seconds from a drop's beginning, and height [m]."""

    span_s: float
    top_m: float

    def points(self, drop: TunedDrop, heights_m: Array) -> Array:
        """Map a curve's heights, shape (T,), to points in the chart, shape (T, 2)."""
        assert drop.overlay is not None
        seconds = drop.overlay.seconds - drop.overlay.seconds[0]
        return np.column_stack([seconds / self.span_s * _WIDTH, -heights_m / self.top_m])


def _axes(slots: Sequence[Slot]) -> _Axes:
    overlays = [
        shown.drop.overlay
        for slot in slots
        for shown in slot.drops
        if shown.drop.overlay is not None
    ]
    if not overlays:
        return _Axes(1.0, 1.0)
    span_s = max(float(overlay.seconds[-1] - overlay.seconds[0]) for overlay in overlays)
    top_m = max(float(np.nanmax(overlay.observed_m, initial=0.0)) for overlay in overlays)
    return _Axes(span_s, max(1.02 * top_m, 1e-3))


def log_overlays(stream: rr.RecordingStream, slots: Sequence[Slot]) -> None:
    """Log the entities of `overlay_view`."""
    axes = _axes(slots)
    rows = [(-height / axes.top_m, f"{height:g} m") for height in ticks(0.0, axes.top_m)]
    marks = [(second / axes.span_s * _WIDTH, f"{second:g} s") for second in ticks(0.0, axes.span_s)]
    log_grid(stream, "sheets/overlay", _WIDTH, rows, marks)
    dots = rr.Points2D.from_fields(radii=screen_radius(1.6))
    stream.log("sheets/overlay/observed", dots, static=True)
    line = rr.LineStrips2D.from_fields(
        colors=[_SIMULATED], radii=screen_radius(0.8), draw_order=25.0
    )
    stream.log("sheets/overlay/simulated", line, static=True)
    for _, index, begun in beginnings(slots):
        _send_overlays(stream, index, [shown.drop if shown else None for _, shown in begun], axes)
    _log_words(stream, slots)
    _log_now(stream, slots, axes)


def _send_overlays(
    stream: rr.RecordingStream,
    index: rr.TimeColumn,
    drops: Sequence[TunedDrop | None],
    axes: _Axes,
) -> None:
    """Send a row per drop; an empty one clears the last drop's curve."""
    observed = [_observed(drop, axes) for drop in drops]
    colors = [
        FAILURE if drop is not None and drop.verdict == "rejected" else OBSERVED
        for drop, points in zip(drops, observed, strict=True)
        for _ in points
    ]
    lengths = [len(points) for points in observed]
    if not lengths:
        return
    stream.send_columns(
        "sheets/overlay/observed",
        indexes=[index],
        columns=rr.Points2D.columns(
            positions=np.concatenate(observed).reshape(-1, 2), colors=colors
        ).partition(lengths),
    )
    lines = [list(_simulated(drop, axes)) for drop in drops]
    stream.send_columns(
        "sheets/overlay/simulated",
        indexes=[index],
        columns=rr.LineStrips2D.columns(
            strips=[strip for strips in lines for strip in strips]
        ).partition([len(strips) for strips in lines]),
    )


def _observed(drop: TunedDrop | None, axes: _Axes) -> Array:
    """Return points of the known samples, shape (T, 2)."""
    if drop is None or drop.overlay is None:
        return np.zeros((0, 2))
    points = axes.points(drop, drop.overlay.observed_m)
    return points[np.isfinite(points[:, 1])]


def _simulated(drop: TunedDrop | None, axes: _Axes) -> Iterator[Array]:
    """Yield the contiguous segments of the line, each of shape (T, 2)."""
    if drop is None or drop.overlay is None:
        return
    points = axes.points(drop, drop.overlay.simulated_m)
    is_known = np.isfinite(points[:, 1])
    for stretch in np.split(points, np.flatnonzero(np.diff(is_known)) + 1):
        if len(stretch) > 1 and np.isfinite(stretch[0, 1]):
            yield stretch


def _log_words(stream: rr.RecordingStream, slots: Sequence[Slot]) -> None:
    """Log why there is no curve, in the middle of the chart; nothing if there is one."""
    entity = "sheets/overlay/words"
    style = rr.Points2D.from_fields(colors=[MUTED], radii=screen_radius(0.1), show_labels=True)
    stream.log(entity, style, static=True)
    for _, index, begun in beginnings(slots):
        words = [_words(shown.drop if shown else None) for _, shown in begun]
        told = [text for text in words if text]
        columns = rr.Points2D.columns(positions=[[_WIDTH / 2, -0.75]] * len(told), labels=told)
        lengths = [1 if text else 0 for text in words]
        stream.send_columns(entity, indexes=[index], columns=columns.partition(lengths))


def _words(drop: TunedDrop | None) -> str:
    """Say shortly why a drop has no curve; "" if it has one."""
    if drop is None:
        return "no drop was recorded for this attempt"
    if drop.overlay is not None:
        return ""
    said = "this drop was rejected" if drop.verdict == "rejected" else "its tuning holds none"
    return f"no curve: {said}"


def _log_now(stream: rr.RecordingStream, slots: Sequence[Slot], axes: _Axes) -> None:
    """Log a dot that moves along the curves while the drops play."""
    entity = "sheets/overlay/now"
    style = rr.Points2D.from_fields(colors=[OBSERVED], radii=screen_radius(5.0), draw_order=30.0)
    stream.log(entity, style, static=True)
    for name, index, begun in beginnings(slots):
        if name != ATTEMPT:
            empty = rr.Points2D.columns(positions=np.zeros((0, 2))).partition([0] * len(begun))
            stream.send_columns(entity, indexes=[index], columns=empty)
    for slot in slots:
        for shown in slot.drops:
            overlay = shown.drop.overlay
            if overlay is None:
                continue
            seen = np.flatnonzero(np.isfinite(overlay.observed_m))[::_EVERY]
            indexes = moments(slot, shown, overlay.seconds[seen].tolist())
            points = axes.points(shown.drop, overlay.observed_m)[seen]
            columns = rr.Points2D.columns(positions=points)
            stream.send_columns(entity, indexes=indexes, columns=columns)
