"""The review of a payload: torques, the arm in 3D, the mass, and what else is in the torques."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from analysis.payload.review.arm_scene import arm_view, log_arm
from analysis.payload.review.story import PayloadReviewData, payload_review_data
from analysis.payload.review.terms import log_terms, term_views
from analysis.payload.review.torque_sheets import log_torque_sheets, step_view, torque_sheet_views
from analysis.payload.review.torques import (
    key_view,
    log_key,
    log_torques,
    residual_views,
    torque_views,
)
from analysis.review.iterates import iterates_view, log_iterates
from analysis.review.sending import ITERATION, LOG_TIME
from analysis.tuning import Tuning

_ONE_COLUMN = 3
"""Joints whose charts lie one over the other."""


def log_payload(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container:
    """Send all that is drawn of it; the layout that shows it."""
    story = payload_review_data(tuning)
    log_torques(stream, story)
    log_key(stream, story)
    log_arm(stream, story)
    log_iterates(stream, story.iterates(), float(story.seconds[0]))
    log_torque_sheets(stream, story)
    log_terms(stream, story)
    return _layout(story)


def _layout(story: PayloadReviewData) -> rrb.Container:
    """Three tabs: to play, to scrub, and what else is in the torques."""
    result = rrb.TextDocumentView(origin="/result", name="result")
    mass = iterates_view(story.iterates())
    torques = rrb.Horizontal(
        rrb.Vertical(*torque_views(story)),
        rrb.Vertical(*residual_views(story)),
    )
    overlay = rrb.Horizontal(
        rrb.Vertical(arm_view(story), mass, row_shares=[5, 2.4]),
        rrb.Vertical(key_view(story), torques, row_shares=[0.55, 8]),
        result,
        column_shares=[4, 5.8, 5],
        name=f"overlay (timeline {LOG_TIME})",
    )
    sheets = torque_sheet_views(story)
    scrub = rrb.Horizontal(
        rrb.Grid(*sheets, grid_columns=2 if len(sheets) > _ONE_COLUMN else 1),
        rrb.Vertical(step_view(), iterates_view(story.iterates())),
        column_shares=[5, 3],
        name=f"scrub (timeline {ITERATION})",
    )
    terms = rrb.Grid(*term_views(story), grid_columns=3, name="what else is in the torques")
    return rrb.Tabs(overlay, scrub, terms, active_tab=0)
