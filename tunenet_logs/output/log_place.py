"""Place a log: under one name while it is written, under another once it is whole."""

from __future__ import annotations

import errno
import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from tunenet_logs.errors import LogError
from tunenet_logs.output.claimed_name import ClaimedName
from tunenet_logs.output.owned_file import OutputPlace, own_log
from tunenet_logs.output.whole_file import free_bytes

ACTIVE_SUFFIX = ".active"  # behind a log's name while it is written
NO_SPACE = (errno.ENOSPC, errno.EDQUOT)  # how a full disk, or a user's share of one, says so
# How a folder that cannot be written to says so.
_READ_ONLY = (errno.EACCES, errno.EPERM, errno.EROFS)

_GB_FROM_MB = 10_000  # from so many MB on, a disk is told of in GB
_MAX_RESCUED = 100  # copies of one log that may lie beside it
_PIECE_BYTES = 1024 * 1024  # copied at a time


def check_log_name(path: Path, *, overwrite: bool) -> None:
    """Refuse a name that a finished log cannot take; it may only `overwrite` a log of ours.

    Raises:
        LogError: it cannot; with the reason.
    """
    if why := OutputPlace(path, "log", own_log).why_not():
        raise LogError(why)
    if os.path.lexists(path) and not overwrite:
        raise LogError(f"{path}: exists; choose another name with -o, or pass --overwrite")


class LogPlace:
    """Both names of a log, and the space beside it. The first name is this process's alone.

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
            check_log_name(path, overwrite=overwrite)
            self.active_path = path.with_name(path.name + ACTIVE_SUFFIX)
            if why := self.why_too_full(free_bytes(path.parent)):
                raise LogError(f"{path}: not recorded, {why}; free some space, or lower --min-free")
            self.claim = ClaimedName(self.active_path, takes_over=overwrite)
            try:
                check_log_name(
                    path, overwrite=overwrite
                )  # another may have ended its log before the claim
            except LogError:
                self.claim.remove()
                raise
        except OSError as error:
            raise not_writable(path, error) from error

    def why_too_full(self, free: int) -> str:
        """Return why a disk with so many bytes free takes no more; "" if it does."""
        if free >= self._min_free_bytes:
            return ""
        scale, unit = (1e6, "MB") if self._min_free_bytes < _GB_FROM_MB * 1e6 else (1e9, "GB")
        bound = math.ceil(self._min_free_bytes / scale)
        return f"the disk has {int(free / scale)} {unit} left and {bound} {unit} are to stay free"

    def keep(
        self, *, is_whole: bool, is_cut: bool = False, or_nothing: bool = False
    ) -> Path | None:
        """Give the file its last name and release it; return where it lies, None if it is lost.

        Where the name cannot be given, it stays under its first one. Where it has lost that, as
        somebody removed or replaced it, what it holds is copied to a name of its own.

        Args:
            is_whole: whether it has its end, so that every reader opens it.
            is_cut: whether an error ended it; then it replaces no log that is there.
            or_nothing: whether nothing is to be left where it cannot have its last name.
        """
        claim = self.claim
        try:
            with suppress(OSError, LogError):
                replaces = self._overwrite and not is_cut
                if replaces:  # somebody else's may have come meanwhile
                    check_log_name(self.path, overwrite=True)
                if is_whole and claim.rename(self.path, replaces=replaces):
                    return self.path
            if or_nothing:
                claim.remove()
                return None
            if claim.is_at(self.active_path):
                return self.active_path
            return claim.found_at() or self._rescued()
        finally:
            claim.release()

    def _rescued(self) -> Path | None:
        """Copy a file that has no name any more, beside it or to the temporary folder."""
        for folder in (self.path.parent, Path(tempfile.gettempdir())):
            for number in range(1, _MAX_RESCUED + 1):
                which = "" if number == 1 else f"_{number}"
                name = folder / f"{self.path.stem}.rescued{which}{self.path.suffix}"
                if os.path.lexists(name):
                    continue
                with suppress(OSError, LogError):
                    if _copied(self.claim.descriptor, name):
                        return name
                break
        return None

    def called(self, path: Path) -> str:
        """Return the display name of a kept log: its name alone where it lies in its folder."""
        return path.name if path.parent == self.path.parent else str(path)


def _copied(descriptor: int, path: Path) -> bool:
    """Copy an open file to a new name, and return whether all of it lies there.

    Raises:
        OSError, LogError: it cannot be written; nothing is left.
    """
    copy = ClaimedName(path.with_name(path.name + ACTIVE_SUFFIX), takes_over=False)
    try:
        for piece in _pieces(descriptor):
            rest = memoryview(piece)
            while rest:
                rest = rest[os.write(copy.descriptor, rest) :]
        os.fsync(copy.descriptor)
        size = os.fstat(copy.descriptor).st_size
        is_there = copy.rename(path, replaces=False)
        return is_there and size == os.fstat(descriptor).st_size
    finally:
        copy.remove()  # nothing is there where it was renamed


def _pieces(descriptor: int) -> Iterator[bytes]:
    """Yield all bytes of an open file; a short read is no end."""
    at = 0
    while piece := os.pread(descriptor, _PIECE_BYTES, at):
        at += len(piece)
        yield piece


def not_writable(path: Path, error: OSError) -> LogError:
    """Build the error for a path that cannot be written, with its remedy."""
    elsewhere = "choose another place with -o"
    if error.errno == errno.ENOENT:
        return LogError(f"{path.parent}: no such folder; make it first, or {elsewhere}")
    if error.errno == errno.ENOTDIR:
        return LogError(f"{path.parent}: is no folder; {elsewhere}")
    if error.errno in _READ_ONLY:
        return LogError(f"{path}: its folder cannot be written to ({error.strerror}); {elsewhere}")
    remedy = f"free some space, or {elsewhere}" if error.errno in NO_SPACE else elsewhere
    return LogError(f"{path}: cannot be written ({error.strerror}); {remedy}")
