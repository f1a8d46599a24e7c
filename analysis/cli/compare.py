"""tunenet-compare: what was tuned from several logs, side by side."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tunenet_logs.commandline import Parser, run
from tunenet_logs.errors import UsageError
from tunenet_logs.terminal import one_line

if TYPE_CHECKING:
    from analysis.comparison import Comparison

_DESCRIPTION = """\
Parameters of several tunings side by side with their 95 % intervals, and which of them
differ by more than these explain. Takes the JSONs that tunenet-tune wrote, and folders
with them. Tunings of different tasks or presets are shown, and never compared.

The test: the difference of two values against their own intervals (errors normal and
independent, added by squares), at 5 % after Holm's correction over the pairs of one
parameter. A value without an interval is not compared, and neither are two tunings of
one recording. Restitutions are compared at the lower of two impact speeds where the
slope is known; else it is said that a difference may be the speed's.

--csv FILE also writes the tests, to FILE with _pairs before its suffix. --html and --png
need matplotlib and Jinja2: pip install 'tunenet-logs[report]'."""

_EXAMPLES = """\
  tunenet-compare red.json blue.json
  tunenet-compare results/ --csv balls.csv
  tunenet-compare before/drop.json after/drop.json --html compared.html --png compared.png"""


def build_parser() -> Parser:
    """The command's arguments."""
    parser = Parser(
        "tunenet-compare", _DESCRIPTION, _EXAMPLES, failed="there is nothing to compare"
    )
    add = parser.add_argument
    add("places", nargs="+", type=Path, metavar="TUNING.json", help="tunings, folders with them")
    add("--csv", type=Path, metavar="FILE", help="write all values as a table, and all tests")
    add("--html", type=Path, metavar="FILE", help="write one self-contained page")
    add("--png", type=Path, metavar="FILE", help="write curves and intervals as a picture")
    add("--overwrite", action="store_true", help="replace what this command wrote before")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of `tunenet-compare`."""
    return run(build_parser(), _compare, argv)


def _compare(arguments: argparse.Namespace) -> int:
    from analysis.comparison import compare
    from analysis.comparison_text import comparison_text
    from analysis.optional_dependencies import needed
    from analysis.tuning_files import read_tunings

    tunings = read_tunings(arguments.places, _warn)
    _check_outputs(arguments, [tuning.path for tuning in tunings])
    if arguments.html or arguments.png:
        needed("matplotlib", "report")
        needed("jinja2", "report")
    comparison = compare(
        [tuning.record for tuning in tunings], [tuning.label for tuning in tunings]
    )
    written = _write(arguments, comparison)
    print(comparison_text(comparison))
    if written:
        print("\nwritten: " + ", ".join(one_line(path) for path in written))
    return 0 if comparison.groups else 1


def _check_outputs(arguments: argparse.Namespace, inputs: Sequence[Path]) -> None:
    from analysis.output_files import check_output

    for path, option, suffix in (
        (arguments.csv, "--csv", ".csv"),
        (arguments.csv and _pairs_path(arguments.csv), "--csv", ".csv"),
        (arguments.html, "--html", ".html"),
        (arguments.png, "--png", ".png"),
    ):
        if path is not None:
            check_output(path, option, (suffix,), inputs, overwrite=arguments.overwrite)


def _pairs_path(path: Path) -> Path:
    return path.with_name(f"{path.stem}_pairs{path.suffix}")


def _write(arguments: argparse.Namespace, comparison: Comparison) -> list[Path]:
    from analysis.result_files import replacing

    written: list[Path] = []
    if arguments.csv:
        frames = (comparison.to_frame(), comparison.pairs_frame())
        for path, frame in zip((arguments.csv, _pairs_path(arguments.csv)), frames, strict=True):
            with replacing(path) as partial:
                frame.to_csv(partial, index=False)
            written.append(path)
    if arguments.html:
        from analysis.report.page import comparison_page

        with replacing(arguments.html) as partial:
            partial.write_text(comparison_page(comparison), "utf-8")
        written.append(arguments.html)
    if arguments.png:
        from analysis.report.compared_figures import comparison_drawings
        from analysis.report.embedded import write_figure

        drawings = comparison_drawings(comparison)
        if not drawings:
            raise UsageError(f"{arguments.png}: these tunings have nothing to draw together")
        with replacing(arguments.png) as partial:
            write_figure(drawings[0].figure, partial, "png")
        written.append(arguments.png)
    return written


def _warn(text: str) -> None:
    print(one_line(f"tunenet-compare: {text}"), file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
