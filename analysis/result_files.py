"""Recognise our own result files, and which logs they are of.

Pages, figures and JSONs have a mark near the beginning with the names and SHA-256 of their logs;
exported files are known by their header, Rerun recordings by their name, tables by their columns.
`OutputPlace` replaces nothing else.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Literal
from urllib.parse import quote, unquote

from tunenet_logs.analysis.record import MAX_RECORD_BYTES, Record, record_in
from tunenet_logs.console import is_stdout
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.files import json_line, open_regular, real_path
from tunenet_logs.terminal import listed, short_name, told
from tunenet_logs.writing.owned_path import Knows, OutputPlace

_BLOCK_BYTES = 2**20

# Of a file, in which its mark stands: one with the most logs, and what is around it.
_MARK_BYTES = 2**17

_MARK = rb"tunenet-logs ([a-z-]+) of((?: [\w.%]{0,80}@\w{0,32}){0,1000})"

# How a marked file begins; of a PDF the end, where a pattern finds its last creator.
_FORMS = {
    "html": rb"<!doctype html>\n<!-- " + _MARK,
    "json": rb'\{\n "made": "' + _MARK,
    "png": rb"\x89PNG\r\n\x1a\n.{29}tEXtSoftware\0" + _MARK,
    "pdf": rb".*/Creator \(" + _MARK,
    "csv": rb"# " + _MARK,
}

# The beginning of a recording of ours: its identity, then what it is of.
_RECORDING = re.compile(
    rb"RRF2.{12}.{0,64}?([0-9a-z]{1,64})\x1a.\x0a.tunenet ([a-z0-9 _-]+) [0-9a-f]{16}", re.DOTALL
)

# Kinds of recordings that are no review of one log.
_OTHER_RECORDINGS = (b"campaign", b"shot", b"overview", b"eval drop")

# The head of an exported file.
_EXPORTED = re.compile(
    rb"Exported by tunenet-export [\w.+-]{1,40} from the tuning of (.{1,400}?)"
    rb"(?:, tuned [^\n]{1,200})?\.[\"\s].{0,200}?"
    rb"(?:SHA-256 of the log: ([0-9a-f]{32})|Verdict: )",
    re.DOTALL,
)

Form = Literal["html", "json", "png", "pdf", "csv"]
# Names of logs by the first digits of their SHA-256, or by their names where nothing has those.
Logs = Mapping[str, str]


def logs_of(records: Iterable[Record]) -> Logs:
    """Collect the logs of tunings."""
    found: dict[str, str] = {}
    for record in records:
        sha256 = record.provenance.log_sha256 if record.provenance else ""
        found.setdefault(review_name(sha256) or record.log, record.log)
    return found


def subject_of(known_by: Iterable[str]) -> str:
    """Hash the logs or places of a recording into the prefix of its identity."""
    return hashlib.sha256("\0".join(sorted(known_by)).encode(errors="replace")).hexdigest()[:16]


def in_words(logs: Logs) -> str:
    """List the first names of the logs."""
    return listed(map(short_name, logs.values()), 3)


def mark(kind: str, logs: Logs) -> str:
    """Return the mark of our own files of these logs, in characters that no format escapes."""
    named: list[str] = []
    # By a thousand logs one page is told from another.
    for known_by, name in list(logs.items())[:1000]:
        plain = re.sub(
            "[-~]", lambda one: f"%{ord(one.group()):02X}", quote(name, safe="", errors="replace")
        )
        named.append(f" {plain[:80]}@{known_by if known_by != name else ''}")
    return f"tunenet-logs {kind} of{''.join(named)}"


def marked(form: Form, kind: str, logs: Logs) -> Knows:
    """Recognise files of a form with the `mark` of a kind."""
    pattern = re.compile(_FORMS[form], re.DOTALL)

    def knows(file: BinaryIO) -> Sequence[str] | None:
        data = file.read(_MARK_BYTES)
        if form == "pdf":
            if not data.startswith(b"%PDF-"):
                return None
            file.seek(max(0, os.fstat(file.fileno()).st_size - _MARK_BYTES))
            data = file.read(_MARK_BYTES)
        found = pattern.match(data)
        if found is None or found[1] != kind.encode():
            return None
        told_of = [one.partition("@") for one in found[2].decode().split()]
        names = {sha256 or unquote(name): unquote(name) for name, _, sha256 in told_of}
        return [name for known_by, name in names.items() if known_by not in logs]

    return knows


def exported_file(record: Record) -> Knows:
    """Recognise files that `tunenet-export` wrote."""
    logs = logs_of([record])

    def knows(file: BinaryIO) -> Sequence[str] | None:
        found = _EXPORTED.search(file.read(_MARK_BYTES))
        if found is None:
            return None
        name = found[1].decode(errors="replace")
        known_by = found[2].decode() if found[2] else name
        return () if known_by in logs else (name,)

    return knows


def recording(kind: str, subject: str) -> Knows:
    """Recognise Rerun recordings of one kind whose identity begins with `subject`.

    The kind "log" is that of all reviews of one log.
    """

    def knows(file: BinaryIO) -> Sequence[str] | None:
        found = _RECORDING.match(file.read(4096))
        if found is None:
            return None
        own = "log" if found[2] not in _OTHER_RECORDINGS else found[2].decode()
        if own != kind:
            return None
        return () if found[1].startswith(subject.encode()) else (f"another {kind}",)

    return knows


def review_of(sha256: str) -> Knows:
    """Recognise reviews of logs."""
    return recording("log", review_name(sha256) if sha256 else "-")  # no identity has a dash


def tuning_of(log: Path, sha256: str) -> Knows:
    """Recognise tunings' JSONs; by the log's name if it cannot be read."""

    def knows(file: BinaryIO) -> Sequence[str] | None:
        record = record_in(file.read(MAX_RECORD_BYTES + 1))
        if record.provenance is None:
            return None
        known = record.provenance.log_sha256
        if (known and known == sha256) or (not known and record.log == log.name):
            return ()
        if record.log == log.name:
            return (f"another {log.name}, or of this one before it changed",)
        return (record.log or "a log without a name",)

    return knows


def table(columns: Sequence[str], lost: Callable[[Mapping[str, str]], str | None]) -> Knows:
    """Recognise CSV tables by their first columns."""
    begins = ",".join(columns)

    def knows(file: BinaryIO) -> Sequence[str] | None:
        text = file.read(_MARK_BYTES).decode(errors="replace")
        if not text.startswith(begins):
            return None
        if len(text) >= _MARK_BYTES:  # its last row is not whole
            text = text.rpartition("\n")[0]
        try:
            rows = list(csv.DictReader(io.StringIO(text), restkey="", restval=""))
        except csv.Error:
            return None
        return list(dict.fromkeys(filter(None, map(lost, rows))))

    return knows


def check_place(
    place: OutputPlace, option: str, suffixes: Sequence[str], inputs: Iterable[Path]
) -> None:
    """Check before the work that its result can be written, and replaces none of the inputs."""
    path = place.path
    if path.suffix.lower() not in suffixes:
        raise UsageError(f"{path}: give {option} a name that ends {' or '.join(suffixes)}")
    if real_path(path) in {real_path(one) for one in inputs}:
        raise UsageError(f"{path}: is one of the files that are read; {place.elsewhere}")
    place.check()


@contextmanager
def writable(path: Path, remedy: str) -> Iterator[None]:
    """Convert an OSError to one line with the file and the remedy."""
    try:
        yield
    except OSError as error:
        why = error.strerror or str(error)
        raise LogError(f"{path}: cannot be written ({why}); {remedy}") from error


def write_json(place: OutputPlace, text: str) -> None:
    """Write a JSON to a file as it is or, for `-`, to standard output as one line of ASCII."""
    if is_stdout(place.path):
        print(json_line(json.loads(text)), flush=True)
        return
    with place.replacing() as partial:
        partial.write_text(text, "utf-8")


def log_sha256(log: Path) -> str:
    """Hash a log; of a folder, the names and contents of its files."""
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
    from tunenet_logs.formats.registry import files_of

    state = hashlib.sha256()
    for path in files_of(log):
        state.update(f"{path.name}\0{log_sha256(path)}\n".encode(errors="surrogateescape"))
    return state.hexdigest()


def known_sha256(log: Path) -> str:
    """Hash a log; "" where it cannot be read, which reading says in our own words."""
    try:
        return log_sha256(log)
    except OSError:
        return ""


def review_name(sha256: str) -> str:
    """Shorten a SHA-256 to the identity of a log in its results."""
    # Digits enough to tell any two logs apart.
    return sha256[:32]
