"""Many logs, several at a time: one bad log never stops the rest."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from analysis.record import Row, row_of, to_json
from analysis.result_files import PARTIAL, replacing
from analysis.review.tuning_review import write_review
from analysis.tuning import Options, Tuning, tune_log
from tunenet_logs.commandline import print_traceback
from tunenet_logs.errors import LogError, UsageError, WeightsError
from tunenet_logs.formats.opening import is_folder
from tunenet_logs.output.log_place import ACTIVE_SUFFIX
from tunenet_logs.progress import Progress


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


def tune_all(
    logs: Sequence[Path], options: Options, folder: Path | None, jobs: int, progress: Progress
) -> list[Result]:
    """Tune every log, write its JSON and review, and return what came out in the logs' order.

    Raises:
        UsageError: the options fit no log at all, or two logs would write the same results.
    """
    logs = list({log.resolve(): log for log in logs}.values())
    names = _names(logs, folder)
    work = [(log, options, name) for log, name in zip(logs, names, strict=True)]
    with progress.bar(len(work), "tuning", "log") as bar:
        if min(jobs, len(work)) == 1:
            results = []
            for item in work:
                results.append(_one(*item))
                bar.update(1)
            return results
        return _in_processes(work, min(jobs, len(work)), bar.update)


def _in_processes(
    work: list[tuple[Path, Options, Path]], jobs: int, done: Callable[[int], object]
) -> list[Result]:
    results: dict[int, Result] = {}
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        futures = {pool.submit(_one, *item): index for index, item in enumerate(work)}
        for future in as_completed(futures):
            if not isinstance(future.exception(), BrokenProcessPool):
                results[futures[future]] = future.result()
                done(1)
    for index, item in enumerate(work):  # a process that dies takes its pool with it
        if index not in results:
            results[index] = _alone(*item)
            done(1)
    return [results[index] for index in range(len(work))]


def _alone(log: Path, options: Options, name: Path) -> Result:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        future: Future[Result] = pool.submit(_one, log, options, name)
        try:
            return future.result()
        except BrokenProcessPool:
            reason = "the process that tuned it died (out of memory?)"
            return Result(row_of(Tuning(log, options.task, options.preset, "rejected", reason)))


def _one(log: Path, options: Options, name: Path) -> Result:
    """Tune one log and write its results; runs in the worker processes."""
    try:
        tuning = tune_log(log, options)
    except (UsageError, WeightsError):  # the same for every log
        raise
    except Exception as error:  # noqa: BLE001 (a defect of ours must not cost the other logs)
        print_traceback()
        reason = f"unexpected {type(error).__name__}: {error}; please report it with the log"
        tuning = Tuning(log, options.task, options.preset, "rejected", reason)
    review = None
    report, recording = _results(name)
    try:
        if log.is_file() or tuning.episode is not None:  # a folder that is a log
            name.parent.mkdir(parents=True, exist_ok=True)
            episode = tuning.episode
            if episode is not None and (episode.signals or episode.picture_topics):
                review = recording
                with replacing(review) as partial:
                    write_review(tuning, partial)
            with replacing(report) as partial:
                partial.write_text(to_json(tuning), "utf-8", errors="backslashreplace")
    except (OSError, UnicodeError) as error:  # the latter for a name that Rerun cannot take
        place, why = name.parent, "its name is not UTF-8"
        if isinstance(error, OSError):
            place, why = str(error.filename or place).removesuffix(PARTIAL), error.strerror
        trouble = f"{place}: cannot be written ({why}); choose another folder with -o"
        return Result(row_of(tuning), None, trouble)
    return Result(row_of(tuning), review)


def _results(name: Path) -> tuple[Path, Path]:
    """The JSON and the review of one log."""
    return name.with_name(name.name + ".json"), name.with_name(name.name + ".rrd")


def _name(log: Path, folder: Path | None) -> Path:
    """That of one log: a file's without its suffix; a folder's is its own, and beside it."""
    log = log.resolve() if log.name in ("", "..") else log
    name = os.fsencode(log.name).decode(errors="replace") or "log"
    stem = name if is_folder(log) else name.removesuffix(ACTIVE_SUFFIX).rsplit(".", 1)[0]
    return (folder or log.parent) / (stem or name)


def _names(logs: Iterable[Path], folder: Path | None) -> list[Path]:
    """Where each log's results go, without the suffix; logs of one stem get their folder's name."""
    logs = list(logs)
    names = [_name(log, folder) for log in logs]
    taken = Counter(names)
    names = [
        name.with_name(f"{log.resolve().parent.name}_{name.name}") if taken[name] > 1 else name
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
    inputs = {log.resolve() for log in logs}
    for name in names:
        for path in _results(name):
            if path.resolve() in inputs:
                raise UsageError(
                    f"{path}: is a log, and would be replaced by results; choose -o DIR"
                )
    if folder is not None and folder.exists() and not folder.is_dir():
        raise LogError(f"{folder}: is not a folder; choose another with -o")
    return names
