"""Read text tables of any encoding and locale: lines, cells, numbers and times.

From the file up: its encoding, lines and cells; rows of numbers in blocks; rows that cannot be
read; what rows without a header are; numbers with any decimal mark; and times, exact to the
nanosecond, as their text never goes through a float.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from decimal import Decimal
from itertools import islice, pairwise, takewhile
from math import isfinite, isnan, nan
from pathlib import Path
from statistics import median
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.files import open_regular, open_regular_text
from tunenet_logs.formats.columns.names import POWERS
from tunenet_logs.terminal import short_name

SUFFIXES = (".csv", ".tsv", ".txt")  # of files that may be tables
SEPARATORS = ("\t", ";", ",", None)  # in the order in which they are tried; None is white space
MAX_LINE = 1024**2  # characters; a row of 5000 columns of 20 digits is a tenth of that
_MAX_TABLE_BYTES = 512 * 1024**2  # its cells are read one by one, in Python
_LOOK_BYTES = 65_536  # of a file, which tell whether it is text, and its encoding
_NUMBER = re.compile(r"[-+]?(?:[0-9]++(?:[.,][0-9]++)?|[.,][0-9]++)(?:[eE][-+]?[0-9]+)?")
# How encodings begin that mark themselves; spreadsheets write UTF-16 as "Unicode text".
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
    (codecs.BOM_UTF8, "utf-8-sig"),
)
# Bytes that no text has; a terminal's log has ESC (1b), an old one of DOS ends with 1a.
_CONTROLS = re.compile(rb"[\x00-\x08\x0e-\x19\x1c-\x1f\x7f]")
_MAX_LINES = 4_000_000  # of a table, empty ones too: as many again as it may have rows


def encoding_of(start: bytes) -> str | None:
    """Detect the encoding of a text file by its first bytes; None where it is no text.

    UTF-8, UTF-16 and UTF-32 are known by their marks, UTF-16 without a mark by its zeros, and what
    is no UTF-8 is taken as Windows' own (CP1252). A damaged byte of UTF-8 stands beside intact
    multi-byte characters; in CP1252 there are none of these.
    """
    start = start[:_LOOK_BYTES]
    for mark, encoding in _MARKS:
        if start.startswith(mark):
            return encoding
    even, odd = start[::2], start[1::2]
    if b"\0" in start:
        if even.count(0) * odd.count(0) or start.count(0) * 2 < len(odd):
            return None
        encoding = "utf-16-le" if odd.count(0) else "utf-16-be"
        text = start.decode(encoding, "replace").encode(errors="replace")
        return None if _CONTROLS.search(text) else encoding
    if _CONTROLS.search(start):
        return None
    try:
        start.decode()
    except UnicodeDecodeError as error:
        is_cut = error.start >= len(start) - 3 and error.reason.startswith("unexpected end")
        others = sum(byte > 127 for byte in start)
        if not is_cut:
            is_utf8 = not start.decode("utf-8", "ignore").isascii()
            text = "utf-8-sig" if is_utf8 else "cp1252"
            return text if others < 0.3 * len(start) else None  # images and sound have more
    return "utf-8-sig"


def text_encoding(path: Path) -> str:
    """Detect the encoding of a file to be read as text in any case."""
    with open_regular(path) as file:
        return encoding_of(file.read(_LOOK_BYTES)) or "utf-8-sig"


def is_text(start: bytes, suffix: str) -> bool:
    """Return whether a file is text, by its first bytes; a table's suffix allows damaged text."""
    if encoding_of(start) is not None:
        return True
    return suffix.lower() in SUFFIXES and b"\0" not in start[:_LOOK_BYTES]


def is_table(path: Path) -> bool:
    """Return whether a file has a table's suffix, and is text."""
    if path.suffix.lower() not in SUFFIXES:
        return False
    with open_regular(path) as file:
        return is_text(file.read(_LOOK_BYTES), path.suffix)


def has_rows(lines: Iterable[str]) -> bool:
    """Return whether any line begins with a number, and is mostly numbers, two or more."""
    return any(map(_is_row, lines))


def _is_row(line: str) -> bool:
    cells = re.split(r"[,;\s]+", line[:_LOOK_BYTES].strip(" ,;\t"))
    numbers = sum(_NUMBER.fullmatch(cell) is not None for cell in cells)
    return numbers > 1 and numbers * 2 >= len(cells) and _NUMBER.fullmatch(cells[0]) is not None


