"""What drawn charts share: their view, their grid, and where its lines are.

A plot shows only what is on the active timeline; a drawing can be static, so that it stays in view
on either, with the iteration's own part on `iteration`.
"""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.review.colors import MUTED, Color
from analysis.review.sending import screen_radius

WIDTH = 2.8
"""Of a chart whose height is 1."""

GROUND = (16, 18, 24)
_LINES = (60, 62, 70)
_FILL = 12


def chart_view(name: str, title: str, width: float = WIDTH) -> rrb.View:
    """The view of the chart `name`."""
    return rrb.Spatial2DView(
        origin=f"/sheets/{name}",
        name=title,
        background=GROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=(-0.2, width + 0.12), y_range=(-1.15, 0.2)),
    )


def log_grid(
    stream: rr.RecordingStream,
    sheet: str,
    width: float,
    rows: list[tuple[float, str]],
    marks: list[tuple[float, str]],
    hang: float = 0.085,
) -> None:
    """Lines across at the rows, ticks below at the marks, and their labels.

    Labels hang from their places; those of the rows by `hang`, which is less in a larger view.
    """
    lines = [[[0, y], [width, y]] for y, _ in rows] + [[[x, 0.02], [x, 0]] for x, _ in marks]
    grid = rr.LineStrips2D(lines, colors=[_LINES], radii=screen_radius(0.5))
    stream.log(f"{sheet}/grid", grid, static=True)
    labels = rr.Points2D(
        [[-0.09, y - hang] for y, _ in rows] + [[x, 0.04] for x, _ in marks],
        labels=[text for _, text in rows + marks],
        colors=[MUTED],
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log(f"{sheet}/labels", labels, static=True)


def filled(
    left: float, right: float, top: float, bottom: float
) -> tuple[list[list[list[float]]], float]:
    """A rectangle as lines side by side along its longer sides, and their radius.

    What can be drawn in 2D has no other that is filled.
    """
    width, height = right - left, bottom - top
    radius = min(width, height) / (_FILL + 1)  # each over half of the one before
    steps = [radius * (1 + k) for k in range(_FILL)]
    if width > height:
        ends = left + radius, right - radius
        return [[[x, top + step] for x in ends] for step in steps], radius
    ends = top + radius, bottom - radius
    return [[[left + step, y] for y in ends] for step in steps], radius


def mixed(color: Color, share: float) -> Color:
    """A colour so far above the ground's."""
    pairs = zip(GROUND, color, strict=True)
    red, green, blue = (round(low + share * (high - low)) for low, high in pairs)
    return red, green, blue


def ticks(low: float, high: float, count: int = 5) -> list[float]:
    """About so many round numbers within [low, high]."""
    raw = (high - low) / count
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * min((1, 2, 5, 10), key=lambda factor: abs(factor * power - raw))
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [round(k * step, 6) for k in range(first, last + 1)]
