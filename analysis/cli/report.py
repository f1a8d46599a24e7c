"""tunenet-report: write tunings as one page, and as figures for a paper."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tunenet_logs.analysis.options import jobs_option
from tunenet_logs.analysis.registry import needed
from tunenet_logs.console import Parser, run
from tunenet_logs.errors import UsageError, pip_install
from tunenet_logs.terminal import Progress, one_line

if TYPE_CHECKING:
    from tunenet_logs.analysis.report.page import Kind

_DESCRIPTION = f"""\
One page of what was tuned, with everything in it: no network, under 3 MB. The verdict
first and what to do, parameters with 95 % intervals and what they mean, observed and
simulated curves, bounces, checks, iterations, the simulator's settings, where it comes
from. Takes JSONs that tunenet-tune wrote, and folders with them; several get an overview
and a comparison. A folder with outcomes is a campaign, as tunenet-review takes it.

The pictures of a filmed drop, the torques of an arm and the signals of a model come from
the review NAME.rrd beside NAME.json; where it is not there, the page says so.

--png and --pdf write the figures for a paper, a column wide: a name with the suffix gets
the main one (curves; torques; signals; of several tunings the comparison), a folder all
of them. --csv writes observed and simulated curves, of an arm those of its torques.
Needs matplotlib and Jinja2: {pip_install("report")}."""

_EXAMPLES = """\
  tunenet-report drop.json -o drop.html
  tunenet-report results/ -o results.html
  tunenet-report campaign/ -o campaign.html
  tunenet-report drop.json --pdf figures/
  tunenet-report drop.json --csv drop_curves.csv"""


def build_parser() -> Parser:
    """Build the argument parser."""
    parser = Parser("tunenet-report", _DESCRIPTION, _EXAMPLES)
    add = parser.add_argument
    add("places", nargs="+", type=Path, metavar="TUNING.json", help="tunings, folders, campaigns")
    add("-o", "--output", type=Path, metavar="REPORT.html", help="page to write")
    add("--png", type=Path, metavar="FILE_OR_FOLDER", help="figures as PNG, 300 dpi")
    add("--pdf", type=Path, metavar="FILE_OR_FOLDER", help="figures as PDF, fonts within")
    add("--csv", type=Path, metavar="FILE_OR_FOLDER", help="curves by time, a file a tuning")
    add("--overwrite", action="store_true", help="replace results of other logs")
    jobs_option(parser, "drops of a campaign at a time")
    add("--quiet", action="store_true", help="no progress bar")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run `tunenet-report`."""
    return run(build_parser(), _report, argv)


def _report(arguments: argparse.Namespace) -> int:
    figures: dict[Kind, Path | None] = {
        "png": arguments.png,
        "pdf": arguments.pdf,
        "csv": arguments.csv,
    }
    if not (arguments.output or any(figures.values())):
        raise UsageError("say what to write: -o REPORT.html, --png, --pdf or --csv")
    needed("matplotlib", "report")
    needed("jinja2", "report")
    from tunenet_logs.analysis.report.page import write_report

    written = write_report(
        arguments.places,
        arguments.output,
        figures,
        Progress(quiet=arguments.quiet),
        lambda text: print(one_line(f"tunenet-report: {text}"), file=sys.stderr),
        jobs=arguments.jobs,
        overwrite=arguments.overwrite,
    )
    print("written: " + ", ".join(one_line(path) for path in written))
    return 0


if __name__ == "__main__":
    sys.exit(main())
