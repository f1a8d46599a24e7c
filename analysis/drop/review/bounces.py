"""Restitution of each bounce against its impact speed, with intervals: drawn, so that it stays."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.drop.bounces import ReportedBounce
from analysis.drop.review.story import ReviewData
from analysis.review.grid import WIDTH, chart_view, log_grid, ticks
from analysis.review.sending import screen_radius
from tunenet_logs.arrays import Array

_LEAST_SPAN = 0.04
"""Of restitution: less would make noise look like a slope."""

_ROOM = 0.32
"""Between two figures, in heights of the chart."""

_CAP = 0.025
_LOWEST_ROW = 0.08
"""Of a label: below are those of the speeds."""

_ABOVE = 0.2
"""Of a figure above its bar: it hangs from its place."""


def log_bounces(stream: rr.RecordingStream, story: ReviewData) -> None:
    """Send the entities of `bounce_view`."""
    bounces = story.bounces
    low, high = _span(bounces)
    across, marks = _across(bounces)
    up = {value: -(value - low) / (high - low) for value in ticks(low, high, 3)}
    rows = [(y, f"{value:.6g}") for value, y in up.items() if y < -_LOWEST_ROW]
    log_grid(stream, "sheets/bounces", WIDTH, rows, marks)
    heights = np.array([-(one.restitution - low) / (high - low) for one in bounces])
    places = np.column_stack([across, heights])
    color = story.simulated[-1].color
    dots = rr.Points2D(places, colors=[color], radii=screen_radius(4.0), draw_order=20.0)
    stream.log("sheets/bounces/values", dots, static=True)
    figures = _with_room(across)
    tops = [-(max(one.interval95 or (one.restitution,)) - low) / (high - low) for one in bounces]
    words = rr.Points2D(
        [[across[index], tops[index] - _ABOVE] for index in figures],
        labels=[f"{bounces[index].restitution:.3f}" for index in figures],
        colors=[color],
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log("sheets/bounces/figures", words, static=True)
    strips = [
        strip
        for x, one in zip(across, bounces, strict=True)
        if one.interval95 is not None
        for strip in _bar(x, *(-(end - low) / (high - low) for end in one.interval95))
    ]
    bars = rr.LineStrips2D(strips, colors=[color], radii=screen_radius(0.9), draw_order=15.0)
    stream.log("sheets/bounces/intervals", bars, static=True)


def bounce_view(story: ReviewData) -> rrb.View:
    """Faster impacts on the right; by number where no speed is known."""
    by = "bounce" if _speeds(story.bounces) is None else "impact speed [m/s]"
    bars = ", bars: 95 %" if story.interval95 is not None else ""
    return chart_view("bounces", f"restitution by {by}{bars}")


def _speeds(bounces: tuple[ReportedBounce, ...]) -> list[float] | None:
    speeds = [one.impact_speed_m_s for one in bounces if one.impact_speed_m_s is not None]
    return speeds if len(speeds) == len(bounces) else None


def _across(bounces: tuple[ReportedBounce, ...]) -> tuple[Array, list[tuple[float, str]]]:
    """Where each bounce is, and the marks below."""
    speeds = _speeds(bounces)
    if speeds is None:
        x = (np.arange(len(bounces)) + 0.5) / len(bounces) * WIDTH
        return x, [(float(at), str(index + 1)) for index, at in enumerate(x)]
    most = 1.08 * max(speeds)
    marks = [(speed / most * WIDTH, f"{speed:g}") for speed in ticks(0.0, most)]
    return np.array(speeds) / most * WIDTH, marks


def _span(bounces: tuple[ReportedBounce, ...]) -> tuple[float, float]:
    """The restitutions between which all that is to be seen lies."""
    ends = [one.restitution for one in bounces]
    for one in bounces:
        ends += one.interval95 or ()
    low, high = min(ends), max(ends)
    more = max(0.0, _LEAST_SPAN - (high - low)) / 2
    low, high = low - more, high + more
    return low - 0.05 * (high - low), high + 0.2 * (high - low)  # figures stand above


def _with_room(across: Array) -> list[int]:
    """Which bounces have room for their figure: from the first on, none over another."""
    chosen: list[int] = []
    for index, x in enumerate(across):
        if all(abs(x - across[other]) > _ROOM for other in chosen):
            chosen.append(index)
    return chosen


def _bar(x: float, low: float, high: float) -> list[list[list[float]]]:
    caps = [[[x - _CAP, y], [x + _CAP, y]] for y in (low, high)]
    return [[[x, low], [x, high]], *caps]
