"""Find the logs of a batch, copy remote ones to this machine, and choose where results go.

A user names files, folders, patterns and addresses: `s3://`, `gs://`, `az://`, `https://`, what
fsspec reads, with the keys that its libraries find. Each log is found once. No two logs write the
same results, and no result replaces a log.
"""

from __future__ import annotations

import glob
import os
import shutil
import sys
import tempfile
import time
from base64 import b64encode
from collections import Counter
from collections.abc import Callable, Coroutine, Iterable, Iterator, Sequence
from concurrent.futures import wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from email.utils import parsedate_to_datetime
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import urlsplit

from tunenet_logs.addresses import Address, scheme_of, without_secrets
from tunenet_logs.analysis.record import MAX_RECORD_BYTES, record_in
from tunenet_logs.errors import LogError, UsageError, pip_install
from tunenet_logs.files import read_small_file, real_path
from tunenet_logs.formats.readers.arrays import TUNINGS_USE
from tunenet_logs.formats.registry import (
    file_bytes,
    files_of,
    is_folder,
    is_log_folder,
    is_log_name,
    may_be_log,
)
from tunenet_logs.passwords import KnownLogin, netrc_login
from tunenet_logs.terminal import one_line, short_name
from tunenet_logs.writing.owned_path import ACTIVE_SUFFIX, check_folders

# ---- Find logs: resolve files, folders, patterns and addresses.

MAX_LOGS = 1_000_000  # in one batch, and entries of a folder that are looked at


@dataclass(frozen=True)
class FoundLog:
    """Log that was found."""

    log: Path | Address  # its path, or the address of one that is read over the network
    below: Path = Path()  # the folder below that of the results in which its own go


@dataclass(frozen=True)
class FoundLogs:
    """Logs that were found."""

    logs: tuple[FoundLog, ...]  # each once, those of a folder sorted by name
    left_out: int  # count of files in folders that are no logs by name and first bytes
    are_many: bool  # whether a folder or a pattern was named, or several logs


def is_remote(log: Path | Address | str) -> bool:
    """Return whether a log is read over the network."""
    return isinstance(log, Address) or "://" in str(log)


def find_logs(named: Sequence[Path | str]) -> FoundLogs:
    """Find the logs of paths, folders, patterns (`'logs/**/*.mcap'`) and addresses (`s3://...`).

    A folder that is one log, such as a bag's, is that log. One without any log counts as a log,
    so that reading reports why it is none. No link to a folder is followed.
    """
    found: dict[Path | Address, FoundLog] = {}
    places, left_out = list(_places(named)), 0
    are_many = max(len(named), len(places)) > 1
    folders = sum(isinstance(place, Path) and is_folder(place) for place in places)
    for place in places:
        if isinstance(place, Address):
            known = found.setdefault(place, FoundLog(place)).log
            if isinstance(known, Address) and known.full_url != place.full_url:
                raise UsageError(
                    f"{place}: is named twice, with other logins or signatures; name it once, or "
                    "tune what are two logs one at a time, into folders of their own (-o)"
                )
            continue
        is_many = is_folder(place) and not is_log_folder(place)
        inside, others = _walked(place) if is_many else ([], 0)
        if not inside:
            found.setdefault(real_path(place), FoundLog(place))
            continue
        are_many, left_out = True, left_out + others
        root = Path(real_path(place).name) if folders > 1 else Path()
        for log in inside:
            below = root / log.parent.relative_to(place)
            found.setdefault(real_path(log), FoundLog(log, below))
        if len(found) > MAX_LOGS:
            raise UsageError(f"{place}: over {MAX_LOGS} logs; tune some of its folders at a time")
    return FoundLogs(tuple(found.values()), left_out, are_many)


def _places(named: Iterable[Path | str]) -> Iterator[Path | Address]:
    """Yield paths and addresses of single logs, with patterns expanded."""
    for one in named:
        if is_remote(one):
            yield from remote_logs(str(one))
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


