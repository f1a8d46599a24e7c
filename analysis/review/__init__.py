"""The Rerun recording of a tuning, with its blueprint: the only room that knows Rerun.

Everything that moves lies on the log's time, so that one play button moves the balls and the
cursors together. A view shows only what is on the active timeline, so what is drawn for each
iteration lies beside a static observed curve, for scrubbing `iteration`.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from analysis.observe.film import FilmedDrop
from analysis.review.bounces import bounce_view, log_bounces
from analysis.review.film import film_aspect, film_view, log_film, log_recorded_film
from analysis.review.plots import height_view, log_plots, residual_view
from analysis.review.scene import log_scene, scene_view
from analysis.review.sending import ITERATION, LOG_TIME, entity_of, send_scalars
from analysis.review.sheets import convergence_view, height_sheet_view, log_sheets, step_view
from analysis.review.story import Story, story_of
from analysis.review.words import result_words
from analysis.tuning import Tuning
from tunenet_logs.wording import one_line

_MOST_CURVES = 150
"""Of a log in which nothing was found: more can neither be told apart nor be loaded soon."""


def write_review(tuning: Tuning, path: Path) -> None:
    """Write the review of a tuning to `path` (.rrd).

    Raises:
        OSError: `path` cannot be written.
    """
    told = os.fsencode(tuning.log.resolve()) + f" {tuning.preset} {tuning.digest}".encode()
    identity = hashlib.sha256(told).hexdigest()[:16]
    kind = "drop" if tuning.found else "log"
    stream = rr.RecordingStream(f"tunenet review {kind}", recording_id=identity)
    memory = stream.memory_recording()  # Rerun's own file sink only prints that a disk is full
    stream.send_recording_name(os.fsencode(tuning.log.name).decode(errors="replace"))
    text = result_words(tuning)
    if tuning.found is None:
        left_out = _log_recorded(stream, tuning)
        text += f"\n\n- {left_out} more curves are not drawn" if left_out else ""
        filmed = log_recorded_film(stream, tuning)
        stream.send_blueprint(_blueprint(_recorded_layout(filmed)))
    else:
        story = story_of(tuning)
        log_plots(stream, story)
        log_scene(stream, story)
        log_sheets(stream, story)
        if story.bounces:
            log_bounces(stream, story)
        if tuning.found.film is not None:
            log_film(stream, tuning, story)
        stream.send_blueprint(_blueprint(_tuning_layout(story, tuning.found.film)))
    stream.log("result", rr.TextDocument(text, media_type="text/markdown"), static=True)
    stream.flush()
    path.write_bytes(memory.drain_as_bytes())
    stream.disconnect()


def _log_recorded(stream: rr.RecordingStream, tuning: Tuning) -> int:
    """What was recorded, where the task found nothing in it; how many curves are left out."""
    signals = tuning.episode.signals if tuning.episode else {}
    curves = [(one, index) for one in signals.values() for index in range(len(one.columns))]
    for signal, index in curves[:_MOST_CURVES]:
        column = signal.columns[index]
        entity = entity_of("recorded", signal.name, column)
        name = one_line(f"{signal.name} {column}")
        stream.log(entity, rr.SeriesLines(names=[name]), static=True)
        send_scalars(stream, entity, signal.seconds, signal.values[:, index])
    return max(0, len(curves) - _MOST_CURVES)


def _tuning_layout(story: Story, film: FilmedDrop | None) -> rrb.Container:
    """Two tabs, to play and to scrub; with the video first where there is one."""
    result = rrb.TextDocumentView(origin="/result", name="result")
    charts = _charts(story)
    words = rrb.Vertical(result, *charts, row_shares=[5, *[2.6] * len(charts)])
    curves = rrb.Vertical(
        scene_view(story), height_view(story), residual_view(story), row_shares=[4, 4, 3]
    )
    name = f"overlay (timeline {LOG_TIME})"
    if film is None:
        overlay = rrb.Horizontal(curves, words, column_shares=[3, 2], name=name)
    else:
        share = min(max(3 * film_aspect(film), 1.2), 3.5)
        video = film_view(film, story)
        overlay = rrb.Horizontal(video, curves, words, column_shares=[share, 3, 3], name=name)
    scrub = rrb.Horizontal(
        height_sheet_view(),
        rrb.Vertical(step_view(), *_charts(story)),
        column_shares=[5, 3],
        name=f"scrub (timeline {ITERATION})",
    )
    return rrb.Tabs(overlay, scrub, active_tab=0)


def _charts(story: Story) -> list[rrb.View]:
    """Those that stay; made anew for each tab, because a view is shown in one place only."""
    return [convergence_view(story), *([bounce_view(story)] if story.bounces else [])]


def _recorded_layout(filmed: bool) -> rrb.Container:
    positions = rrb.TimeSeriesView(origin="/recorded", name="recorded position [m]")
    pictures = rrb.Spatial2DView(origin="/film", name="recorded pictures")
    return rrb.Horizontal(
        pictures if filmed else positions,
        rrb.TextDocumentView(origin="/result", name="result"),
        column_shares=[3, 2],
    )


def _blueprint(layout: rrb.Container) -> rrb.Blueprint:
    return rrb.Blueprint(
        layout,
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=LOG_TIME),
        auto_views=False,
        auto_layout=False,
    )
