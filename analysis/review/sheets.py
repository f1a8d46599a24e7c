"""Charts drawn in 2D, because they must stay in view on either timeline.

A plot shows only what is on the active timeline; a drawing can be static, with the iteration's own
part on `iteration`.
"""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from analysis.review.sending import at_iterations, at_seconds, screen_radius
from analysis.review.story import MUTED, OBSERVED, Curve, Story

Array = NDArray[np.float64]

_HEIGHTS_WIDTH = 1.7
_CONVERGENCE_WIDTH = 2.8
"""Of a sheet whose height is 1."""

_GROUND = (16, 18, 24)


def log_sheets(stream: rr.RecordingStream, story: Story) -> None:
    """Send the entities of `height_sheet_view`, `step_view` and `convergence_view`."""
    _log_heights(stream, story)
    _log_convergence(stream, story)


def height_sheet_view() -> rrb.View:
    """The observed curve fixed, the simulated one of the iteration over it."""
    title = "height above the table: observed (dots), simulated (line)"
    return _sheet_view("heights", title, _HEIGHTS_WIDTH)


def convergence_view() -> rrb.View:
    """Restitution against iteration, the current one ringed."""
    return _sheet_view("convergence", "restitution by iteration", _CONVERGENCE_WIDTH)


def step_view() -> rrb.View:
    """The iteration in words."""
    return rrb.TextDocumentView(origin="/step", name="iteration")


def _sheet_view(name: str, title: str, width: float) -> rrb.View:
    return rrb.Spatial2DView(
        origin=f"/sheets/{name}",
        name=title,
        background=_GROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=(-0.2, width + 0.12), y_range=(-1.15, 0.2)),
    )


def _log_heights(stream: rr.RecordingStream, story: Story) -> None:
    start_s = story.release_s - 0.05 * (story.end_s - story.release_s)
    width_s, top = story.end_s - start_s, story.drop_height_m

    def places(curve: Curve) -> Array:
        inside = (curve.seconds >= start_s) & (curve.seconds <= story.end_s)
        x = (curve.seconds[inside] - start_s) / width_s * _HEIGHTS_WIDTH
        return np.column_stack([x, -curve.heights_m[inside] / top])

    rows = [(-height / top, f"{height:g} m") for height in _ticks(0.0, top)]
    marks = [
        ((second - start_s) / width_s * _HEIGHTS_WIDTH, f"{second:g} s")
        for second in _ticks(start_s, story.end_s)
    ]
    _log_grid(stream, "sheets/heights", _HEIGHTS_WIDTH, rows, marks)
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
    x = (np.arange(count) + 0.5) / count * _CONVERGENCE_WIDTH
    dots = np.column_stack([x, [-one.value for one in story.simulated]])
    rows = [(-value, f"{value:g}") for value in (0.0, 0.25, 0.5, 0.75, 1.0)]
    marks = [(float(at), one.name) for at, one in zip(x, story.simulated, strict=True)]
    _log_grid(stream, "sheets/convergence", _CONVERGENCE_WIDTH, rows, marks)
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
        dots - [0, 0.2],
        labels=[f"{one.value:.4f}" for one in story.simulated],
        colors=[one.color for one in story.simulated],
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


def _log_grid(
    stream: rr.RecordingStream,
    sheet: str,
    width: float,
    rows: list[tuple[float, str]],
    marks: list[tuple[float, str]],
) -> None:
    """Lines across at the rows, ticks below at the marks, and their labels."""
    lines = [[[0, y], [width, y]] for y, _ in rows] + [[[x, 0.02], [x, 0]] for x, _ in marks]
    grid = rr.LineStrips2D(lines, colors=[(60, 62, 70)], radii=screen_radius(0.5))
    stream.log(f"{sheet}/grid", grid, static=True)
    labels = rr.Points2D(
        [[-0.09, y - 0.035] for y, _ in rows] + [[x, 0.04] for x, _ in marks],
        labels=[text for _, text in rows + marks],
        colors=[MUTED],
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log(f"{sheet}/labels", labels, static=True)


def _ticks(low: float, high: float) -> list[float]:
    """About five round numbers within [low, high]."""
    raw = (high - low) / 5
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * min((1, 2, 5, 10), key=lambda factor: abs(factor * power - raw))
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [round(k * step, 6) for k in range(first, last + 1)]


def _words(story: Story, k: int) -> str:
    off = story.simulated[k].minus(story.observed).heights_m
    return (
        f"# k = {k}\n\nrestitution **{story.simulated[k].value:.4f}**\n\n"
        f"{1000 * float(np.sqrt(np.mean(off**2))):.2f} mm rms from the observed curve"
    )
