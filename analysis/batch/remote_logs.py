"""Logs that lie elsewhere, at an address: listed, and copied here once for as long as one is tuned.

`s3://`, `gs://`, `az://`, `https://`: what fsspec reads, with the keys that its libraries find.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any

from analysis.batch.ledger_row import LogState
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.formats.log_names import is_log_name
from tunenet_logs.terminal import one_line, short_name

_SCHEMES = ("s3", "gs", "gcs", "az", "abfs", "http", "https")
"""Of addresses. Those that name files of this machine, or another within them, are none."""

_CONNECT_S, _SILENT_S = 15, 30
"""For which a server may say nothing, when it is called and later."""

_ATTEMPTS = 2
"""Of a request to a server that is silent; s3fs has more of its own."""

_KEPT_FREE = 0.1
"""Of the disk's free space, never filled by a copy."""

_MAGIC = frozenset("*?[")


def remote_logs(address: str, most: int) -> Iterator[str]:
    """The addresses of logs that one names: a log's own, a folder's (`.../`), a pattern's.

    Args:
        address: with a scheme.
        most: so many are looked at.

    Raises:
        UsageError: it names nothing, nobody answers, or what asks is not installed.
    """
    scheme = address.partition("://")[0]
    is_pattern = bool(_MAGIC & set(address)) and scheme not in ("http", "https")
    if not is_pattern and not address.endswith("/"):
        _check(address)
        yield address
        return
    files, path = _opened(address)
    try:
        found = files.glob(path) if is_pattern else files.find(path)
    except Exception as error:
        raise UsageError(f"{address}: {_why(error)}") from error
    names = [str(name) for name in islice(sorted(found), most + 1)]
    logs = [name for name in names if is_pattern or is_log_name(PurePosixPath(name).name)]
    if not logs:
        raise UsageError(f"{address}: no log has such an address")
    yield from (str(files.unstrip_protocol(name)) for name in logs)


def remote_state(address: str) -> LogState:
    """Size and last change of a log; nothing where its server does not say."""
    try:
        files, path = _opened(address)
        size = int(files.info(path)["size"])
        return LogState(size, round(files.modified(path).timestamp() * 1e9))
    except Exception:  # noqa: BLE001 (each library has its own)
        return LogState()


@contextmanager
def fetched(address: str) -> Iterator[Path]:
    """A copy of a log on this machine, under its own name; it is gone afterwards.

    Raises:
        LogError: it cannot be read, or is larger than the disk.
    """
    from fsspec.callbacks import Callback

    class Bounded(Callback):
        """Ends a copy that would fill the disk, whatever its server said of its size."""

        left = 0

        def relative_update(self, inc: int = 1) -> None:
            self.left -= inc
            if self.left < 0:
                raise LogError(f"{address}: is larger than the space that is free; free some")

    with tempfile.TemporaryDirectory(prefix="tunenet-") as folder:
        copy = Path(folder) / (PurePosixPath(address.split("?", maxsplit=1)[0]).name or "log")
        counted = Bounded()
        counted.left = round((1 - _KEPT_FREE) * shutil.disk_usage(folder).free)
        try:
            files, path = _opened(address)
            files.get_file(path, str(copy), callback=counted)
        except LogError:
            raise
        except Exception as error:
            raise LogError(
                f"{address}: cannot be read ({_why(error)})",
                "check the address and your rights to it",
            ) from error
        yield copy


def _check(address: str) -> None:
    scheme = address.partition("://")[0]
    if scheme not in _SCHEMES or "::" in address:
        raise UsageError(
            f"{one_line(address)}: is no address that is read; write one with "
            f"{', '.join(f'{one}://' for one in _SCHEMES)}, or a path"
        )


def _opened(address: str) -> tuple[Any, str]:
    """The file system of an address, and the path there.

    Raises:
        UsageError: a library for it is not installed, or no such addresses are read.
    """
    _check(address)
    options: dict[str, Any] = {}
    try:
        from fsspec.core import url_to_fs

        if address.startswith("s3"):
            options["config_kwargs"] = {
                "connect_timeout": _CONNECT_S,
                "read_timeout": _SILENT_S,
                "retries": {"total_max_attempts": _ATTEMPTS},
            }
        elif address.startswith("http"):
            from aiohttp import ClientTimeout

            patience = ClientTimeout(total=None, sock_connect=_CONNECT_S, sock_read=_SILENT_S)
            options["client_kwargs"] = {"timeout": patience}
        files, path = url_to_fs(address, **options)
    except ImportError as error:
        raise UsageError(
            f"{address}: {_why(error)}; logs over the network need the extra: "
            "pip install 'tunenet-logs[remote]'"
        ) from error
    return files, str(path)


def _why(error: BaseException) -> str:
    return short_name(str(error) or type(error).__name__, 200)
