"""Group the columns of a table into signals, and build an episode of their rows.

First what all readers of exports share: stamps, position signals, the episode. Then two kinds of
export with fixed columns: markers side by side (motion capture), and objects below each other
(trackers). Then tables of any columns: `table_layout_of` groups joints and coordinates by the names
of a header, `rows_of_runs` splits stacked runs, and `SignalSamples` collects a group's rows.
"""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tunenet_logs.episode import (
    FRAME_NS,
    INCOMPLETE,
    UNREADABLE,
    UNSTATED,
    Channel,
    Episode,
    EpisodeInfo,
    Signal,
    added,
    in_proportion,
)
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.formats.columns.cells import (
    NUMBER_REMEDY,
    Clock,
    LineReader,
    NumberFormat,
    Numbers,
    format_of,
    numbers_of,
    unended,
    unreadable,
)
from tunenet_logs.formats.columns.names import (
    LENGTHS,
    CoordinateColumn,
    DateColumn,
    FrameColumn,
    ImpactColumn,
    ImpactNumberColumn,
    JointColumn,
    JointNameColumn,
    Meaning,
    Reading,
    RunColumn,
    TimeColumn,
    UnusedColumn,
    Words,
    by_name,
    lowered,
    meaning_of,
    runs_of,
    words_of,
)
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.timing.stamps import fill_holes, order_samples, sorted_stamps

_MAX_S = 2.0**62 * 1e-9  # half of what int64 holds in ns, so that differences fit as well


def time_stamps(seconds: ArrayLike) -> NDArray[np.int64]:
    """Convert times [s] to stamps [ns], shape (T,).

    Raises:
        ValueError: one is not finite, or out of range.
    """
    values = np.asarray(seconds, np.float64)
    if not np.all(np.abs(values) < _MAX_S):  # NaN is not
        raise ValueError("a time is none")
    return np.round(values * 1e9).astype(np.int64)


def frame_stamps(
    frames: ArrayLike, rate_hz: float | None, options: ReadOptions
) -> tuple[NDArray[np.int64], bool]:
    """Convert frame numbers to stamps [ns], shape (T,), and say whether their rate is unknown.

    Args:
        frames: numbers, shape (T,).
        rate_hz: stated by the file; None where it is unstated. `--fps` takes precedence.
        options: the user's.

    Raises:
        ValueError: a number is not finite, or out of range.
    """
    rate = options.rate_hz or rate_hz
    period_s = FRAME_NS * 1e-9 if not rate else 1 / rate
    return time_stamps(np.asarray(frames, np.float64) * period_s), not rate


def position_signal(
    name: str,
    stamps_ns: NDArray[np.int64],
    values: ArrayLike,
    unit: str,
    options: ReadOptions,
    *,
    counts_frames: bool = False,
) -> tuple[Signal, list[str]]:
    """Build an object's position signal from the rows in which it was seen, and note repairs.

    Args:
        name: of the signal.
        stamps_ns: shape (T,).
        values: x, y, z in `unit`, z up where the file states the vertical; NaN where unseen,
            shape (T, 3).
        unit: one of `LENGTHS`, "px" or `UNSTATED`; `--length-unit` overrides the last two.
        options: the user's.
        counts_frames: see `Signal`.
    """
    rows = np.asarray(values, np.float64)
    seen = np.isfinite(rows).all(axis=1)
    keep, ordered, notes, left_out = sorted_stamps(stamps_ns[seen], (rows[seen],))
    unit = unit if unit in LENGTHS else options.length_unit or unit
    scale, unit = (LENGTHS[unit], "m") if unit in LENGTHS else (1.0, unit or UNSTATED)
    signal = Signal(
        name,
        ordered,
        rows[seen][keep] * scale,
        ("x", "y", "z"),
        unit,
        counts_frames=counts_frames,
        left_out=left_out,
    )
    return signal, [f"{name}: {note}" for note in notes]


def export_episode(
    path: Path,
    what: str,
    signals: Sequence[Signal],
    *,
    unused: Mapping[str, str] | None = None,
    warnings: Sequence[str] = (),
    losses: Sequence[str] = (),
    notes: Mapping[str, str] | None = None,
) -> Episode:
    """Build the episode of an export.

    Args:
        path: of the file.
        what: kind of file: "OptiTrack Motive export", ...
        signals: that a task may use; each name once.
        unused: what else it holds, by name: why that is not used.
        warnings: what was repaired or is doubtful, in words.
        losses: warnings that mean damage.
        notes: of the episode's info.
    """
    channels = [
        Channel(one.name, f"{_listed(one.columns)} [{one.unit or '?'}]", "export", one.stamps_ns)
        for one in signals
    ]
    none: NDArray[np.int64] = np.empty(0, np.int64)
    channels += [
        Channel(name[:200], "", "export", none, skipped=why) for name, why in (unused or {}).items()
    ]
    info = EpisodeInfo(source=f"{what} {path.name}", notes=notes or {})
    by_name = {one.name: one for one in signals if len(one.stamps_ns)}
    return Episode(info, by_name, tuple(channels), (*losses, *warnings), tuple(losses))


def _listed(columns: Sequence[str]) -> str:
    return ", ".join(columns) if len(columns) <= 8 else f"{len(columns)} columns"


# ---- Motion capture exports: three columns per body or marker, side by side.

_UNLABELED = re.compile(r"(?:.*:)?(?:\*\d+|unlabell?ed.*|unidentified.*|new ?\d+)", re.IGNORECASE)


@dataclass(frozen=True)
class MarkerTrack:
    """One body or marker.

    Attributes:
        name: as the file has it, made unique.
        columns: of x, y and z.
        unit: of its coordinates, as in `position_signal`.
        is_unlabeled: whether its name was generated; a file may have hundreds of these.
    """

    name: str
    columns: tuple[int, int, int]
    unit: str
    is_unlabeled: bool = False


