"""Section of a report page on a campaign: rates, balls, attempts."""

from __future__ import annotations

from dataclasses import dataclass

from analysis.campaign.attempts import Attempt
from analysis.campaign.build import Campaign
from analysis.campaign.rates import ball_rates, overall_rates, restitutions_by_ball
from analysis.terminal_table import interval_words

_MAX_ROWS = 300

Cells = tuple[str, ...]


@dataclass(frozen=True)
class CampaignSection:
    """Tables of a campaign.

    Attributes:
        rates: Rows of whose, successes, rate and Wilson interval.
        balls: Rows of ball, mean restitution, standard deviation and drops.
        attempts: Rows of number, ball, drops, restitution, interval, outcome and reason.
        notes: What is not in the tables.
    """

    rates: tuple[Cells, ...]
    balls: tuple[Cells, ...]
    attempts: tuple[Cells, ...]
    notes: tuple[str, ...]


def campaign_section(campaign: Campaign) -> CampaignSection:
    """Build the tables of a campaign."""
    attempts = campaign.attempts
    rates = [
        (
            rate.name,
            f"{rate.successes} of {rate.count}",
            f"{100 * rate.fraction:.0f} %",
            "{:.0f} to {:.0f} %".format(*(100 * end for end in rate.interval95)),
        )
        for rate in (*overall_rates(attempts), *ball_rates(attempts))
        if rate.count
    ]
    balls = [
        (
            ball.name,
            f"{ball.mean:.4f}",
            f"{ball.sd:.4f}" if len(ball.values) > 1 else "-",
            str(len(ball.values)),
        )
        for ball in restitutions_by_ball(attempts)
    ]
    notes: list[str] = []
    if campaign.tuned_now:
        notes.append(
            f"{campaign.tuned_now} drops had no tuning beside them: they were tuned for this page, "
            "and have no part of their own. Run tunenet-tune on them first."
        )
    if campaign.unread:
        notes.append(f"{campaign.unread} logs cannot be read.")
    if len(attempts) > _MAX_ROWS:
        notes.append(f"{len(attempts) - _MAX_ROWS} more attempts are not listed.")
    rows = tuple(_row(attempt) for attempt in attempts[:_MAX_ROWS])
    return CampaignSection(tuple(rates), tuple(balls), rows, tuple(notes))


def _row(attempt: Attempt) -> Cells:
    outcome = attempt.outcome
    said = "not recorded"
    if outcome is not None:
        said = "success" if outcome.success else "failure"
        said += "" if attempt.was_shot else ", not shot"
    used = attempt.used
    doubts = "" if used is None or used.verdict == "ok" else f" ({used.verdict})"
    drops = ", ".join(
        drop.name if drop.verdict == "ok" else f"{drop.name} ({drop.verdict})"
        for drop in attempt.drops
    )
    value, ends = attempt.value, attempt.interval95
    return (
        str(attempt.number),
        attempt.ball,
        drops or "-",
        "-" if value is None else f"{value:.4f}{doubts}",
        "-" if ends is None else interval_words(*ends),
        said,
        (outcome.reason or "") if outcome is not None else "",
    )
