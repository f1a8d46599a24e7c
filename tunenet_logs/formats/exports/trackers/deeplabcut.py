"""Read DeepLabCut's tables: position and likelihood of each body part in each frame.

Rows of a header say `scorer`, perhaps `individuals`, `bodyparts` and `coords`; then a row a frame.
A part has `x`, `y` [px, y down] and `likelihood`; one that was triangulated has `x`, `y`, `z`.
https://deeplabcut.github.io/DeepLabCut/docs/standardDeepLabCut_UserGuide.html
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path

from tunenet_logs.episode import UNSTATED, Episode
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.formats.exports.build import export_episode
from tunenet_logs.formats.exports.start import Start
from tunenet_logs.formats.exports.trackers.spot_rows import (
    Place,
    Tracks,
    TrackUnits,
    number_at,
    place_at,
    unique_names,
)
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.tables.failures import DAMAGED_REMEDY, Failures, UnreadableError
from tunenet_logs.formats.tables.layout import MAX_COLUMNS
from tunenet_logs.formats.tables.lines import cells_of, lines_of
from tunenet_logs.formats.tables.numbers import Numbers

_WHAT = "DeepLabCut table"
_MAX_HEADS = 4

_MIN_LIKELIHOOD = 0.6  # below it DeepLabCut itself takes a part as not seen (`pcutoff`)


def is_deeplabcut(start: Start) -> bool:
    """Return whether a file is a DeepLabCut table, by the rows of its header."""
    firsts = [line.split(",", 1)[0] for line in start.lines[:_MAX_HEADS]]
    return firsts[:1] == ["scorer"] and "bodyparts" in firsts and "coords" in firsts


def read_deeplabcut(path: Path, options: ReadOptions) -> Episode:
    """Read each part of each body as a signal, without frames of low likelihood.

    Raises:
        LogError: it names no part, or its rows cannot be read.
        OSError: it cannot be read.
    """
    lines = enumerate(lines_of(path), 1)
    heads: dict[str, list[str]] = {}
    for _, line in islice(lines, _MAX_HEADS):
        name, *cells = [cell.strip() for cell in cells_of(line or "", ",")[:MAX_COLUMNS]]
        heads[name] = cells
        if name == "coords":
            break
    parts = _parts(heads)
    if not parts:
        raise LogError(f"{path}: is a {_WHAT} that names no part's x and y", EXPORT_AGAIN)
    rows = _FrameRows(path, parts, ("frame", *heads["coords"]))
    for number, line in lines:
        if line is None or line.strip(" ,"):
            rows.add(number, line)
    return rows.episode(options)


class _FrameRows:
    """Rows of a table, while they are read."""

    def __init__(
        self, path: Path, parts: Sequence[tuple[Place, int | None]], header: Sequence[str]
    ) -> None:
        self._path, self._parts, self._header = path, parts, header
        self._tracks, self._failures, self._numbers = Tracks(path), Failures(), Numbers(",")
        self._count = self._unsure = 0

    def add(self, number: int, line: str | None) -> None:
        """Add the row of a line, or count it as unreadable."""
        self._count += 1
        try:
            self._add(cells_of(line or "", ","))
        except UnreadableError as error:
            self._failures.add(number, error)

    def _add(self, cells: Sequence[str]) -> None:
        header, numbers = self._header, self._numbers
        if len(cells) < len(header):
            raise UnreadableError(f"it has {len(cells)} of {len(header)} cells", DAMAGED_REMEDY)
        frame = number_at(cells, 0, header, numbers)
        for place, sure in self._parts:
            seen = 1.0 if sure is None else number_at(cells, sure, header, numbers)
            if seen < _MIN_LIKELIHOOD:
                self._unsure += 1
            else:
                self._tracks.add(place.name, frame, place_at(cells, place, header, numbers))

    def episode(self, options: ReadOptions) -> Episode:
        """Build an episode of the rows."""
        path, count, failures = self._path, self._count, self._failures
        if not len(self._tracks):
            if failures:
                raise LogError(f"{path}: {_WHAT}: {failures.nothing(count)}")
            why = f"nothing is seen with a likelihood of {_MIN_LIKELIHOOD}"
            raise LogError(f"{path}: {_WHAT}: {why}", "label more frames, train and analyse again")
        if why := failures.refusal(count):
            raise LogError(f"{path}: {_WHAT}: {why}")
        is_flat = all(place.axes[2] is None for place, _ in self._parts)
        units = TrackUnits("px" if is_flat else UNSTATED, None)
        signals, unused, notes = self._tracks.signals(units, options)
        if self._unsure:
            notes.append(
                f"{self._unsure} places with a likelihood below {_MIN_LIKELIHOOD} were left out"
            )
        lost = [failures.lost(count)] if failures else []
        return export_episode(path, _WHAT, signals, unused=unused, warnings=notes, losses=lost)


def _parts(heads: dict[str, list[str]]) -> list[tuple[Place, int | None]]:
    """Return each part's columns, and that of its likelihood."""
    found: dict[str, dict[str, int]] = {}
    bodies = heads.get("individuals", [])
    for at, (part, axis) in enumerate(
        zip(heads.get("bodyparts", ()), heads.get("coords", ()), strict=False)
    ):
        body = bodies[at] if at < len(bodies) and bodies[at] != "single" else ""
        name = f"{body}.{part}" if body else part
        found.setdefault(name, {}).setdefault(axis, at + 1)
    there = {name: at for name, at in found.items() if {"x", "y"} <= at.keys()}
    return [
        (Place(name, (at["x"], at["y"], at.get("z"))), at.get("likelihood"))
        for name, at in zip(unique_names(there), there.values(), strict=True)
    ]