def lines_of(path: Path) -> Iterator[str | None]:
    """Yield the lines without their ends; None for one that is too long for any table."""
    size = path.stat().st_size
    if size > _MAX_TABLE_BYTES:
        raise LogError(f"{path}: is a table of {size} bytes, over the limit of 512 MiB; split it")
    with open_regular_text(path, text_encoding(path), errors="replace") as file:
        count = 0
        while line := file.readline(MAX_LINE):
            count += 1
            if count > _MAX_LINES:
                raise LogError(
                    f"{path}: is a table of over {_MAX_LINES} lines, the limit; split it"
                )
            whole = line.endswith("\n") or len(line) < MAX_LINE
            while not line.endswith("\n") and len(line) == MAX_LINE:
                line = file.readline(MAX_LINE)
            yield line.rstrip("\n") if whole else None


def best_separator(line: str) -> str | None:
    """Return the most frequent separator of a header's cells; None is white space."""
    mark = max("\t;,", key=line.count)
    return mark if mark in line else None


def cells_of(line: str, separator: str | None) -> list[str]:
    """Split a line into cells; none where it is malformed.

    A cell never spans lines: an unclosed quote must not swallow the rest of a file.
    """
    if separator is None:
        return line.split()
    if '"' not in line:
        return line.split(separator)
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:
        return []


# ---- Parse rows of numbers in blocks: a gigabyte is read in bounded memory.

MAX_COLUMNS = 5000  # of a file of tracks: more than a thousand markers
# Where rows of numbers end and the next section begins.
_WORDS = re.compile(r'^[ \t,;"]*[A-Za-z]', re.MULTILINE)
# How cells are written where nothing was seen, in small letters too.
_UNSEEN = ("", "-", "nan", "Nan", "NAN", "-nan", "null", "none")
_FORMAT_LOOK_ROWS = 20  # that show how numbers are written


class LineReader:
    """Buffered reader of lines or of blocks of lines, in bounded memory."""

    def __init__(self, file: TextIO, path: Path, what: str) -> None:
        self.path = path
        self._what = what
        self._file = file
        self._ahead = ""
        self._at = 0

    def refusal(self, why: str) -> LogError:
        """Return the error of a header with some fault."""
        return LogError(f"{self.path}: is {self._what} with {why}", EXPORT_AGAIN)

    def cells(self, line: str, separator: str) -> list[str]:
        """Split a header line into stripped cells."""
        count = line.count(separator)
        cells = (
            [] if count > 2 * MAX_COLUMNS else [one.strip() for one in cells_of(line, separator)]
        )
        while cells and not cells[-1]:
            cells.pop()
        if count > 2 * MAX_COLUMNS or len(cells) > MAX_COLUMNS:
            raise self.refusal(f"{len(cells) or count} columns, over the limit of {MAX_COLUMNS}")
        return cells

    def line(self) -> str | None:
        """Read a line without its end, cut where it is too long for a table; None at the end."""
        self._fill()
        if not self._ahead:
            return None
        end = self._ahead.find("\n", self._at)
        if end < 0:
            end = len(self._ahead)
        taken = self._ahead[self._at : min(end, self._at + MAX_LINE)]
        self._at = end + 1
        return taken

    def block(self, *, until_words: bool = False) -> str:
        """Read a block of whole lines; "" at the end."""
        self._fill()
        words = _WORDS.search(self._ahead, self._at) if until_words else None
        end = words.start() if words else len(self._ahead)
        taken = self._ahead[self._at : end]
        self._at = end
        return taken

    def _fill(self) -> None:
        if self._at >= len(self._ahead):
            self._ahead, self._at = self._file.read(4 * 1024**2), 0
            if self._ahead and not self._ahead.endswith("\n"):
                self._ahead += self._file.readline(MAX_LINE)


@contextmanager
def open_lines(path: Path, what: str) -> Iterator[LineReader]:
    """Open an export of some kind as lines."""
    size = path.stat().st_size
    if size > 1024**3:
        raise LogError(
            f"{path}: is an export of {size} bytes, over the limit of 1 GiB; export fewer markers "
            "or a part of the take"
        )
    with open_regular_text(path, text_encoding(path), errors="replace") as file:
        yield LineReader(file, path, what)


def format_of(block: str, separator: str) -> Numbers:
    """Detect the number format of a block of rows."""
    some = "".join(block[: 64 * 1024].splitlines(keepends=True)[:_FORMAT_LOOK_ROWS])
    is_comma = separator != "," and "." not in some and re.search(r"\d,\d", some)
    return Numbers(separator, "," if is_comma else ".")


def unended(block: str) -> tuple[str, str]:
    """Split a file's last block into whole lines and an unterminated one; "" if none."""
    if block.endswith("\n"):
        return block, ""
    before, end, last = block.rpartition("\n")
    return before + end, last if last.strip() else ""