@dataclass(frozen=True)
class MarkerTracks:
    """Tracks of a file, as its header describes them.

    Attributes:
        what: kind of file: "OptiTrack Motive export", ...
        tracks: in display order.
        frame: column of frame numbers; None: rows are counted.
        time: column of times [s]; None where there is none.
        sub_frame: column of parts of a frame.
        rate_hz: frame rate; None where it is unstated.
        frames: number of frames stated; None where it is unstated.
        zero_is_unseen: whether an unseen marker is written as 0, 0, 0.
        unused: what else it holds, by name: why that is not used.
        warnings: what is doubtful, in words.
    """

    what: str
    tracks: Sequence[MarkerTrack]
    frame: int | None = None
    time: int | None = None
    sub_frame: int | None = None
    rate_hz: float | None = None
    frames: int | None = None
    zero_is_unseen: bool = False
    unused: Mapping[str, str] = field(default_factory=dict)
    warnings: Sequence[str] = ()

    @property
    def named(self) -> str:
        """Kind of file, with its article."""
        return f"{'an' if self.what[:1] in 'AEIO' else 'a'} {self.what}"

    @property
    def columns(self) -> list[int]:
        """Sorted indices of the columns to read."""
        clocks = (self.frame, self.time, self.sub_frame)
        used = {index for track in self.tracks for index in track.columns}
        return sorted(used | {index for index in clocks if index is not None})


def is_unlabeled(name: str) -> bool:
    """Return whether a marker's name was generated by a program, not given by a user."""
    return not name or _UNLABELED.fullmatch(name) is not None


def unique(names: Iterable[str]) -> list[str]:
    """Return the names, with " (2)", " (3)" appended to repeated ones."""
    used: dict[str, int] = {}
    found: list[str] = []
    for name in names:
        taken = name or "unnamed"
        while taken in used:
            used[name] = used.get(name, 1) + 1
            taken = f"{name or 'unnamed'} ({used[name]})"
        used.setdefault(taken, 1)
        found.append(taken)
    return found


def unit_of(text: str) -> str:
    """Parse a unit of length, one of `LENGTHS`; `UNSTATED` where it is none."""
    unit = text.strip().lower()
    return unit if unit in LENGTHS else UNSTATED


def rate_of(text: str | None) -> float | None:
    """Parse a rate [Hz]; None where it is none."""
    try:
        value = float((text or "").replace(",", "."))
    except ValueError:
        return None
    return value if math.isfinite(value) and 0.01 < value < 1e6 else None


def count_of(text: str | None) -> int | None:
    """Parse a count; None where it is none."""
    text = re.sub(r"\.0*$", "", (text or "").strip())
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 12 else None


# ---- `TrackRows`: collect the rows of markers, each in the frames in which it was seen.

MAX_UNLABELED = 100  # of the tracks that no one named: those that were seen most are used
_MAX_VALUES = 20_000_000  # held of a file: 160 MB, and as much again while they are sorted
# Held of any file; of a larger one, a number for each so many bytes: small files take little room.
_FEWER_VALUES, _VALUE_BYTES = 8_000_000, 6
_MAX_ROWS = 500_000  # of a file: 8 minutes at 1 kHz; tuning takes over 512 bytes for each
_MAX_WRONG = 1000  # rows with cells that are no number; more may be no more than half of all
_ROUNDING_S = 0.6e-3  # of a time in a file: some are written with three decimals


