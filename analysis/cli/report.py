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
from tunenet_logs.errors import UsageError
from tunenet_logs.terminal import Progress, one_line

if TYPE_CHECKING:
    from tunenet_logs.analysis.report.page import Kind
    from tunenet_logs.analysis.result_files import Logs
    from tunenet_logs.writing.owned_path import OutputPlace

_DESCRIPTION = """\
One page of what was tuned, with everything in it: no network, under 3 MB. The verdict
first and what to do, parameters with 95 % intervals and what they mean, observed and
simulated curves, bounces, checks, iterations, the simulator's settings, where it comes
from. Takes JSONs that tunenet-tune wrote, and folders with them; several get an overview
and a comparison. A folder with outcomes is a campaign, as tunenet-review takes it.

The pictures of a filmed drop and the torques of an arm come from the review NAME.rrd
beside NAME.json; where it is not there, the page says so.

--png and --pdf write the figures for a paper, a column wide: a name with the suffix gets
the main one (curves; torques; of several tunings the comparison), a folder all of them.
Needs matplotlib and Jinja2: pip install 'tunenet-logs[report]'."""

_EXAMPLES = """\
  tunenet-report drop.json -o drop.html
  tunenet-report results/ -o results.html
  tunenet-report campaign/ -o campaign.html
  tunenet-report drop.json --pdf figures/"""


def build_parser() -> Parser:
    """Build the argument parser."""
    parser = Parser("tunenet-report", _DESCRIPTION, _EXAMPLES)
    add = parser.add_argument
    add("places", nargs="+", type=Path, metavar="TUNING.json", help="tunings, folders, campaigns")
    add("-o", "--output", type=Path, metavar="REPORT.html", help="page to write")
    add("--png", type=Path, metavar="FILE_OR_FOLDER", help="figures as PNG, 300 dpi")
    add("--pdf", type=Path, metavar="FILE_OR_FOLDER", help="figures as PDF, fonts within")
    add("--overwrite", action="store_true", help="replace results of other logs")
    jobs_option(parser, "drops of a campaign at a time")
    add("--quiet", action="store_true", help="no progress bar")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run `tunenet-report`."""
    return run(build_parser(), _report, argv)


def _report(arguments: argparse.Namespace) -> int:
    if not (arguments.output or arguments.png or arguments.pdf):
        raise UsageError("say what to write: -o REPORT.html, --png or --pdf")
    needed("matplotlib", "report")
    needed("jinja2", "report")
    from tunenet_logs.analysis.campaign import files_of
    from tunenet_logs.analysis.report.page import read_reported, report_page
    from tunenet_logs.analysis.result_files import check_place, logs_of

    inputs = list(files_of(arguments.places, _warn))
    if arguments.output:  # a campaign takes a while, and then says of which logs it is
        check_place(_page(arguments, {}, overwrite=True), "-o", (".html",), inputs)
    progress = Progress(quiet=arguments.quiet)
    reported = read_reported(arguments.places, arguments.jobs, progress, _warn)
    written: list[Path] = []
    logs = logs_of(one.record for one in reported.tunings)
    page = arguments.output and _page(arguments, logs, overwrite=arguments.overwrite)
    if page:
        page.check()
    from tunenet_logs.analysis.report.page import FigureOrder, write_figures

    places: dict[Kind, Path | None] = {"png": arguments.png, "pdf": arguments.pdf}
    orders = [
        FigureOrder(place, kind, inputs, overwrite=arguments.overwrite)
        for kind, place in places.items()
        if place is not None
    ]
    figures = [path for order in orders for path in write_figures(order, reported.tunings)]
    if page:
        with page.replacing() as partial:
            partial.write_text(report_page(reported), "utf-8")
        written.append(arguments.output)
    written += figures
    print("written: " + ", ".join(one_line(path) for path in written))
    return 0


def _page(arguments: argparse.Namespace, logs: Logs, *, overwrite: bool) -> OutputPlace:
    from tunenet_logs.analysis.result_files import in_words, marked
    from tunenet_logs.writing.owned_path import OutputPlace

    knows = marked("html", "page", logs)
    elsewhere = "give -o another file"
    return OutputPlace(
        arguments.output, "page", knows, in_words(logs), elsewhere, overwrite=overwrite
    )


def _warn(text: str) -> None:
    print(one_line(f"tunenet-report: {text}"), file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
