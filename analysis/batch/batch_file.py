"""A text file that a batch writes beside its results: where it may go, and over what."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from analysis.batch.found_logs import FoundLog
from analysis.result_files import check_writable
from tunenet_logs.errors import UsageError
from tunenet_logs.regular_file import open_regular, real_path


def check_batch_file(
    path: Path,
    option: str,
    begins: bytes,
    logs: Iterable[FoundLog],
    folder: Path | None,
    *,
    overwrite: bool,
) -> None:
    """Find out before hours of work whether a file can be written, and over what.

    Args:
        path: where it goes.
        option: that named it, with its dashes.
        begins: how every such file begins.
        logs: of the batch, which it never replaces.
        folder: of the results, which need not be there yet; None for beside each log.
        overwrite: whether it may replace a file that begins otherwise.

    Raises:
        UsageError: it cannot; says why.
    """
    place = real_path(path)
    if any(isinstance(one.log, Path) and real_path(one.log) == place for one in logs):
        raise UsageError(f"{path}: is a log of this batch; give {option} another file")
    if path.parent.is_dir() or folder is None or real_path(path.parent) != real_path(folder):
        check_writable(path, option)
    if path.exists() and not overwrite and not _is_alike(path, begins):
        raise UsageError(
            f"{path}: exists, and was not written by {option}; give it another file, or pass "
            "--overwrite"
        )


def _is_alike(path: Path, begins: bytes) -> bool:
    try:
        with open_regular(path) as file:
            return file.read(len(begins)) in (b"", begins)
    except OSError:
        return False