class TrackRows:
    """Rows read of a file of tracks, kept only where something was seen."""

    def __init__(self, path: Path, tracks: MarkerTracks) -> None:
        self.path = path
        self.rows = 0
        self.wrong = 0
        self.is_cut = False
        self.is_broken = False
        self.tracks = tracks
        self._clocks: dict[int, list[NDArray[np.float64]]] = {}
        self._seen: list[list[tuple[NDArray[np.int64], NDArray[np.float64]]]] = [
            [] for _ in tracks.tracks
        ]
        self._values = 0
        self._most_values = min(
            _MAX_VALUES, max(_FEWER_VALUES, path.stat().st_size // _VALUE_BYTES)
        )

    def add(self, columns: Sequence[int], values: NDArray[np.float64], wrong: int = 0) -> None:
        """Add rows.

        Args:
            columns: that `values` holds.
            values: shape (T, len(columns)).
            wrong: number of malformed rows, whether kept or left out.

        Raises:
            LogError: there are too many rows or malformed cells.
        """
        self.wrong += wrong
        place = {column: index for index, column in enumerate(columns)}
        layout = self.tracks
        clocks = [one for one in (layout.frame, layout.time, layout.sub_frame) if one is not None]
        values = values[~np.isnan(values).all(axis=1)]
        for clock in clocks:
            self._clocks.setdefault(clock, []).append(values[:, place[clock]].copy())
        for track, seen in zip(layout.tracks, self._seen, strict=True):
            xyz = values[:, [place[column] for column in track.columns]]
            is_seen = np.isfinite(xyz).all(axis=1)
            if layout.zero_is_unseen:
                is_seen &= (xyz != 0).any(axis=1)
            at = np.flatnonzero(is_seen)
            if len(at):
                seen.append((at + self.rows, xyz[at]))
                self._values += 3 * len(at)
        self.rows += len(values)
        if self._values > self._most_values or self.rows > _MAX_ROWS:
            raise LogError(
                f"{self.path}: is {self.tracks.named} with over "
                f"{_MAX_ROWS} rows or {self._most_values // 10**6} million numbers; "
                "export fewer markers or a part of the take"
            )
        if self.wrong > max(_MAX_WRONG, self.rows / 2):
            raise LogError(
                f"{self.path}: is {self.tracks.named}, but {self.wrong} of its "
                f"first {self.rows} rows hold cells that are no number",
                EXPORT_AGAIN,
            )

    def episode(self, options: ReadOptions) -> Episode:
        """Build an episode of the rows.

        Raises:
            LogError: there are none, or their times are invalid.
        """
        layout = self.tracks
        if not self.rows:
            raise LogError(f"{self.path}: is {layout.named} without a row of numbers", EXPORT_AGAIN)
        stamps, keep, counts_frames, notes = self._stamps(options)
        signals, unused = [], {}
        drop = self._left_out()
        for index, track in enumerate(layout.tracks):
            rows, xyz = _joined(self._seen[index])
            self._seen[index] = []
            if index in drop:
                unused[track.name] = drop[index]
                continue
            if not len(rows):
                unused[track.name] = "was never seen"
                continue
            inside = keep[rows]
            signal, _ = position_signal(
                track.name,
                stamps[rows][inside],
                xyz[inside],
                track.unit,
                options,
                counts_frames=counts_frames,
            )
            untimed = {UNREADABLE: int(np.count_nonzero(~inside))}
            signals.append(replace(signal, left_out=added(signal.left_out, untimed)))
        unused.update(layout.unused)
        return export_episode(
            self.path,
            layout.what,
            signals,
            unused=unused,
            warnings=(*layout.warnings, *notes),
            losses=self._losses(keep),
        )

    def _stamps(
        self, options: ReadOptions
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_], bool, list[str]]:
        """Return the stamps of all rows, their mask, whether they count frames, and notes."""
        layout = self.tracks
        frames = self._clock(layout.frame)
        frames = np.arange(self.rows, dtype=np.float64) if frames is None else frames
        parts = self._clock(layout.sub_frame)
        if parts is not None and np.nanmax(parts, initial=0) > 0:
            frames = frames + parts / (np.nanmax(parts) + 1)
        times = self._clock(layout.time)
        keep = np.isfinite(frames if times is None or options.rate_hz else times)
        if times is not None:
            keep &= np.isfinite(frames)
        if not keep.any():
            raise LogError(f"{self.path}: no row of it has a time or a frame", EXPORT_AGAIN)
        stamps = np.zeros(self.rows, np.int64)
        try:
            if times is None or options.rate_hz:
                stamps[keep], counts_frames = frame_stamps(frames[keep], layout.rate_hz, options)
            else:
                exact = _exact(times[keep], frames[keep], layout.rate_hz)
                stamps[keep], counts_frames = time_stamps(exact), False
        except ValueError as error:
            raise LogError(
                f"{self.path}: times or frames reach beyond all bounds", EXPORT_AGAIN
            ) from error
        notes = sorted_stamps(stamps[keep]).notes
        first_ns = int(stamps[keep].min())
        if first_ns < 0:
            stamps -= first_ns
            notes.append(f"times begin at {first_ns / 1e9:.9g} s; they were moved to begin at 0")
        return stamps, keep, counts_frames, notes

    def _clock(self, column: int | None) -> NDArray[np.float64] | None:
        return None if column is None else np.concatenate(self._clocks[column])

    def _left_out(self) -> dict[int, str]:
        """Return the unlabeled tracks beyond the limit, by index, with the reason."""
        layout = self.tracks
        counts = {
            index: sum(len(rows) for rows, _ in self._seen[index])
            for index, track in enumerate(layout.tracks)
            if track.is_unlabeled
        }
        least_first = sorted(counts, key=lambda index: counts[index])
        return {
            index: f"unlabeled, seen in {counts[index]} of {self.rows} frames; of "
            f"{len(counts)} unlabeled markers, the {MAX_UNLABELED} seen most are used"
            for index in least_first[: max(0, len(counts) - MAX_UNLABELED)]
        }

    def _losses(self, keep: NDArray[np.bool_]) -> list[str]:
        losses = []
        stated = self.tracks.frames
        if stated is not None and self.rows < stated:
            losses.append(f"holds {self.rows} of the {stated} frames that it states: it is cut")
        elif self.is_cut:
            losses.append(f"its last line has no end and was left out, after {self.rows} frames")
        if self.is_broken:
            losses.append(f"a line that is no row ends it after {self.rows} frames")
        if self.wrong:
            losses.append(f"{self.wrong} of {self.rows} rows hold cells that are no number")
        if lost := int(np.count_nonzero(~keep)):
            losses.append(f"{lost} of {self.rows} rows without a time were left out")
        return losses


def read_tracks(
    path: Path,
    lines: LineReader,
    separator: str,
    tracks: MarkerTracks,
    *,
    first: str = "",
    until_words: bool = False,
) -> TrackRows:
    """Read the rows below a header.

    Args:
        path: of the file.
        lines: at the first row.
        separator: between cells.
        tracks: described by the header.
        first: a row that was read before, or "".
        until_words: see `LineReader.block`.

    Raises:
        LogError: there are too many rows or malformed cells.
    """
    found = TrackRows(path, tracks)
    form: NumberFormat | None = None
    columns = tracks.columns
    for block, is_last in _with_last(_blocks(lines, first, until_words=until_words)):
        whole, rest = unended(block) if is_last else (block, "")
        form = form or format_of(whole or rest, separator)
        found.add(columns, *numbers_of(whole, form, columns))
        if rest and _is_whole(rest, whole, form, found.rows, tracks.frames):
            found.add(columns, *numbers_of(rest, form, columns))
        elif rest:
            found.is_cut = True
    return found


def _is_whole(line: str, before: str, form: NumberFormat, rows: int, stated: int | None) -> bool:
    """Return whether an unterminated last line is complete: the last frame that the file states."""
    separator = form.separator
    full = before.rstrip("\n").rpartition("\n")[2].count(separator)
    return line.count(separator) >= full and stated is not None and rows + 1 >= stated


def _exact(
    times: NDArray[np.float64], frames: NDArray[np.float64], rate_hz: float | None
) -> NDArray[np.float64]:
    """Return times [s] without rounding error, from frames and rate where these agree with them."""
    if not rate_hz:
        return times
    by_frame = times[0] + (frames - frames[0]) / rate_hz
    with np.errstate(invalid="ignore", over="ignore"):
        agrees = np.all(np.abs(by_frame - times) < min(_ROUNDING_S, 0.3 / rate_hz))
    if not agrees:
        return times
    offset = times[0] - frames[0] / rate_hz  # of whole frames: then it is rounding as well
    frames_off = np.round(offset * rate_hz)
    if abs(offset - frames_off / rate_hz) < _ROUNDING_S:
        return (frames + frames_off) / rate_hz
    return by_frame