def numbers_of(
    block: str, form: Numbers, columns: Sequence[int]
) -> tuple[NDArray[np.float64], int]:
    """Parse cells of a block of lines; also count the lines that are malformed."""
    lines = [line for line in block[: 64 * 1024].splitlines()[:_FORMAT_LOOK_ROWS] if line]
    separator = form.separator or "\t"
    width = max((line.count(separator) + 1 for line in lines), default=0)
    there = [column for column in columns if column < width]
    none = np.empty((0, len(columns))), block.count("\n")
    if not there or width > 2 * MAX_COLUMNS:
        return none
    import pandas as pd

    keywords: dict[str, Any] = {
        "sep": separator,
        "decimal": form.decimal,
        "header": None,
        "names": list(range(width)),
        "usecols": there,
        "index_col": False,
        "on_bad_lines": "skip",
        "skipinitialspace": True,
        "na_values": _UNSEEN,
        "engine": "c",
    }
    wrong = 0
    try:
        table = pd.read_csv(io.StringIO(block), dtype=np.float64, **keywords)
    except (ValueError, OverflowError):  # pandas' own errors of parsing are ValueErrors
        try:
            texts = pd.read_csv(io.StringIO(block), dtype=str, quoting=3, **keywords)
        except (ValueError, OverflowError):
            return none
        if form.decimal == ",":
            texts = texts.apply(lambda column: column.str.replace(",", "."))
        table = texts.apply(pd.to_numeric, errors="coerce").astype(np.float64)
        unseen = texts.apply(lambda column: column.str.strip().str.lower().isin(_UNSEEN))
        wrong = int((table.isna() & texts.notna() & ~unseen).any(axis=1).sum())
    missing = np.full((len(table), len(columns) - len(there)), np.nan)
    return np.hstack([table.to_numpy(np.float64), missing]), wrong


# ---- Unreadable rows of a table: where, why, and the remedy.

# What to do about a cell or a row.
NUMBER_REMEDY = "write numbers as 1050.25"
TIME_REMEDY = "write times in seconds (0.008), or as 2026-11-21T10:00:00.008Z"
CELLS_REMEDY = (
    "give each row as many cells as the header has, with ';' between them where numbers have ','"
)
DAMAGED_REMEDY = EXPORT_AGAIN


class UnreadableError(ValueError):
    """A row that cannot be read, and what the user may do about it."""

    def __init__(self, why: str, remedy: str) -> None:
        super().__init__(why)
        self.remedy = remedy
        self.is_damage = remedy == DAMAGED_REMEDY  # or it is in another notation


def unreadable(column: str, cell: str, why: object, remedy: str) -> UnreadableError:
    """Build the error of an unreadable cell."""
    return UnreadableError(f"column {column[:60]!r}: {cell.strip()[:60]!r} {why}", remedy)


class Failures:
    """Unreadable rows of a table."""

    def __init__(self) -> None:
        self._first: dict[bool, tuple[int, UnreadableError]] = {}
        self._counts = {True: 0, False: 0}

    def __len__(self) -> int:
        return sum(self._counts.values())

    def add(self, line: int, error: UnreadableError) -> None:
        """Count an unreadable line."""
        self._counts[error.is_damage] += 1
        self._first.setdefault(error.is_damage, (line, error))

    def lost(self, rows: int) -> str:
        """Describe the unreadable rows as a loss, where the others are used."""
        line, error = min(self._first.values(), key=lambda failure: failure[0])
        return (
            f"{len(self)} of {rows} rows could not be read and were left out "
            f"(the first is line {line}, {error})"
        )

    def refusal(self, rows: int) -> str:
        """Return why the table should be refused; "" where too few rows fail."""
        count = self._counts[False]
        if count < 2 or count <= 0.05 * rows:  # with more the file is not damaged, but misread
            return ""
        return f"{count} of {rows} rows cannot be read; {self._first_failure(is_damage=False)}"

    def nothing(self, rows: int) -> str:
        """Return why no row of a table was of use."""
        if not rows:
            return f"it has no row; {DAMAGED_REMEDY}"
        if not self._first:
            return f"none of its {rows} rows holds a value; name the columns of those that do"
        return (
            f"none of its {rows} rows can be read; {self._first_failure(False not in self._first)}"
        )

    def _first_failure(self, is_damage: bool) -> str:
        line, error = self._first[is_damage]
        return f"the first is line {line}, {error}; {error.remedy}"


# ---- Recognize headerless tables by their rows: TUM, KITTI, echoed ROS messages.

