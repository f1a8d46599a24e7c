"""Resolve files, folders, patterns and addresses that a user names into logs."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tunenet_logs.addresses import Address, without_secrets
from tunenet_logs.errors import UsageError
from tunenet_logs.formats.log_names import is_log_folder, may_be_log
from tunenet_logs.regular_file import real_path

MAX_LOGS = 1_000_000  # in one batch, and entries of folders that are looked at for each of them
_MAX_DEPTH = 64  # folders within folders


@dataclass(frozen=True)
class FoundLog:
    """Log that was found.

    Attributes:
        log: its path, or the address of one that is read over the network.
        below: the folder below that of the results in which its own go.
    """

    log: Path | Address
    below: Path = Path()


@dataclass(frozen=True)
class FoundLogs:
    """Logs that were found.

    Attributes:
        logs: Each once, those of a folder sorted by name.
        left_out: Count of files in folders that are no logs by name and first bytes.
        are_many: Whether a folder or a pattern was named, or several logs.
    """

    logs: tuple[FoundLog, ...]
    left_out: int
    are_many: bool


def is_remote(log: Path | Address | str) -> bool:
    """Return whether a log is read over the network."""
    return isinstance(log, Address) or "://" in str(log)


def find_logs(named: Sequence[Path | str]) -> FoundLogs:
    """Find the logs of paths, folders, patterns (`'logs/**/*.mcap'`) and addresses (`s3://...`).

    A folder that is one log, such as a bag's, is that log. One without any log counts as a log,
    so that reading reports why it is none. No link to a folder is followed.

    Raises:
        UsageError: A pattern matches nothing, there are too many logs, an address does not answer,
            or one is named twice with different logins or signatures.
    """
    found: dict[Path | Address, FoundLog] = {}
    left_out, are_many = 0, len(named) > 1
    places = list(_places(named))
    are_many = are_many or len(places) > 1
    folders = sum(isinstance(place, Path) and _is_folder(place) for place in places)
    for place in places:
        if not isinstance(place, Path):
            known = found.setdefault(place, FoundLog(place)).log
            if isinstance(known, Address) and known.full_url != place.full_url:
                raise UsageError(
                    f"{place}: is named twice, with other logins or signatures; name it once, or "
                    "tune what are two logs one at a time, into folders of their own (-o)"
                )
            continue
        inside = _Walk(place) if _is_folder(place) and not is_log_folder(place) else None
        if inside is None or not inside.logs:
            found.setdefault(real_path(place), FoundLog(place))
            continue
        are_many, left_out = True, left_out + inside.left_out
        root = Path(real_path(place).name) if folders > 1 else Path()
        for log in inside.logs:
            below = root / log.parent.relative_to(place)
            found.setdefault(real_path(log), FoundLog(log, below))
        if len(found) > MAX_LOGS:
            raise UsageError(f"{place}: over {MAX_LOGS} logs; tune some of its folders at a time")
    return FoundLogs(tuple(found.values()), left_out, are_many)


def _places(named: Iterable[Path | str]) -> Iterator[Path | Address]:
    """Yield paths and addresses of single logs, with patterns expanded."""
    for one in named:
        if is_remote(one):
            from analysis.batch.remote_logs import remote_logs

            yield from remote_logs(str(one), MAX_LOGS)
            continue
        path = Path(one)
        if without_secrets(str(one)) != str(one) and not os.path.lexists(path):
            raise UsageError(
                f"{one}: no such file, and no address; begin one with https:// or s3://"
            )
        if os.path.lexists(path) or not glob.has_magic(str(path)):
            yield path
            continue
        matches = sorted(glob.glob(str(path), recursive=True))  # noqa: PTH207 (absolute ones too)
        if not matches:
            raise UsageError(f"{path}: no file has such a name")
        yield from map(Path, matches)


class _Walk:
    """The logs in a folder and those below it; `logs` in the order of their names."""

    def __init__(self, folder: Path) -> None:
        self.logs: list[Path] = []
        self.left_out = 0
        self._seen = 0
        self._look(folder, 0)

    def _look(self, folder: Path, depth: int) -> None:
        try:
            with os.scandir(folder) as entries:
                inside = sorted(entries, key=lambda entry: entry.name)
        except OSError as error:
            raise UsageError(f"{folder}: cannot be read ({error.strerror})") from error
        self._seen += len(inside)
        if self._seen > MAX_LOGS:
            raise UsageError(f"{folder}: over {MAX_LOGS} files; tune some folders at a time")
        for entry in inside:
            path = folder / entry.name
            if entry.name.startswith("."):
                continue
            if entry.is_dir(follow_symlinks=False):
                if is_log_folder(path):
                    self.logs.append(path)
                elif depth < _MAX_DEPTH:
                    self._look(path, depth + 1)
            elif may_be_log(path):
                self.logs.append(path)
            else:
                self.left_out += 1


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False
