"""Files as systems of motion capture export them, written from their documentation.

Each writer takes the same track, so that what reads one layout can be judged against another. It
imports nothing of the project: a mistake here must not cancel out against the same one there.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Where bodies or markers were, by name: metres, z up, NaN where unseen, shape (T, 3) each.
Tracks = Mapping[str, ArrayLike]

# What each unit of length is in metres.
UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}

# Which of a z-up world's axes stand in x, y and z: a turn, so that right hands stay right.
_AXES = {"x": (2, 0, 1), "y": (1, 2, 0), "z": (0, 1, 2)}


def oriented(xyz: ArrayLike, up: str = "z", unit: str = "m") -> NDArray[np.float64]:
    """A z-up track [m] in a file's axes and unit; `up` is "x", "y", "z", or "-x", ... for down."""
    turned = np.asarray(xyz, np.float64)[:, _AXES[up[-1]]] / UNITS_M[unit]
    if up.startswith("-"):
        at = "xyz".index(up[-1])
        turned[:, [at, (at + 1) % 3]] *= -1
    return turned


def write_motive(
    path: Path,
    seconds: ArrayLike,
    tracks: Tracks,
    *,
    rate_hz: float,
    unit: str = "m",
    up: str = "y",
    version: str = "1.23",
    markers: Tracks | None = None,
    unlabeled: Tracks | None = None,
) -> None:
    """OptiTrack Motive CSV of rigid bodies, of markers by `Body:Marker1`, and of unnamed ones.

    Rows above the columns have no labels before version 1.22, a parent from 1.25 on.
    """
    names = {"m": "Meters", "cm": "Centimeters", "mm": "Millimeters", "in": "Inches", "ft": "Feet"}
    times = np.asarray(seconds, np.float64)
    frames = np.round((times - times[0]) * rate_hz).astype(int)
    above: list[tuple[str, str, str, str, str]] = []
    values: list[NDArray[np.float64]] = []
    for name, xyz in tracks.items():
        above += [("Rigid Body", name, "", "Rotation", axis) for axis in "XYZW"]
        above += [("Rigid Body", name, "", "Position", axis) for axis in "XYZ"]
        above.append(("Rigid Body", name, "", "Mean Marker Error", ""))
        place = oriented(xyz, up, unit)
        is_seen = np.isfinite(place).all(axis=1, keepdims=True)
        turn = np.where(is_seen, [[0.0, 0.0, 0.0, 1.0]], np.nan)
        values += [turn, place, np.where(is_seen, 0.0002, np.nan)]
    for name, xyz in [*(markers or {}).items(), *(unlabeled or {}).items()]:
        parent = name.partition(":")[0] if ":" in name else ""
        above += [("Marker", name, parent, "Position", axis) for axis in "XYZ"]
        values.append(oriented(xyz, up, unit))
    kinds, bodies, parents, quantities, axes = zip(*above, strict=True)
    ids = [f'"{100 + bodies.index(name):X}"' for name in bodies]
    has_labels = tuple(map(int, version.split("."))) >= (1, 22)
    labels = ("Type", "Name", "ID", "Parent") if has_labels else ("", "", "", "")
    rows = [
        ["", labels[0], *kinds],
        ["", labels[1], *bodies],
        ["", labels[2], *ids],
        *([["", labels[3], *parents]] if version == "1.25" else []),
        ["", "", *quantities],
        ["Frame", "Time (Seconds)" if has_labels else "Time", *axes],
    ]
    said = {
        "Format Version": version,
        "Take Name": "Take 2026-01-05 03.49.50 PM",
        "Capture Frame Rate": f"{rate_hz:.6f}",
        "Export Frame Rate": f"{rate_hz:.6f}",
        "Capture Start Time": "2026-01-05 03.49.50.755 PM",
        "Total Frames in Take": str(len(times)),
        "Total Exported Frames": str(len(times)),
        "Rotation Type": "Quaternion",
        "Length Units": names[unit],
        "Coordinate Space": "Global",
    }
    lines = [",".join(f"{key},{value}" for key, value in said.items()), ""]
    lines += [",".join(row) for row in rows]
    table = np.hstack(values)
    lines += [
        ",".join([str(frame), f"{time:.6f}", *_cells(row, 6)])
        for frame, time, row in zip(frames, times, table, strict=True)
    ]
    path.write_text("\n".join(lines) + "\n")