LOOK_ROWS = 50  # looked at: what all of them share is no accident
_MIN_ROWS = 3
_OFF = 0.02  # by which a quaternion's norm or a rotation may differ from 1: files are rounded
_TURN = tuple(f"orientation.{axis}" for axis in "xyzw")
_POSE = ("x", "y", "z", *_TURN)
_ROS_POSE = ("x (m)", "y (m)", "z (m)", *_TURN)
_COVARIANCE = tuple(f"covariance{at}" for at in range(36))
_STAMP = ("header.stamp.sec", "header.stamp.nanosec")
_TWIST = tuple(f"twist{at}" for at in range(6 + 36))
_MATRIX = ("r11", "r12", "r13", "x", "r21", "r22", "r23", "y", "r31", "r32", "r33", "z")


@dataclass(frozen=True)
class KnownRows:
    """Recognized format of headerless rows."""

    what: str  # in words
    separator: str | None  # of cells; None is white space
    names: tuple[str, ...]  # of the columns
    has_clock: bool = True  # whether rows have times; else a row is a frame
    # what the user has to state, where the rows are ambiguous; "" where they are not
    remedy: str = ""
    texts: tuple[int, ...] = ()  # text columns, which are equal in every row

    def of_one(
        self, path: Path, rows: Iterable[tuple[int, str | None]]
    ) -> Iterator[tuple[int, str | None]]:
        """Yield the rows, which all have to name the same object."""
        first: list[str] = []
        for number, line in rows:
            cells = cells_of(line, self.separator) if line is not None else []
            texts = [cells[at].strip() for at in self.texts if len(cells) == len(self.names)]
            first = first or texts
            for one, other in zip(first, texts, strict=False):
                if one == other:
                    continue
                raise LogError(
                    f"{path}: line {number} is of {short_name(other)!r}, those before it of "
                    f"{short_name(one)!r}",
                    f"keep one of them, for example: grep ,{one or ','}, {path.name} > one.csv",
                )
            yield number, line


def known_rows(lines: Sequence[str]) -> KnownRows | None:
    """Recognize headerless rows by their numbers; None where these are inconclusive."""
    for separator in (",", "\t", ";", None):
        rows = [cells_of(line, separator) for line in lines]
        widths = {len(row) for row in rows}
        if len(rows) >= _MIN_ROWS and len(widths) == 1 and min(widths) > 1:
            stripped = [[cell.strip() for cell in row] for row in rows]
            numbers = np.array([[number_of(cell) for cell in row] for row in stripped])
            return _echoed(separator, stripped, numbers) or _trajectory(separator, numbers)
    return None


def _trajectory(separator: str | None, numbers: NDArray[np.float64]) -> KnownRows | None:
    """Recognize TUM (time, position, quaternion) and KITTI (3 x 4 matrix) trajectories."""
    if not np.isfinite(numbers).all():
        return None
    width = numbers.shape[1]
    increases = bool((np.diff(numbers[:, 0]) > 0).all())
    if width == 8 and increases and _is_turn(numbers[:, 4:]):
        return KnownRows("a TUM trajectory", separator, ("t", *_POSE))
    if width == 7 and _is_turn(numbers[:, 3:]):
        remedy = "--columns x=1,y=2,z=3 --fps RATE, or write them with their times"
        return KnownRows("a list of poses without times", separator, _POSE, False, remedy)
    if width in (12, 13) and _is_rotation(numbers[:, -12:]):
        if width == 13 and not increases:
            return None
        names = _MATRIX if width == 12 else ("t", *_MATRIX)
        return KnownRows("a KITTI trajectory", separator, names, width == 13)
    return None


