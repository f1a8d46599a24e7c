"""List remote logs, and copy each to this machine while it is tuned.

`s3://`, `gs://`, `az://`, `https://`: what fsspec reads, with the keys that its libraries find.
"""

from __future__ import annotations

import asyncio
import shutil
import sys
import tempfile
import time
from base64 import b64encode
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import wait
from contextlib import contextmanager
from datetime import datetime
from email.utils import parsedate_to_datetime
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import urlsplit

from analysis.batch.ledger_row import LogState
from tunenet_logs.addresses import Address, scheme_of
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.formats.log_names import is_log_name
from tunenet_logs.passwords import KnownLogin, netrc_login
from tunenet_logs.terminal import one_line, short_name

# Of addresses. Those that name files of this machine, or another within them, are none.
_SCHEMES = ("s3", "gs", "gcs", "az", "abfs", "http", "https")

_CONNECT_S, _SILENT_S = 8, 8  # for which a server may say nothing, when it is called and later
_MIN_BYTES = 10_000  # that come in any `_SILENT_S`: slower than a modem, it would never end
_LISTING_S = 60  # for which a folder may be listed
_UNTOLD_BYTES = 500_000_000  # of a log whose size its server does not tell, or that unpacks

_LOOK_S = 0.5

_ATTEMPTS = 2  # of a request to a server that is silent; s3fs has more of its own
_KEPT_FREE = 0.1  # of the disk's free space, never filled by a copy
_MAGIC = frozenset("*?[")


def remote_logs(named: str, most: int) -> Iterator[Address]:
    """Yield at most `most` addresses of a log, of the logs in a folder (`.../`), or of a pattern.

    Raises:
        UsageError: It names nothing, the server does not answer, or its library is not installed.
    """
    address = log_address(named)
    is_pattern = bool(_MAGIC & set(address.url)) and not address.url.startswith("http")
    if not is_pattern and not address.url.endswith("/"):
        yield address
        return
    files, path = _opened(address)
    try:
        found = _answer(files, files._glob(path) if is_pattern else files._find(path), _LISTING_S)
    except Exception as error:
        raise UsageError(f"{address}: {_why(error)}") from error
    names = [str(name) for name in islice(sorted(found), most + 1)]
    logs = [name for name in names if is_pattern or is_log_name(PurePosixPath(name).name)]
    if not logs:
        raise UsageError(f"{address}: no log has such an address")
    yield from (address.beside(str(files.unstrip_protocol(name))) for name in logs)


def remote_state(address: Address) -> LogState:
    """Return size and last change of a log; -1 and 0 if its server does not report them."""
    try:
        files, path = _opened(address)
        known = _answer(files, files._info(path))
        if not address.url.startswith("http"):
            return LogState(int(known["size"]), _ns(files.modified(path)))
        changed = known.get("Last-Modified")
        return LogState(int(known["size"]), _ns(parsedate_to_datetime(changed)) if changed else 0)
    except Exception:  # noqa: BLE001 (each library has its own)
        return LogState()


@contextmanager
def fetched(address: Address) -> Iterator[Path]:
    """Open a temporary copy of a log on this machine, under its own name.

    Raises:
        LogError: It cannot be read, or is larger than the disk.
    """
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
                    "server told of; copy it here yourself, if you trust it"
                )

    with tempfile.TemporaryDirectory(prefix="tunenet-") as folder:
        copy = Path(folder) / (address.name or "log")
        counted = Bounded()
        counted.free = round((1 - _KEPT_FREE) * shutil.disk_usage(folder).free)
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
    """Await a call in fsspec's thread, and abandon it when it stalls.

    Args:
        files: An fsspec file system, whose calls are coroutines.
        asking: The call.
        longest_s: Longest time with under `_MIN_BYTES` received; `_SILENT_S` by default.
        came: Returns the bytes received so far.

    Raises:
        TimeoutError: The call stalled.
    """
    answer = asyncio.run_coroutine_threadsafe(asking, files.loop)
    longest_s = longest_s or _SILENT_S
    known, since_s = came(), time.monotonic()
    try:
        while not answer.done():
            wait((answer,), _LOOK_S)  # a signal is answered at once
            if came() - known >= _MIN_BYTES:
                known, since_s = came(), time.monotonic()
            if time.monotonic() - since_s > longest_s and not answer.done():
                raise TimeoutError(f"under {_MIN_BYTES} bytes came in {longest_s:g} s")
        return answer.result()
    finally:
        answer.cancel()


def log_address(named: str) -> Address:
    """Parse a log's address.

    Raises:
        UsageError: Such addresses are not read.
    """
    if scheme_of(named) not in _SCHEMES or "::" in named:  # a chain may name files of this machine
        raise UsageError(
            f"{one_line(named)}: is no address that is read; write one with "
            f"{', '.join(f'{one}://' for one in _SCHEMES)}, or a path"
        )
    address = Address.of(named)
    if address.password is not None and address.url.startswith(("gs", "gcs", "az", "abfs")):
        raise UsageError(
            f"{address}: a login in such an address is not read; its library finds your keys "
            "(docs/scale.md)"
        )
    return address


def _ns(changed: datetime) -> int:
    return round(changed.timestamp() * 1e9)


def _opened(address: Address) -> tuple[Any, str]:
    """Return the file system of an address, and the path there.

    Raises:
        UsageError: A library for it is not installed.
    """
    options: dict[str, Any] = {}
    try:
        from fsspec.core import url_to_fs

        if address.url.startswith("s3"):
            if address.user:
                options |= {"key": address.user, "secret": address.password}
            options["config_kwargs"] = {
                "connect_timeout": _CONNECT_S,
                "read_timeout": _SILENT_S,
                "retries": {"total_max_attempts": _ATTEMPTS},
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
            "pip install 'tunenet-logs[remote]'"
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