def _joined(
    parts: Sequence[tuple[NDArray[np.int64], NDArray[np.float64]]],
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    if not parts:
        return np.empty(0, np.int64), np.empty((0, 3))
    rows, values = zip(*parts, strict=True)
    return np.concatenate(rows), np.concatenate(values)


def _blocks(lines: LineReader, first: str, *, until_words: bool) -> Iterator[str]:
    head = f"{first}\n" if first else ""
    while block := head + lines.block(until_words=until_words):
        yield block
        head = ""


def _with_last(blocks: Iterable[str]) -> Iterator[tuple[str, bool]]:
    """Yield each block and whether it is the last."""
    before: str | None = None
    for block in blocks:
        if before is not None:
            yield before, False
        before = block
    if before is not None:
        yield before, True


# ---- `Tracks`: collect objects from rows that each give the position of one in an image.

MAX_TEXT_BYTES = 256 * 1024**2  # an hour of images with a hundred objects in each is a tenth
MAX_TRACKS = 1000  # that become signals, the longest; of cells there are many thousands
_MAX_PLACES = 2_000_000  # of all tracks together
_MAX_NAMES = 100_000  # of tracks


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


# ---- `Group`: columns of a table that make up one signal.


@dataclass(frozen=True)
class Used:
    """One column of values: `row` of the result, in its unit, is `scale` times the text."""

    index: int
    row: int
    scale: float


@dataclass(frozen=True)
class Group:
    """Columns that make up one signal.

    Attributes:
        name: of the signal.
        columns: of the signal; an axis may have no column in the table.
        unit: of the signal.
        needs_all: whether a row with only some of the values is damaged.
        clock: time of arrival, or of acquisition, of a row.
        stamp: time of acquisition, where the table states it beside that of arrival.
        numbers: of the joints named by a number alone, by column.
        note: for the user.
        is_impacts: whether its samples are impacts: the clock's times, with the value 1.
    """

    name: str
    columns: tuple[str, ...]
    unit: str
    used: tuple[Used, ...]
    needs_all: bool
    clock: Clock
    stamp: Clock | None = None
    numbers: Mapping[str, str] = field(default_factory=dict)
    note: str = ""
    is_impacts: bool = False

    def name_of_run(self, run: str) -> str:
        """Return the name of a run's signal; a joint signal's ends with its quantity."""
        return name_of_run(self.name, run, is_joints=not (self.needs_all or self.is_impacts))


def name_of_run(name: str, run: str, *, is_joints: bool) -> str:
    """Return the name of a run's signal; a joint signal's ends with its quantity."""
    if not run:
        return name
    robot, _, quantity = name.rpartition(".") if is_joints else (name, "", "")
    return ".".join(filter(None, (robot, run, quantity)))


def stamp_for(words: Words, stamps: Sequence[Clock]) -> Clock | None:
    """Return the stamp of the message that a column belongs to, by the longest common prefix."""
    fitting = [clock for clock in stamps if words[: len(clock.scope)] == clock.scope]
    return max(fitting, key=lambda clock: len(clock.scope), default=None)


def plain_words(name: str) -> Words:
    """Split a name into lower-case words, not at capitals."""
    return lowered(words_of(name, camel=False))


# ---- Group joint columns into signals, one per robot and quantity.

_UNITS = {"position": "rad", "velocity": "rad/s", "effort": "N·m", "current": "A"}  # of signals


def joints_of(
    header: Sequence[str],
    meanings: Mapping[int, Meaning],
    clock: Clock,
    stamps: Sequence[Clock],
    unused: dict[str, str],
) -> list[Group]:
    """Group joint columns by robot and quantity; all groups of one robot have the same joints.

    Args:
        header: the names of all columns.
        meanings: of columns, by index.
        clock: of the rows.
        stamps: of messages.
        unused: reasons by name; to be added to.
    """
    values = {at: meaning for at, meaning in meanings.items() if isinstance(meaning, JointColumn)}
    if all(one.is_bare and one.quantity != "effort" for one in values.values()):
        for at in values:
            unused[header[at]] = "it says not of what; name it x, y, z, height_m or JOINT_position"
        return []
    tables = _tables(header, values, unused)
    robots: dict[str, dict[str, int]] = {}
    for (robot, _), labels in tables.items():
        rows = robots.setdefault(robot, {})
        for label in labels:
            rows.setdefault(label, len(rows))
    groups: list[Group] = []
    for (robot, quantity), labels in tables.items():
        if not labels:
            continue
        rows = robots[robot]
        used = tuple(Used(at, rows[label], values[at].scale) for label, at in labels.items())
        numbers = {one.label: one.number for one in values.values() if one.number}
        stamp = stamp_for(plain_words(header[used[0].index]), stamps)
        name, unit = f"{robot}.{quantity}", _UNITS[quantity]
        groups.append(Group(name, tuple(rows), unit, used, False, clock, stamp, numbers))
    return groups


def _tables(
    header: Sequence[str], values: Mapping[int, JointColumn], unused: dict[str, str]
) -> dict[tuple[str, str], dict[str, int]]:
    """Return the column of each joint, by robot and quantity, without ambiguous ones."""
    tables: dict[tuple[str, str], dict[str, list[int]]] = {}
    for at, meaning in values.items():
        found = tables.setdefault((meaning.group, meaning.quantity), {})
        found.setdefault(meaning.label, []).append(at)
    for (_, quantity), labels in tables.items():
        for label in [label for label, found in labels.items() if len(found) > 1]:
            for at in labels.pop(label):
                unused[header[at]] = f"several columns are the {quantity} of {label!r}"
    return {key: {one: at for one, (at,) in labels.items()} for key, labels in tables.items()}


def with_torques(groups: Sequence[Group], constants: Sequence[float]) -> list[Group]:
    """Convert motor currents to torques where none are measured.

    Args:
        groups: of a table.
        constants: N·m for each A, joint by joint; none leaves currents as they are.

    Raises:
        ValueError: there are fewer or more constants than joints with currents.
    """
    found: list[Group] = []
    measured = {group.name for group in groups}
    for group in groups:
        name = f"{group.name.removesuffix('.current')}.effort"
        if constants and group.name.endswith(".current") and name not in measured:
            if len(constants) != len(group.used):
                raise ValueError(
                    f"has currents of {len(group.used)} joints, and --torque-constants gives "
                    f"{len(constants)}; give one for each joint"
                )
            scaled = tuple(
                replace(used, scale=used.scale * constant)
                for used, constant in zip(group.used, constants, strict=True)
            )
            note = "currents times --torque-constants"
            group = replace(group, name=name, unit=_UNITS["effort"], used=scaled, note=note)  # noqa: PLW2901
        found.append(group)
    return found


# ---- Group coordinate columns into tracks of objects.

_ALONG_A_LINE = "a distance along one line, up or down"  # a motion sensor's one coordinate
_DISTANCE = 3  # rank of a bare distance: beside x and y it is that from the start, and no z
# Why a coordinate is not used where there is one of a better name.
_INSTEAD = ("there is a column z", "there is a column of heights", "there is a column of positions")


@dataclass(frozen=True)
class _Coordinate:
    """A column that is a coordinate."""

    at: int
    meaning: CoordinateColumn


def tracks_of(
    header: Sequence[str],
    meanings: Mapping[int, Meaning],
    clock: Clock,
    stamps: Sequence[Clock],
    unused: dict[str, str],
) -> list[Group]:
    """Group coordinate columns by moving object.

    Args:
        header: the names of all columns.
        meanings: of columns, by index.
        clock: of the rows.
        stamps: of messages.
        unused: reasons by name; to be added to.
    """
    things: dict[str, list[_Coordinate]] = {}
    for at, meaning in _with_pictures(header, meanings).items():
        if isinstance(meaning, CoordinateColumn):
            unused.pop(header[at], None)
            things.setdefault(meaning.thing, []).append(_Coordinate(at, meaning))
    groups: list[Group] = []
    for thing, places in things.items():
        if _is_doubtful(places):
            for place in places:
                unused[header[place.at]] = f"it is the one column of {thing!r}; name it {thing}_x"
            continue
        axes = _axes(header, _in_lengths(header, places, unused), unused)
        chosen = [place for found in axes.values() for place in found]
        if any(len(found) > 1 for found in axes.values()):
            for place in chosen:
                unused[header[place.at]] = f"several columns are a coordinate of {thing!r}"
            continue
        unit, default = _unit_of(chosen)
        used = tuple(
            Used(place.at, axis, place.meaning.scale if place.meaning.unit else default)
            for axis, (place,) in axes.items()
        )
        stamp = stamp_for(plain_words(header[chosen[0].at]), stamps)
        note = _ALONG_A_LINE if any(place.meaning.rank > 1 for place in chosen) else ""
        groups.append(Group(thing, ("x", "y", "z"), unit, used, True, clock, stamp, note=note))
    return groups


def _is_doubtful(places: Sequence[_Coordinate]) -> bool:
    """Return whether columns are hardly an object's: an axis named first, without another."""
    axes = {place.meaning.axis for place in places}
    return len(axes) < 2 and all(place.meaning.is_doubtful for place in places)


def _with_pictures(header: Sequence[str], meanings: Mapping[int, Meaning]) -> dict[int, Meaning]:
    """Interpret pairs (u, v) as image coordinates x and y; u alone is a control input."""
    names = {plain_words(header[at]): at for at in meanings}
    found = dict(meanings)
    for words, at in names.items():
        partner = names.get((*words[:-1], "v")) if words[-1:] == ("u",) else None
        is_free = partner is not None and all(
            isinstance(meanings[one], UnusedColumn) for one in (at, partner)
        )
        if partner is not None and is_free:
            thing = "_".join(words[:-1]) or "track"
            found[at] = CoordinateColumn(thing, 0, 1.0, "px")
            found[partner] = CoordinateColumn(thing, 1, 1.0, "px")
    return found


def _in_lengths(
    header: Sequence[str], places: list[_Coordinate], unused: dict[str, str]
) -> list[_Coordinate]:
    """Drop columns in pixels where others are in lengths."""
    lengths = [place for place in places if place.meaning.unit != "px"]
    if not lengths:
        return places
    for place in places:
        if place.meaning.unit == "px":
            unused[header[place.at]] = "there are columns in a unit of length"
    return lengths


def _axes(
    header: Sequence[str], places: list[_Coordinate], unused: dict[str, str]
) -> dict[int, list[_Coordinate]]:
    """Return the columns of each axis, of the best kind of name."""
    axes: dict[int, list[_Coordinate]] = {}
    has_axes = {0, 1}.issubset(place.meaning.axis for place in places)
    for place in places:
        if has_axes and place.meaning.rank == _DISTANCE:
            unused[header[place.at]] = "there are columns x and y"
        else:
            axes.setdefault(place.meaning.axis, []).append(place)
    for axis, found in axes.items():
        best = min(place.meaning.rank for place in found)
        axes[axis] = [place for place in found if place.meaning.rank == best]
        for place in found:
            if place.meaning.rank > best:
                unused[header[place.at]] = _INSTEAD[best]
    return axes


def _unit_of(chosen: Sequence[_Coordinate]) -> tuple[str, float]:
    """Return a track's unit, and the scale of columns without a unit beside others with one."""
    sizes = {place.meaning.scale for place in chosen if place.meaning.unit == "m"}
    if sizes:
        return "m", sizes.pop() if len(sizes) == 1 else 1.0
    return chosen[0].meaning.unit, 1.0


# ---- `TableLayout`: clocks, tracks, joints and unused columns of a header.

MAX_COLUMNS = 5000  # motion capture of hundreds of markers has fewer; each name costs its reading


@dataclass(frozen=True)
class TableLayout:
    """A table's columns.

    Attributes:
        separator: of cells; None is white space.
        names: columns of joint names, by joint number.
        runs: columns that identify run and object of a row, with the kind of each.
        unused: why a column is not used, by its name.
        header: the names of all columns, with their units.
        reading: interpreter of the columns.
    """

    separator: str | None
    groups: tuple[Group, ...]
    names: Mapping[str, int]
    runs: tuple[tuple[int, str], ...]
    unused: Mapping[str, str]
    header: tuple[str, ...]
    reading: Reading = by_name

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.header)