def _walked(folder: Path) -> tuple[list[Path], int]:
    """Return the logs in a folder and those below it, by name, and the count of other files."""
    logs: list[Path] = []
    left_out = seen = 0
    waiting = [(folder, 0, True)]  # with its depth, and whether it is a folder; the next one last
    while waiting:
        path, depth, is_dir = waiting.pop()
        if is_dir and not (depth and is_log_folder(path)):
            if depth > 64:  # folders within folders
                continue
            try:
                with os.scandir(path) as entries:
                    inside = sorted(entries, key=lambda entry: entry.name, reverse=True)
            except OSError as error:
                raise UsageError(f"{path}: cannot be read ({error.strerror})") from error
            seen += len(inside)
            if seen > MAX_LOGS:
                raise UsageError(f"{path}: over {MAX_LOGS} files; tune some folders at a time")
            waiting += [
                (path / entry.name, depth + 1, entry.is_dir(follow_symlinks=False))
                for entry in inside
                if not entry.name.startswith(".")
            ]
        elif is_dir or may_be_log(path):
            logs.append(path)
        else:
            left_out += 1
    return logs, left_out


@dataclass(frozen=True)
class LogState:
    """Size and modification time of a log, to detect cheaply whether it changed."""

    size: int = -1  # of all of its files [bytes]; -1 if unknown
    modified_ns: int = 0  # the last change of any of them, on the file system's clock

    @classmethod
    def of(cls, log: Path) -> LogState:
        """Read the state of a log on this machine; -1 and 0 if it cannot be read."""
        try:
            files = [log, *files_of(log)]
            return cls(file_bytes(log), max(one.stat().st_mtime_ns for one in files))
        except (OSError, ValueError):
            return cls()


# ---- Remote logs: list them, and copy each to this machine while it is tuned.

# Of addresses; none that names a file of this machine.
_SCHEMES = ("s3", "gs", "gcs", "az", "abfs", "http", "https")

_CONNECT_S, _SILENT_S = 8, 8  # for which a server may say nothing, when it is called and later
_MIN_BYTES = 10_000  # in any `_SILENT_S`: slower than a modem, a copy would never end
_UNTOLD_BYTES = 500_000_000  # of a log whose size its server does not tell, or that unpacks


def remote_logs(named: str) -> Iterator[Address]:
    """Yield the addresses of one log, of a folder's logs (`.../`), or of a pattern."""
    address = log_address(named)
    is_pattern = not set("*?[").isdisjoint(address.url) and not address.url.startswith("http")
    if not is_pattern and not address.url.endswith("/"):
        yield address
        return
    files, path = _opened(address)
    try:
        # A folder may take a minute to list.
        found = _answer(files, files._glob(path) if is_pattern else files._find(path), 60)
    except Exception as error:
        raise UsageError(f"{address}: {_why(error)}") from error
    names = [str(name) for name in islice(sorted(found), MAX_LOGS + 1)]
    logs = [name for name in names if is_pattern or is_log_name(PurePosixPath(name).name)]
    if not logs:
        raise UsageError(f"{address}: no log has such an address")
    yield from (address.beside(str(files.unstrip_protocol(name))) for name in logs)


def remote_state(address: Address) -> LogState:
    """Return size and last change of a log; -1 and 0 if its server does not report them."""
    try:
        files, path = _opened(address)
        known = _answer(files, files._info(path))
        if address.url.startswith("http"):
            told = known.get("Last-Modified")
            changed = parsedate_to_datetime(told) if told else None
        else:
            changed = files.modified(path)
        modified_ns = round(changed.timestamp() * 1e9) if changed else 0
        return LogState(int(known["size"]), modified_ns)
    except Exception:  # noqa: BLE001 (each library has its own)
        return LogState()


