"""Many logs, several at a time: one bad log never stops the rest."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from analysis.processes import Piece, parallel_map
from analysis.record import Provenance, Tuning, record_of
from analysis.record_json import to_json
from analysis.report import Row, row_of
from analysis.result_files import check_own, log_sha256, replacing
from analysis.review.tuning_review import write_review
from analysis.selection import Options, Selection
from analysis.tuning import tune_log
from tunenet_logs.commandline import print_traceback
from tunenet_logs.errors import LogError, UsageError, WeightsError
from tunenet_logs.formats.registry import is_folder
from tunenet_logs.output.log_place import ACTIVE_SUFFIX
from tunenet_logs.regular_file import real_path
from tunenet_logs.terminal import Progress

_Also = Callable[[Tuning, Provenance], None]
"""Writes something of a tuning, and raises LogError or OSError where it cannot."""


@dataclass(frozen=True)
class Result:
    """What came of a log, and where it went.

    Attributes:
        review: the recording to open; None if there is nothing to show.
        trouble: why results could not be written, one line; None if they were.
    """

    row: Row
    review: Path | None = None
    trouble: str | None = None


@dataclass(frozen=True)
class _OneLog:
    """One log, and where its results go, without the suffix."""

    log: Path
    name: Path


def tune_all(
    logs: Sequence[Path],
    options: Options,
    folder: Path | None,
    jobs: int,
    progress: Progress,
    *,
    overwrite: bool = False,
    also: _Also | None = None,
) -> list[Result]:
    """Tune every log, write its JSON and review, and return what came out in the logs' order.

    Args:
        logs: a log that is named twice is tuned once.
        options: for all of them.
        folder: where results go; None for beside each log.
        jobs: processes.
        progress: shows how many are done.
        overwrite: whether results of other logs may be replaced.
        also: writes what else is to be kept of a tuning, or says why not in a LogError or OSError.

    Raises:
        UsageError: the options fit no log at all, or two logs would write the same results.
    """
    logs = list({real_path(log): log for log in logs}.values())
    pieces = [Piece(_OneLog(*pair)) for pair in zip(logs, _names(logs, folder), strict=True)]
    work = partial(_tuned_and_written, options=options, overwrite=overwrite, also=also)
    lost = partial(_lost, options=options)
    what = ("tuning", "log")
    return parallel_map(work, pieces, jobs, progress, what, may_stay=True, lost=lost)


def _lost(work: _OneLog, options: Options) -> Result:
    return _rejected(work.log, options, "the process that tuned it died (out of memory?)")


def _rejected(log: Path, options: Options, reason: str, trouble: str | None = None) -> Result:
    tuning = Tuning(log, options.task, options.preset, "rejected", reason)
    return Result(row_of(tuning, record_of(tuning)), trouble=trouble)


def _tuned_and_written(
    work: _OneLog,
    options: Options,
    *,
    overwrite: bool,
    also: _Also | None,
) -> Result:
    """Tune one log and write its results; runs in the worker processes."""
    log, (report, recording) = work.log, _results(work.name)
    sha256 = ""
    try:
        with suppress(OSError):  # reading and writing say why in our own words
            sha256 = log_sha256(log)
            if not overwrite:
                check_own(report, recording, log, sha256)
    except LogError as error:
        return _rejected(log, options, "not tuned: its results would replace others", str(error))
    try:
        tuning = tune_log(log, options)
    except (UsageError, WeightsError):  # the same for every log
        raise
    except Exception as error:  # noqa: BLE001 (a defect of ours must not cost the other logs)
        print_traceback()
        reason = f"unexpected {type(error).__name__}: {error}; please report it with the log"
        tuning = Tuning(log, options.task, options.preset, "rejected", reason)
    provenance = _provenance(tuning, sha256, options)
    record = record_of(tuning, provenance)
    row, review = row_of(tuning, record), None
    try:
        is_log = log.is_file() or tuning.episode is not None  # a folder may be one
        if is_log and (sha256 or not report.exists()):
            work.name.parent.mkdir(parents=True, exist_ok=True)
            episode = tuning.episode
            if episode is not None and (episode.signals or episode.picture_topics):
                review = recording
                with replacing(review) as unfinished:
                    write_review(tuning, record, unfinished)
            with replacing(report) as unfinished:
                unfinished.write_text(to_json(record), "utf-8", errors="backslashreplace")
    except (OSError, UnicodeError) as error:  # the latter for a name that Rerun cannot take
        place, why = work.name.parent, "its name is not UTF-8"
        if isinstance(error, OSError):
            place, why = error.filename or place, error.strerror
        trouble = f"{place}: cannot be written ({why}); choose another folder with -o"
        return Result(row, None, trouble)
    return Result(row, review, also and _trouble(also, tuning, provenance))


def _trouble(also: _Also, tuning: Tuning, provenance: Provenance) -> str | None:
    """Keep what else is wanted of a tuning; why that was not possible, else None."""
    try:
        also(tuning, provenance)
    except LogError as error:
        return str(error)
    except OSError as error:
        return f"{error.filename}: cannot be written ({error.strerror}); choose another place"
    return None


def _provenance(tuning: Tuning, sha256: str, options: Options) -> Provenance:
    """Where the record of a tuning comes from."""
    return Provenance(
        version=version("tunenet-logs"),
        log_sha256=sha256,
        options={**_given(options, Options()), **_given(options.selection, Selection())},
        tares=tuple(_named(tare) for tare in options.selection.tares if isinstance(tare, Path)),
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        engine=None if tuning.simulator is None else tuning.simulator["engine"],
    )


def _named(tare: Path) -> dict[str, str]:
    """A tare's name and SHA-256."""
    try:
        return {"log": tare.name, "sha256": log_sha256(tare)}
    except OSError:  # the tuning was rejected for it
        return {"log": tare.name, "sha256": ""}


