"""Files of figures: whole or not there."""

from __future__ import annotations

from pathlib import Path


def write_text_to(path: Path, text: str) -> None:
    """Write a table, replacing the file."""
    from analysis.result_files import replacing

    with replacing(path) as partial:
        partial.write_text(text, "utf-8")


def write_json_to(path: Path, text: str) -> None:
    """Write a JSON, replacing the file, or to standard output."""
    from analysis.result_files import write_json

    write_json(path, text)
