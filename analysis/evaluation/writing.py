"""Write files of figures: whole or not there, with the experiment that they are of."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tunenet_logs.output.owned_file import OutputPlace

_KIND = "figures"
_MADE_BY = "tunenet_eval"  # the first column of every table: the experiment


@dataclass(frozen=True)
class FigurePlace:
    """Destination of an experiment's figures.

    Attributes:
        experiment: by name.
        place: of the file.
    """

    experiment: str
    place: OutputPlace

    @classmethod
    def of(cls, experiment: str, form: str, path: Path, *, overwrite: bool) -> FigurePlace:
        """Make the destination of one option: "json", "csv", "png" or "rrd"; see `OutputPlace`."""
        from analysis.result_files import marked, recording, table
        from tunenet_logs.output.owned_file import OutputPlace

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
        from analysis.result_files import mark

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
    from analysis.result_files import write_json

    write_json(to.place, text.replace("{\n", f'{{\n "made": "{to.mark}",\n', 1))
