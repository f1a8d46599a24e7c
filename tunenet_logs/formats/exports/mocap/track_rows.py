"""Collect the rows of a file of tracks: each track in the frames in which it was seen."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Episode
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.formats.exports.build import (
    export_episode,
    frame_stamps,
    position_signal,
    time_stamps,
)
from tunenet_logs.formats.exports.mocap.markers import MarkerTracks
from tunenet_logs.formats.exports.mocap.number_rows import (
    LineReader,
    NumberFormat,
    format_of,
    numbers_of,
    unended,
)
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.left_out import UNREADABLE, added
from tunenet_logs.sample_order import sorted_stamps

MAX_UNLABELED = 100  # of the tracks that no one named: those that were seen most are used
_MAX_VALUES = 20_000_000  # held of a file: 160 MB, and as much again while it is put in order
_FEWER_VALUES = 8_000_000  # held of any file; more only where a number has ..
_VALUE_BYTES = 6  # ... so many bytes of it: small files shall not take much memory.
# Of a file: 8 minutes at 1 kHz; tuning takes over half a kilobyte of memory for each.
_MAX_ROWS = 500_000

# Rows that hold what is no number, from which on they must be fewer than the others.
_MAX_WRONG = 1000

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
