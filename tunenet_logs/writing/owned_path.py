"""Write files as all commands do: what is not ours is never replaced or deleted.

Ours is what its content says is ours. No link is followed, nothing is opened that may wait, and
what is written has a name of its own until it is whole. `OutputPlace` is for a result, `write_new`
for a small file; a log, which grows, has a name that one process claims (`ClaimedName`), is written
in whole pieces (`WholeFile`) and gets its last name at the end (`LogPlace`).
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import math
import os
import re
import stat
import tempfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from itertools import count
from pathlib import Path
from typing import BinaryIO

from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.files import open_regular
from tunenet_logs.terminal import listed, short_name

# ---- Renaming without replacing, kept on the disk


def rename_new(old: Path, new: Path) -> None:
    """Rename a file or change nothing: none is ever replaced (renameat2, RENAME_NOREPLACE)."""
    try:
        call = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):  # the C library has none
        take_and_rename(old, new)
        return
    call.argtypes = (ctypes.c_int, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_uint)
    # -100 instead of an open folder: names are relative to the working directory (AT_FDCWD).
    if call(-100, os.fsencode(old), -100, os.fsencode(new), 1) == 0:
        return
    number = ctypes.get_errno()
    # How kernels and file systems (exFAT, NFS) say that they rename only by replacing.
    if number not in (errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP):
        raise OSError(number, os.strerror(number), str(old), None, str(new))
    take_and_rename(old, new)


def take_and_rename(old: Path, new: Path) -> None:
    """Rename without that call: an empty file takes the name first; an error changes nothing."""
    os.close(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666))
    try:
        old.replace(new)
    except BaseException:
        new.unlink(missing_ok=True)
        raise


# ---- Result: where it goes, and what it may replace

# Looks at the beginning of an open file: None where it is not of our kind, else the names of what
# it tells of and the new one will not. Where nothing is lost, it may be replaced.
Knows = Callable[[BinaryIO], Sequence[str] | None]


@dataclass(frozen=True)
class OutputPlace:
    """Destination of a file, and what it may replace."""

    path: Path
    what: str  # kind of file, as "page" or "tuning"
    knows: Knows  # recognises files of this kind
    of: str = ""  # whose the new one is, in words; "" where that needs no word
    elsewhere: str = "choose another name with -o"  # what a user does where the place is taken
    overwrite: bool = False  # whether a file of this kind with other content may be replaced
    asked_by: str = "--overwrite"  # how the user says so

    def why_not(self) -> str | None:
        """Return why nothing may be written there, in one line; None where it may."""
        try:
            mode = self.path.lstat().st_mode
        except (FileNotFoundError, NotADirectoryError):  # writing says what is missing
            return None
        except (OSError, ValueError) as error:
            fault = f"cannot be written ({_why(error)}); "
        else:
            if stat.S_ISLNK(mode):
                fault = "is a link, and none is followed; remove it, or "
            elif stat.S_ISDIR(mode):
                fault = "is a folder; "
            elif not stat.S_ISREG(mode):
                fault = "is no regular file; "
            elif not (fault := self._not_ours()) and not mode & 0o222:
                fault = "is read-only; make it writable, or "
        return f"{self.path}: {fault}{self.elsewhere}" if fault else None

    def check(self) -> None:
        """Check before hours of work that their result can be written; else UsageError."""
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
        """Yield a file of this process beside it that takes its name once whole; else LogError."""
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
        """Delete what is there where it may be replaced; anything else stays."""
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
        others = listed([short_name(one, 120) for one in lost], 3)
        new = f", not of {self.of}" if self.of else ""
        return f"exists, and is the {self.what} of {others}{new}; pass {self.asked_by}, or "


def check_folders(folder: Path, below: Path) -> None:
    """Refuse symbolic links below a folder of results, which itself may be one."""
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


def own_log(file: BinaryIO) -> Sequence[str] | None:
    """Recognise a log that this package wrote: a `Knows`."""
    # A header's record: its length, then profile and library, each behind its own length.
    known = rb"\x89MCAP0\r\n\x01.{8}.\0\0\0[a-z0-9]{0,32}.\0\0\0tunenet-logs "
    return () if re.match(known, file.read(128), re.DOTALL) else None


@contextmanager
def _scratch(path: Path) -> Iterator[Path]:
    """Open an empty file beside `path`, new, and gone at the end unless renamed by then."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    number = 0
    while True:
        which = f"-{number}" if number else ""
        partial = path.with_name(f"{path.name}.{os.getpid()}{which}.partial")
        try:
            file = os.open(partial, flags, 0o666)
            break
        except FileExistsError:  # somebody's
            number += 1
        except OSError as error:
            error.filename = str(path)
            raise
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


