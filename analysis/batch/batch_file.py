"""Check where a batch may write a text file beside its results."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from analysis.batch.found_logs import FoundLog
from tunenet_logs.errors import UsageError
from tunenet_logs.output.owned_file import OutputPlace
from tunenet_logs.regular_file import real_path


def check_batch_file(place: OutputPlace, logs: Iterable[FoundLog], folder: Path | None) -> None:
    """Check before hours of work that a file can be written, and replaces no log.

    The `folder` of the results may not exist yet; None is for beside each log.

    Raises:
        UsageError: It cannot be written.
    """
    path = place.path
    real = real_path(path)
    if any(isinstance(one.log, Path) and real_path(one.log) == real for one in logs):
        raise UsageError(f"{path}: is a log of this batch; {place.elsewhere}")
    if path.parent.is_dir() or folder is None or real_path(path.parent) != real_path(folder):
        place.check()
