"""Rerun recording of a tuning, with its blueprint.

Everything that moves is on the log's time, so that one play button moves the balls and the cursors
together. A view shows only what is on the active timeline, so what is drawn for each iteration is
beside a static observed curve, for scrubbing `iteration`.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.components import AbsoluteTimeRange

from analysis.record import Record, Tuning
from analysis.result_files import review_name
from analysis.review.drawing import LOG_TIME, application_id, entity_of, send_scalars
from analysis.review.pictures import log_recorded_film
from analysis.review.verdict import VERDICT_SHARE, log_verdict
from analysis.review.words import result_words
from tunenet_logs.regular_file import real_path
from tunenet_logs.terminal import one_line

# Of a log in which nothing was found: more can neither be told apart nor be loaded soon.
_MAX_CURVES = 150

_MAX_VIEWS = 4  # one for each unit: more would be too low to read
# Of all legends, one over the other: what fits beside the views on a laptop's screen.
_MAX_NAMES = 24

_BESIDE = 1.6  # how much longer than the curves an axis is that has a legend beside them
# Of the true speed: a bounce that lasts half a second is over before it is looked at.
_SLOW_MOTION = 0.5

# Of a unit.
_QUANTITIES = {
    "m": "positions",
    "rad": "joint positions",
    "rad/s": "joint velocities",
    "N·m": "joint torques",
}


def write_review(tuning: Tuning, record: Record, path: Path) -> None:
    """Write the review of a tuning to `path` (.rrd).

    Raises:
        OSError: `path` cannot be written.
    """
    identity = os.fsencode(real_path(tuning.log)) + f" {tuning.preset} {tuning.digest}".encode()
    name = hashlib.sha256(identity).hexdigest()[:16]
    if record.provenance is not None and record.provenance.log_sha256:
        name = review_name(record.provenance.log_sha256)
    text = result_words(
        record, tuning.preset, tuning.experiment.occasion if tuning.experiment else None
    )
    stream = rr.RecordingStream(application_id(tuning.task or "log"), recording_id=name)
    memory = stream.memory_recording()  # Rerun's own file sink only prints that a disk is full
    stream.send_recording_name(os.fsencode(tuning.log.name).decode(errors="replace"))
    layout = tuning.experiment.review(stream, tuning) if tuning.experiment else None
    if tuning.detection is None or layout is None:
        views, left_out = _log_recorded(stream, tuning, only_what_changes=layout is not None)
        text += f"\n\n- {left_out} more curves are not drawn" if left_out else ""
        if layout is None and log_recorded_film(stream, tuning):
            views = [rrb.Spatial2DView(origin="/film", name="recorded pictures")]
        layout = _recorded_layout(layout, views)
    strip = log_verdict(stream, tuning, record)
    blueprint = rrb.Blueprint(
        rrb.Vertical(strip, layout, row_shares=[VERDICT_SHARE, 1 - VERDICT_SHARE]),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        _time_panel(record, has_film=tuning.refused is not None and tuning.detection is None),
        auto_views=False,
        auto_layout=False,
    )
    stream.send_blueprint(blueprint)
    stream.log("result", rr.TextDocument(text, media_type="text/markdown"), static=True)
    stream.flush()
    path.write_bytes(memory.drain_as_bytes())
    stream.disconnect()


def _time_panel(record: Record, *, has_film: bool) -> rrb.TimePanel:
    """Loop a motion from the release to the last bounce, or a video without a drop as a whole.

    A blueprint cannot set the cursor's start. One that plays shows the ball in its flight soon
    after opening; a paused one would show it at rest, where the recording ends.
    """
    curves = record.motion.curves
    if curves is None:
        play, loop = ("playing", "all") if has_film else (None, None)
        return rrb.TimePanel(state="collapsed", timeline=LOG_TIME, play_state=play, loop_mode=loop)
    first_ns, last_ns = (round(1e9 * float(at_s)) for at_s in curves.seconds[[0, -1]])
    return rrb.TimePanel(
        state="collapsed",
        timeline=LOG_TIME,
        playback_speed=_SLOW_MOTION,
        play_state="playing",
        loop_mode="selection",
        time_selection=AbsoluteTimeRange(first_ns, last_ns),
    )


def _log_recorded(
    stream: rr.RecordingStream, tuning: Tuning, *, only_what_changes: bool
) -> tuple[list[rrb.View], int]:
    """Log recorded signals by unit where the task found nothing; count curves left out."""
    signals = tuning.episode.signals if tuning.episode else {}
    if only_what_changes:  # marks of events are the same at each of them
        signals = {name: one for name, one in signals.items() if np.ptp(one.values)}
    curves = [(one, index) for one in signals.values() for index in range(len(one.columns))]
    by_unit: dict[str, list[str]] = {}
    for signal, index in curves[:_MAX_CURVES]:
        column = signal.columns[index]
        entity = entity_of("recorded", signal.name, column)
        name = one_line(f"{signal.name} {column}")
        stream.log(entity, rr.SeriesLines(names=[name]), static=True)
        send_scalars(stream, entity, signal.seconds, signal.values[:, index])
        by_unit.setdefault(signal.unit, []).append(entity)
    last_s = max((float(one.seconds[-1]) for one in signals.values()), default=0.0)
    shown = list(by_unit.items())[:_MAX_VIEWS]
    names = _MAX_NAMES // max(len(shown), 1)
    views = [_recorded_view(unit, some, last_s, names) for unit, some in shown]
    return views, max(0, len(curves) - _MAX_CURVES)


def _recorded_view(unit: str, entities: list[str], last_s: float, most_names: int) -> rrb.View:
    """Return the view of one unit's curves, with a legend beside them if it fits."""
    has_legend = len(entities) <= most_names
    begin, end = 0.0, max(last_s, 1e-3) * (_BESIDE if has_legend else 1.0)
    seconds = rr.TimeRange(
        start=rrb.TimeRangeBoundary.absolute(seconds=begin),
        end=rrb.TimeRangeBoundary.absolute(seconds=end),
    )
    return rrb.TimeSeriesView(
        origin="/recorded",
        contents=[f"+ {one}" for one in entities],
        name=one_line(f"recorded {_QUANTITIES.get(unit, 'values')} [{unit}]"),
        axis_x=rrb.TimeAxis(view_range=seconds),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop, visible=has_legend),
    )


def _recorded_layout(evidence: rrb.Container | None, views: Sequence[rrb.View]) -> rrb.Container:
    """Lay out the evidence over all that was recorded, beside the result."""
    result = rrb.TextDocumentView(origin="/result", name="result")
    parts: list[rrb.View | rrb.Container] = [] if evidence is None else [evidence]
    parts += [rrb.Vertical(*views)] if views else []
    if not parts:
        return rrb.Horizontal(result)
    return rrb.Horizontal(rrb.Vertical(*parts), result, column_shares=[3, 2])
