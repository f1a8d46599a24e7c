"""Where a log comes to lie: under one name while it is written, under another once it is whole."""

from __future__ import annotations

from pathlib import Path

from tunenet_logs.errors import LogError
from tunenet_logs.output.whole_file import free_bytes

ACTIVE_SUFFIX = ".active"


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
        if path.is_dir():
            raise LogError(f"{path}: is a directory; name a file to write")
        self.path = path
        self.active_path = path.with_name(path.name + ACTIVE_SUFFIX)
        self._overwrite = overwrite
        self._min_free_bytes = min_free_bytes
        if path.exists() and not overwrite:
            raise LogError(f"{path}: exists; choose another name with -o, or pass --overwrite")
        if self.active_path.exists() and not overwrite:
            raise LogError(
                f"{self.active_path}: is left from a recording that did not end; save it with "
                "tunenet-logs recover and move it away, or pass --overwrite to lose it"
            )
        try:
            free = free_bytes(path.parent)
        except OSError as error:
            raise LogError(f"{self.active_path}: cannot be written ({error.strerror})") from error
        if why := self.why_too_full(free):
            raise LogError(f"{path}: not recorded, {why}; free some space, or lower --min-free")

    def why_too_full(self, free: int) -> str:
        """Why a disk with so many bytes free takes no more; "" if it does."""
        if free >= self._min_free_bytes:
            return ""
        bound = f"{self._min_free_bytes / 1e6:g} MB are to stay free"
        return f"the disk has {free / 1e6:.0f} MB left and {bound}"

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
