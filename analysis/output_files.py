"""Where a command writes what it makes of tunings: never over them, a log, or unasked."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from analysis.result_files import check_writable
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.regular_file import open_regular, real_path

PAGE_MARK = "<!-- tunenet-logs page -->"
"""Early in every page of ours."""

TABLE_MARK = "log,task,preset,"
PAIRS_MARK = "group,parameter,unit,"
"""How a table of ours begins."""

_MARKS = {".html": (PAGE_MARK,), ".csv": (TABLE_MARK, PAIRS_MARK)}
"""By the suffix of a file: what one of ours has near its beginning."""

_STARTS = {".png": b"\x89PNG", ".pdf": b"%PDF"}
"""Of pictures; whose they are does not show."""

_START_BYTES = 4096


def check_output(
    path: Path, option: str, suffixes: Sequence[str], inputs: Iterable[Path], *, overwrite: bool
) -> None:
    """Find out before the work whether its result can be written, and over what.

    Args:
        path: where it goes.
        option: that named it.
        suffixes: one of which it must have.
        inputs: files that are read, which nothing replaces.
        overwrite: whether a file of the same kind may be replaced.

    Raises:
        UsageError: it cannot; says why.
    """
    if path.suffix.lower() not in suffixes:
        raise UsageError(f"{path}: give {option} a name that ends {' or '.join(suffixes)}")
    if real_path(path) in {real_path(one) for one in inputs}:
        raise UsageError(f"{path}: is one of the files that are read; give {option} another file")
    check_writable(path, option)
    if not path.exists():
        return
    if not overwrite:
        raise UsageError(f"{path}: exists; give {option} another file, or pass --overwrite")
    if not _is_alike(path):
        raise UsageError(
            f"{path}: exists, and this command did not write it; give {option} another file, or "
            "delete it"
        )


def _is_alike(path: Path) -> bool:
    """Whether a file is of the kind that its suffix stands for, and ours where that shows."""
    suffix = path.suffix.lower()
    try:
        with open_regular(path) as file:
            start = file.read(_START_BYTES)
    except (LogError, OSError):
        return False
    if suffix in _STARTS:
        return not start or start.startswith(_STARTS[suffix])
    text = start.decode(errors="replace")
    if suffix == ".csv":
        return not start or text.startswith(_MARKS[suffix])
    return not start or any(mark in text for mark in _MARKS[suffix])
