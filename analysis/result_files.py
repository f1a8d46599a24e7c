"""Files of results: whole or not there, and known to be writable before the work is done."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tunenet_logs.errors import UsageError

PARTIAL = ".partial"


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Write to a file beside `path` that takes its name once it is whole."""
    partial = path.with_name(path.name + PARTIAL)
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def check_writable(path: Path, option: str) -> None:
    """Find out before hours of work whether their result can be written.

    Raises:
        UsageError: it cannot; says why.
    """
    if path.is_dir():
        raise UsageError(f"{path}: is a folder; give {option} a file")
    if not path.parent.is_dir():
        raise UsageError(f"{path.parent}: no such folder; create it, or give {option} another file")
    partial = path.with_name(path.name + PARTIAL)
    try:
        partial.write_bytes(b"")
        partial.unlink()
    except OSError as error:
        raise UsageError(
            f"{path}: cannot be written ({error.strerror}); give {option} another file"
        ) from error
