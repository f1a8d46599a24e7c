"""Write files as all commands do: what is not ours is never replaced or deleted.

Ours is what its content says is ours. No link is followed, nothing is opened that may wait, and
what is written has a name of its own until it is whole.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.output.rename_new import rename_new
from tunenet_logs.regular_file import open_regular
from tunenet_logs.terminal import listed, short_name

# Looks at the beginning of an open file: None where it is not of our kind, else the names of what
# it tells of and the new one will not. Where nothing is lost, it may be replaced.
Knows = Callable[[BinaryIO], Sequence[str] | None]

_PARTIAL = ".partial"

_MAX_NAMED, _MAX_CHARACTERS = 3, 120  # of what would be lost, in a message, and of each name
OWN_LOG_BYTES = 128  # of a log's beginning, from which `is_own_log` tells
# A header's record: its length, then profile and library, each behind its own length.
_OWN_LOG = re.compile(rb"\x89MCAP0\r\n\x01.{8}.\0\0\0[a-z0-9]{0,32}.\0\0\0tunenet-logs ", re.DOTALL)

_ANYBODY_WRITES = stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH


@dataclass(frozen=True)
class OutputPlace:
    """Destination of a file, and what it may replace.

    Attributes:
        path: the file.
        what: kind of file, as "page" or "tuning".
        knows: recognises files of this kind.
        of: whose the new one is, in words; "" where that needs no word.
        elsewhere: what a user does where the place is taken.
        overwrite: whether a file of this kind with other content may be replaced.
        asked_by: how the user says so.
    """

    path: Path
    what: str
    knows: Knows
    of: str = ""
    elsewhere: str = "choose another name with -o"
    overwrite: bool = False
    asked_by: str = "--overwrite"

    def why_not(self) -> str | None:
        """Return why nothing may be written there, in one line; None where it may."""
        try:
            mode = self.path.lstat().st_mode
        except (FileNotFoundError, NotADirectoryError):  # writing says what is missing
            return None
        except (OSError, ValueError) as error:
            fault = f"cannot be written ({_why(error)}); "
        else:
            fault = _no_file(mode) or self._not_ours() or _locked(mode)
        return f"{self.path}: {fault}{self.elsewhere}" if fault else None

    def check(self) -> None:
        """Check before hours of work that their result can be written.

        Raises:
            UsageError: it cannot; says why.
        """
        folder = self.path.parent
        if not folder.is_dir():
            raise UsageError(f"{folder}: no such folder; create it, or {self.elsewhere}")
        if why := self.why_not():
            raise UsageError(why)
        try:
            with _scratch(self.path):
                pass
        except OSError as error:
            why = f"{self.path}: cannot be written ({_why(error)})"
            raise UsageError(f"{why}; {self.elsewhere}") from error

    @contextmanager
    def replacing(self) -> Iterator[Path]:
        """Yield a file beside it, this process's own, that takes its name once it is whole.

        Raises:
            LogError: something else is there, or is by then.
            OSError: it cannot be written; it names `path`.
        """
        if why := self.why_not():
            raise LogError(why)
        with _scratch(self.path) as partial:
            yield partial
            try:
                rename_new(partial, self.path)
            except FileExistsError:
                if why := self.why_not():  # it may have come meanwhile
                    raise LogError(why) from None
                partial.replace(self.path)

    def remove(self) -> None:
        """Delete what is there where it may be replaced; anything else stays.

        Raises:
            OSError: it cannot be deleted.
        """
        if self.why_not() is None:
            self.path.unlink(missing_ok=True)

    def _not_ours(self) -> str:
        """Return why a file that is there stays, and half of the remedy; "" where it need not."""
        try:
            with open_regular(self.path, follows=False) as file:
                try:
                    lost = self.knows(file)
                except (LogError, OSError, ValueError, RecursionError):
                    lost = None
        except (LogError, OSError) as error:
            return f"exists, and cannot be read ({_why(error)}); "
        if lost is None:
            return f"exists, and is no {self.what} that tunenet-logs wrote; move it away, or "
        if not lost or self.overwrite:
            return ""
        others = listed([short_name(one, _MAX_CHARACTERS) for one in lost], _MAX_NAMED)
        new = f", not of {self.of}" if self.of else ""
        return f"exists, and is the {self.what} of {others}{new}; pass {self.asked_by}, or "


def _no_file(mode: int) -> str:
    if stat.S_ISLNK(mode):
        return "is a link, and none is followed; remove it, or "
    if stat.S_ISDIR(mode):
        return "is a folder; "
    return "" if stat.S_ISREG(mode) else "is no regular file; "


def _locked(mode: int) -> str:
    return "" if mode & _ANYBODY_WRITES else "is read-only; make it writable, or "


def check_folders(folder: Path, below: Path) -> None:
    """Refuse symbolic links among the folders within a folder of results.

    Args:
        folder: as the user named it, be it a link.
        below: what is to be written, or its folder, within that.

    Raises:
        LogError: one is a link, or no folder.
    """
    path = folder
    for name in below.parts:
        path /= name
        if path.is_symlink():
            raise LogError(
                f"{path}: is a link, and none is followed; remove it, or choose another folder "
                "with -o"
            )


def nothing(_file: BinaryIO) -> None:
    """Replace no file: a `Knows`."""
    return


def begins_with(*starts: bytes) -> Knows:
    """Make a `Knows` of files of ours that hold nothing else, by how they begin."""

    def knows(file: BinaryIO) -> Sequence[str] | None:
        return () if file.read(max(map(len, starts))).startswith(starts) else None

    return knows


def is_own_log(start: bytes) -> bool:
    """Check whether a file that begins so is a log that this package wrote."""
    return _OWN_LOG.match(start) is not None


def own_log(file: BinaryIO) -> Sequence[str] | None:
    """Recognise a log that this package wrote: a `Knows`."""
    return () if is_own_log(file.read(OWN_LOG_BYTES)) else None


@contextmanager
def _scratch(path: Path) -> Iterator[Path]:
    """Open an empty file beside `path`, new, and gone at the end unless renamed by then.

    Raises:
        OSError: it cannot be made or written; it names `path`.
    """
    partial, file = _made(path)
    try:
        yield partial
    except OSError as error:
        if error.filename in (None, str(partial)):  # none where a write failed, as on a full disk
            error.filename = str(path)
        raise
    finally:
        with suppress(OSError):
            if os.path.samestat(partial.lstat(), os.fstat(file)):
                partial.unlink()
        os.close(file)


def _made(path: Path) -> tuple[Path, int]:
    """Create a file beside `path` under a name that nobody has, open for writing."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    number = 0
    while True:
        which = f"-{number}" if number else ""
        partial = path.with_name(f"{path.name}.{os.getpid()}{which}{_PARTIAL}")
        try:
            return partial, os.open(partial, flags, 0o666)
        except FileExistsError:  # somebody's
            number += 1
        except OSError as error:
            error.filename = str(path)
            raise


def _why(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