def table_layout_of(
    header: Sequence[str], separator: str | None, reading: Reading = by_name
) -> TableLayout | None:
    """Parse a header line; None where it names no time, and so is no header."""
    least = 2 if reading is by_name else 1
    if not least <= len(header) <= MAX_COLUMNS:
        return None
    columns = runs_of(header) if reading is by_name else [("", name) for name in header]
    names = [name for _, name in columns]
    meanings = {at: reading(at, name) for at, name in enumerate(names)}
    unused = {
        header[at]: meaning.reason
        for at, meaning in meanings.items()
        if isinstance(meaning, UnusedColumn)
    }
    groups: list[Group] = []
    clock: Clock | None = None
    for run in dict.fromkeys(sorted((run for run, _ in columns), key=bool)):
        part = {at: meanings[at] for at, (of, _) in enumerate(columns) if of == run}
        clocks = _clocks(names, part)
        stamps = [one for is_header, one in clocks if is_header]
        shared = clock
        clock = _arrival(clocks) or shared or _frames(names, part)
        if clock is None:
            continue
        found = [
            *tracks_of(names, part, clock, stamps, unused),
            *joints_of(names, part, clock, stamps, unused),
            *_impacts(part, clock),
        ]
        groups += [replace(one, name=one.name_of_run(run)) if run else one for one in found]
    if clock is None:
        return None
    if not groups and any(isinstance(one, ImpactNumberColumn) for one in meanings.values()):
        groups = [_impact_group(clock.indices[0], clock)]
    if not clock.counts_frames:
        frames = (header[at] for at, one in meanings.items() if isinstance(one, FrameColumn))
        unused.update(dict.fromkeys(frames, "there is a column of times"))
    texts = {one.number: at for at, one in meanings.items() if isinstance(one, JointNameColumn)}
    return TableLayout(
        separator, tuple(groups), texts, run_columns(meanings), unused, tuple(header), reading
    )


