"""The review of a payload: torques, the arm in 3D, the mass, and what else is in the torques."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from analysis.payload.review.arm_scene import arm_view, log_arm
from analysis.payload.review.review_data import payload_review_data
from analysis.payload.review.terms import log_terms, term_views
from analysis.payload.review.torques import (
    key_view,
    log_key,
    log_torque_sheets,
    log_torques,
    torque_sheet_views,
    torque_views,
)
from analysis.review.charts import iterates_view, log_iterates
from analysis.review.drawing import ITERATION, LOG_TIME
from analysis.tuning_result import Tuning

_ONE_COLUMN = 3
"""Joints whose charts lie one over the other; more take two columns."""


def log_payload(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container:
    """Send all that is drawn of it; three tabs: to play, to scrub, and what else is in it."""
    data = payload_review_data(tuning)
    log_torques(stream, data)
    log_key(stream, data)
    log_arm(stream, data)
    log_iterates(stream, data.iterates(), float(data.seconds[0]))
    log_torque_sheets(stream, data)
    log_terms(stream, data)
    torques, residuals = torque_views(data)
    curves = rrb.Horizontal(rrb.Vertical(*torques), rrb.Vertical(*residuals))
    overlay = rrb.Horizontal(
        rrb.Vertical(arm_view(data), iterates_view(data.iterates()), row_shares=[5, 2.4]),
        rrb.Vertical(key_view(data), curves, row_shares=[0.55, 8]),
        rrb.TextDocumentView(origin="/result", name="result"),
        column_shares=[4, 5.8, 5],
        name=f"overlay (timeline {LOG_TIME})",
    )
    sheets = torque_sheet_views(data)
    step = rrb.TextDocumentView(origin="/step", name="iteration")
    scrub = rrb.Horizontal(
        rrb.Grid(*sheets, grid_columns=2 if len(sheets) > _ONE_COLUMN else 1),
        rrb.Vertical(step, iterates_view(data.iterates())),
        column_shares=[5, 3],
        name=f"scrub (timeline {ITERATION})",
    )
    terms = rrb.Grid(*term_views(data), grid_columns=3, name="what else is in the torques")
    return rrb.Tabs(overlay, scrub, terms, active_tab=0)
