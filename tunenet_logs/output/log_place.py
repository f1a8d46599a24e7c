"""Where a log comes to lie: under one name while it is written, under another once it is whole."""

from __future__ import annotations

import errno
import math
from pathlib import Path

from tunenet_logs.errors import LogError
from tunenet_logs.output.whole_file import free_bytes

ACTIVE_SUFFIX = ".active"
"""Behind a log's name while it is written."""

NO_SPACE = (errno.ENOSPC, errno.EDQUOT)
"""How a full disk, or a user's share of one, says so."""

_READ_ONLY = (errno.EACCES, errno.EPERM, errno.EROFS)
"""How a folder that cannot be written to says so."""

_GB_FROM_MB = 10_000
"""From so many MB on, a disk is told of in GB."""


class LogPlace:
    """A log's two names, and the space beside it.

    Args:
        path: the finished log.
        overwrite: whether it may replace one that is there.
        min_free_bytes: what is to stay free on the disk; 0 for no such bound.

    Attributes:
        active_path: the log while it is written.

    Raises:
        LogError: no recording should start here.
    """

    def __init__(self, path: Path, *, overwrite: bool, min_free_bytes: int) -> None:
        self.path = path
        self._overwrite = overwrite
        self._min_free_bytes = min_free_bytes
        try:
            self.active_path = self._checked_names()
            free = free_bytes(path.parent)
        except OSError as error:
            raise not_writable(path, error) from error
        if why := self.why_too_full(free):
            raise LogError(f"{path}: not recorded, {why}; free some space, or lower --min-free")

    def _checked_names(self) -> Path:
        """The name while it is written, where that and the finished log's may be taken."""
        path, overwrite = self.path, self._overwrite
        if path.is_dir():
            raise LogError(f"{path}: is a directory; name a file to write")
        if path.exists() and not overwrite:
            raise LogError(f"{path}: exists; choose another name with -o, or pass --overwrite")
        active_path = path.with_name(path.name + ACTIVE_SUFFIX)
        if active_path.exists() and not overwrite:
            raise LogError(
                f"{active_path}: is left from a recording that did not end; save it with "
                "tunenet-logs recover and move it away, or pass --overwrite to lose it"
            )
        return active_path

    def why_too_full(self, free: int) -> str:
        """Why a disk with so many bytes free takes no more; "" if it does."""
        if free >= self._min_free_bytes:
            return ""
        scale, unit = (1e6, "MB") if self._min_free_bytes < _GB_FROM_MB * 1e6 else (1e9, "GB")
        bound = math.ceil(self._min_free_bytes / scale)
        return f"the disk has {int(free / scale)} {unit} left and {bound} {unit} are to stay free"

    def give_name(self, *, is_cut: bool) -> bool:
        """Rename the file to the finished log; False where that is not possible.

        A log that was cut by an error replaces none that is there.
        """
        if self.path.exists() and (is_cut or not self._overwrite):
            return False
        try:
            self.active_path.replace(self.path)
        except OSError:
            return False
        return True


def not_writable(path: Path, error: OSError) -> LogError:
    """Why no log can be written to `path`, by the name that its user gave, and the remedy."""
    elsewhere = "choose another place with -o"
    if error.errno == errno.ENOENT:
        return LogError(f"{path.parent}: no such folder; make it first, or {elsewhere}")
    if error.errno == errno.ENOTDIR:
        return LogError(f"{path.parent}: is no folder; {elsewhere}")
    if error.errno in _READ_ONLY:
        return LogError(f"{path}: its folder cannot be written to ({error.strerror}); {elsewhere}")
    remedy = f"free some space, or {elsewhere}" if error.errno in NO_SPACE else elsewhere
    return LogError(f"{path}: cannot be written ({error.strerror}); {remedy}")
