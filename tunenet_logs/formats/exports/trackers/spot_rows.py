"""Collect tracks from text rows that each give positions of objects in an image."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Signal
from tunenet_logs.errors import LogError
from tunenet_logs.formats.exports.build import frame_stamps, position_signal, time_stamps
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.tables.failures import NUMBER_REMEDY, unreadable
from tunenet_logs.formats.tables.numbers import Numbers

# Of a text of tracks: an hour of pictures with a hundred things in each is a tenth of that.
MAX_BYTES = 256 * 1024**2

MAX_TRACKS = 1000  # that become signals, the longest; whoever tracks cells has many thousands
_MAX_PLACES = 2_000_000  # of all tracks together
_MAX_NAMES = 100_000  # of tracks that are told apart


@dataclass(frozen=True)
class Place:
    """Columns of one object's position; None where there is none.

    Attributes:
        axes: of x, y, z.
    """

    name: str
    axes: tuple[int | None, int | None, int | None]


@dataclass(frozen=True)
class TrackUnits:
    """Units of a file's numbers.

    Attributes:
        length: as `position_signal` takes it.
        second: unit of time [s]; None where rows count frames.
        rate_hz: frame rate; None where it is unstated.
    """

    length: str
    second: float | None
    rate_hz: float | None = None


@dataclass(eq=False)
class _Track:
    whens: array[float] = field(default_factory=lambda: array("d"))
    places: array[float] = field(default_factory=lambda: array("d"))


class Tracks:
    """All tracks of a file, filled row by row."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._tracks: dict[str, _Track] = {}
        self._count = 0

    def __len__(self) -> int:
        return len(self._tracks)

    def add(self, name: str, when: float, place: tuple[float, float, float]) -> None:
        """Add a position to a track.

        Args:
            name: of the track.
            when: a time or a frame's number.
            place: NaN where not seen.

        Raises:
            LogError: there are too many tracks or positions.
        """
        self._count += 1
        if self._count > _MAX_PLACES:
            raise LogError(
                f"{self._path}: holds more than {_MAX_PLACES} places; export fewer tracks"
            )
        track = self._tracks.get(name)
        if track is None:
            if len(self._tracks) == _MAX_NAMES:
                raise LogError(
                    f"{self._path}: holds more than {_MAX_NAMES} tracks; filter them first"
                )
            track = self._tracks.setdefault(name, _Track())
        track.whens.append(when)
        track.places.extend(place)

    def signals(
        self, units: TrackUnits, options: ReadOptions
    ) -> tuple[list[Signal], dict[str, str], list[str]]:
        """Return the signals, unused tracks with the reason, and notes on repairs.

        Raises:
            LogError: a time is not finite.
        """
        names = sorted(self._tracks, key=lambda name: -len(self._tracks[name].whens))
        unused: dict[str, str] = {}
        if (rest := len(names) - MAX_TRACKS) > 0:
            unused[f"{rest} more tracks"] = f"they are no longer than the {MAX_TRACKS} longest"
        kept = set(names[:MAX_TRACKS])
        signals: list[Signal] = []
        notes: list[str] = []
        for name, track in self._tracks.items():
            if name not in kept:
                continue
            try:
                stamps, counts = _stamps(np.frombuffer(track.whens), units, options)
            except ValueError:
                raise LogError(
                    f"{self._path}: {name}: a time or frame is no number; mend it or leave it out"
                ) from None
            values = np.frombuffer(track.places).reshape(-1, 3)
            signal, repairs = position_signal(
                name, stamps, values, units.length, options, counts_frames=counts
            )
            if len(signal.stamps_ns):
                signals.append(signal)
                notes += repairs
            else:
                unused[name] = "it is seen in no row"
        return signals, unused, notes


def _stamps(
    whens: NDArray[np.float64], units: TrackUnits, options: ReadOptions
) -> tuple[NDArray[np.int64], bool]:
    if units.second is None:
        return frame_stamps(whens, units.rate_hz, options)
    return time_stamps(whens * units.second), False


def number_at(cells: Sequence[str], index: int, header: Sequence[str], numbers: Numbers) -> float:
    """Parse a cell as a number; NaN for an empty one.

    Raises:
        UnreadableError: it holds no number.
    """
    try:
        return numbers.read(cells[index])
    except ValueError as why:
        raise unreadable(header[index], cells[index], why, NUMBER_REMEDY) from None


def place_at(
    cells: Sequence[str], place: Place, header: Sequence[str], numbers: Numbers
) -> tuple[float, float, float]:
    """Parse an object's position in a row; 0 along an axis without a column.

    Raises:
        UnreadableError: a cell holds no number.
    """
    x, y, z = (
        0.0 if index is None else number_at(cells, index, header, numbers) for index in place.axes
    )
    return x, y, z


def best_separator(line: str) -> str | None:
    """Return the separator of a header's cells; None is white space."""
    counts = {mark: line.count(mark) for mark in "\t;,"}
    mark = max(counts, key=lambda one: counts[one])
    return mark if counts[mark] else None


def unique_names(names: Iterable[str]) -> list[str]:
    """Shorten names and make them unique: the second "a" is "a 2"."""
    used: set[str] = set()
    found: list[str] = []
    for name in names:
        short = " ".join("".join(filter(str.isprintable, name)).split())[:60] or "track"
        number, chosen = 1, short
        while chosen in used:
            number += 1
            chosen = f"{short} {number}"
        used.add(chosen)
        found.append(chosen)
    return found