def write_nexus(
    path: Path,
    seconds: ArrayLike,
    tracks: Tracks,
    *,
    rate_hz: float,
    unit: str = "mm",
    up: str = "z",
    subject: str = "",
    devices: bool = False,
) -> None:
    """Vicon Nexus CSV with a section of trajectories, and one of devices where it is asked for.

    Nexus counts frames from 1 and writes no time, so a track that begins later begins at a later
    frame.
    """
    times = np.asarray(seconds, np.float64)
    frames = np.round(times * rate_hz).astype(int) + 1
    values = [oriented(xyz, up, unit) for xyz in tracks.values()]
    lines: list[str] = []
    if devices:
        names = ["Force.Fx", "Force.Fy", "Force.Fz"]
        lines += ["Devices", f"{10 * rate_hz:g}", ",,Force plate - Force,,"]
        lines += [",".join(["Frame", "Sub Frame", *names]), ",,N,N,N"]
        lines += [f"{frame},{sub},0.1,-0.2,9.8" for frame in frames[:3] for sub in range(10)]
        lines += [""]
    named = [f"{subject}:{name}" if subject else name for name in tracks]
    lines += ["Trajectories", f"{rate_hz:g}"]
    lines += [",," + ",,,".join(named) + ",,"]
    lines += ["Frame,Sub Frame" + ",X,Y,Z" * len(named), "," + f",{unit}" * 3 * len(named)]
    for frame, row in zip(frames, np.hstack(values), strict=True):
        lines.append(",".join([str(frame), "0", *_cells(row, 6, significant=True)]))
    path.write_text("\n".join(lines) + "\n")


def write_qualisys(
    path: Path,
    seconds: ArrayLike,
    tracks: Tracks,
    *,
    rate_hz: float,
    unit: str = "mm",
    up: str = "z",
    has_columns: bool = True,
    unseen: str = "",
    bodies: bool = False,
) -> None:
    """Qualisys QTM TSV, which never names its unit; a 6DOF export where `bodies` is.

    `unseen` is how a coordinate is written that was not seen: "", "0.000" or "NULL".
    """
    times = np.asarray(seconds, np.float64)
    kind = "BODIES" if bodies else "MARKERS"
    names = list(tracks)
    lines = [
        f"NO_OF_FRAMES\t{len(times)}",
        "NO_OF_CAMERAS\t8",
        f"NO_OF_{kind}\t{len(names)}",
        f"FREQUENCY\t{rate_hz:g}",
        "NO_OF_ANALOG\t0",
        "ANALOG_FREQUENCY\t0",
        "DESCRIPTION\t--",
        "TIME_STAMP\t2026-01-22, 17:47:17.123\t22107.99179716",
        f"DATA_INCLUDED\t{'6D' if bodies else '3D'}",
        "EVENT\tRelease\t12\t0.11000",
        ("BODY_NAMES\t" if bodies else "MARKER_NAMES\t") + "\t".join(names) + "\t",
    ]
    if not bodies:
        lines.append("TRAJECTORY_TYPES" + "\tMeasured" * len(names) + "\t")
    rest = ["Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{at}]" for at in range(9))]
    if has_columns:
        columns = [
            cell
            for name in names
            for cell in (
                [f"{name} X", "Y", "Z", *rest] if bodies else [f"{name} {axis}" for axis in "XYZ"]
            )
        ]
        lines.append("\t".join(["Frame", "Time", *columns]) + "\t")
    turn = [0.0, 0.0, 0.0, 0.5, *np.eye(3).ravel()]
    values = [oriented(xyz, up, unit) for xyz in tracks.values()]
    for at, time in enumerate(times):
        cells = [str(at + 1), f"{time:.5f}"] if has_columns else []
        for xyz in values:
            row = [*xyz[at], *(turn if bodies else [])]
            is_seen = np.isfinite(xyz[at]).all()
            cells += _cells(row, 3) if is_seen else [unseen] * len(row)
        lines.append("\t".join(cells) + "\t")
    path.write_text("\r\n".join(lines) + "\r\n")


