"""Rerun recording of a campaign with its blueprint: an overview that leads to each attempt."""

from __future__ import annotations

import hashlib
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from analysis.campaign.build import Campaign
from analysis.campaign.rates import ball_rates, overall_rates, restitutions_by_ball
from analysis.result_files import subject_of
from analysis.review.campaign.attempt import attempt_view, log_attempts
from analysis.review.campaign.charts import log_rates, log_restitutions
from analysis.review.campaign.film import film_view
from analysis.review.campaign.lanes import lane_view, log_lanes
from analysis.review.campaign.overlay import overlay_view
from analysis.review.campaign.times import ATTEMPT, slots_of
from analysis.review.campaign.words import campaign_words
from analysis.review.drawing import application_id
from tunenet_logs.terminal import short_name

_LANES_SHARE = 0.36  # of a tab's height: all lanes are in view on a small screen too
_MAX_LETTERS = 40  # of a campaign's name, in the titles of its views


def write_campaign(campaign: Campaign, path: Path) -> None:
    """Write the review of a campaign to `path` (.rrd).

    Raises:
        OSError: `path` cannot be written.
    """
    words = campaign_words(campaign)
    identity = subject_of(campaign.places) + hashlib.sha256(words.encode()).hexdigest()[:16]
    stream = rr.RecordingStream(application_id("campaign"), recording_id=identity)
    memory = stream.memory_recording()
    stream.send_recording_name(campaign.name)
    slots = slots_of(campaign.attempts)
    log_lanes(stream, slots)
    rates = (*overall_rates(campaign.attempts), *ball_rates(campaign.attempts))
    charts = [
        log_rates(stream, rates),
        log_restitutions(stream, restitutions_by_ball(campaign.attempts)),
    ]
    log_attempts(stream, slots)
    is_filmed = any(drop.film for attempt in campaign.attempts for drop in attempt.drops)
    stream.send_blueprint(
        _blueprint(short_name(campaign.name, _MAX_LETTERS), charts, is_filmed=is_filmed)
    )
    stream.log("summary", rr.TextDocument(words, media_type="text/markdown"), static=True)
    stream.flush()
    path.write_bytes(memory.drain_as_bytes())
    stream.disconnect()


def _blueprint(name: str, charts: list[rrb.View], *, is_filmed: bool) -> rrb.Blueprint:
    summary = rrb.TextDocumentView(origin="/summary", name=f"{name}: all figures")
    overview = rrb.Vertical(
        lane_view(f"{name}: the attempts (a click goes to one; the next tab shows it)"),
        rrb.Horizontal(*charts),
        row_shares=[_LANES_SHARE, 1 - _LANES_SHARE],
        name="overview",
    )
    attempt = rrb.Vertical(
        lane_view(f"{name}: the attempts (a click goes to one)"),
        _attempt(is_filmed=is_filmed),
        row_shares=[_LANES_SHARE, 1 - _LANES_SHARE],
        name="attempt",
    )
    return rrb.Blueprint(
        rrb.Tabs(overview, attempt, rrb.Horizontal(summary, name="tables"), active_tab=0),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=ATTEMPT, play_state="paused"),
        auto_views=False,
        auto_layout=False,
    )


def _attempt(*, is_filmed: bool) -> rrb.Container:
    """Lay out the attempt under the cursor; anew for each tab, as a view has one place."""
    if not is_filmed:
        return rrb.Horizontal(overlay_view(), attempt_view(), column_shares=[5, 3])
    return rrb.Horizontal(overlay_view(), film_view(), attempt_view(), column_shares=[5, 3, 3])
