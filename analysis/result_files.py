"""Files of results: whole or not there, writable before the work is done, and never another's."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from analysis.record_json import read_record
from tunenet_logs.commandline import is_stdout
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.json_lines import json_line
from tunenet_logs.progress import told
from tunenet_logs.regular_file import open_regular

_PARTIAL = ".partial"

_HEADER_BYTES = 4096
"""Of a recording for Rerun, in which its names stand."""

_BLOCK_BYTES = 2**20

_OWN_DIGITS = 32
"""Of a log's SHA-256 in the name of its review: enough to tell any two logs apart."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Write to a file beside `path`, this process's own, that takes its name once it is whole.

    Raises:
        OSError: it cannot be written; it names `path`.
    """
    partial = _partial(path)
    partial.unlink(missing_ok=True)  # be it a pipe, which would wait, or a link to another file
    try:
        yield partial
        partial.replace(path)
    except OSError as error:
        if error.filename == str(partial):
            error.filename = str(path)
        raise
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def writable(path: Path, remedy: str) -> Iterator[None]:
    """Say in one line which file could not be written, and what to do.

    Raises:
        LogError: what is done in the block raised an OSError.
    """
    try:
        yield
    except OSError as error:
        why = error.strerror or str(error)
        raise LogError(f"{path}: cannot be written ({why}); {remedy}") from error


def _partial(path: Path) -> Path:
    """Where this process writes first: another one that writes the same results has another."""
    return path.with_name(f"{path.name}.{os.getpid()}{_PARTIAL}")


def write_json(path: Path, text: str) -> None:
    """Write a JSON to a file as it is or, for `-`, to standard output as one line of ASCII.

    Raises:
        OSError: it cannot be written; it names `path`.
    """
    if is_stdout(path):
        print(json_line(json.loads(text)), flush=True)
        return
    with replacing(path) as partial:
        partial.write_text(text, "utf-8")


def check_writable(path: Path, option: str) -> None:
    """Find out before hours of work whether their result can be written.

    Raises:
        UsageError: it cannot; says why.
    """
    if path.is_dir():
        raise UsageError(f"{path}: is a folder; give {option} a file")
    if not path.parent.is_dir():
        raise UsageError(f"{path.parent}: no such folder; create it, or give {option} another file")
    partial = _partial(path)
    try:
        partial.unlink(missing_ok=True)
        partial.open("xb").close()
        partial.unlink()
    except OSError as error:
        raise UsageError(
            f"{path}: cannot be written ({error.strerror}); give {option} another file"
        ) from error


def log_sha256(log: Path) -> str:
    """SHA-256 of a log; of a folder, of the names and contents of its files.

    Raises:
        OSError: it cannot be read, or is neither file nor folder.
    """
    if not log.is_dir():
        try:
            with open_regular(log) as file:
                state = hashlib.sha256()
                blocks = iter(lambda: file.read(_BLOCK_BYTES), b"")
                count = os.fstat(file.fileno()).st_size // _BLOCK_BYTES
                for block in told(blocks, "reading the log's bytes for its SHA-256", count):
                    state.update(block)
                return state.hexdigest()
        except LogError as error:
            raise OSError(str(error)) from error
    state = hashlib.sha256()
    for path in sorted(log.iterdir()):
        if path.is_file():
            state.update(f"{path.name}\0{log_sha256(path)}\n".encode(errors="surrogateescape"))
    return state.hexdigest()


def review_name(sha256: str) -> str:
    """What the review of a log is called inside, so that it can be told from another's."""
    return sha256[:_OWN_DIGITS]


def check_own(results: Path, review: Path, log: Path, sha256: str) -> None:
    """Refuse to replace the results of something else.

    Args:
        results: the JSON that is to be written.
        review: the recording for Rerun.
        log: whose they are to be.
        sha256: of it.

    Raises:
        LogError: one of them is there, and not of this log; the message names both.
    """
    if results.exists():
        check_own_json(results, log, sha256)
    else:
        check_own_review(review, log, sha256)


_CHOOSE = "choose another folder with -o, or pass --overwrite"


def check_own_json(results: Path, log: Path, sha256: str) -> None:
    """Refuse to replace a JSON that is no tuning of this log; see `check_own`."""
    if not results.exists():
        return
    record = None
    with suppress(LogError):
        record = read_record(results)
    if record is None:
        raise LogError(f"{results}: exists, and is no tuning of {log.name}; {_CHOOSE}")
    known = record.provenance.log_sha256 if record.provenance else None
    has_its_name = not known and record.log == log.name  # of a log that could not be read
    if not has_its_name and (known != sha256 or not sha256):
        named = f"another {log.name}, or of this one before it changed"
        named = named if record.log == log.name else record.log
        raise LogError(f"{results}: is the tuning of {named}, not of {log} as it is; {_CHOOSE}")


def check_own_review(review: Path, log: Path, sha256: str) -> None:
    """Refuse to replace a recording that is no review of this log; see `check_own`."""
    if not review.exists():
        return
    with open_regular(review) as file:
        is_own = review_name(sha256).encode() in file.read(_HEADER_BYTES)
    if not (is_own and sha256):
        raise LogError(f"{review}: exists, and is no review of {log.name}; {_CHOOSE}")