def write_trc(
    path: Path,
    seconds: ArrayLike,
    tracks: Tracks,
    *,
    rate_hz: float,
    unit: str = "mm",
    up: str = "y",
    separator: str = "\t",
) -> None:
    """TRC, with tabs or commas; `unit` is named in it."""
    times = np.asarray(seconds, np.float64)
    names = list(tracks)
    keys = "DataRate CameraRate NumFrames NumMarkers Units OrigDataRate OrigDataStartFrame"
    said = [f"{rate_hz:.2f}", f"{rate_hz:.2f}", len(times), len(names), unit, f"{rate_hz:.2f}", 1]
    axes = [f"{axis}{number + 1}" for number in range(len(names)) for axis in "XYZ"]
    rows = [
        ["PathFileType", "4", "(X/Y/Z)", path.name],
        [*keys.split(), "OrigNumFrames"],
        [*map(str, said), str(len(times))],
        ["Frame#", "Time", *(cell for name in names for cell in (name, "", ""))],
        ["", "", *axes],
    ]
    lines = [separator.join(row) for row in rows] + [""]
    table = np.hstack([oriented(xyz, up, unit) for xyz in tracks.values()])
    for at, (time, row) in enumerate(zip(times, table, strict=True)):
        lines.append(separator.join([str(at + 1), f"{time:.6f}", *_cells(row, 6)]))
    path.write_text("\n".join(lines) + "\n")


def write_c3d(
    path: Path,
    seconds: ArrayLike,
    tracks: Tracks,
    *,
    rate_hz: float,
    unit: str = "mm",
    up: str = "z",
    processor: str = "intel",
    is_float: bool = True,
    analogs: int = 0,
) -> None:
    """C3D, of floating or whole numbers, as processors of three kinds write them.

    Whole numbers are of a tenth of a millimetre; `analogs` are channels sampled once a frame.
    """
    scale = -1.0 if is_float else 1e-4 / UNITS_M[unit]
    points = {name: oriented(xyz, up, unit) for name, xyz in tracks.items()}
    first = round(float(np.asarray(seconds, np.float64)[0]) * rate_hz) + 1
    path.write_bytes(
        _c3d_bytes(points, first, rate_hz, unit, processor=processor, scale=scale, analogs=analogs)
    )


# By layout: `(path, seconds, tracks, *, rate_hz, unit, up)`, all but the rate as it is usual.
WRITERS: dict[str, Callable[..., None]] = {
    "motive": write_motive,
    "nexus": write_nexus,
    "qualisys": write_qualisys,
    "trc": write_trc,
    "c3d": write_c3d,
}

# Of files by layout.
SUFFIXES = {"motive": ".csv", "nexus": ".csv", "qualisys": ".tsv", "trc": ".trc", "c3d": ".c3d"}


def _cells(row: Sequence[float] | NDArray[np.float64], digits: int, *, significant=False):
    form = f".{digits}{'g' if significant else 'f'}"
    return [f"{value:{form}}" if np.isfinite(value) else "" for value in row]


# C3D, after its user guide: https://www.c3d.org/docs/C3D_User_Guide.pdf.
_C3D_KINDS = {"intel": 84, "dec": 85, "mips": 86}