def run_columns(meanings: Mapping[int, Meaning]) -> tuple[tuple[int, str], ...]:
    """Return the columns that identify run and object of a row, with the kind of each."""
    counts = [(at, one.kind) for at, one in meanings.items() if isinstance(one, RunColumn)]
    runs = [one for one in counts if one[1] == "run"]
    things = sorted((one for one in counts if one[1] != "run"), key=lambda one: one[1] == "object")
    return (*runs[:1], *things[:1])


def clock_of(header: Sequence[str]) -> Clock | None:
    """Return the clock of the rows under a header; None where no name is a time."""
    return _arrival(_clocks(header, dict(enumerate(map(meaning_of, header)))))


def _arrival(clocks: Sequence[tuple[bool, Clock]]) -> Clock | None:
    """Return the clock of the rows: the shortest name, arrival before header stamps."""
    arrivals = [one for is_header, one in clocks if not is_header] or [one for _, one in clocks]
    return min(arrivals, key=lambda one: len(words_of(one.name, camel=True)), default=None)


def _clocks(header: Sequence[str], meanings: Mapping[int, Meaning]) -> list[tuple[bool, Clock]]:
    """Return all clocks; seconds and nanoseconds of one name are one."""
    times = {at: meaning for at, meaning in meanings.items() if isinstance(meaning, TimeColumn)}
    rests = {
        plain_words(header[at])[:-1]: at
        for at, meaning in times.items()
        if meaning.part == "nanosec"
    }
    dates = [at for at, meaning in meanings.items() if isinstance(meaning, DateColumn)]
    clocks: list[tuple[bool, Clock]] = []
    paired: set[int] = set()
    for at, meaning in times.items():
        rest = rests.get(plain_words(header[at])[:-1]) if meaning.part == "sec" else None
        if rest is not None:
            paired.update((at, rest))
            clock = Clock(header[at], (at, rest), 0, meaning.scope)
            clocks.append((meaning.is_header, clock))
    for at, meaning in times.items():
        if at not in paired:
            has_date = bool(dates) and meaning.power is None and not meaning.is_header
            indices = (dates[0], at) if has_date else (at,)
            clock = Clock(header[at], indices, meaning.power, meaning.scope, has_date=has_date)
            clocks.append((meaning.is_header, clock))
    if dates and not times:
        clocks.append((False, Clock(header[dates[0]], (dates[0],), None)))
    clocks += [
        (
            False,
            Clock(header[at], (at,), meaning.power, counts_frames=meaning.counts_frames),
        )
        for at, meaning in meanings.items()
        if isinstance(meaning, ImpactColumn)
    ]
    return clocks


def _frames(header: Sequence[str], meanings: Mapping[int, Meaning]) -> Clock | None:
    """Return the clock of a table that counts frames and has no other."""
    at = next((at for at, one in meanings.items() if isinstance(one, FrameColumn)), None)
    return None if at is None else Clock(header[at], (at,), 0, counts_frames=True)


def _impacts(meanings: Mapping[int, Meaning], clock: Clock) -> list[Group]:
    return [
        _impact_group(at, clock)
        for at, meaning in meanings.items()
        if isinstance(meaning, ImpactColumn)
    ]


def _impact_group(at: int, clock: Clock) -> Group:
    return Group(
        *("impacts", ("impact",), "1", (Used(at, 0, 1.0),)),
        needs_all=True,
        clock=clock,
        is_impacts=True,
    )


# ---- Split stacked runs, by a column that numbers them or where the times restart.

MAX_RUNS = 500  # of a table; each is a signal of its own
_MAX_LENGTH = 40  # of a run's name
_MAX_SHOWN = 4  # of the names of things in a message
_MIN_ROWS = 5  # of a run that only its times show
_ALTERNATING = 0.5  # share of rows of another object than the row before, where runs interleave
_MAX_SHARED = 0.1  # share of rows with another's stamp and other values: some were sent twice
_MIN_STAMPS = 0.2  # distinct stamps per row: with fewer, no motion shows
_ALIKE = 0.5  # step of one object from stamp to stamp, per difference of rows with one stamp
_RESTART_FRACTION = 0.8  # of a run's length: by more than that the next one's times must jump back
# Local time is set by multiples of this, as at the end of summer time; the next row comes within
# so many periods.
_ZONE_NS, _ZONE_PERIODS = 900 * 10**9, 10

_NEARBY = 128  # rows among which those of one run may have overtaken each other
Rows = NDArray[np.intp] | slice  # which rows


class RunNames:
    """Runs of a table in order of appearance.

    Args:
        kinds: kind of each column that identifies them: "run", "ball", ...
    """

    def __init__(self, kinds: Sequence[str]) -> None:
        self._kinds = kinds
        self._numbers: dict[tuple[str, ...], int] = {}
        self._by_name: dict[tuple[str, ...], int] = {}

    @property
    def names(self) -> list[str]:
        """Names such as "run1" for a number, else the table's own; "run1.ball" for two columns."""
        parts = list(self._by_name)
        told = [at for at in range(len(self._kinds)) if len({each[at] for each in parts}) > 1]
        return [".".join(each[at] for at in told) or ".".join(each) for each in parts]

    @property
    def note(self) -> str:
        """Note that a task takes one of several objects; "" for runs, or for one object."""
        names = self.names
        if len(names) < 2 or set(self._kinds) <= {"run"}:
            return ""
        shown = ", ".join(names[:_MAX_SHOWN]) + (", ..." if len(names) > _MAX_SHOWN else "")
        return f"rows are of {len(names)} things ({shown}): each is a signal; see --topic"

    def number(self, cells: Sequence[str]) -> int:
        """Return the index of a run in `names`, by the cells of its columns."""
        texts = tuple(cell.strip()[:_MAX_LENGTH] for cell in cells)
        if (number := self._numbers.get(texts)) is not None:
            return number
        parts = tuple(map(_name_of, texts, self._kinds))
        self._numbers[texts] = self._by_name.setdefault(parts, len(self._by_name))
        return self._numbers[texts]


