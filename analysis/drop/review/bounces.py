"""Chart of bounces: restitution against impact speed, with intervals."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.drop.review.review_data import ReviewData
from analysis.record import Rebound
from analysis.review.drawing import WIDTH, chart_view, log_grid, screen_radius, ticks

_MIN_SPAN = 0.04  # of restitution: less would make noise look like a slope
# Chart heights that a figure takes up across; figures that would overlap are left out.
_FIGURE_WIDTH = 0.55

_FIGURE_RISE = 0.2  # chart heights from a bar up to the place that its figure hangs from
_CAP = 0.025  # half the width of the caps at a bar's ends, in chart heights
_LOWEST_ROW = 0.08  # chart heights: a row's label below this would overlap those of the speeds


def log_bounces(stream: rr.RecordingStream, data: ReviewData) -> None:
    """Send the entities of `bounce_view`; static, so that they stay in view on any timeline."""
    bounces, color = data.bounces, data.simulated[-1].color
    low, high = _span(bounces)
    speeds = _speeds(bounces)
    if speeds is None:
        x = (np.arange(len(bounces)) + 0.5) / len(bounces) * WIDTH
        marks = [(float(at), str(index + 1)) for index, at in enumerate(x)]
    else:
        most = 1.08 * max(speeds)
        x = np.array(speeds) / most * WIDTH
        marks = [(speed / most * WIDTH, f"{speed:g}") for speed in ticks(0.0, most)]
    levels = [(-(value - low) / (high - low), f"{value:.6g}") for value in ticks(low, high, 3)]
    rows = [(y, text) for y, text in levels if y < -_LOWEST_ROW]
    log_grid(stream, "sheets/bounces", WIDTH, rows, marks)
    y = np.array([-(bounce.restitution - low) / (high - low) for bounce in bounces])
    dots = rr.Points2D(
        np.column_stack([x, y]), colors=[color], radii=screen_radius(4.0), draw_order=20.0
    )
    stream.log("sheets/bounces/values", dots, static=True)
    strips: list[list[list[float]]] = []
    figures: list[tuple[list[float], str]] = []
    for at, bounce in zip(x.tolist(), bounces, strict=True):
        ends = bounce.interval95 or (bounce.restitution,)
        bottom, top = (-(end - low) / (high - low) for end in (min(ends), max(ends)))
        if bounce.interval95 is not None:
            caps = [[[at - _CAP, end], [at + _CAP, end]] for end in (bottom, top)]
            strips += [[[at, bottom], [at, top]], *caps]
        if all(abs(at - place[0]) > _FIGURE_WIDTH for place, _ in figures):
            figures.append(([at, top - _FIGURE_RISE], f"{bounce.restitution:.3f}"))
    labels = rr.Points2D(
        [place for place, _ in figures],
        labels=[text for _, text in figures],
        colors=[color],
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log("sheets/bounces/figures", labels, static=True)
    bars = rr.LineStrips2D(strips, colors=[color], radii=screen_radius(0.9), draw_order=15.0)
    stream.log("sheets/bounces/intervals", bars, static=True)


def bounce_view(data: ReviewData) -> rrb.View:
    """Build the view of the bounces by impact speed, or by number where no speed is known."""
    by = "bounce" if _speeds(data.bounces) is None else "impact speed [m/s]"
    bars = ", bars: 95 %" if data.interval95 is not None else ""
    return chart_view("bounces", f"restitution by {by}{bars}")


def _speeds(bounces: tuple[Rebound, ...]) -> list[float] | None:
    """Return the impact speeds [m/s]; None unless all are known."""
    speeds = [bounce.impact_speed_m_s for bounce in bounces if bounce.impact_speed_m_s is not None]
    return speeds if len(speeds) == len(bounces) else None


def _span(bounces: tuple[Rebound, ...]) -> tuple[float, float]:
    """Return the range of restitutions and intervals, with room for their figures."""
    ends = [bounce.restitution for bounce in bounces]
    for bounce in bounces:
        ends += bounce.interval95 or ()
    low, high = min(ends), max(ends)
    more = max(0.0, _MIN_SPAN - (high - low)) / 2
    low, high = low - more, high + more
    return low - 0.05 * (high - low), high + 0.2 * (high - low)  # figures stand above
