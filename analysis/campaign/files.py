"""Sort the files of a campaign into logs of drops, tunings and outcomes."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from analysis.campaign.tuned_drop import TunedDrop, read_tuned_drop
from tunenet_logs.errors import LogError
from tunenet_logs.formats.registry import is_folder
from tunenet_logs.outcome import Outcome
from tunenet_logs.outcome_reading import Warn, holds_outcomes, numbered, read_outcomes
from tunenet_logs.regular_file import real_path
from tunenet_logs.terminal import listed

# Suffixes of what is taken for a recording of a drop wherever it is found.
_LOGS = frozenset((".mcap", ".bag", ".db3", ".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v"))

# The same for a file that the user names: a table that merely lies in a folder may be anything.
_NAMED_LOGS = _LOGS | {".csv", ".tsv"}

_TABLES = frozenset((".csv", ".tsv", ".txt"))  # suffixes of what may be a table of outcomes
# Of one folder: a campaign has hundreds; somebody named the wrong folder, a home or a disk.
_MAX_FILES = 20_000

_MAX_ENTRIES = 100_000  # that are looked at, with folders: those can be many without a file in them


@dataclass(frozen=True)
class Material:
    """Contents of a campaign's files.

    Attributes:
        outcomes: Sorted by time.
        drops: Tuned, sorted by name.
        untuned: Logs without a tuning.
        roots: Folders that outcomes may name files from.
    """

    outcomes: tuple[Outcome, ...]
    drops: tuple[TunedDrop, ...]
    untuned: tuple[Path, ...]
    roots: tuple[Path, ...]


def material_of(places: Sequence[Path], warn: Warn) -> Material:
    """Sort the files of folders, and files that were named.

    Args:
        places: Files, and folders, which are searched recursively.
        warn: Called with what cannot be read.

    Raises:
        LogError: There is no such place or no file of a campaign in it, or a table of outcomes is
            invalid.
    """
    named = frozenset(real_path(place) for place in places if place.is_file())
    outcomes: list[Outcome] = []
    drops: list[TunedDrop] = []
    logs: list[Path] = []
    outcome_files: list[Path] = []
    for file in files_of(places, warn):
        suffixes = _NAMED_LOGS if real_path(file) in named else _LOGS
        try:
            if file.suffix.lower() == ".json":
                drops += filter(None, [read_tuned_drop(file)])
            elif found := _outcomes(file, warn):
                outcomes += found
                outcome_files.append(file)
            elif file.suffix.lower() in suffixes:
                logs.append(file)
        except OSError as error:
            warn(f"{file}: cannot be read ({error.strerror})")
    if not (outcomes or drops or logs):
        words = ", ".join(map(str, places))
        raise LogError(
            f"{words}: holds no drop and no outcome; name a folder with logs that tunenet-record "
            "wrote, and the tunings beside them"
        )
    roots = tuple(dict.fromkeys(place if place.is_dir() else place.parent for place in places))
    no_drops = {real_path(file) for file in outcome_files}
    drops = [
        drop
        for drop in _with_logs(drops, [*logs, *outcome_files], warn)
        if drop.log is None or real_path(drop.log) not in no_drops
    ]
    texts = {outcome.tuning for outcome in outcomes if outcome.tuning}
    drops = _one_each(
        drops, frozenset(real_path(root / text) for text in texts for root in roots), warn
    )
    tuned = {real_path(drop.log) for drop in drops if drop.log is not None}
    return Material(
        outcomes=tuple(sorted(numbered(outcomes), key=lambda outcome: outcome.stamp_ns)),
        drops=tuple(sorted(drops, key=lambda drop: natural(drop.name))),
        untuned=tuple(log for log in logs if not tuned & {real_path(log), real_path(log).parent}),
        roots=roots,
    )


def holds_campaign(places: Sequence[Path]) -> bool:
    """Return whether outcomes are among these files; unreadable ones are skipped."""

    def is_outcome(file: Path) -> bool:
        try:
            return bool(_outcomes(file, _silent))
        except (LogError, OSError):
            return False

    return any(map(is_outcome, files_of(places, _silent)))


def _silent(_: str) -> None:
    """Ignore a warning: the next reader of these files reports it."""


def natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Return a natural sort key: drop_2 before drop_10."""
    parts: list[tuple[int, int, str]] = []
    text = ""
    for letter in [*name, ""]:
        if text and (not letter or letter.isdecimal() != text[-1].isdecimal()):
            is_number = text.isdecimal()
            parts.append((0, int(text), "") if is_number else (1, 0, text))
            text = ""
        text += letter
    return tuple(parts)