def _echoed(
    separator: str | None, rows: Sequence[Sequence[str]], numbers: NDArray[np.float64]
) -> KnownRows | None:
    """Recognize stamped messages of `ros2 topic echo --csv`: field by field, no names."""
    if separator != "," or numbers.shape[1] < 4 or not _are_stamps(numbers[:, :2]):
        return None
    fields = list(zip(*rows, strict=True))[2:]
    count = sum(1 for _ in takewhile(lambda cells: all(map(_is_text, cells)), fields))
    values = numbers[:, 2 + count :]
    if not count or any(_is_text(cell) for cells in fields[count:] for cell in cells):
        return None
    what = "`ros2 topic echo --csv` of "
    width = values.shape[1]
    is_pose = width >= 7 and _is_turn(values[:, 3:7])
    if is_pose and count == 1 and width in (7, 7 + 36):
        kind = "PoseStamped" if width == 7 else "PoseWithCovarianceStamped"
        names = (*_STAMP, "frame_id", *_ROS_POSE, *_COVARIANCE[: width - 7])
        return KnownRows(what + kind, separator, names, texts=(2,))
    if is_pose and count == 2 and width in (7, 7 + 36 + 42):
        kind = "TransformStamped" if width == 7 else "Odometry"
        more = (*_COVARIANCE, *_TWIST) if width > 7 else ()
        names = (*_STAMP, "frame_id", "child_frame_id", *_ROS_POSE, *more)
        return KnownRows(what + kind, separator, names, texts=(2, 3))
    texts = tuple(range(2, 2 + count))
    joints = rows[0][3 : 2 + count]
    if joints and width == 3 * len(joints) and len(set(joints)) == len(joints) and all(joints):
        quantities = ("position", "velocity", "effort")
        names = (
            *(*_STAMP, "frame_id", *(f"name of joint {at}" for at in range(1, count))),
            *(f"/joint_states/{joint}/{one}" for one in quantities for joint in joints),
        )
        return KnownRows(what + "JointState", separator, names, texts=texts)
    places = zip("xyz"[: width if width < 4 else 3], range(3 + count, 6 + count), strict=False)
    said = ",".join(f"{axis}={at}" for axis, at in places) if width != 1 else f"z={3 + count}"
    remedy = f"where the numbers in columns {said} are a place, say so with --columns {said}"
    columns = (f"column {at + 1}" for at in range(2 + count, 2 + count + width))
    names = (*_STAMP, *(f"text {at + 1}" for at in texts), *columns)
    return KnownRows(what + "a type that its rows do not tell", separator, names, True, remedy)


def _are_stamps(values: NDArray[np.float64]) -> bool:
    """Return whether columns are integer seconds, and nanoseconds that are no mere counts."""
    if not np.isfinite(values).all() or (values != np.floor(values)).any():
        return False
    rest = values[:, 1]
    in_range = (values >= 0).all() and (rest < _S_NS).all()
    return bool(in_range and (rest > 1000).any())


def _is_turn(values: NDArray[np.float64]) -> bool:
    return bool((np.abs(np.linalg.norm(values, axis=1) - 1) < _OFF).all())


def _is_rotation(values: NDArray[np.float64]) -> bool:
    turns = values.reshape(-1, 3, 4)[:, :, :3]
    products = turns @ turns.transpose(0, 2, 1)
    return bool((np.abs(products - np.eye(3)) < _OFF).all() and (np.linalg.det(turns) > 0).all())


def _is_text(cell: str) -> bool:
    return isnan(number_of(cell)) and cell.strip().lower().lstrip("+-") != "nan"


def number_of(value: Any) -> float:
    """Return a value as a number, NaN where it is none."""
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return nan


# ---- Parse numbers in any locale, as long as they are unambiguous.

# What stands in a cell for no value, in small letters.
_NUMBERLESS = frozenset(("", "-", "--", "null", "none", "na", "n/a", "<na>", "#n/a"))
# A number with any marks between its digits.
_MARKED_NUMBER = re.compile(r"[+-]?[\d.,]+(?:e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
# Thousands in groups, beyond doubt: with a mark of decimals as well, or two groups and more.
_IN_GROUPS = re.compile(
    r"[+-]?[1-9]\d{0,2}(?:(?:,\d{3})+\.\d*|(?:\.\d{3})+,\d*|(?:,\d{3}){2,}|(?:\.\d{3}){2,})",
    re.ASCII,
)
# What may be a thousand or more, or have three decimals.
_ONE_GROUP = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}", re.ASCII)


@dataclass(frozen=True)
class Numbers:
    """Number format of a table."""

    separator: str | None  # of cells; None is white space
    decimal: str = ""  # decimal mark; "" where the first rows do not show it

    def plain(self, cell: str) -> str:
        """Normalize a number's text to a decimal point; ValueError where it is ambiguous."""
        text = cell.strip()
        if "," not in text and text.count(".") < (1 if self.decimal == "," else 2):
            return text
        if _IN_GROUPS.fullmatch(text):
            mark = max(text.rfind(","), text.rfind("."))
            if text.count(text[mark]) > 1:
                return text.replace(text[mark], "")
            return re.sub("[.,]", "", text[:mark]) + "." + text[mark + 1 :]
        if _ONE_GROUP.fullmatch(text) and self._is_doubtful("," if "," in text else "."):
            digits = re.split("[.,]", text)
            raise ValueError(f"may be {'.'.join(digits)} or {''.join(digits)}")
        return text.replace(",", ".") if self.separator != "," and "." not in text else text

    def _is_doubtful(self, mark: str) -> bool:
        return mark == self.separator or self.decimal not in ("", mark)

    def read(self, cell: str) -> float:
        """Parse a number, NaN where a cell has none; ValueError where it holds something else."""
        try:
            value = float(
                cell if self.decimal != "," else (cell.replace(",", ".") if "." not in cell else "")
            )
        except ValueError:
            text = self.plain(cell)
            try:
                value = nan if text.lower() in _NUMBERLESS else float(text)
            except ValueError:
                raise ValueError("is no number") from None
        return value if isfinite(value) else nan