@contextmanager
def fetched(address: Address) -> Iterator[Path]:
    """Open a temporary copy of a log on this machine, under its own name."""
    from fsspec.callbacks import Callback

    class Bounded(Callback):
        """Abort a copy that would fill the disk, even if its server reported a smaller size."""

        told = came = 0
        free = sys.maxsize

        def set_size(self, size: int | None) -> None:
            self.told = size or 0

        def relative_update(self, inc: int = 1) -> None:
            self.came += inc
            if self.came > self.free:
                raise LogError(f"{address}: is larger than the space that is free; free some")
            if self.came > max(self.told, _UNTOLD_BYTES):
                raise LogError(
                    f"{address}: unpacks to over {_UNTOLD_BYTES // 1_000_000} MB, or more than its "
                    "server stated; copy it here yourself, if you trust it"
                )

    with tempfile.TemporaryDirectory(prefix="tunenet-") as folder:
        copy = Path(folder) / (address.name or "log")
        counted = Bounded()
        # A copy never fills the last tenth of the free space.
        counted.free = round(0.9 * shutil.disk_usage(folder).free)
        try:
            files, path = _opened(address)
            copying = files._get_file(path, str(copy), callback=counted)
            _answer(files, copying, came=lambda: counted.came)
        except LogError:
            raise
        except Exception as error:
            is_unknown = getattr(error, "status", 0) == 401
            trouble = _login(address).trouble if is_unknown else ""
            raise LogError(
                f"{address}: cannot be read ({_why(error)}{trouble and f', and {trouble}'})",
                "check the address and your rights to it",
            ) from error
        yield copy


def _answer(
    files: Any,
    asking: Coroutine[Any, Any, Any],
    longest_s: float | None = None,
    came: Callable[[], int] = lambda: 0,
) -> Any:
    """Await a call of a file system in fsspec's thread; abandon it when it stalls (TimeoutError).

    It stalls when under `_MIN_BYTES` came in `longest_s` (None: `_SILENT_S`), by what `came` says.
    """
    import asyncio

    answer = asyncio.run_coroutine_threadsafe(asking, files.loop)
    longest_s = longest_s or _SILENT_S
    known, since_s = came(), time.monotonic()
    try:
        while not answer.done():
            # A look each half second at a call under way.
            wait((answer,), 0.5)  # a signal is answered at once
            if came() - known >= _MIN_BYTES:
                known, since_s = came(), time.monotonic()
            if time.monotonic() - since_s > longest_s and not answer.done():
                raise TimeoutError(f"under {_MIN_BYTES} bytes came in {longest_s:g} s")
        return answer.result()
    finally:
        answer.cancel()


def log_address(named: str) -> Address:
    """Parse a log's address."""
    if scheme_of(named) not in _SCHEMES or "::" in named:  # a chain may name files of this machine
        raise UsageError(
            f"{one_line(named)}: is no address that is read; write one with "
            f"{', '.join(f'{one}://' for one in _SCHEMES)}, or a path"
        )
    address = Address.of(named)
    if address.password is not None and address.url.startswith(("gs", "gcs", "az", "abfs")):
        raise UsageError(
            f"{address}: a login in such an address is not read; its library finds your keys "
            "(tunenet docs scale)"
        )
    return address


def _opened(address: Address) -> tuple[Any, str]:
    """Return the file system of an address, and the path there."""
    options: dict[str, Any] = {}
    try:
        from fsspec.core import url_to_fs

        if address.url.startswith("s3"):
            if address.user:
                options |= {"key": address.user, "secret": address.password}
            # Attempts at a server that is silent; s3fs has more of its own.
            options["config_kwargs"] = {
                "connect_timeout": _CONNECT_S,
                "read_timeout": _SILENT_S,
                "retries": {"total_max_attempts": 2},
            }
        elif address.url.startswith("http"):
            from aiohttp import ClientTimeout

            options["headers"] = {"Accept-Encoding": "identity"}
            known = _login(address)
            if known.user or known.password:  # of each request: aiohttp gives it to no other host
                proof = b64encode(f"{known.user}:{known.password}".encode()).decode()
                options["headers"]["Authorization"] = f"Basic {proof}"
            patience = ClientTimeout(total=None, sock_connect=_CONNECT_S, sock_read=_SILENT_S)
            options["client_kwargs"] = {"timeout": patience}
            options["encoded"] = address.url.isascii() and " " not in address.url  # as was signed
        files, path = url_to_fs(address.url, **options)
    except ImportError as error:
        raise UsageError(
            f"{address}: {_why(error)}; logs over the network need the extra: "
            + pip_install("remote")
        ) from error
    return files, str(path)


