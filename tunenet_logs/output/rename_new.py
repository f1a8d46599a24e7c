"""Rename without replacing, and have the disk keep the new name."""

from __future__ import annotations

import ctypes
import errno
import os
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

_HERE = -100  # instead of an open folder: names are relative to the working directory (AT_FDCWD)
_REPLACE_NOTHING = 1  # the flag of Linux's renameat2 (RENAME_NOREPLACE)
# How kernels and file systems (exFAT, NFS) say that they rename only by replacing.
_NO_SUCH_CALL = (errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP)


def rename_new(old: Path, new: Path) -> None:
    """Rename a file without ever replacing another (renameat2 with RENAME_NOREPLACE).

    Raises:
        FileExistsError: the new name is taken; nothing was changed.
        OSError: it cannot be renamed; nothing was changed.
    """
    call = _renameat2()
    if call is not None:
        if call(_HERE, os.fsencode(old), _HERE, os.fsencode(new), _REPLACE_NOTHING) == 0:
            return
        number = ctypes.get_errno()
        if number not in _NO_SUCH_CALL:
            raise OSError(number, os.strerror(number), str(old), None, str(new))
    take_and_rename(old, new)


def take_and_rename(old: Path, new: Path) -> None:
    """Rename without that call: an empty file takes the name first.

    A process that is killed in between leaves that, and the old name.

    Raises:
        FileExistsError: the new name is taken; nothing was changed.
        OSError: it cannot be renamed; nothing was changed.
    """
    os.close(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666))
    try:
        old.replace(new)
    except BaseException:
        new.unlink(missing_ok=True)
        raise


def sync_folder(folder: Path) -> None:
    """Sync a folder's names to disk (`fsync`), unless its file system cannot."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


@cache
def _renameat2() -> Any:
    """Return the C library's call; None where it has none."""
    try:
        call = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):
        return None
    call.argtypes = (ctypes.c_int, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_uint)
    return call