class Thousands:
    """Detector of columns with ambiguous thousands separators: `1.050` beside `985`.

    A table that writes decimals writes more or fewer of them somewhere, or none below 1000 only.
    """

    def __init__(self, columns: Iterable[int]) -> None:
        self._undecided = set(columns)
        self._groups: dict[int, str] = {}
        self._wholes: set[int] = set()

    def look(self, rows: Sequence[Sequence[str]]) -> None:
        """Examine some more rows."""
        for at in tuple(self._undecided):
            for row in rows:
                text = row[at].strip()
                if _ONE_GROUP.fullmatch(text):
                    self._groups.setdefault(at, text)
                elif (digits := text.lstrip("+-")).isdecimal() and len(digits) < 4:
                    if digits.strip("0"):
                        self._wholes.add(at)
                elif any(map(str.isdecimal, text)):
                    self._undecided.discard(at)
                    break

    def doubt(self, names: Sequence[str]) -> str:
        """Describe an ambiguous column; "" where there is none."""
        at = min(self._undecided & self._groups.keys() & self._wholes, default=None)
        if at is None:
            return ""
        one, two = re.split("[.,]", self._groups[at])
        return (
            f"column {names[at][:60]!r}: {self._groups[at]!r} beside whole numbers may be "
            f"{one}.{two} or {one}{two}"
        )


def is_missing(cell: str) -> bool:
    """Return whether a cell holds no value, or a mark of that."""
    text = cell.strip().lower()
    return text in _NUMBERLESS or text == "nan"


def decimal_of(cells: Iterable[str]) -> str:
    """Detect the decimal mark of numbers; "" where they show none, or disagree."""
    marks = {mark for cell in cells if (mark := _mark(cell.strip()))}
    return marks.pop() if len(marks) == 1 else ""


def _mark(text: str) -> str:
    at = max(text.rfind(","), text.rfind("."))
    if at < 0 or not _MARKED_NUMBER.fullmatch(text) or _ONE_GROUP.fullmatch(text):
        return ""
    mark = text[at]
    return mark if text.count(mark) == 1 else ".,".replace(mark, "")


# ---- Parse times: numbers of any unit, dates, and times of day.

# A number and its unit: "0.008 sec".
_WITH_UNIT = re.compile(rf"(\S+)\s+({'|'.join(POWERS)})", re.ASCII | re.IGNORECASE)
# A date: the year first, or last as people write it.
_DAY = r"(\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.]\d\d?[-/.]\d{4})"
# A time of the day, to the nanosecond.
_HOURS = r"(\d{1,2}):(\d\d)(?::(\d\d)(?:[.,](\d{1,9}))?)?(?:\s?([AaPp])[Mm])?"
# A date and perhaps the time of that day, with or without a zone: ISO 8601 and its kin.
_DATE = re.compile(rf"{_DAY}(?:[T ]\s?{_HOURS})?\s?(Z|[+-]\d\d(?::?\d\d)?)?", re.ASCII)
# A time of day alone, or minutes and seconds as spreadsheets show them without hours: 30:25.1.
_OF_DAY = re.compile(rf"{_HOURS}|(\d{{1,4}}):(\d\d)[.,](\d{{1,9}})", re.ASCII)
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)  # what stamps count from
MAX_NS = 2**62  # half of what int64 holds, so that differences fit as well: to the year 2116
_S_NS = 10**9
_HOUR_NS, _DAY_NS = 3600 * _S_NS, 86_400 * _S_NS
_NAMES = {_S_NS: "s", 10**6: "ms", 10**3: "us", 1: "ns"}  # units of times [ns]
_MAX_STEP_S = 2.0  # from row to row, for times since 1970 or days of a spreadsheet
# Least step of times in each unit [ns]: what moves is sampled at 2.5 Hz to 2 kHz.
_STEPS = ((5e8, _S_NS), (4e5, 1), (400.0, 10**3), (2.0, 10**6))
# Steps of times in s lie between these: larger ones may be another unit's, smaller ones no log has.
_SLOW_STEP, _FAST_STEP = 0.5, 2e-5
UNIT_ROWS = 100  # whose steps and size tell the unit of times that name none


