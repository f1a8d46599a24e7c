"""Tracks as video trackers, spreadsheets and the phone app phyphox write them, by no code of ours.

Lengths are multiplied by `scale` (metres in, the file's unit out: 1 as calibrated, or pixels for
each metre); x and y are written, y being up unless `is_y_down`.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np


@dataclass(frozen=True)
class FilmedTrack:
    """What is written.

    Attributes:
        seconds: shape (T,).
        bodies: by name x, y, z [m], z up, NaN where not seen, shape (T, 3).
        scale: of the file's unit for each metre.
        is_y_down: whether the file's y runs down, as in pictures.
        origin: of the file's coordinates, in its unit.
        rate_hz: of frames.
    """

    seconds: np.ndarray
    bodies: Mapping[str, np.ndarray]
    scale: float = 1.0
    is_y_down: bool = False
    origin: tuple[float, float] = (0.0, 0.0)
    rate_hz: float = 120.0
    unit: str = "pixel"
    separator: str = ","
    decimal: str = "."
    extra: Sequence[str] = field(default_factory=tuple)

    @property
    def frames(self) -> np.ndarray:
        """Numbers of the pictures from 0, shape (T,)."""
        return np.round(self.seconds * self.rate_hz).astype(int)

    def places(self, name: str) -> np.ndarray:
        """x, y as the file has them, shape (T, 2)."""
        xyz = self.bodies[name]
        up = -xyz[:, 2] if self.is_y_down else xyz[:, 2]
        return np.column_stack([xyz[:, 0], up]) * self.scale + np.array(self.origin)


def _number(value: float, decimal: str = ".") -> str:
    return "" if np.isnan(value) else f"{value:.9E}".replace("E+0", "E").replace(".", decimal)


def tracker(path: Path, track: FilmedTrack) -> None:
    """One mass alone: `,mass A,,` and `t,x,y,` above rows of three cells."""
    _tracker(path, track, list(track.bodies)[:1], "")


def tracker_multi(path: Path, track: FilmedTrack) -> None:
    """All masses side by side."""
    _tracker(path, track, list(track.bodies), "#multi:\n")


def _tracker(path: Path, track: FilmedTrack, names: Sequence[str], top: str) -> None:
    mark = track.separator
    count = 2 + len(track.extra)
    masses = "".join(mark + name + mark * (count - 1) for name in names) + mark
    columns = mark.join(["t", *(["x", "y", *track.extra] * len(names)), ""])
    rows = []
    places = [track.places(name) for name in names]
    for at, second in enumerate(track.seconds):
        cells = [_number(second, track.decimal)]
        for place in places:
            cells += [_number(value, track.decimal) for value in place[at]]
            cells += [_number(7.0, track.decimal)] * len(track.extra)
        rows.append(mark.join(cells))
    path.write_text(f"{top}{masses}\n{columns}\n" + "\n".join(rows) + "\n", "utf-8")


def mtrack2(path: Path, track: FilmedTrack) -> None:
    """Frame, and X, Y, Flag of each track; a blank where it is not seen; a summary below."""
    names = list(track.bodies)
    header = ["Frame", *(f"{k}{n}" for n in range(1, len(names) + 1) for k in ("X", "Y", "Flag"))]
    lines = ["\t".join(header), f"Tracks 1 to {len(names)}"]
    for at, frame in enumerate(track.frames):
        cells = [str(frame + 1)]
        for name in names:
            x, y = track.places(name)[at]
            cells += [" ", " ", " "] if np.isnan(x) else [f"{x:.6f}", f"{y:.6f}", " "]
        lines.append("\t".join(cells))
    lines += ["", "Track \tLength\tDistance traveled\tNr of Frames", "1\t21.5\t20.1\t80"]
    path.write_text("\n".join(lines) + "\n")


def manual_tracking(path: Path, track: FilmedTrack) -> None:
    """A row for each place, with numbers of track and slice, in Latin-1."""
    lines = [" \tTrack n°\tSlice n°\tX\tY\tDistance\tVelocity\tPixel Value"]
    for number, name in enumerate(track.bodies, 1):
        for frame, (x, y) in zip(track.frames, track.places(name), strict=True):
            if not np.isnan(x):
                lines.append(f"{len(lines)}\t{number}\t{frame + 1}\t{x:.6f}\t{y:.6f}\t-1\t-1\t9")
    path.write_bytes(("\n".join(lines) + "\n").encode("latin-1"))


def imagej_results(path: Path, track: FilmedTrack) -> None:
    """Measurements of the first body, one a slice."""
    lines = [" \tArea\tMean\tMin\tMax\tX\tY\tXM\tYM\tSlice"]
    for frame, (x, y) in zip(track.frames, track.places(next(iter(track.bodies))), strict=True):
        if not np.isnan(x):
            cells = [len(lines), 88, 200.5, 1, 255, f"{x:.6f}", f"{y:.6f}", 1, 1, frame + 1]
            lines.append("\t".join(map(str, cells)))
    path.write_text("\n".join(lines) + "\n")


def trackmate_csv(path: Path, track: FilmedTrack) -> None:
    """Spots with three more rows of names and units, sorted by track; one spot of no track."""
    unit = f"({track.unit})"
    lines = [
        "LABEL,ID,TRACK_ID,QUALITY,POSITION_X,POSITION_Y,POSITION_Z,POSITION_T,FRAME,RADIUS",
        "Label,Spot ID,Track ID,Quality,X,Y,Z,T,Frame,Radius",
        "Label,Spot ID,Track ID,Quality,X,Y,Z,T,Frame,R",
        f",,,(quality),{unit},{unit},{unit},(sec),,{unit}",
        "ID999,999,,5.0,1.0,1.0,0.0,0.0,0,3.0",
    ]
    for number, name in enumerate(track.bodies):
        for frame, (x, y) in zip(track.frames, track.places(name), strict=True):
            if not np.isnan(x):
                second = frame / track.rate_hz
                spot = len(lines)
                lines.append(
                    f"ID{spot},{spot},{number},5.0,{x:.6f},{y:.6f},0.0,{second:.9f},{frame},3.0"
                )
    path.write_text("\n".join(lines) + "\n")


def trackmate_xml(path: Path, track: FilmedTrack) -> None:
    """Tracks alone, each with its places by frames."""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<Tracks nTracks="{len(track.bodies)}" spaceUnits="{track.unit}" '
        f'frameInterval="{1 / track.rate_hz!r}" timeUnits="sec" from="TrackMate v7">',
    ]
    for name in track.bodies:
        places = list(zip(track.frames, track.places(name), strict=True))
        seen = [(frame, x, y) for frame, (x, y) in places if not np.isnan(x)]
        lines.append(f'  <particle nSpots="{len(seen)}">')
        lines += [
            f'    <detection t="{frame}" x="{x:.6f}" y="{y:.6f}" z="0.0" />' for frame, x, y in seen
        ]
        lines.append("  </particle>")
    path.write_text("\n".join([*lines, "</Tracks>"]) + "\n")


def xlsx_track(path: Path, track: FilmedTrack) -> None:
    """A sheet for each body, with `t (s)`, `x`, `y`, and a sheet of words."""
    sheets: dict[str, list[list[object]]] = {}
    for name in track.bodies:
        rows: list[list[object]] = [["t (s)", "x", "y"]]
        for second, (x, y) in zip(track.seconds, track.places(name), strict=True):
            rows.append([float(second), *(None if np.isnan(v) else float(v) for v in (x, y))])
        sheets[name] = rows
    write_xlsx(path, {**sheets, "Remarks": [["dropped by hand"], ["on a table"]]})


def phyphox_xlsx(path: Path, seconds: Sequence[float]) -> None:
    """Times of impacts as phyphox's acoustic stopwatch exports them."""
    times = [float(one) for one in seconds]
    gaps = [*np.diff(times).tolist(), 0.0]
    stops = [*times[1:6], 0.0, 0.0, 0.0, 0.0, 0.0][:5]
    sheets: dict[str, Sequence[Sequence[object]]] = {
        "Simple": [["Start (s)", "Stop (s)", "Difference (s)"], [times[0], times[1], gaps[0]]],
        "Multiple": [["Start (s)", *(f"Stop {n} (s)" for n in range(1, 6))], [times[0], *stops]],
        "All": [["Event time (s)", "Interval (s)"], *map(list, zip(times, gaps, strict=True))],
        "Metadata Device": [["property", "value"], ["version", "1.1.11"]],
        "Metadata Time": [
            ["event", "experiment time", "system time"],
            ["START", 0.0, 1_700_000_000.1],
        ],
    }
    write_xlsx(path, sheets)


