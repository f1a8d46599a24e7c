"""Read the tunings that a user names: JSONs of `tunenet-tune`, and folders with them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from analysis.campaign.files import files_of, natural
from analysis.comparison import distinct
from analysis.record import Record
from analysis.record_json import read_record
from tunenet_logs.errors import LogError
from tunenet_logs.outcome_reading import Warn
from tunenet_logs.regular_file import real_path

_MAX_DEPTH = 4  # folders in front of a name, at most, that tell it from an equal one


@dataclass(frozen=True, eq=False)
class TuningFile:
    """JSON of a tuning, and its record.

    Attributes:
        label: The log's name; with folders in front if several logs have it.
    """

    path: Path
    record: Record
    label: str


def read_tunings(places: Sequence[Path], warn: Warn) -> tuple[TuningFile, ...]:
    """Read tunings in the order they are named; those of a folder, searched recursively, by name.

    Raises:
        LogError: There is no such place, no tuning in any of them, or a named file is none.
    """
    named = {real_path(place) for place in places if place.is_file()}
    found: list[tuple[Path, Record]] = []
    for path in files_of(places, warn):
        is_named = real_path(path) in named
        if not is_named and path.suffix.lower() != ".json":
            continue
        try:
            found.append((path, read_record(path)))
        except LogError:
            if is_named:
                raise
    if not found:
        words = ", ".join(map(str, places))
        raise LogError(f"{words}: holds no tuning; give the .json that tunenet-tune wrote")
    labels = _labels(found)
    return tuple(
        TuningFile(path, record, label) for (path, record), label in zip(found, labels, strict=True)
    )


def in_order(tunings: Sequence[TuningFile]) -> tuple[TuningFile, ...]:
    """Sort by labels in natural order."""
    return tuple(sorted(tunings, key=lambda tuning: natural(tuning.label)))


def _labels(found: Sequence[tuple[Path, Record]]) -> list[str]:
    """Label logs; equal names get as many folders of their JSON as distinguish them."""
    names = [record.log or path.stem for path, record in found]
    counts = Counter(names)
    labels = list(names)
    for depth in range(_MAX_DEPTH):
        again = Counter(labels)
        for index, (path, _) in enumerate(found):
            if counts[names[index]] > 1 and again[labels[index]] > 1:
                folders = real_path(path).parent.parts[-1 - depth :]
                labels[index] = f"{names[index]} ({'/'.join([*folders, path.stem])})"
    return distinct(labels)