@dataclass(frozen=True)
class Clock:
    """Time columns of a table's rows."""

    name: str  # of its column, or of the first of two
    # of the columns: one, one of seconds and one of nanoseconds, or a date and a time
    indices: tuple[int, ...]
    power: int | None  # the unit as a power of ten of a second; None to go by the numbers
    scope: tuple[str, ...] = ()  # the words before it in its name: what it is the time of
    counts_frames: bool = False  # whether it numbers frames, read as so many seconds
    has_date: bool = False  # whether the first of two columns is a date, which a time of day lacks
    unit_ns: int = 0  # the unit, where it is no power of ten


class TextClock:
    """Reader of a clock's texts, row by row; times of day go on across midnight.

    The texts of its columns in the `first` rows tell the unit of times; ValueError if none fits.
    """

    def __init__(
        self, clock: Clock, first: Sequence[Sequence[str]], is_sampled: bool = True
    ) -> None:
        self._clock = clock
        self._is_sum = len(clock.indices) > 1 and not clock.has_date
        self._turn_ns = self._last_ns = self._turns_ns = 0
        self.doubts: list[str] = []
        texts = [row[-1 if clock.has_date else 0] for row in first]
        if any(
            _DATE.fullmatch(one) or _WITH_UNIT.fullmatch(one) or is_of_day(one) for one in texts
        ):
            self._unit_ns = 10 ** (9 + (clock.power or 0))
            if any(one and one[2] and not one[7] for one in map(_DATE.fullmatch, texts)):
                self.doubts.append(f"{clock.name!r} names no time zone and was taken as UTC")
            of_day = next(filter(is_of_day, texts), "")
            if of_day and not clock.has_date:  # without hours it begins anew every hour
                self._turn_ns = _HOUR_NS if of_day.count(":") == 1 else _DAY_NS
            return
        power = 0 if self._is_sum or clock.counts_frames else clock.power
        self._unit_ns = clock.unit_ns
        if clock.unit_ns:
            return
        self._unit_ns, doubt = unit_of_times(clock.name, texts, power, is_sampled=is_sampled)
        self.doubts += [doubt] if doubt else []

    def read(self, texts: Sequence[str]) -> int:
        """Parse the time of a row [ns]; ValueError where it is none."""
        if self._is_sum:
            return exact_ns(texts[0], 0) + exact_ns(texts[1], -9)
        text = texts[-1]
        if ":" not in text:
            try:
                return self._turned(_units_ns(text, self._unit_ns))
            except ValueError:
                return self._turned(_own_ns(text))
        if self._clock.has_date and is_of_day(text):
            return _own_ns(texts[0]) + _own_ns(text)
        return self._turned(_own_ns(text))

    def _turned(self, time_ns: int) -> int:
        """Return the time since the first midnight, from that since its own."""
        if self._turn_ns // 2 < self._last_ns - time_ns < self._turn_ns:
            self._turns_ns += self._turn_ns
        self._last_ns = time_ns
        return time_ns + self._turns_ns


def exact_ns(text: str, power: int) -> int:
    """Convert a decimal number of 10**power seconds to the nearest ns; ValueError if it is none."""
    return _units_ns(text, 10 ** (9 + power))


def _units_ns(text: str, unit_ns: int) -> int:
    if len(text) > 60:  # a longer one costs too much to read
        raise ValueError("a time of too many digits")
    try:
        number = Decimal(text)
        if not number.is_finite() or number.adjusted() > 20:
            raise ValueError(f"{text} is no time")
        nanoseconds = int((number * unit_ns).to_integral_value())
    except ArithmeticError as error:
        raise ValueError(f"{text} is no number") from error
    if abs(nanoseconds) > MAX_NS:
        raise ValueError(f"{text} is no time")
    return nanoseconds