def _name_of(text: str, kind: str) -> str:
    """Name a run: "run2" for "2", "2.0" and "Run 2"; others keep their name."""
    if found := re.fullmatch(rf"(?:{kind}\W{{0,3}})?0*(\d{{1,15}})(?:[.,]0*)?", text, re.I | re.A):
        return f"{kind}{found[1]}"
    return re.sub(r"\W+", "_", text).strip("_").lower() or f"no_{kind}"


def telling_column(
    stamps: Sequence[Sequence[str]], columns: Mapping[int, Sequence[str]]
) -> int | None:
    """Find the column that identifies objects, where several rows share a stamp.

    Args:
        stamps: the time of each row, as it is written.
        columns: the cells of the columns with uninformative names.

    Returns:
        The index of one that makes all pairs of stamp and cell unique; None where all stamps
        differ, or there is none. Names go before numbers, and few objects before many.
    """
    times = [tuple(cells) for cells in stamps]
    if len(set(times)) == len(times):
        return None
    found: list[tuple[bool, int, int]] = []
    for at, cells in columns.items():
        things = len(set(cells))
        is_told = 1 < things <= len(cells) // 3 and all(map(str.strip, cells))
        if is_told and len(set(zip(times, cells, strict=True))) == len(times):
            found.append((any(map(_is_number, cells)), things, at))
    return min(found)[2] if found else None


def _is_number(text: str) -> bool:
    return re.fullmatch(r"[+-]?[\d.,]+", text.strip()) is not None


def rows_of_runs(
    times_ns: NDArray[np.int64], runs: NDArray[np.int64], names: Sequence[str]
) -> list[tuple[str, Rows]]:
    """Return name and rows of each run or object; the name is "" where there is only one.

    A column of run numbers separates runs where times restart with another number, or where
    numbers alternate: an object whose number changes once and for all is one object.

    Args:
        times_ns: of T rows [ns], shape (T,).
        runs: their runs' indices in `names`, shape (T,); empty where the table numbers none.
        names: of runs.

    Raises:
        ValueError: there are over `MAX_RUNS` runs.
    """
    changes = np.diff(runs) != 0
    backwards = np.flatnonzero(np.diff(times_ns) <= 0)
    comes_and_goes = np.count_nonzero(changes) > max(_ALTERNATING * len(runs), len(names))
    if len(runs) and (comes_and_goes or np.any(changes[backwards])):
        numbers = np.unique(runs)
        if 2 * len(numbers) <= len(runs):  # else each row has a number of its own
            _check_count(len(numbers))
            return [(str(names[one]), np.flatnonzero(runs == one)) for one in numbers.tolist()]
    if not len(backwards):
        return [("", slice(None))]
    starts = _restarts(times_ns, backwards)
    if len(starts) == 1:
        return [("", slice(None))]
    _check_count(len(starts))
    ends = [*starts[1:], len(times_ns)]
    pairs = enumerate(zip(starts, ends, strict=True), 1)
    return [(f"run{number}", slice(start, end)) for number, (start, end) in pairs]


def restarts_note(parts: Sequence[tuple[str, Rows]]) -> list[str]:
    """Note that times restart without a column of run numbers: a clock may have been set back."""
    if len(parts) < 2 or isinstance(parts[0][1], np.ndarray):
        return []
    return [
        f"its times begin again {len(parts) - 1} times: runs, or a clock that was set back; each "
        "is a signal by itself; see --topic"
    ]


def check_one_thing(times_ns: NDArray[np.int64], values: NDArray[np.float64]) -> None:
    """Refuse rows that are of several objects, or whose stamps are truncated.

    In stacked rows of several objects, the second row of each stamp is near the second row of the
    next; of one object with coarse stamps, it is near the first of its own.

    Args:
        times_ns: of T rows [ns], in the order of the file, shape (T,).
        values: shape (T, C).

    Raises:
        ValueError: which of these it is, and the remedy.
    """
    order = np.argsort(times_ns, kind="stable")
    times, rows = times_ns[order], values[order]
    is_same = np.diff(times) == 0
    if not np.any(is_same):
        return
    steps = _steps(rows)
    shared = int(np.count_nonzero(is_same & (steps > 0)))
    if shared <= _MAX_SHARED * len(times):
        return
    firsts = np.flatnonzero(np.concatenate([[True], ~is_same]))
    rank = np.arange(len(times)) - np.repeat(firsts, np.diff(firsts, append=len(times)))
    by_rank = np.argsort(rank, kind="stable")
    alike = _steps(rows[by_rank])[np.diff(rank[by_rank]) == 0]
    are_things = len(alike) > 0 and np.median(alike) < _ALIKE * np.median(steps[is_same])
    if not are_things and len(firsts) > _MIN_STAMPS * len(times):
        return
    what = "the stamps have too few digits; "
    if are_things:
        what = (
            "several things, or stamps of too few digits; say which column separates the objects: "
            "--columns object=NAME, or "
        )
    raise ValueError(
        f"{shared} of {len(times)} rows have the stamp of another row and other values: {what}"
        "write times with all their digits"
    )


