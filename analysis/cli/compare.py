"""tunenet-compare: compare the tunings of several logs."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tunenet_logs.console import Parser, run
from tunenet_logs.errors import UsageError, pip_install
from tunenet_logs.terminal import one_line

if TYPE_CHECKING:
    from tunenet_logs.analysis.compare import Comparison
    from tunenet_logs.analysis.record import Record
    from tunenet_logs.writing.owned_path import OutputPlace

_OPTIONS = {"pairs": "csv"}  # by which an output is asked for that has no option of its own
_DESCRIPTION = f"""\
Parameters of several tunings side by side with their 95 % intervals, and which of them
differ by more than these explain. Takes the JSONs that tunenet-tune wrote, and folders
with them. Tunings of different tasks or presets are shown, and never compared.

The test: the difference of two values against their own intervals (errors normal and
independent, added by squares), at 5 % after Holm's correction over the pairs of one
parameter. A value without an interval is not compared, and neither are two tunings of
one recording. Restitutions are compared at the lower of two impact speeds where the
slope is known; else it is said that a difference may be the speed's.

--csv FILE also writes the tests, to FILE with _pairs before its suffix. --html and --png
need matplotlib and Jinja2: {pip_install("report")}."""

_EXAMPLES = """\
  tunenet-compare red.json blue.json
  tunenet-compare results/ --csv balls.csv
  tunenet-compare before/drop.json after/drop.json --html compared.html --png compared.png"""


def build_parser() -> Parser:
    """Build the argument parser."""
    parser = Parser(
        "tunenet-compare", _DESCRIPTION, _EXAMPLES, failed="there is nothing to compare"
    )
    add = parser.add_argument
    add("places", nargs="+", type=Path, metavar="TUNING.json", help="tunings, folders with them")
    add("--csv", type=Path, metavar="FILE", help="write all values as a table, and all tests")
    add("--html", type=Path, metavar="FILE", help="write one self-contained page")
    add("--png", type=Path, metavar="FILE", help="write curves and intervals as a picture")
    add("--overwrite", action="store_true", help="replace results of other logs")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run `tunenet-compare`."""
    return run(build_parser(), _compare, argv)


def _compare(arguments: argparse.Namespace) -> int:
    from tunenet_logs.analysis.campaign import read_tunings
    from tunenet_logs.analysis.compare import compare
    from tunenet_logs.analysis.presentation import comparison_text
    from tunenet_logs.analysis.registry import needed

    tunings = read_tunings(arguments.places, _warn)
    places = _places(arguments, [tuning.record for tuning in tunings])
    inputs = [tuning.path for tuning in tunings]
    from tunenet_logs.analysis.result_files import check_place

    for name, place in places.items():
        option = _OPTIONS.get(name, name)
        check_place(place, f"--{option}", (f".{option}",), inputs)
    if arguments.html or arguments.png:
        needed("matplotlib", "report")
        needed("jinja2", "report")
    comparison = compare(
        [tuning.record for tuning in tunings], [tuning.label for tuning in tunings]
    )
    written = _write(places, comparison)
    print(comparison_text(comparison))
    if written:
        print("\nwritten: " + ", ".join(one_line(path) for path in written))
    return 0 if comparison.groups else 1


def _places(arguments: argparse.Namespace, records: Sequence[Record]) -> dict[str, OutputPlace]:
    """Return the output places that were asked for: "csv", "pairs", "html", "png"."""
    from tunenet_logs.analysis.compare import COLUMNS, PAIR_COLUMNS
    from tunenet_logs.analysis.result_files import in_words, logs_of, marked, review_name, table
    from tunenet_logs.writing.owned_path import OutputPlace

    logs = logs_of(records)

    def lost(row: Mapping[str, str]) -> str | None:
        known_by = review_name(row["log_sha256"]) or row["log"]
        return None if known_by in logs else row["log"]

    kinds = {
        "csv": (arguments.csv, "table of tunings", table(COLUMNS, lost)),
        "pairs": (
            arguments.csv
            and arguments.csv.with_name(f"{arguments.csv.stem}_pairs{arguments.csv.suffix}"),
            "table of tests",
            table(PAIR_COLUMNS, lambda _row: None),
        ),
        "html": (arguments.html, "comparison", marked("html", "comparison", logs)),
        "png": (arguments.png, "figure", marked("png", "figure", logs)),
    }
    return {
        name: OutputPlace(
            path,
            what,
            knows,
            in_words(logs),
            f"give --{_OPTIONS.get(name, name)} another file",
            overwrite=arguments.overwrite,
        )
        for name, (path, what, knows) in kinds.items()
        if path is not None
    }


def _write(places: Mapping[str, OutputPlace], comparison: Comparison) -> list[Path]:
    from tunenet_logs.files import csv_line

    for name, told in (("csv", comparison.to_frame), ("pairs", comparison.pairs_frame)):
        if name in places:
            frame = told()
            lines = (csv_line(row) for row in (frame.columns, *frame.itertuples(index=False)))
            with places[name].replacing() as partial:
                partial.write_text("".join(lines), "utf-8")
    if "html" in places:
        from tunenet_logs.analysis.report.page import comparison_page

        with places["html"].replacing() as partial:
            partial.write_text(comparison_page(comparison), "utf-8")
    if "png" in places:
        from tunenet_logs.analysis.report.figures import comparison_drawings
        from tunenet_logs.analysis.report.page import write_figure
        from tunenet_logs.analysis.result_files import logs_of, mark

        path = places["png"].path
        drawings = comparison_drawings(comparison)
        if not drawings:
            raise UsageError(f"{path}: these tunings have nothing to draw together")
        made = mark("figure", logs_of(comparison.records))
        with places["png"].replacing() as partial:
            write_figure(drawings[0].figure, partial, "png", made)
    return [place.path for place in places.values()]


def _warn(text: str) -> None:
    print(one_line(f"tunenet-compare: {text}"), file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
