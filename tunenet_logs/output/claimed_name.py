"""Claim a file name that one process alone writes under: made for it, locked, and watched."""

from __future__ import annotations

import errno
import fcntl
import os
import stat
from contextlib import suppress
from functools import partial
from itertools import count
from pathlib import Path

from tunenet_logs.errors import LogError
from tunenet_logs.output.owned_file import OWN_LOG_BYTES, is_own_log
from tunenet_logs.output.rename_new import rename_new, sync_folder

# To take a name over which others fight at the same moment; each try ends with one of them having
# it, or refusing.
_TRIES = 100

_ELSEWHERE = "choose another name with -o"

# How links, folders, sockets and devices say that they open as no file.
_NO_FILE = (errno.ELOOP, errno.EISDIR, errno.ENXIO, errno.ENODEV)


class ClaimedName:
    """New, empty file under a name, which no other claim can take while this one lasts.

    The file is made under a name of its own and locked (`flock`) before it gets the one that is
    claimed, so nobody ever finds that unlocked but where a killed process left it. Nothing is
    emptied, and no link is followed.

    Args:
        path: the name.
        takes_over: whether a log of ours that a process left there that is gone may be lost.

    Attributes:
        is_kept: whether the file stays where its claim is dropped without a word, as by a signal
            before its first message.

    Raises:
        LogError: something is there that stays; says what, and the remedy.
        OSError: the file cannot be made.
    """

    def __init__(self, path: Path, *, takes_over: bool) -> None:
        self.is_kept = False
        self.path = path
        self._first = path.with_name(f"{path.name}.{os.getpid()}-{next(_NUMBERS)}")
        self._opened: list[int] = []
        # In C alone: no signal's exception comes between the file and its number.
        self._opened.extend(map(partial(os.open, flags=_MAKE, mode=0o666), (self._first,)))
        try:
            _locked(self.descriptor)
            for _ in range(_TRIES):
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
        """Give the file its last name, in the same folder; return whether it then lies there.

        Raises:
            FileExistsError: the name is taken, and is not to be replaced.
            OSError: the file system does not do it.
        """
        if self.why_lost():
            return False
        if replaces:
            self.path.replace(path)
        else:
            rename_new(self.path, path)
        sync_folder(path.parent)
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
_MAKE = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
# Flags to make a file, and to look at one that is there without waiting for it.
_LOOK = os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


def _clear(path: Path, *, takes_over: bool) -> None:
    """Remove the file of a process that is gone.

    Raises:
        LogError: it is no such thing, or is to stay.
        OSError: it cannot be looked at, or removed.
    """
    try:
        left = os.open(path, _LOOK)
    except FileNotFoundError:  # it has its last name by now
        return
    except OSError as error:
        if error.errno in _NO_FILE:
            raise _no_file(path) from error
        raise
    try:
        if not stat.S_ISREG(os.fstat(left).st_mode):
            raise _no_file(path)
        lock = _locked(left)
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
        if not is_own_log(os.pread(left, OWN_LOG_BYTES, 0)):
            raise LogError(f"{path}: is no log of tunenet-logs; move it away, or {_ELSEWHERE}")
        with suppress(FileNotFoundError):
            # Who holds the lock of the file under the name is alone with it.
            if os.path.samestat(os.lstat(path), os.fstat(left)):
                path.unlink()
    finally:
        os.close(left)


def _locked(descriptor: int) -> bool | None:
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


def _no_file(path: Path) -> LogError:
    return LogError(f"{path}: is no regular file; move it away, or {_ELSEWHERE}")
