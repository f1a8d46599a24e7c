"""A campaign in words: rates beside the paper's, restitutions by ball."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan
from statistics import median

from analysis.campaign.attempts import Attempt
from analysis.campaign.build import Campaign
from analysis.campaign.rates import Rate, Spread, ball_rates, overall_rates, spreads
from analysis.review.words import table
from tunenet_logs.wording import one_line


def campaign_words(campaign: Campaign) -> str:
    """The campaign's tables as Markdown."""
    attempts = campaign.attempts
    drops = {id(drop): drop for one in attempts for drop in one.drops}
    rejected = sum(one.verdict == "rejected" for one in drops.values())
    ended = sum(one.outcome is not None for one in attempts)
    lines = [
        f"# {one_line(campaign.name)}",
        f"{len(attempts)} attempts, {len(drops)} drops ({rejected} rejected), {ended} outcomes",
        "## Success",
        _rates([*overall_rates(attempts), *ball_rates(attempts)]),
        "## Restitution",
        _spreads(spreads(attempts)),
        "## Misses",
        _misses(attempts),
    ]
    return "\n\n".join(lines)


def _rates(rates: Sequence[Rate]) -> str:
    rows = []
    for one in rates:
        low, high = one.interval95
        share = f"{100 * one.share:.0f} %" if one.count else "-"
        ends = f"{100 * low:.0f} to {100 * high:.0f} %" if one.count else "-"
        paper = "" if one.published is None else f"{100 * one.published:.0f} %"
        rows.append((one_line(one.name), f"{one.successes}/{one.count}", share, ends, paper))
    return table(("of", "successes", "rate", "95 % (Wilson)", "paper"), rows)


def _spreads(found: Sequence[Spread]) -> str:
    if not found:
        return "none was tuned"
    rows = []
    for one in found:
        halves = [(high - low) / 2 for pair in one.intervals95 if pair for low, high in [pair]]
        interval = f"± {median(halves):.4f}" if halves else "-"
        deviation = "-" if isnan(one.deviation) else f"{one.deviation:.4f}"
        ends = f"{min(one.values):.4f} to {max(one.values):.4f}"
        rows.append(
            (one_line(one.ball), str(len(one.values)), f"{one.mean:.4f}", deviation, ends, interval)
        )
    return table(("ball", "drops", "mean", "sd", "least to most", "usual 95 %"), rows)


def _misses(attempts: Sequence[Attempt]) -> str:
    misses = sorted(
        abs(one.outcome.miss_m)
        for one in attempts
        if one.outcome is not None and one.outcome.miss_m is not None
    )
    if not misses:
        return "none was measured"
    middle = 1000 * median(misses)
    return f"{len(misses)} measured: median {middle:.0f} mm, largest {1000 * misses[-1]:.0f} mm"