def unit_of_times(
    name: str, texts: Iterable[object], power: int | None, *, is_sampled: bool = True
) -> tuple[int, str]:
    """Determine the unit of a time column by its name, else by the size and steps of its numbers.

    Return its length [ns], and how it was inferred where no name states it, in words. Stamps since
    1970 show it by their size, others by their step: moving objects are sampled some 2 to 2000
    times a second, and a unit is a thousand times the next. A gap is a step among many. Raises
    ValueError where no unit has such steps.
    """
    if power is not None:
        return 10 ** (9 + power), ""
    numbers = [one for one in map(number_of, islice(texts, UNIT_ROWS)) if isfinite(one)]
    rises = [b - a for a, b in pairwise(numbers) if b > a]
    size, step = median(map(abs, numbers)) if numbers else 0.0, _usual(rises)
    for unit_ns in _NAMES:
        second = 1e9 / unit_ns
        is_recent = 1e9 <= size / second < 4e9  # 2001 to 2096
        if is_recent and (step <= _SLOW_STEP * second or not is_sampled):
            return unit_ns, ""
        if is_recent and step <= _MAX_STEP_S * second:  # or since the start of a computer
            return _guessed(name, unit_ns, step)
    # Days of a spreadsheet count from 1900: 1954 to 2119.
    if 20_000 <= size < 80_000 and 0 < step * 86_400 <= _MAX_STEP_S:
        doubt = f"{name!r} names no unit and was taken as the days of a spreadsheet since 1900"
        return _DAY_NS, doubt
    if is_sampled and 0 < step < _FAST_STEP:
        raise ValueError(
            f"column {name[:60]!r} rises by {step:.2g} from row to row, which is too fast to be s; "
            "write it in s, or name its unit: t_s, t_ms, t_us or t_ns"
        )
    if not is_sampled or step < _SLOW_STEP:
        return _S_NS, ""
    # Counts of frames or seconds begin below 1000; larger whole numbers that rise by 1 are ms. Of
    # fractions those with a larger step are ms of a fast sensor, not s of a slow one.
    are_whole = all(number.is_integer() for number in numbers)
    is_count = step < 2.0 and (numbers[0] < 1000 if are_whole else step < 0.8)
    is_count |= len(rises) < 8  # too few to tell a unit
    found = next((unit for least, unit in _STEPS if step >= least), 10**6)
    return _guessed(name, _S_NS if is_count else found, step)


def _guessed(name: str, unit_ns: int, step: float) -> tuple[int, str]:
    others = " or ".join(f"t_{other}" for ns, other in _NAMES.items() if ns != unit_ns)
    return unit_ns, (
        f"{name!r} names no unit and was taken as {_NAMES[unit_ns]}: it rises by {step:g} from row "
        f"to row; if it is not, name it {others}"
    )


def _usual(rises: Sequence[float]) -> float:
    """Return the mean increment without the largest tenth, which are gaps; 0 without any."""
    usual = sorted(rises)[: max(1, len(rises) - len(rises) // 10)]
    return sum(usual) / len(usual) if usual else 0.0


def is_of_day(text: str) -> bool:
    """Return whether a text is a time of day without a date."""
    return bool(_OF_DAY.fullmatch(text.strip()))


def _own_ns(text: str) -> int:
    """Parse a time with its unit: "0.008 sec", a date without a zone in UTC, "9:30:00"."""
    text = text.strip()
    if own := _WITH_UNIT.fullmatch(text):
        return exact_ns(own[1], POWERS[own[2].lower()])
    if of_day := _OF_DAY.fullmatch(text):
        *whole, minutes, seconds, part = of_day.groups()
        if minutes is None:
            return _of_day_ns(*whole)
        return int(minutes) * 60 * _S_NS + _of_day_ns("0", "0", seconds, part, None)
    found = _DATE.fullmatch(text)
    if found is None:
        raise ValueError(f"{text} is no time")
    day, *of_day, zone = found.groups()
    since = datetime.fromisoformat(f"{_iso_day(day)}T00:00:00{zone or 'Z'}") - _EPOCH
    nanoseconds = (since.days * 86400 + since.seconds) * _S_NS
    nanoseconds += _of_day_ns(*of_day) if of_day[0] else 0
    if abs(nanoseconds) > MAX_NS:
        raise ValueError(f"{text} is no time")
    return nanoseconds


def _of_day_ns(
    hours: str, minutes: str, seconds: str | None, part: str | None, half: str | None
) -> int:
    """Return a time since midnight [ns]; raise ValueError where there is no such time."""
    hour, minute, second = int(hours), int(minutes), int(seconds or 0)
    if half:
        if not 1 <= hour <= 12:
            raise ValueError(f"there is no {hour} o'clock")
        hour = hour % 12 + (12 if half in "pP" else 0)
    if hour > 23 or minute > 59 or second > 59:
        raise ValueError("there is no such time of the day")
    return (hour * 3600 + minute * 60 + second) * _S_NS + int((part or "").ljust(9, "0"))


def _iso_day(day: str) -> str:
    """Return a date with the year first; in 1/2/2026 the month is first, unless impossible."""
    one, two, three = (int(part) for part in re.split("[-/.]", day))
    if len(day) > 4 and day[:4].isdecimal():
        return f"{one:04}-{two:02}-{three:02}"
    if "/" in day and two <= 31 and one <= 12:
        one, two = two, one
    return f"{three:04}-{two:02}-{one:02}"
