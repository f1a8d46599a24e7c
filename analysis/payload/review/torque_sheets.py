"""What the payload adds to each torque at an iteration, over the observed torque, which stays."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.payload.review.story import PayloadReviewData
from analysis.review.colors import OBSERVED
from analysis.review.grid import WIDTH, chart_view, log_grid, ticks
from analysis.review.sending import at_iterations, at_seconds, screen_radius
from tunenet_logs.arrays import Array

_LEAST_SPAN_NM = 0.5
_ROOM = 0.05
"""Above and below the curves, of what they span."""


def log_torque_sheets(stream: rr.RecordingStream, story: PayloadReviewData) -> None:
    """Send the entities of `torque_sheet_views` and `step_view`."""
    for joint in story.order:
        _log_sheet(stream, story, joint)
    stream.log("step", rr.TextDocument.from_fields(media_type="text/markdown"), static=True)
    for index, chosen in _indexes(story):
        words = rr.TextDocument.columns(text=[_words(story, k) for k in chosen])
        stream.send_columns("step", indexes=[index], columns=words)


def torque_sheet_views(story: PayloadReviewData) -> list[rrb.View]:
    """A joint each: observed torque, and what the iteration's payload adds to the empty arm's."""
    return [
        chart_view(_name(joint), f"{story.title(joint)} beyond the empty arm")
        for joint in story.order
    ]


def step_view() -> rrb.View:
    """The iteration in words."""
    return rrb.TextDocumentView(origin="/step", name="iteration")


def _name(joint: int) -> str:
    return f"torque_{joint + 1}"


def _indexes(story: PayloadReviewData) -> tuple[tuple[rr.TimeColumn, range], ...]:
    """Every iteration on its own timeline; the last one on the log's."""
    count = len(story.simulated)
    return (
        (at_iterations(count), range(count)),
        (at_seconds(story.seconds[:1]), range(count - 1, count)),
    )


def _log_sheet(stream: rr.RecordingStream, story: PayloadReviewData, joint: int) -> None:
    sheet = f"sheets/{_name(joint)}"
    empty = story.empty_nm[:, joint]
    observed = story.observed_nm[:, joint] - empty
    simulated = [one.effort_nm[:, joint] - empty for one in story.simulated]
    fitted = None if story.fitted is None else story.fitted.effort_nm[:, joint] - empty
    shown = np.concatenate([observed, *simulated, [0.0]])
    reach = max(float(np.ptp(shown)), _LEAST_SPAN_NM) * (1 + 2 * _ROOM)
    low = float(shown.min() + shown.max() - reach) / 2
    start_s, width_s = story.seconds[0], story.seconds[-1] - story.seconds[0]
    x = (story.seconds - start_s) / width_s * WIDTH

    def places(values: Array) -> Array:
        return np.column_stack([x, -(values - low) / reach])

    rows = [(-(value - low) / reach, f"{value:g}") for value in ticks(low, low + reach, 4)]
    marks = [
        (float((second - start_s) / width_s * WIDTH), f"{second:g} s")
        for second in ticks(start_s, story.seconds[-1])
    ]
    log_grid(stream, sheet, WIDTH, rows, marks)
    dots = rr.Points2D(places(observed), colors=[OBSERVED], radii=screen_radius(1.2))
    stream.log(f"{sheet}/observed", dots, static=True)
    if story.fitted is not None and fitted is not None:
        line = rr.LineStrips2D(
            [places(fitted)], colors=[story.fitted.color], radii=screen_radius(0.9)
        )
        stream.log(f"{sheet}/fit", line, static=True)
    style = rr.LineStrips2D.from_fields(radii=screen_radius(1.4), draw_order=40.0)
    stream.log(f"{sheet}/simulated", style, static=True)
    for index, chosen in _indexes(story):
        strips = rr.LineStrips2D.columns(
            strips=[places(simulated[k]) for k in chosen],
            colors=[story.simulated[k].color for k in chosen],
        )
        stream.send_columns(f"{sheet}/simulated", indexes=[index], columns=strips)


def _words(story: PayloadReviewData, k: int) -> str:
    one = story.simulated[k]
    lines = [
        f"# {one.name}",
        f"payload mass **{one.mass_kg:.4f} kg**",
        f"{_rms(one.effort_nm - story.observed_nm):.3f} N·m rms from the observed torques",
        "Dots: observed torques less the empty arm's. Thick line: what this payload adds to them.",
    ]
    if story.fitted is not None:
        left = _rms(story.fitted.effort_nm - story.observed_nm)
        lines.append(
            f"Thin line: the fit, with friction, offsets and all else; {left:.3f} N·m rms is left."
        )
    return "\n\n".join(lines)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