def _login(address: Address) -> KnownLogin:
    """Return the login of the address, else of its host in `~/.netrc`."""
    if address.password is not None:
        return KnownLogin(address.user, address.password)
    return netrc_login(urlsplit(address.url).hostname or "", address.user)


def _why(error: BaseException) -> str:
    """Describe an error without quoting an address, which may hold secrets."""
    status = getattr(error, "status", None)  # of aiohttp
    if type(error).__name__ == "TooManyRedirects":
        return "its server sends from one address to the next"
    if isinstance(status, int) and status:
        return f"{status} {short_name(getattr(error, 'message', ''))}".strip()
    if isinstance(error, FileNotFoundError):
        return "nothing is there"
    return short_name(one_line(error) or type(error).__name__, 200)


# ---- Result names: choose the path of each log's results.

OF_BATCH = "ledger"  # what the files of a whole batch are called, without the suffix


def result_files(name: Path) -> tuple[Path, Path]:
    """Return the paths of the JSON and the review of one log."""
    return name.with_name(name.name + ".json"), name.with_name(name.name + ".rrd")


def result_names(logs: Sequence[FoundLog], folder: Path | None) -> list[Path]:
    """Choose the path of each log's results, without the suffix.

    Logs of one stem get their folder's name, or keep their suffix: `drop.mcap` beside `drop.mp4`.
    """
    if folder is None and any(is_remote(one.log) for one in logs):
        raise UsageError("results of logs that are read over the network need a place; give -o DIR")
    ways = [_names_of(one, folder) for one in logs]
    names = [way[0] for way in ways]
    taken = Counter(names)
    taken[(folder or Path()) / OF_BATCH] += 1
    for at in range(1, 4):
        better = [
            name if taken[name] < 2 else way[at] for way, name in zip(ways, names, strict=True)
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
    # No result replaces a log.
    inputs = {real_path(one.log) for one in logs if isinstance(one.log, Path)}
    real = {folder: real_path(folder) for folder in {name.parent for name in names}}
    for path in (path for name in names for path in result_files(name)):
        is_link_to_one = path.is_symlink() and real_path(path) in inputs
        if real[path.parent] / path.name in inputs or is_link_to_one:
            with suppress(LogError, ValueError):
                if record_in(read_small_file(path, MAX_RECORD_BYTES)).provenance is not None:
                    raise UsageError(f"{path}: is a tuning that tunenet-tune wrote", TUNINGS_USE)
            raise UsageError(f"{path}: is a log, and would be replaced by results; choose -o DIR")
    if folder is not None:
        if folder.exists() and not folder.is_dir():
            raise LogError(f"{folder}: is not a folder; choose another with -o")
        for below in {one.below for one in logs}:
            check_folders(folder, below)
    return names


def _names_of(one: FoundLog, folder: Path | None) -> tuple[Path, ...]:
    """Return what a log's results may be called: by stem, with parent, with suffix, with both."""
    log = one.log
    if isinstance(log, Address):
        plain, parent, is_file = Path(log.name), log.parent_name, True
    else:  # one without a name (`.`) is resolved
        plain = real_path(log) if log.name in ("", "..") else log
        parent, is_file = real_path(log).parent.name, not is_folder(plain)
    name = stem = os.fsencode(plain.name).decode(errors="replace") or "log"
    if is_file:
        stem = name.removesuffix(ACTIVE_SUFFIX).rsplit(".", 1)[0] or name
    place = plain.parent if folder is None else folder / one.below
    return tuple(place / each for each in (stem, f"{parent}_{stem}", name, f"{parent}_{name}"))