def write_xlsx(path: Path, sheets: Mapping[str, Sequence[Sequence[object]]]) -> None:
    """A workbook by hand: numbers and words, no styles."""
    main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    office = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    package = "http://schemas.openxmlformats.org/package/2006"
    kinds = "application/vnd.openxmlformats-officedocument.spreadsheetml"
    rels = f'<Relationships xmlns="{package}/relationships">'
    types = f'<Types xmlns="{package}/content-types"><Default Extension="rels" '
    types += 'ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    types += f'<Override PartName="/xl/workbook.xml" ContentType="{kinds}.sheet.main+xml"/>'
    book, book_rels = f'<workbook xmlns="{main}" xmlns:r="{office}"><sheets>', rels
    parts: dict[str, str] = {}
    for n, (name, rows) in enumerate(sheets.items(), 1):
        part = f"worksheets/sheet{n}.xml"
        types += f'<Override PartName="/xl/{part}" ContentType="{kinds}.worksheet+xml"/>'
        book += f'<sheet name="{escape(name)}" sheetId="{n}" r:id="rId{n}"/>'
        book_rels += f'<Relationship Id="rId{n}" Type="{office}/worksheet" Target="{part}"/>'
        cells = "".join(
            f'<row r="{at}">{"".join(_cell(at, *one) for one in enumerate(row))}</row>'
            for at, row in enumerate(rows, 1)
        )
        parts[f"xl/{part}"] = (
            f'<worksheet xmlns="{main}"><sheetData>{cells}</sheetData></worksheet>'
        )
    parts |= {
        "[Content_Types].xml": f"{types}</Types>",
        "_rels/.rels": f'{rels}<Relationship Id="rId1" Type="{office}/officeDocument" '
        'Target="xl/workbook.xml"/></Relationships>',
        "xl/workbook.xml": f"{book}</sheets></workbook>",
        "xl/_rels/workbook.xml.rels": f"{book_rels}</Relationships>",
    }
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for part, text in parts.items():
            archive.writestr(part, f'<?xml version="1.0" encoding="UTF-8"?>{text}')


def _cell(row: int, column: int, value: object) -> str:
    letters, column = "", column + 1
    while column:
        column, rest = divmod(column - 1, 26)
        letters = chr(65 + rest) + letters
    if value is None:
        return ""
    if isinstance(value, str):
        return f'<c r="{letters}{row}" t="inlineStr"><is><t>{escape(value)}</t></is></c>'
    return f'<c r="{letters}{row}"><v>{value!r}</v></c>'


# By the name of the file that each of them writes.
WRITERS: dict[str, Callable[[Path, FilmedTrack], None]] = {
    "tracker.txt": tracker,
    "tracker_multi.txt": tracker_multi,
    "mtrack2.txt": mtrack2,
    "manual_tracking.xls": manual_tracking,
    "imagej_results.csv": imagej_results,
    "trackmate.csv": trackmate_csv,
    "trackmate.xml": trackmate_xml,
    "track.xlsx": xlsx_track,
}
