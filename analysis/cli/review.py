"""tunenet-review: write a campaign's drops, tunings and outcomes as one recording."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tunenet_logs.analysis.options import jobs_option
from tunenet_logs.console import Parser, run
from tunenet_logs.errors import UsageError
from tunenet_logs.terminal import Progress, listed, one_line, short_name

_DESCRIPTION = """\
A campaign on one timeline: the drops, what was tuned from them, the shots, and how each
attempt ended; restitution by ball with its spread, success rates with Wilson intervals
beside the paper's, the curves and the video of every drop.

Takes folders (with those in them) and files: logs of drops, the JSON that tunenet-tune
wrote of each, outcomes that tunenet-record --outcome wrote, or a CSV of outcomes with
the columns ball and success (also task, attempt, time, shot_height_m, miss_m,
drop_log, tuning, reason, note), and the rig's YAML (with "rig" in its name), by
which each shot is drawn as it was to be expected. An outcome belongs to the drop that
it names; a drop of that ball before it which none names was tried for the same
attempt. A JSON belongs to the log beside it, else to the one log of its name; drops
without one are tuned on the way, which takes seconds each."""

_EXAMPLES = """\
  tunenet-review campaign/ -o campaign.rrd
  tunenet-review drops/*.mcap tuned/*.json outcomes.csv -o today.rrd
  rerun campaign.rrd"""


def build_parser() -> Parser:
    """Build the argument parser."""
    parser = Parser(
        "tunenet-review", _DESCRIPTION, _EXAMPLES, failed="a file of the campaign could not be read"
    )
    add = parser.add_argument
    add("places", nargs="+", type=Path, metavar="CAMPAIGN", help="folder or file of the campaign")
    add("-o", "--output", type=Path, required=True, metavar="REVIEW.rrd", help="recording to write")
    add("--overwrite", action="store_true", help="replace the review of another campaign")
    jobs_option(parser, "drops at a time")
    add("--quiet", action="store_true", help="no progress bar")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run `tunenet-review`."""
    return run(build_parser(), _review, argv)


def _review(arguments: Any) -> int:
    output: Path = arguments.output
    if output.suffix != ".rrd":
        raise UsageError(f"{output}: what is written is a recording; name it {output.stem}.rrd")
    from tunenet_logs.analysis.campaign import (
        ball_rates,
        campaign_of,
        overall_rates,
        places_of,
        restitutions_by_ball,
    )
    from tunenet_logs.analysis.result_files import recording, subject_of
    from tunenet_logs.analysis.review.campaign import write_campaign
    from tunenet_logs.writing.owned_path import OutputPlace

    named = places_of(arguments.places)
    knows = recording("campaign", subject_of(named))
    place = OutputPlace(output, "review", knows, listed(named, 3), overwrite=arguments.overwrite)
    place.check()
    campaign = campaign_of(arguments.places, arguments.jobs, Progress(quiet=arguments.quiet), _warn)
    with place.replacing() as partial:
        write_campaign(campaign, partial)
    attempts = campaign.attempts
    if campaign.tuned_now:
        _warn(f"drops without a tuning, tuned now, nothing kept: {campaign.tuned_now}")
    for rate in (*overall_rates(attempts), *ball_rates(attempts)):
        if rate.count:
            low, high = rate.interval95
            paper = "" if rate.published is None else f"   paper {100 * rate.published:.0f} %"
            print(
                f"{short_name(rate.name, 30):30}  {rate.successes}/{rate.count} = "
                f"{100 * rate.fraction:.0f} % (95 %: {100 * low:.0f} to {100 * high:.0f} %){paper}"
            )
    for ball in restitutions_by_ball(attempts):
        sd = f" ± {ball.sd:.4f}" if len(ball.values) > 1 else ""
        print(
            f"{short_name(ball.name, 30):30}  restitution {ball.mean:.4f}{sd} ({len(ball.values)})"
        )
    print(f"\nreview: rerun {one_line(output)}")
    return 1 if campaign.unread else 0


def _warn(text: str) -> None:
    print(one_line(f"tunenet-review: {text}"), file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
