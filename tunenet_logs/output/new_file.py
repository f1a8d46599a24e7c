"""Write a small file whole, on the disk, or not at all; it never takes another's place."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from tunenet_logs.output.log_place import ACTIVE_SUFFIX
from tunenet_logs.output.rename_new import rename_new

# How file systems and kernels say that they know no file without a name, or cannot name it.
_NO_NAMELESS = (errno.EOPNOTSUPP, errno.EISDIR, errno.EINVAL, errno.ENOENT, errno.EPERM)


def write_new(path: Path, data: bytes) -> None:
    """Write a new file atomically: whole and on the disk before it has its name.

    A process that is killed leaves nothing, where the file system knows files without a name;
    elsewhere at most `NAME.active`, which no reader takes for the file.

    Raises:
        FileExistsError: `path` is taken; it stays as it is.
        OSError: it cannot be written; nothing is left.
    """
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        if not _write_nameless(path, data, folder):
            write_aside(path, data)
        os.fsync(folder)
    finally:
        os.close(folder)


def _write_nameless(path: Path, data: bytes, folder: int) -> bool:
    """Write an unnamed file, then link it; False where the file system does not do that."""
    try:
        file = os.open(path.parent, os.O_TMPFILE | os.O_WRONLY, 0o666)
    except OSError as error:
        if error.errno in _NO_NAMELESS:
            return False
        raise
    try:
        _write_all(file, data)
        # Only with a folder does os.link follow the link that /proc has for the open file.
        os.link(f"/proc/self/fd/{file}", path.name, dst_dir_fd=folder, follow_symlinks=True)
    except OSError as error:
        if error.errno in _NO_NAMELESS:
            return False
        raise
    finally:
        os.close(file)
    return True


def write_aside(path: Path, data: bytes) -> None:
    """Write under a name of its own, which no one else may take meanwhile, and rename.

    Raises:
        FileExistsError: `path` is taken, or about to be.
        OSError: it cannot be written; nothing is left.
    """
    aside = path.with_name(path.name + ACTIVE_SUFFIX)
    file = os.open(aside, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666)
    try:
        _write_all(file, data)
        rename_new(aside, path)
    except BaseException:
        aside.unlink(missing_ok=True)
        raise
    finally:
        os.close(file)


def _write_all(file: int, data: bytes) -> None:
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(file, rest) :]
    os.fsync(file)