def _c3d_bytes(
    points: Mapping[str, NDArray[np.float64]],
    first_frame: int,
    rate_hz: float,
    unit: str,
    *,
    processor: str = "intel",
    scale: float = -1.0,
    analogs: int = 0,
) -> bytes:
    """A whole file of points by name, in `unit`, NaN where unseen, shape (T, 3) each.

    `scale` is of units for each step of whole numbers; negative for floating data.
    """
    names = list(points)
    frames = len(next(iter(points.values())))
    order = ">" if processor == "mips" else "<"
    groups: dict[str, dict[str, bytes]] = {
        "POINT": {
            "USED": _words(order, len(names)),
            "SCALE": _float(processor, scale),
            "RATE": _float(processor, rate_hz),
            "FRAMES": _words(order, min(65535, frames)),
            "LABELS": _texts(names),
            "UNITS": _texts([unit], is_one=True),
        },
        "ANALOG": {
            "USED": _words(order, analogs),
            "RATE": _float(processor, rate_hz),
            "GEN_SCALE": _float(processor, 1.0),
            "SCALE": _float(processor, *[1.0] * analogs),
            "OFFSET": _words(order, *[0] * analogs),
            "LABELS": _texts([f"Channel {at + 1}" for at in range(analogs)]),
            "UNITS": _texts(["V"] * analogs),
        },
    }
    records = b""
    for number, (group, parameters) in enumerate(groups.items(), start=1):
        records += _record(order, group, -number, b"\0")
        for name, body in parameters.items():
            records += _record(order, name, number, body + b"\0")
    blocks = -(-(len(records) + 5) // 512)
    section = bytes([1, 80, blocks, _C3D_KINDS[processor]]) + records
    last = min(65535, first_frame + frames - 1)
    header = b"\x02\x50" + struct.pack(f"{order}5H", len(names), analogs, first_frame, last, 10)
    header += _floats(processor, np.array([scale]))
    header += struct.pack(f"{order}2H", 2 + blocks, bool(analogs))
    header += _floats(processor, np.array([rate_hz]))
    rows = np.zeros((frames, 4 * len(names) + analogs))
    for at, xyz in enumerate(points.values()):
        is_seen = np.isfinite(xyz[:, :1])
        rows[:, 4 * at : 4 * at + 3] = np.where(is_seen, xyz, 0) / (scale if scale > 0 else 1)
        rows[:, 4 * at + 3] = np.where(is_seen[:, 0], 0, -1)
    data = (
        np.round(rows).astype(f"{order}i2").tobytes()
        if scale > 0
        else _floats(processor, rows.ravel())
    )
    whole = header.ljust(512, b"\0") + section.ljust(512 * blocks, b"\0") + data
    return whole + bytes(-len(whole) % 512)


def _record(order: str, name: str, group: int, body: bytes) -> bytes:
    """A group or a parameter, with the way to the next."""
    head = struct.pack("<bb", len(name), group) + name.encode()
    return head + struct.pack(f"{order}H", len(body) + 2) + body


def _words(order: str, *values: int) -> bytes:
    return _shape(2, len(values)) + struct.pack(f"{order}{len(values)}H", *values)


def _float(processor: str, *values: float) -> bytes:
    return _shape(4, len(values)) + _floats(processor, np.array(values))


def _shape(kind: int, count: int) -> bytes:
    return struct.pack("<bB", kind, 0) if count == 1 else struct.pack("<bBB", kind, 1, count)


def _texts(texts: Sequence[str], *, is_one: bool = False) -> bytes:
    width = max(map(len, texts), default=0)
    body = b"".join(text.encode().ljust(width) for text in texts)
    shape = [width] if is_one else [width, len(texts)]
    return struct.pack("<bB", -1, len(shape)) + bytes(shape) + body


def _floats(processor: str, values: NDArray[np.float64]) -> bytes:
    """Numbers of 32 bits; DEC's F format is IEEE's with 4 for 1 and its halves swapped."""
    if processor == "mips":
        return values.astype(">f4").tobytes()
    if processor == "dec":
        return (4 * values).astype("<f4").view("<u2").reshape(-1, 2)[:, ::-1].tobytes()
    return values.astype("<f4").tobytes()
