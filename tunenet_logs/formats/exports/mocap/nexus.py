"""Read marker trajectories from Vicon Nexus' ASCII exports (.csv).

A section is its title, its rate [Hz], a row of names, a row of axes that begins with `Frame,Sub
Frame`, a row of units, and its rows. Before Nexus 2 the title is `TRAJECTORIES`, the rate `100,Hz`,
the row of axes begins with `Field #`, and no unit is named.
https://help.vicon.com/space/Nexus216 (Export to ASCII)
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tunenet_logs.episode import UNSTATED, Episode
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.formats.exports.mocap.markers import (
    MarkerTrack,
    MarkerTracks,
    is_unlabeled,
    unique,
    unit_of,
)
from tunenet_logs.formats.exports.mocap.number_rows import (
    LineReader,
    header_cells,
    open_lines,
    separator_of,
)
from tunenet_logs.formats.exports.mocap.track_rows import TrackRows, read_tracks
from tunenet_logs.formats.exports.start import Start
from tunenet_logs.formats.read_options import ReadOptions

WHAT = "Vicon Nexus export"  # what it is called
_TITLES = ("trajectories", "model outputs", "devices", "joints", "segments", "events")

# How names of what a model tells end; early versions write it among the trajectories.
_MODEL = re.compile(r"(?:Angles?|Forces?|Moments?|Powers?)$")

_LOOK_LINES = 40  # in which a file's first section begins: a few lines may tell the take before
_MAX_UNUSED = 200  # listed of what is not used
_MAX_SECTIONS = 50

_MAX_BETWEEN = 10_000  # lines between two sections


@dataclass(frozen=True)
class _Section:
    """Header of a section; `first` is its first row of numbers, where that was read already."""

    title: str
    separator: str
    rate_hz: float | None
    names: Sequence[str]
    axes: Sequence[str]
    units: Sequence[str]
    first: str = ""


def is_nexus(start: Start) -> bool:
    """Return whether a file is a Nexus export: a section's title above its rate."""
    lines = start.lines[:_LOOK_LINES]
    for title, rate, names in zip(lines, lines[1:], lines[2:], strict=False):
        if _title(title) in _TITLES and _rate(rate) is not None and names[:1] in (",", ";", "\t"):
            return True
    return False


def read_nexus(path: Path, options: ReadOptions) -> Episode:
    """Read a take, one signal per marker's trajectory.

    Raises:
        LogError: it has no section of trajectories, no row, or more than is read.
        OSError: it cannot be read.
    """
    rows: TrackRows | None = None
    unused: dict[str, str] = {}
    with open_lines(path) as lines:
        for _ in range(_MAX_SECTIONS):
            try:
                section, stray = _next_section(lines)
            except ValueError as error:
                raise LogError(f"{path}: is a {WHAT} with {error}", EXPORT_AGAIN) from error
            if rows is not None and stray:
                rows.is_broken = True
            if section is None:
                break
            if rows is None and section.title == "trajectories":
                tracks = _tracks(section, unused)
                rows = read_tracks(
                    path, lines, section.separator, tracks, first=section.first, until_words=True
                )
                continue
            for name in section.names:
                if name:
                    _note(unused, name, f"of the section {section.title!r}: not where a marker was")
            while lines.block(until_words=True):
                pass
    if rows is None or not rows.tracks.tracks:
        held = ", ".join(list(unused)[:3]) or "nothing"
        raise LogError(
            f"{path}: is a {WHAT} without trajectories of markers (it holds {held}); export it "
            "with Trajectories"
        )
    return rows.episode(options)


def _next_section(lines: LineReader) -> tuple[_Section | None, int]:
    """Return the next section's header (None at the end) and the count of stray rows before it.

    Raises:
        ValueError: its header is malformed.
    """
    stray = 0
    for _ in range(_MAX_BETWEEN):
        line = lines.line()
        if line is None:
            return None, stray
        stray += line[:1].isdecimal()
        if (title := _title(line)) in _TITLES:
            break
    else:
        return None, stray
    rate, names, axes = (lines.line() or "" for _ in range(3))
    separator = separator_of(names)
    below = lines.line() or ""
    has_units = not re.match(r'[\s"]*[-+.\d]', below)
    section = _Section(
        title,
        separator,
        _rate(rate),
        header_cells(names, separator),
        header_cells(axes, separator),
        header_cells(below, separator) if has_units else (),
        "" if has_units else below,
    )
    return section, stray


def _tracks(section: _Section, unused: dict[str, str]) -> MarkerTracks:
    axes = [axis.lower() for axis in section.axes]
    frame = 0 if axes[:1] in (["frame"], ["field #"]) else None
    sub_frame = 1 if axes[1:2] == ["sub frame"] else None
    starts = [at for at, name in enumerate(section.names) if name]
    found = [at for at in starts if axes[at : at + 3] == ["x", "y", "z"]]
    if not section.units:
        found = [at for at in found if not _MODEL.search(section.names[at])]
    for at in starts:
        if at in found:
            continue
        if _MODEL.search(section.names[at]):
            _note(unused, section.names[at], "a model's output by its name")
        else:
            _note(unused, section.names[at], f"has no X, Y, Z but {', '.join(axes[at : at + 3])}")
    warnings = []
    if section.rate_hz is None:
        warnings.append("its trajectories have no rate; say it with --fps")
    names = unique(section.names[at] for at in found)
    return MarkerTracks(
        WHAT,
        [
            MarkerTrack(name, (at, at + 1, at + 2), _unit(section.units, at), is_unlabeled(name))
            for name, at in zip(names, found, strict=True)
        ],
        frame=frame,
        sub_frame=sub_frame,
        rate_hz=section.rate_hz,
        zero_is_unseen=True,
        unused=unused,
        warnings=warnings,
    )


def _unit(units: Sequence[str], at: int) -> str:
    named = set(units[at : at + 3])
    return unit_of(named.pop()) if len(named) == 1 else UNSTATED


def _note(unused: dict[str, str], name: str, why: str) -> None:
    if len(unused) < _MAX_UNUSED:
        unused[name] = why
    else:
        unused["others"] = "more than are listed, of the same sections"


def _title(line: str) -> str:
    """Return the only cell of a line, in lower case; "" where there are several."""
    return line[:1000].strip(' \t,;"').lower() if len(line) < 100_000 else ""


def _rate(line: str) -> float | None:
    """Parse a section's rate [Hz]; None where the line is none."""
    match = re.fullmatch(r"(\d{1,6}(?:[.,]\d{1,9})?)[,;\t ]*(?:Hz)?", line[:100].strip(' \t,;"'))
    value = float(match[1].replace(",", ".")) if match else math.nan
    return value if value > 0 else None
