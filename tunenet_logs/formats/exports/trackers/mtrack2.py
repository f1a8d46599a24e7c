"""Read ImageJ's MTrack2 tables: one row per frame, three columns per track, in blocks of tracks."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from itertools import chain
from math import isfinite
from pathlib import Path

from tunenet_logs.episode import UNSTATED, Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.exports.build import export_episode
from tunenet_logs.formats.exports.trackers.mtrack2_blanks import Follower, points_of
from tunenet_logs.formats.exports.trackers.spot_rows import Tracks, TrackUnits
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.tables.failures import DAMAGED_REMEDY, Failures, UnreadableError
from tunenet_logs.formats.tables.numbers import Numbers

# How such a file begins, and what stands between its cells.
_HEADER = re.compile(r"Frame([\t,; ])X1\1Y1\1Flag1(?:\1|$)")

# Which tracks the next rows are of.
_BLOCK = re.compile(r"Tracks[\s,;](\d{1,6})[\s,;]to[\s,;]\d{1,6}\b")

# What stands above one row for each track, below all of the frames.
_SUMMARY = re.compile(r"Track\s*[\s,;]Length")


def is_mtrack2(line: str) -> bool:
    """Return whether a file with this first line is an MTrack2 table."""
    return _HEADER.match(line) is not None


def read_mtrack2(path: Path, text: Iterable[str | None], options: ReadOptions) -> Episode:
    """Read each track as a signal in an unstated unit, its stamps counting frames.

    Args:
        path: of the file, for messages.
        text: its lines, or those of one of its sheets.
        options: the user's.

    Raises:
        LogError: no row can be read, or many cannot.
    """
    lines = iter(text)
    header = next(lines, None)
    found = _HEADER.match(header or "")
    if found is None:
        raise LogError(f"{path}: is no table of MTrack2; export it again")
    table = _Blocks(path, found[1])
    for number, line in enumerate(lines, 2):
        if not table.takes(number, line):
            break
    return table.episode(options)


class _Blocks:
    """Rows of a table, while they are read."""

    def __init__(self, path: Path, separator: str) -> None:
        self._path = path
        self._separator = separator
        self._numbers = Numbers(separator, "" if separator == "," else ".")
        self._tracks = Tracks(path)
        self._failures = Failures()
        self._first_track = 1
        self._rows = 0
        self._flags: Counter[str] = Counter()
        self._follower = Follower(1)

    def takes(self, number: int, line: str | None) -> bool:
        """Read a line; return whether rows may follow it."""
        if line is not None and (block := _BLOCK.match(line)):
            self._first_track = int(block[1])
            self._follower = Follower(self._first_track)
            return True
        if line is not None and _SUMMARY.match(line):
            return False
        if line is not None and (not line.strip(" \t,;") or _HEADER.match(line)):
            return True
        self._rows += 1
        try:
            if line is None:
                raise UnreadableError("it is longer than any row", DAMAGED_REMEDY)
            self._add(line)
        except UnreadableError as error:
            self._failures.add(number, error)
        return True

    def _add(self, line: str) -> None:
        if self._separator == " ":
            self._add_blanks(line)
            return
        cells = line.split(self._separator)
        try:
            frame, *values = [
                float("nan") if at and at % 3 == 0 else self._numbers.read(cell)
                for at, cell in enumerate(cells)
            ]
        except ValueError:
            raise UnreadableError(f"{line[:60]!r} is no row", DAMAGED_REMEDY) from None
        if frame != frame:  # noqa: PLR0124 (NaN)
            raise UnreadableError(f"{line[:60]!r} is no row", DAMAGED_REMEDY)
        for at in range(0, len(values) - 1, 3):
            x, y = values[at : at + 2]
            if x == x and y == y:  # noqa: PLR0124 (NaN)
                name = f"track{self._first_track + at // 3}"
                self._tracks.add(name, frame, (x, y, 0.0))
                self._flags[name] += len(cells) > at + 3 and cells[at + 3].strip() == "*"

    def _add_blanks(self, line: str) -> None:
        frame, *cells = line.split()
        try:
            when = self._numbers.read(frame)
            pairs, flags = points_of(cells)
            points = [(self._numbers.read(x), self._numbers.read(y)) for x, y in pairs]
            if not all(map(isfinite, (when, *chain(*points)))):
                raise ValueError("a number is missing")
            numbers = self._follower.named(when, points)
        except ValueError:
            raise UnreadableError(f"{line[:60]!r} is no row", DAMAGED_REMEDY) from None
        for number, (x, y), flag in zip(numbers, points, flags, strict=True):
            self._tracks.add(f"track{number}", when, (x, y, 0.0))
            self._flags[f"track{number}"] += flag

    def episode(self, options: ReadOptions) -> Episode:
        """Build an episode of the rows."""
        if not len(self._tracks):
            raise LogError(f"{self._path}: table of MTrack2: {self._failures.nothing(self._rows)}")
        if why := self._failures.refusal(self._rows):
            raise LogError(f"{self._path}: table of MTrack2: {why}")
        signals, unused, notes = self._tracks.signals(TrackUnits(UNSTATED, None), options)
        notes += [
            f"{name}: MTrack2 was not sure of {count} of its places"
            for name, count in self._flags.items()
            if count and name not in unused
        ]
        lost = [self._failures.lost(self._rows)] if self._failures else []
        return export_episode(
            self._path,
            "MTrack2 table of ImageJ",
            signals,
            unused=unused,
            warnings=notes,
            losses=lost,
        )