def _given(options: Options | Selection, defaults: Options | Selection) -> dict[str, Any]:
    """What differs from the defaults, as JSON has it; files by their names."""
    found: dict[str, Any] = {}
    for field in fields(options):
        value = getattr(options, field.name)
        if value == getattr(defaults, field.name) or field.name in ("selection", "tares"):
            continue
        if isinstance(value, Path):
            value = value.name
        elif field.name in ("hints", "ball"):
            value = {part.name: getattr(value, part.name) for part in fields(value)}
        elif field.name == "arm" and isinstance(value, tuple):
            value = {"urdf": value[0].name, "tool_link": value[1]}
        elif field.name == "arm_card":
            value = {"file": value.file, "logs": [run["log"] for run in value.runs]}
        found[field.name] = value
    return found


def _results(name: Path) -> tuple[Path, Path]:
    """The JSON and the review of one log."""
    return name.with_name(name.name + ".json"), name.with_name(name.name + ".rrd")


def _name(log: Path, folder: Path | None) -> Path:
    """That of one log: a file's without its suffix; a folder's is its own, and beside it."""
    log = real_path(log) if log.name in ("", "..") else log
    name = os.fsencode(log.name).decode(errors="replace") or "log"
    stem = name if is_folder(log) else name.removesuffix(ACTIVE_SUFFIX).rsplit(".", 1)[0]
    return (folder or log.parent) / (stem or name)


def _names(logs: Sequence[Path], folder: Path | None) -> list[Path]:
    """Where each log's results go, without the suffix; logs of one stem get their folder's name."""
    names = [_name(log, folder) for log in logs]
    taken = Counter(names)
    names = [
        name.with_name(f"{real_path(log).parent.name}_{name.name}") if taken[name] > 1 else name
        for log, name in zip(logs, names, strict=True)
    ]
    first: dict[Path, Path] = {}
    for log, name in zip(logs, names, strict=True):
        other = first.setdefault(name, log)
        if other != log:
            raise UsageError(
                f"{other} and {log} would both write {_results(name)[0]}; "
                "tune them one by one, each with a folder of its own (-o DIR)"
            )
    inputs = {real_path(log) for log in logs}
    for name in names:
        for path in _results(name):
            if real_path(path) in inputs:
                raise UsageError(
                    f"{path}: is a log, and would be replaced by results; choose -o DIR"
                )
    if folder is not None and folder.exists() and not folder.is_dir():
        raise LogError(f"{folder}: is not a folder; choose another with -o")
    return names