def _steps(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the largest change from each row to the next, shape (T - 1,); 0 where missing."""
    return np.nan_to_num(np.abs(np.diff(rows, axis=0))).max(axis=1, initial=0.0)


def _restarts(times_ns: NDArray[np.int64], backwards: NDArray[np.intp]) -> list[int]:
    """Return where runs begin; a few rows out of order begin none."""
    starts = [0]
    rising = np.diff(
        backwards, append=len(times_ns) - 1
    )  # rows from there to the next that is back
    for at in (backwards[rising >= _MIN_ROWS] + 1).tolist():
        begin = starts[-1]
        ahead = times_ns[at : at + _MIN_ROWS]
        if at - begin < _MIN_ROWS:
            continue
        last, first = int(times_ns[at - 1]), int(times_ns[begin])
        back = last - int(times_ns[at])
        period_ns = (last - first) / (at - 1 - begin)
        is_local = back > _ZONE_NS / 2 and -back % _ZONE_NS <= _ZONE_PERIODS * period_ns
        if times_ns[at] < first and is_local:
            continue  # one run, whose clock was set
        around = times_ns[begin : begin + max(2 * (at - begin), _NEARBY)]
        if fill_holes(around, at - begin):
            continue  # one run, whose rows overtook each other
        if back > _RESTART_FRACTION * (last - first) > 0 and ahead[-1] < last:
            starts.append(at)
    return starts


def _check_count(count: int) -> None:
    if count > MAX_RUNS:
        raise ValueError(f"holds {count} runs, over the limit of {MAX_RUNS}; split it")


# ---- `SignalSamples`: collect the samples that rows give each signal.


class SignalSamples:
    """Samples of one group of columns, stored flat: a table of an hour must fit.

    Attributes:
        group: of columns.
        columns: names of the signal's.
        arrivals: times of the rows [ns]; counted frames are one second apart.
    """

    def __init__(self, group: Group, header: Sequence[str], options: ReadOptions) -> None:
        self.group = group
        self.columns = group.columns
        self.arrivals = array("q")
        self._stamps = array("q")
        self._runs = array("q")
        self._header = header
        self._options = options
        self._incomplete = 0
        self._values = array("d")
        self._empty = [0.0 if group.needs_all else float("nan")] * len(group.columns)

    def read(self, cells: Sequence[str], numbers: Numbers) -> list[float] | None:
        """Return the values of a row; None where it has none, or lacks a coordinate.

        Raises:
            UnreadableError: a cell holds no number.
        """
        row = self._empty.copy()
        missing = 0
        for column in self.group.used:
            try:
                value = numbers.read(cells[column.index])
            except ValueError as why:
                name = self._header[column.index]
                raise unreadable(name, cells[column.index], why, NUMBER_REMEDY) from None
            row[column.row] = value * column.scale
            missing += value != value  # noqa: PLR0124 (NaN)
        if missing == len(self.group.used):
            return None
        if missing and self.group.needs_all:
            self._incomplete += 1
            return None
        return row

    def add(self, stamp_ns: int, arrival_ns: int, row: list[float]) -> None:
        """Append a sample."""
        self._stamps.append(stamp_ns)
        self.arrivals.append(arrival_ns)
        self._values.extend(row)

    def add_run(self, run: int) -> None:
        """Set the run of the last sample, numbered in order of appearance."""
        self._runs.append(run)

    def signals(
        self, offset_ns: int, run_names: Sequence[str]
    ) -> tuple[list[Signal], list[Channel], list[str]]:
        """Return one signal per run, their channels, and notes on what was left out or repaired.

        Args:
            offset_ns: added to all times.
            run_names: by the numbers of runs.

        Raises:
            ValueError: there are too many runs, or impacts out of order.
        """
        counts_frames = self.group.clock.counts_frames
        arrivals = np.frombuffer(self.arrivals, np.int64) + offset_ns
        if counts_frames:
            arrivals, counts_frames = frame_stamps(arrivals * 1e-9, None, self._options)
        stamps = np.frombuffer(self._stamps, np.int64)
        values, unit = self._in_unit(np.frombuffer(self._values).reshape(-1, len(self.columns)))
        if self.group.is_impacts:
            return self._impacts(arrivals, counts_frames)
        runs = np.frombuffer(self._runs, np.int64)
        signals: list[Signal] = []
        channels: list[Channel] = []
        parts = rows_of_runs(arrivals, runs, run_names)
        notes = [f"{self.group.name}: {note}" for note in restarts_note(parts)]
        for run, rows in parts:
            name = self.group.name_of_run(run) if run else self.group.name
            own, of_run = arrivals[rows], stamps[rows]
            check_one_thing(own, values[rows])
            keep, ordered, repairs, left_out = order_samples(
                of_run if len(own) > 1 else own, own, (values[rows],)
            )
            incomplete = in_proportion(len(own), self._incomplete, len(arrivals))
            signals.append(
                Signal(
                    name,
                    ordered,
                    values[rows][keep],
                    self.columns,
                    unit,
                    counts_frames=counts_frames,
                    left_out=added(left_out, {INCOMPLETE: incomplete}),
                )
            )
            channels.append(Channel(name, self._type(unit), "csv", own))
            notes += [f"{name}: {repair}" for repair in repairs]
        if self._incomplete:
            lacking = f"{self._incomplete} samples without all coordinates were left out"
            notes.append(f"{self.group.name}: {lacking}")
        return signals, channels, notes

    def _in_unit(self, values: NDArray[np.float64]) -> tuple[NDArray[np.float64], str]:
        """Convert values to the user's length unit, where the table states none."""
        unit, options = self.group.unit, self._options
        if unit not in (UNSTATED, "px") or not options.length_unit:
            return values, unit
        return (values, "px") if options.length_m is None else (values * options.length_m, "m")

    def _impacts(
        self, arrivals: NDArray[np.int64], counts_frames: bool
    ) -> tuple[list[Signal], list[Channel], list[str]]:
        wrong = np.flatnonzero(np.diff(arrivals) <= 0)
        if len(wrong):
            at = int(wrong[0])
            raise ValueError(
                f"times of impacts do not increase: {arrivals[at] * 1e-9:.13g} s is followed by "
                f"{arrivals[at + 1] * 1e-9:.13g} s; give times since a start, not intervals"
            )
        ones = np.ones((len(arrivals), 1))
        signal = Signal(
            self.group.name, arrivals, ones, self.columns, "1", counts_frames=counts_frames
        )
        channel = Channel(self.group.name, self._type("1"), "csv", arrivals)
        return [signal], [channel], []

    def _type(self, unit: str) -> str:
        columns = ", ".join(self.columns) if len(self.columns) <= 8 else "joints"
        note = f": {self.group.note}" if self.group.note else ""
        return f"{columns} [{unit or '?'}]{note}"