def files_of(places: Iterable[Path], warn: Warn) -> Iterator[Path]:
    """Yield every file of the places once, folders recursively."""
    seen: set[Path] = set()
    for place in places:
        if not place.exists():
            raise LogError(f"{place}: no such file or folder", "check its name")
        found = _inside(place, warn) if place.is_dir() else [place]
        for file in found:
            if (full := real_path(file)) not in seen:
                seen.add(full)
                if _is_regular(file, warn):
                    yield file


def _inside(folder: Path, warn: Warn) -> list[Path]:
    """List the files of a folder and its subfolders, its own first; links are not followed."""
    found: list[Path] = []
    waiting = [folder]
    looked = 0
    while waiting:
        root = waiting.pop()
        try:
            with os.scandir(root) as entries:
                every = list(islice(entries, _MAX_ENTRIES))
        except OSError as error:
            warn(f"{root}: cannot be read ({error.strerror})")
            continue
        looked += len(every)
        folders = [entry.name for entry in every if entry.is_dir(follow_symlinks=False)]
        names = [entry.name for entry in every if not _is_folder(entry)]
        found += [Path(root, name) for name in sorted(names, key=natural)]
        waiting += [Path(root, name) for name in sorted(folders, reverse=True)]
        if len(found) > _MAX_FILES or looked >= _MAX_ENTRIES:
            most = (
                f"{_MAX_FILES} files"
                if len(found) > _MAX_FILES
                else f"{_MAX_ENTRIES} files and folders"
            )
            warn(f"{folder}: holds over {most}; those beyond are left out")
            return found[:_MAX_FILES]
    return found


def _is_folder(entry: os.DirEntry[str]) -> bool:
    """Return whether it is a folder or a link to one; circular links are not."""
    return entry.is_dir(follow_symlinks=False) or (
        entry.is_symlink() and is_folder(Path(entry.path))
    )


def _is_regular(file: Path, warn: Warn) -> bool:
    """Return whether it is a file or a link to one; warn of pipes and circular links."""
    try:
        if file.is_file():
            return True
    except OSError as error:
        warn(f"{file}: cannot be read ({error.strerror})")
        return False
    if file.suffix.lower() in _NAMED_LOGS | _TABLES | {".json"}:
        warn(f"{file}: is no regular file; it is left out")
    return False


def _outcomes(file: Path, warn: Warn) -> Sequence[Outcome]:
    """Read a file's outcomes; none if it is something else.

    Raises:
        LogError: A table of outcomes is invalid.
        OSError: It cannot be read.
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


def _with_logs(drops: Iterable[TunedDrop], logs: Iterable[Path], warn: Warn) -> list[TunedDrop]:
    """Match tunings that lie apart from their logs by name; warn and skip if ambiguous."""
    by_name: dict[str, list[Path]] = {}
    for log in logs:
        by_name.setdefault(log.name, []).append(log)
    placed: list[TunedDrop] = []
    for drop in drops:
        same = by_name.get(drop.name, []) if drop.log is None else []
        if len(same) > 1:
            warn(
                f"{drop.tuning}: is left out, as {len(same)} logs are called {drop.name} "
                f"({listed(map(str, same))}); put it beside its own"
            )
        else:
            placed.append(replace(drop, log=same[0]) if same else drop)
    return placed


def _one_each(drops: Sequence[TunedDrop], named: frozenset[Path], warn: Warn) -> list[TunedDrop]:
    """Keep one tuning per log, by `_rank`, so that no drop is counted twice."""
    by_log: dict[Path, list[TunedDrop]] = {}
    for drop in drops:
        if drop.log is not None:
            by_log.setdefault(real_path(drop.log), []).append(drop)
    kept = [drop for drop in drops if drop.log is None]
    for log, several in by_log.items():
        chosen = min(several, key=lambda drop: _rank(drop, named))
        if len(several) > 1:
            warn(f"{log}: has {len(several)} tunings; {chosen.tuning} counts")
        kept.append(chosen)
    return kept


def _rank(drop: TunedDrop, named: frozenset[Path]) -> tuple[bool, bool, str]:
    """Rank tunings of one log: named by an outcome first, then named as the log is."""
    tuning, log = drop.tuning or Path(), drop.log or Path()
    return real_path(tuning) not in named, tuning.stem != log.stem, str(tuning)
