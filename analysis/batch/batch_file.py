"""A text file that a batch writes beside its results: where it may go, and over what."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from analysis.batch.found_logs import FoundLog
from tunenet_logs.errors import UsageError
from tunenet_logs.output.owned_file import OutputPlace
from tunenet_logs.regular_file import real_path


def check_batch_file(place: OutputPlace, logs: Iterable[FoundLog], folder: Path | None) -> None:
    """Find out before hours of work whether a file can be written, and over what.

    Args:
        place: where it goes.
        logs: of the batch, which it never replaces.
        folder: of the results, which need not be there yet; None for beside each log.

    Raises:
        UsageError: it cannot; says why.
    """
    path = place.path
    real = real_path(path)
    if any(isinstance(one.log, Path) and real_path(one.log) == real for one in logs):
        raise UsageError(f"{path}: is a log of this batch; {place.elsewhere}")
    if path.parent.is_dir() or folder is None or real_path(path.parent) != real_path(folder):
        place.check()
