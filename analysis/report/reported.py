"""Read what a report is about: tunings, and a campaign if outcomes are among the files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from analysis.campaign.build import campaign_of
from analysis.campaign.files import holds_campaign
from analysis.report.campaign_section import CampaignSection, campaign_section
from analysis.tuning_files import TuningFile, in_order, read_tunings
from tunenet_logs.regular_file import real_path
from tunenet_logs.terminal import Progress


@dataclass(frozen=True, eq=False)
class Reported:
    """Contents of a report.

    Attributes:
        title: Of the page; None for that of its tunings.
        tunings: In their order.
        campaigns: None, or the one whose outcomes are among the files.
    """

    title: str | None
    tunings: Sequence[TuningFile]
    campaigns: Sequence[CampaignSection] = ()


def read_reported(
    places: Sequence[Path], jobs: int | None, progress: Progress, warn: Callable[[str], None]
) -> Reported:
    """Read tunings, folders of them, or a campaign.

    Args:
        places: Files and folders.
        jobs: Processes for a campaign's drops; None for all cores.
        progress: Shows the drop under way.
        warn: Called with what cannot be read.

    Raises:
        UsageError: Nothing in them can be reported.
    """
    title = real_path(places[0]).name if places[0].is_dir() else None
    if not holds_campaign(places):
        return Reported(title, read_tunings(places, warn))
    campaign = campaign_of(places, jobs, progress, warn)
    drops = [drop for attempt in campaign.attempts for drop in attempt.drops]
    known = dict.fromkeys(drop.tuning for drop in drops if drop.tuning is not None)
    tunings = in_order(read_tunings(list(known), warn)) if known else ()
    return Reported(title, tunings, [campaign_section(campaign)])
