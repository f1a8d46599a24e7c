"""The review of a drop: the ball on the video and in 3D, its heights, residuals and bounces."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from analysis.drop.film import FilmedDrop
from analysis.drop.review.bounces import bounce_view, log_bounces
from analysis.drop.review.film import film_aspect, film_view, log_film
from analysis.drop.review.plots import height_view, log_plots, residual_view
from analysis.drop.review.scene import log_scene, scene_view
from analysis.drop.review.sheets import convergence_view, height_sheet_view, log_sheets, step_view
from analysis.drop.review.story import ReviewData, review_data
from analysis.review.sending import ITERATION, LOG_TIME
from analysis.tuning import Tuning


def log_drop(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container:
    """Send all that is drawn of it; the layout that shows it."""
    story = review_data(tuning)
    log_plots(stream, story)
    log_scene(stream, story)
    log_sheets(stream, story)
    if story.bounces:
        log_bounces(stream, story)
    if tuning.found.film is not None:
        log_film(stream, tuning, story)
    return _layout(story, tuning.found.film)


def _layout(story: ReviewData, film: FilmedDrop | None) -> rrb.Container:
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


def _charts(story: ReviewData) -> list[rrb.View]:
    """Those that stay; made anew for each tab, because a view is shown in one place only."""
    return [convergence_view(story), *([bounce_view(story)] if story.bounces else [])]
