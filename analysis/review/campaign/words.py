"""Summarise a campaign: rates beside the paper's, restitutions by ball."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan
from statistics import median

from analysis.campaign.attempts import Attempt
from analysis.campaign.build import Campaign
from analysis.campaign.rates import (
    BallRestitutions,
    Rate,
    ball_rates,
    overall_rates,
    restitutions_by_ball,
)
from analysis.terminal_table import markdown_table
from tunenet_logs.terminal import one_line


def campaign_words(campaign: Campaign) -> str:
    """Format the campaign's tables as Markdown."""
    attempts = campaign.attempts
    drops = {id(drop): drop for attempt in attempts for drop in attempt.drops}
    rejected = sum(drop.verdict == "rejected" for drop in drops.values())
    ended = sum(attempt.outcome is not None for attempt in attempts)
    lines = [
        f"# {one_line(campaign.name)}",
        f"{len(attempts)} attempts, {len(drops)} drops ({rejected} rejected), {ended} outcomes",
        "## Success",
        _rates([*overall_rates(attempts), *ball_rates(attempts)]),
        "## Restitution",
        _restitutions(restitutions_by_ball(attempts)),
        "## Misses",
        _misses(attempts),
    ]
    return "\n\n".join(lines)


def _rates(rates: Sequence[Rate]) -> str:
    rows = []
    for rate in rates:
        low, high = rate.interval95
        fraction = f"{100 * rate.fraction:.0f} %" if rate.count else "-"
        ends = f"{100 * low:.0f} to {100 * high:.0f} %" if rate.count else "-"
        paper = "" if rate.published is None else f"{100 * rate.published:.0f} %"
        rows.append((one_line(rate.name), f"{rate.successes}/{rate.count}", fraction, ends, paper))
    return markdown_table(("of", "successes", "rate", "95 % (Wilson)", "paper"), rows)


def _restitutions(balls: Sequence[BallRestitutions]) -> str:
    if not balls:
        return "none was tuned"
    rows = []
    for ball in balls:
        halves = [(high - low) / 2 for pair in ball.intervals95 if pair for low, high in [pair]]
        interval = f"± {median(halves):.4f}" if halves else "-"
        sd = "-" if isnan(ball.sd) else f"{ball.sd:.4f}"
        ends = f"{min(ball.values):.4f} to {max(ball.values):.4f}"
        rows.append(
            (one_line(ball.name), str(len(ball.values)), f"{ball.mean:.4f}", sd, ends, interval)
        )
    return markdown_table(("ball", "drops", "mean", "sd", "least to most", "usual 95 %"), rows)


def _misses(attempts: Sequence[Attempt]) -> str:
    misses = sorted(
        abs(attempt.outcome.miss_m)
        for attempt in attempts
        if attempt.outcome is not None and attempt.outcome.miss_m is not None
    )
    if not misses:
        return "none was measured"
    middle = 1000 * median(misses)
    return f"{len(misses)} measured: median {middle:.0f} mm, largest {1000 * misses[-1]:.0f} mm"
