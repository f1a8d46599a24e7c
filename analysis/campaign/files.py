"""Which files of a campaign are what: recordings of drops, tunings of them, outcomes."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from analysis.campaign.pairing import one_each, with_logs
from analysis.campaign.tuned_drop import TunedDrop, read_tuned_drop
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.outcome import Outcome
from tunenet_logs.outcome_reading import holds_outcomes, numbered, read_outcomes

_LOGS = frozenset((".mcap", ".bag", ".db3", ".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v"))
_TABLES = frozenset((".csv", ".tsv", ".txt"))
_NAMED = _LOGS | {".csv", ".tsv"}
"""What is a log where it is named; a table in a folder may be anything."""
_MOST_FILES = 20_000

Warn = Callable[[str], None]


@dataclass(frozen=True)
class Material:
    """What a campaign's files hold.

    Attributes:
        outcomes: in the order of their times.
        drops: tuned, in the order of their names.
        untuned: recordings that no tuning speaks of.
        roots: the folders that outcomes may name files from.
    """

    outcomes: tuple[Outcome, ...]
    drops: tuple[TunedDrop, ...]
    untuned: tuple[Path, ...]
    roots: tuple[Path, ...]


def material_of(places: Sequence[Path], warn: Warn) -> Material:
    """Sort the files of folders, and files that were named.

    Args:
        places: folders are gone through with those in them.
        warn: told of what cannot be read.

    Raises:
        UsageError: there is no such place, or nothing of a campaign in it.
        LogError: a table of outcomes is wrong.
    """
    named = frozenset(one.resolve() for one in places if one.is_file())
    outcomes: list[Outcome] = []
    drops: list[TunedDrop] = []
    logs: list[Path] = []
    told: list[Path] = []
    for file in _files(places, warn):
        suffixes = _NAMED if file.resolve() in named else _LOGS
        try:
            if file.suffix.lower() == ".json":
                drops += filter(None, [read_tuned_drop(file)])
            elif found := _outcomes(file, warn):
                outcomes += found
                told.append(file)
            elif file.suffix.lower() in suffixes:
                logs.append(file)
        except OSError as error:
            warn(f"{file}: cannot be read ({error.strerror})")
    if not (outcomes or drops or logs):
        words = ", ".join(str(one) for one in places)
        raise UsageError(
            f"{words}: holds no drop and no outcome; name a folder with logs that tunenet-record "
            "wrote, and the tunings beside them"
        )
    roots = tuple(dict.fromkeys(one if one.is_dir() else one.parent for one in places))
    drops = with_logs(drops, [*logs, *told], warn)
    no_drops = {one.resolve() for one in told}
    drops = [one for one in drops if one.log is None or one.log.resolve() not in no_drops]
    drops = one_each(drops, _tunings(outcomes, roots), warn)
    tuned = {one.log.resolve() for one in drops if one.log is not None}
    return Material(
        outcomes=tuple(sorted(numbered(outcomes), key=lambda one: one.stamp_ns)),
        drops=tuple(sorted(drops, key=lambda one: natural(one.name))),
        untuned=tuple(one for one in logs if not tuned & {one.resolve(), one.resolve().parent}),
        roots=roots,
    )


def natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sorts names as people count: drop_2 before drop_10."""
    parts: list[tuple[int, int, str]] = []
    text = ""
    for letter in [*name, ""]:
        if text and (not letter or letter.isdecimal() != text[-1].isdecimal()):
            is_number = text.isdecimal()
            parts.append((0, int(text), "") if is_number else (1, 0, text))
            text = ""
        text += letter
    return tuple(parts)


def _files(places: Iterable[Path], warn: Warn) -> Iterator[Path]:
    """Every file once."""
    seen: set[Path] = set()
    for place in places:
        if not place.exists():
            raise UsageError(f"{place}: no such file or folder")
        found = _inside(place, warn) if place.is_dir() else [place]
        for file in found:
            if (full := file.resolve()) not in seen:
                seen.add(full)
                yield file


def _inside(folder: Path, warn: Warn) -> list[Path]:
    found: list[Path] = []
    for root, folders, names in os.walk(folder):
        folders.sort()
        found += [Path(root, name) for name in sorted(names, key=natural)]
        if len(found) > _MOST_FILES:
            warn(f"{folder}: holds over {_MOST_FILES} files; those beyond are left out")
            return found[:_MOST_FILES]
    return found


def _tunings(outcomes: Iterable[Outcome], roots: Sequence[Path]) -> frozenset[Path]:
    """Those that outcomes name."""
    texts = {one.tuning for one in outcomes if one.tuning}
    return frozenset((root / text).resolve() for text in texts for root in roots)


def _outcomes(file: Path, warn: Warn) -> Sequence[Outcome]:
    """Those of a file; none of a log or a text that holds something else.

    Raises:
        LogError: a table of outcomes is wrong.
        OSError: it cannot be read.
    """
    suffix = file.suffix.lower()
    if suffix not in _TABLES and suffix != ".mcap":
        return ()
    try:
        if not holds_outcomes(file):
            return ()
    except LogError as error:
        warn(str(error))
        return ()
    try:
        return read_outcomes(file, warn)
    except LogError:
        if suffix in _TABLES:
            raise
        return ()