def _why(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


# ---- Claimed name: one process alone writes under it: made for it, locked, and watched

_ELSEWHERE = "choose another name with -o"


class ClaimedName:
    """New, empty file under a name, which no other claim can take while this one lasts.

    The file is made under a name of its own and locked (`flock`) before it gets the one that is
    claimed, so nobody ever finds that unlocked but where a killed process left it. Nothing is
    emptied, and no link is followed. With `takes_over` a log of ours that a process left there that
    is gone may be lost. LogError says what stays, and the remedy.
    """

    def __init__(self, path: Path, *, takes_over: bool) -> None:
        self.is_kept = False
        self.path = path
        self._first = path.with_name(f"{path.name}.{os.getpid()}-{next(_NUMBERS)}")
        self._opened: list[int] = []
        flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        # In C alone: no signal's exception comes between the file and its number.
        self._opened.extend(map(partial(os.open, flags=flags, mode=0o666), (self._first,)))
        try:
            _try_lock(self.descriptor)
            for _ in range(100):  # each try ends with one process having it, or refusing
                with suppress(FileExistsError):
                    rename_new(self._first, path)
                    return
                _clear(path, takes_over=takes_over)
        except BaseException:
            self.remove()
            raise
        self.remove()
        raise _in_use(path)

    @property
    def descriptor(self) -> int:
        """File descriptor, for writing and reading; -1 once it was released."""
        return self._opened[0] if self._opened else -1

    def is_at(self, path: Path) -> bool:
        """Check whether this file, and no other, lies at `path`."""
        try:
            return os.path.samestat(os.lstat(path), os.fstat(self.descriptor))
        except OSError:
            return False

    def why_lost(self) -> str:
        """Return what became of the file under its name; "" while it is there."""
        if self.is_at(self.path):
            return ""
        try:
            os.lstat(self.path)
        except OSError as error:
            if error.errno not in (errno.ENOENT, errno.ENOTDIR):
                return f"cannot be found any more ({error.strerror})"
            return "was moved" if self.found_at() else "was removed"
        return "was replaced by another file"

    def found_at(self) -> Path | None:
        """Find the file, whoever moved it; None where it has no name any more."""
        with suppress(OSError):
            path = Path(f"/proc/self/fd/{self.descriptor}").readlink()
            return path if self.is_at(path) else None
        return None

    def rename(self, path: Path, *, replaces: bool) -> bool:
        """Give the file its last name, in the same folder; return whether it then lies there."""
        if self.why_lost():
            return False
        if replaces:
            self.path.replace(path)
        else:
            rename_new(self.path, path)
        with suppress(OSError):  # there are file systems that sync no folder
            folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
        return self.is_at(path)

    def remove(self) -> None:
        """Delete the file, unless another one lies there by now, and release the name."""
        for path in (self.path, self._first):
            if self._opened and self.is_at(path):
                with suppress(OSError):
                    path.unlink()
        self.release()

    def release(self) -> None:
        """Release the file as it is. Safe to call twice."""
        while self._opened:
            with suppress(OSError):  # nothing is held back that could be lost here
                os.close(self._opened.pop())

    def __del__(self) -> None:
        if not self.is_kept:
            self.remove()


_NUMBERS = count()  # of the claims of this process


def _clear(path: Path, *, takes_over: bool) -> None:
    """Remove the file of a process that is gone; LogError where it is none, or is to stay."""
    try:
        left = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:  # it has its last name by now
        return
    except OSError as error:
        # How links, folders, sockets and devices say that they open as no file.
        if error.errno in (errno.ELOOP, errno.EISDIR, errno.ENXIO, errno.ENODEV):
            raise _not_regular(path) from error
        raise
    try:
        if not stat.S_ISREG(os.fstat(left).st_mode):
            raise _not_regular(path)
        lock = _try_lock(left)
        if lock is False:
            raise _in_use(path)
        if not takes_over:
            raise LogError(
                f"{path}: is left from a recording that did not end; save it with "
                "tunenet-logs recover and move it away, or pass --overwrite to lose it"
            )
        if lock is None:
            raise LogError(
                f"{path}: may be written right now, which this file system does not tell; move it "
                f"away, or {_ELSEWHERE}"
            )
        if own_log(BytesIO(os.pread(left, 128, 0))) is None:
            raise LogError(f"{path}: is no log of tunenet-logs; move it away, or {_ELSEWHERE}")
        with suppress(FileNotFoundError):
            # Who holds the lock of the file under the name is alone with it.
            if os.path.samestat(os.lstat(path), os.fstat(left)):
                path.unlink()
    finally:
        os.close(left)


def _try_lock(descriptor: int) -> bool | None:
    """Lock the file for this process if possible; None where the file system has no locks."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _in_use(path: Path) -> LogError:
    return LogError(
        f"{path}: is being written by another process; wait until it has ended, or {_ELSEWHERE}"
    )


def _not_regular(path: Path) -> LogError:
    return LogError(f"{path}: is no regular file; move it away, or {_ELSEWHERE}")


# ---- Whole pieces: one that does not fit leaves no trace


class WholeFile:
    """Open file, written without a buffer: what `append` returned from is in the file.

    In the file means that it survives this process being killed; `sync` makes it survive the
    machine. Where a piece does not fit, the file is cut back to the last whole one. The descriptor
    is of an empty file, opened for appending, and is not closed here.
    """

    def __init__(self, descriptor: int) -> None:
        self.size_bytes = 0
        self.crc32 = 0
        self._is_torn = False
        self._descriptor = descriptor

    def append(self, piece: bytes) -> None:
        """Write all of `piece`, or nothing: OSError where it did not fit, or the disk failed."""
        if self._is_torn:
            raise OSError(errno.EIO, "cannot be cut back after a write that failed")
        try:
            _write(self._descriptor, piece)
        except OSError:
            self._is_torn = True  # what follows half a piece could not be read
            with suppress(OSError):
                os.ftruncate(self._descriptor, self.size_bytes)
                os.lseek(self._descriptor, self.size_bytes, os.SEEK_SET)
                self._is_torn = False
            raise
        self.size_bytes += len(piece)
        self.crc32 = zlib.crc32(piece, self.crc32)

    def sync(self) -> None:
        """Sync the contents to disk."""
        os.fdatasync(self._descriptor)

    def is_changed(self) -> bool:
        """Check whether another process has cut the file, or written to it."""
        return os.fstat(self._descriptor).st_size != self.size_bytes


def free_bytes(place: Path | int) -> int:
    """Return the bytes that an ordinary user may still write to a folder's or open file's disk."""
    disk = os.statvfs(place)
    return disk.f_bavail * disk.f_frsize


# ---- Log: under one name while it is written, under another once it is whole

ACTIVE_SUFFIX = ".active"  # behind a log's name while it is written
NO_SPACE = (errno.ENOSPC, errno.EDQUOT)  # how a full disk, or a user's share of one, says so


def check_log_name(path: Path, *, overwrite: bool) -> None:
    """Refuse a name that a finished log cannot take; it may only `overwrite` a log of ours."""
    if why := OutputPlace(path, "log", own_log).why_not():
        raise LogError(why)
    if os.path.lexists(path) and not overwrite:
        raise LogError(f"{path}: exists; choose another name with -o, or pass --overwrite")


class LogPlace:
    """Both names of a log, of which the first is this process's alone, and the space beside it."""

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
                # Another may have ended its log before the claim.
                check_log_name(path, overwrite=overwrite)
            except LogError:
                self.claim.remove()
                raise
        except OSError as error:
            raise not_writable(path, error) from error

    def why_too_full(self, free: int) -> str:
        """Return why a disk with so many bytes free takes no more; "" if it does."""
        if free >= self._min_free_bytes:
            return ""
        scale, unit = (1e6, "MB") if self._min_free_bytes < 1e10 else (1e9, "GB")
        bound = math.ceil(self._min_free_bytes / scale)
        return f"the disk has {int(free / scale)} {unit} left and {bound} {unit} are to stay free"

    def keep(
        self, *, is_whole: bool, is_cut: bool = False, or_nothing: bool = False
    ) -> Path | None:
        """Give the file its last name and release it; return where it lies, None if it is lost.

        Where the name cannot be given, it stays under its first one, or, `or_nothing`, goes. Where
        it has lost that, as somebody removed or replaced it, what it holds is copied to a name of
        its own. It `is_whole` if it has its end; one that an error `is_cut` replaces no log that is
        there.
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
            numbers = ("", *(f"_{number}" for number in range(2, 101)))
            names = (folder / f"{self.path.stem}.rescued{one}{self.path.suffix}" for one in numbers)
            name = next((one for one in names if not os.path.lexists(one)), None)
            if name is None:
                continue
            with suppress(OSError, LogError):
                copy = ClaimedName(name.with_name(name.name + ACTIVE_SUFFIX), takes_over=False)
                try:
                    at, descriptor = 0, self.claim.descriptor
                    while piece := os.pread(descriptor, 1024 * 1024, at):  # a short read is no end
                        at += len(piece)
                        _write(copy.descriptor, piece)
                    os.fsync(copy.descriptor)
                    size = os.fstat(copy.descriptor).st_size
                    is_there = copy.rename(name, replaces=False)
                    if is_there and size == os.fstat(descriptor).st_size:
                        return name
                finally:
                    copy.remove()  # nothing is there where it was renamed
        return None

    def called(self, path: Path) -> str:
        """Return the display name of a kept log: its name alone where it lies in its folder."""
        return path.name if path.parent == self.path.parent else str(path)


def not_writable(path: Path, error: OSError) -> LogError:
    """Build the error for a path that cannot be written, with its remedy."""
    elsewhere = "choose another place with -o"
    if error.errno == errno.ENOENT:
        return LogError(f"{path.parent}: no such folder; make it first, or {elsewhere}")
    if error.errno == errno.ENOTDIR:
        return LogError(f"{path.parent}: is no folder; {elsewhere}")
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return LogError(f"{path}: its folder cannot be written to ({error.strerror}); {elsewhere}")
    remedy = f"free some space, or {elsewhere}" if error.errno in NO_SPACE else elsewhere
    return LogError(f"{path}: cannot be written ({error.strerror}); {remedy}")


# ---- Small file: whole and on the disk, or not at all; it never takes another's place


def write_new(path: Path, data: bytes) -> None:
    """Write a new file atomically: whole and on the disk before it has its name.

    A process that is killed leaves nothing, where the file system knows files without a name;
    elsewhere at most `NAME.active`, which no reader takes for the file. A `path` that is taken
    stays as it is: FileExistsError.
    """
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            file = os.open(path.parent, os.O_TMPFILE | os.O_WRONLY, 0o666)
            try:
                _write(file, data)
                os.fsync(file)
                # Only with a folder does os.link follow the link that /proc has for the open file.
                opened = f"/proc/self/fd/{file}"
                os.link(opened, path.name, dst_dir_fd=folder, follow_symlinks=True)
            finally:
                os.close(file)
        except OSError as error:
            # How kernels and file systems say that they know no file without a name, or cannot
            # name it.
            unknown = (errno.EOPNOTSUPP, errno.EISDIR, errno.EINVAL, errno.ENOENT, errno.EPERM)
            if error.errno not in unknown:
                raise
            write_aside(path, data)
        os.fsync(folder)
    finally:
        os.close(folder)


def write_aside(path: Path, data: bytes) -> None:
    """Write under a name of its own, which no one else may take meanwhile, and rename."""
    aside = path.with_name(path.name + ACTIVE_SUFFIX)
    file = os.open(aside, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666)
    try:
        _write(file, data)
        os.fsync(file)
        rename_new(aside, path)
    except BaseException:
        aside.unlink(missing_ok=True)
        raise
    finally:
        os.close(file)


def _write(file: int, data: bytes) -> None:
    """Write all of `data`; a short write is no end."""
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(file, rest) :]
