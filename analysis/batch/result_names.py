"""Choose where each log's results go: without collisions, and never over a log."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from analysis.batch.found_logs import FoundLog, is_remote
from tunenet_logs.addresses import Address
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.formats.registry import is_folder
from tunenet_logs.output.log_place import ACTIVE_SUFFIX
from tunenet_logs.output.owned_file import check_folders
from tunenet_logs.regular_file import real_path

OF_BATCH = "ledger"  # what the files of a whole batch are called, without the suffix


def result_files(name: Path) -> tuple[Path, Path]:
    """Return the paths of the JSON and the review of one log."""
    return name.with_name(name.name + ".json"), name.with_name(name.name + ".rrd")


def result_names(logs: Sequence[FoundLog], folder: Path | None) -> list[Path]:
    """Choose the path of each log's results, without the suffix.

    Logs of one stem get their folder's name, or keep their suffix: `drop.mcap` beside `drop.mp4`.

    Args:
        logs: Each once.
        folder: For all results; None for beside each log.

    Raises:
        UsageError: Two logs would write the same results, or one would replace a log.
        LogError: The folder is none, or one within it is a link.
    """
    if folder is None and any(is_remote(one.log) for one in logs):
        raise UsageError("results of logs that are read over the network need a place; give -o DIR")
    names = [_folder_of(one, folder) / _stem(one.log) for one in logs]
    taken = Counter(names)
    taken[(folder or Path()) / OF_BATCH] += 1
    for rename in (_with_parent, _with_suffix, _with_both):
        better = [
            name if taken[name] < 2 else _folder_of(one, folder) / rename(one.log)
            for one, name in zip(logs, names, strict=True)
        ]
        counts = Counter(better)
        names = [new if counts[new] < 2 else old for new, old in zip(better, names, strict=True)]
        taken = Counter(names)
    for name, count in taken.items():
        if count > 1:
            both = [one.log for one, its in zip(logs, names, strict=True) if its == name]
            json_file = result_files(name)[0]
            raise UsageError(
                f"{both[0]} and {both[1]} would both write {json_file}; tune one at a time"
            )
    _check_inputs(logs, names)
    if folder is not None and folder.exists() and not folder.is_dir():
        raise LogError(f"{folder}: is not a folder; choose another with -o")
    if folder is not None:
        for below in {one.below for one in logs}:
            check_folders(folder, below)
    return names


def _check_inputs(logs: Sequence[FoundLog], names: Sequence[Path]) -> None:
    inputs = {real_path(one.log) for one in logs if isinstance(one.log, Path)}
    folders = {name.parent for name in names}
    real = {folder: real_path(folder) for folder in folders}
    for name in names:
        for path in result_files(name):
            if real[name.parent] / path.name in inputs or (
                path.is_symlink() and real_path(path) in inputs
            ):
                raise UsageError(
                    f"{path}: is a log, and would be replaced by results; choose -o DIR"
                )


def _folder_of(one: FoundLog, folder: Path | None) -> Path:
    if folder is not None:
        return folder / one.below
    return _plain(one.log).parent


def _plain(log: Path | Address) -> Path:
    """Return a log's path; one without a name (`.`) is resolved."""
    if isinstance(log, Address):
        return Path(log.name)
    return real_path(log) if log.name in ("", "..") else log


def _name(log: Path | Address) -> str:
    return os.fsencode(_plain(log).name).decode(errors="replace") or "log"


def _stem(log: Path | Address) -> str:
    """Return a file's name without its suffix, or a folder's name."""
    name = _name(log)
    if isinstance(log, Path) and is_folder(_plain(log)):
        return name
    return name.removesuffix(ACTIVE_SUFFIX).rsplit(".", 1)[0] or name


def _with_parent(log: Path | Address) -> str:
    return f"{_parent(log)}_{_stem(log)}"


def _with_suffix(log: Path | Address) -> str:
    return _name(log)


def _with_both(log: Path | Address) -> str:
    return f"{_parent(log)}_{_name(log)}"


def _parent(log: Path | Address) -> str:
    return log.parent_name if isinstance(log, Address) else real_path(log).parent.name
