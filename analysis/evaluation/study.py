"""What the experiments of `tunenet-eval` share: their choices, the form of figures, their files.

Methods and sections stand here by name, as the modules that have them take a second to load.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tunenet_logs.errors import UsageError
from tunenet_logs.files import csv_line

if TYPE_CHECKING:
    from tunenet_logs.writing.owned_path import OutputPlace


# Those of `studies.drop_methods`.
METHODS = (
    *("mean", "entropy-search", "cma-es", "direct", "tunenet-paper", "tunenet-paper-code"),
    *("secant", "brent", "least-squares", "tpe", "npe"),
    *("network", "ours"),
    *("concatenation", "difference", "antisymmetric"),
)

# Those of `studies.video`: on tracks, and on clips.
SECTIONS = ("set-A", "set-B", "set-C", "slope", "drag", "bad", "clips", "transformed")

SHOT_SECTIONS = ("campaigns", "drops")  # policies in the hidden world, and verdicts on its drops
REAL_SECTIONS = ("positions", "balls", "films")  # those of `studies.real_balls`
# Drops of a cell for each seed; fewer make fewer of the table's balls in proportion.
FULL_REAL = 200

FULL_SHOT = 60  # trials of a campaign; fewer make fewer drops in proportion
# Users' models tuned, with a parameter that a log cannot tell, of another machine, by another
# toolbox, and by the network's first step.
SYSID_SECTIONS = ("tuned", "untold", "wrong", "toolbox", "network")

FULL_SYSID = 200  # logs of a machine and section for each seed; a twentieth for the network
# Bounces by their sound alone, the same by phyphox's way, sounds that are no bounce, films with
# their sound, and tracks with a sound that is not theirs; balls whose impacts differ, alone and in
# films.
SOUND_SECTIONS = (
    *("alone", "phyphox", "negatives", "films", "unrelated"),
    *("uneven", "uneven-films"),
)

FULL_SOUND = 200  # clips at a ratio, sounds, films and tracks for each seed
FULL_ENGINES = 10  # targets of a range for each seed and pair of engines
# Table 1 of the paper, logs like a real driver's, arms that share no code with the fit, and what
# their drivers mean by torque.
PAYLOAD_SECTIONS = ("masses", "logs", "strangers", "conventions")

# Those that are made where none is named: the others take over an hour.
TYPICAL_PAYLOAD_SECTIONS = ("masses", "logs")

FULL_PAYLOAD = 300  # targets of a set for each seed, and two thirds as many logs of a case in all
# Logs of a cell in all, and logs whose drivers mean different things by torque.
FULL_STRANGERS, FULL_CONVENTIONS = 400, 1000

FULL_VIDEO = 200  # tracks for each seed and line of `video`; fewer make fewer clips in proportion


def chosen_sections(
    arguments: argparse.Namespace, available: Sequence[str], usual: Sequence[str] = ()
) -> Sequence[str]:
    """Return the tables that `--sections` lists, or the usual ones, or all.

    Raises:
        UsageError: one is not available.
    """
    wanted = chosen_names(arguments, "sections", available) or usual or available
    for name in wanted:
        if name not in available:
            raise UsageError(f"no section {name!r}; there is: {', '.join(available)}")
    return wanted


def chosen_names(
    arguments: argparse.Namespace, option: str, available: Sequence[str]
) -> tuple[str, ...] | None:
    """Return the names that an option lists; None where it is not given.

    Raises:
        UsageError: it lists none.
    """
    listed = getattr(arguments, option)
    if listed is None:
        return None
    names = tuple(filter(None, (name.strip() for name in listed.split(","))))
    if not names:
        raise UsageError(f"--{option} names none; there is: {', '.join(available)}")
    return names


# ---- Records: JSON and CSV.


def json_text(content: Mapping[str, Any]) -> str:
    """Serialise to indented JSON; a figure that does not exist is null, never NaN.

    Raises:
        ValueError: a number is NaN or infinite.
    """
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def csv_text(columns: Sequence[str], records: Sequence[Mapping[str, Any]]) -> str:
    """Format a header and one line a record; None is an empty field."""
    rows = (csv_line(record.get(name) for name in columns) for record in records)
    return csv_line(columns) + "".join(rows)


# ---- Tables: errors, seeds and rows as text.


NEGLIGIBLE = 1e-9  # an error below this is rounding of float64, and is written as none
# An error keeps two digits: in four decimals from the first on, below it in five, and below the
# second in scientific notation (0.000949 is .00095, 0.0000949 is 9.5e-5).
_FOUR_DIGITS_FROM = 0.00095
_SCIENTIFIC_BELOW = 0.000095


def short(error: float) -> str:
    """Format an error in at most 6 characters: four decimals, or two digits if it is less."""
    if error < NEGLIGIBLE:
        return "<1e-9"
    if error < _SCIENTIFIC_BELOW:
        return f"{error:.1e}".replace("e-0", "e-")
    return f"{error:.{4 if error >= _FOUR_DIGITS_FROM else 5}f}".removeprefix("0")


def short_or_dash(error: float | None) -> str:
    """Format by `short`; a dash where there is none."""
    return "-" if error is None else short(error)


def seeds_in_words(seeds: Sequence[int]) -> str:
    """Describe seeds, as "seed 1" or "seeds 1 to 3"."""
    return f"seed {seeds[0]}" if len(seeds) == 1 else f"seeds {seeds[0]} to {seeds[-1]}"


def table_line(cells: Sequence[str], widths: Sequence[int]) -> str:
    """Left-align columns to these widths [characters]; widths beyond the cells are not used."""
    fitted = [cell.ljust(width) for cell, width in zip(cells, widths, strict=False)]
    return "".join(fitted).rstrip()


# ---- Files of figures: whole or not there, marked with the experiment that they are of.


_KIND = "figures"
_MADE_BY = "tunenet_eval"  # the first column of every table: the experiment


@dataclass(frozen=True)
class FigurePlace:
    """Destination of an experiment's figures."""

    experiment: str  # by name
    place: OutputPlace  # of the file

    @classmethod
    def of(cls, experiment: str, form: str, path: Path, *, overwrite: bool) -> FigurePlace:
        """Make the destination of one option: "json", "csv", "png" or "rrd"; see `OutputPlace`."""
        from tunenet_logs.analysis.result_files import marked, recording, table
        from tunenet_logs.writing.owned_path import OutputPlace

        logs = _as_logs(experiment)
        knows = {
            "json": marked("json", _KIND, logs),
            "png": marked("png", _KIND, logs),
            "rrd": recording("eval drop", ""),
            "csv": table([_MADE_BY], lambda row: row[_MADE_BY].replace(experiment, "") or None),
        }[form]
        more = (experiment, f"give --{form} another file", overwrite)
        return cls(experiment, OutputPlace(path, "file of figures", knows, *more))

    @property
    def mark(self) -> str:
        """Mark by which the file is known."""
        from tunenet_logs.analysis.result_files import mark

        return mark(_KIND, _as_logs(self.experiment))


def _as_logs(experiment: str) -> dict[str, str]:
    return {experiment: experiment}


def write_text_to(to: FigurePlace, text: str) -> None:
    """Write a table, with the experiment in each row."""
    header, *rows = csv.reader(io.StringIO(text))
    made = io.StringIO()
    writer = csv.writer(made, lineterminator="\n")
    writer.writerow([_MADE_BY, *header])
    writer.writerows([to.experiment, *row] for row in rows)
    with to.place.replacing() as partial:
        partial.write_text(made.getvalue(), "utf-8")


def write_json_to(to: FigurePlace, text: str) -> None:
    """Write a JSON, to a file or to standard output."""
    from tunenet_logs.analysis.result_files import write_json

    write_json(to.place, text.replace("{\n", f'{{\n "made": "{to.mark}",\n', 1))
