"""Open others' files for reading: regular ones alone, so that no opening ever waits."""

from __future__ import annotations

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path
from typing import TextIO

from tunenet_logs.errors import LogError

# Of the opening: a pipe or a terminal that took the file's name meanwhile holds nobody up.
_FLAGS = os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC


def open_regular(path: Path | str, *, follows: bool = True) -> BufferedReader:
    """Open a regular file, or a link to one where it `follows`, for reading bytes.

    A file that states a size of 0 is read as empty: those under /proc state it too, and reading
    one may wait for ever.

    Raises:
        LogError: it is a pipe, a socket or a device.
        OSError: it is a folder, a circle of links, or cannot be opened.
    """
    return open(path, "rb", opener=_opened if follows else _opened_itself)


def open_regular_text(
    path: Path | str, encoding: str, *, errors: str = "strict", newline: str | None = None
) -> TextIO:
    """Open a regular file as `open_regular` does, for reading text, with `open`'s arguments.

    Raises:
        LogError, OSError: as `open_regular`.
    """
    return open(path, encoding=encoding, errors=errors, newline=newline, opener=_opened)


def real_path(path: Path | str) -> Path:
    """Resolve links and dots of a path that need not exist, to compare it with another.

    Unlike `Path.resolve`, it takes a circle of links, and a name that no file can have, as it is.
    """
    try:
        return Path(os.path.realpath(path))
    except ValueError:  # a zero byte
        return Path(path)


def _opened_itself(path: str, flags: int) -> int:
    return _opened(path, flags, os.O_NOFOLLOW)


def _opened(path: str, _flags: int, more_flags: int = 0) -> int:
    """Open a descriptor; its own state is asked, so that nobody exchanges the file in between."""
    _check(path, Path(path).stat().st_mode)  # before it is opened: that alone starts some devices
    descriptor = os.open(path, _FLAGS | more_flags)
    try:
        state = os.fstat(descriptor)
        _check(path, state.st_mode)
        os.set_blocking(descriptor, True)
    except BaseException:
        os.close(descriptor)
        raise
    if state.st_size:
        return descriptor
    os.close(descriptor)
    return os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)


def _check(path: str, mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), path)
    if not stat.S_ISREG(mode):
        raise LogError(f"{path}: is no regular file; copy it to one first")
