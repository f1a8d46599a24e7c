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
    named = {"m": "Meters", "cm": "Centimeters", "mm": "Millimeters", "in": "Inches", "ft": "Feet"}
    times = np.asarray(seconds, np.float64)
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
    kinds, bodies, parents, quantities, axes = (",".join(row) for row in zip(*above, strict=True))
    names = [name for _, name, *_ in above]
    ids = ",".join(f'"{100 + names.index(name):X}"' for name in names)
    has_labels = tuple(map(int, version.split("."))) >= (1, 22)
    labels = ("Type", "Name", "ID", "Parent") if has_labels else ("", "", "", "")
    family = f",{labels[3]},{parents}\n" if version == "1.25" else ""
    rows = "".join(
        ",".join([str(frame), f"{time:.6f}", *_cells(row, 6)]) + "\n"
        for frame, time, row in zip(
            np.round((times - times[0]) * rate_hz).astype(int),
            times,
            np.hstack(values),
            strict=True,
        )
    )
    path.write_text(
        f"Format Version,{version},Take Name,Take 2026-01-05 03.49.50 PM,"
        f"Capture Frame Rate,{rate_hz:.6f},Export Frame Rate,{rate_hz:.6f},"
        f"Capture Start Time,2026-01-05 03.49.50.755 PM,Total Frames in Take,{len(times)},"
        f"Total Exported Frames,{len(times)},Rotation Type,Quaternion,"
        f"Length Units,{named[unit]},Coordinate Space,Global\n\n"
        f",{labels[0]},{kinds}\n,{labels[1]},{bodies}\n,{labels[2]},{ids}\n{family},,{quantities}\n"
        f"Frame,{'Time (Seconds)' if has_labels else 'Time'},{axes}\n{rows}"
    )


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
    frames = np.round(np.asarray(seconds, np.float64) * rate_hz).astype(int) + 1
    text = ""
    if devices:
        text += f"Devices\n{10 * rate_hz:g}\n,,Force plate - Force,,\n"
        text += "Frame,Sub Frame,Force.Fx,Force.Fy,Force.Fz\n,,N,N,N\n"
        text += "".join(f"{n},{sub},0.1,-0.2,9.8\n" for n in frames[:3] for sub in range(10)) + "\n"
    names = ",,,".join(f"{subject}:{name}" if subject else name for name in tracks)
    count = len(tracks)
    text += f"Trajectories\n{rate_hz:g}\n,,{names},,\n"
    text += f"Frame,Sub Frame{',X,Y,Z' * count}\n,{f',{unit}' * 3 * count}\n"
    table = np.hstack([oriented(xyz, up, unit) for xyz in tracks.values()])
    for frame, row in zip(frames, table, strict=True):
        text += ",".join([str(frame), "0", *_cells(row, 6, significant=True)]) + "\n"
    path.write_text(text)


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
    times, names = np.asarray(seconds, np.float64), list(tracks)
    kind, one = ("BODIES", "BODY") if bodies else ("MARKERS", "MARKER")
    text = (
        f"NO_OF_FRAMES\t{len(times)}\nNO_OF_CAMERAS\t8\nNO_OF_{kind}\t{len(names)}\n"
        f"FREQUENCY\t{rate_hz:g}\nNO_OF_ANALOG\t0\nANALOG_FREQUENCY\t0\nDESCRIPTION\t--\n"
        "TIME_STAMP\t2026-01-22, 17:47:17.123\t22107.99179716\n"
        f"DATA_INCLUDED\t{'6D' if bodies else '3D'}\nEVENT\tRelease\t12\t0.11000\n"
        f"{one}_NAMES\t" + "".join(f"{name}\t" for name in names) + "\n"
    )
    if not bodies:
        text += "TRAJECTORY_TYPES" + "\tMeasured" * len(names) + "\t\n"
    rest = ["Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{at}]" for at in range(9))]
    if has_columns:
        text += "Frame\tTime\t"
        for name in names:
            columns = ["X", "Y", "Z", *rest] if bodies else ["X", f"{name} Y", f"{name} Z"]
            text += f"{name} " + "".join(f"{column}\t" for column in columns)
        text += "\n"
    turn = [0.0, 0.0, 0.0, 0.5, *np.eye(3).ravel()]
    values = [oriented(xyz, up, unit) for xyz in tracks.values()]
    for at, time in enumerate(times):
        cells = [str(at + 1), f"{time:.5f}"] if has_columns else []
        for xyz in values:
            row = [*xyz[at], *(turn if bodies else [])]
            is_seen = np.isfinite(xyz[at]).all()
            cells += _cells(row, 3) if is_seen else [unseen] * len(row)
        text += "\t".join(cells) + "\t\n"
    path.write_text(text.replace("\n", "\r\n"))


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
    times, count = np.asarray(seconds, np.float64), len(tracks)
    text = (
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\t"
        f"OrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n{rate_hz:.2f}\t{rate_hz:.2f}\t{len(times)}\t"
        f"{count}\t{unit}\t{rate_hz:.2f}\t1\t{len(times)}\nFrame#\tTime"
        + "".join(f"\t{name}\t\t" for name in tracks)
        + "\n\t"
        + "".join(f"\tX{n}\tY{n}\tZ{n}" for n in range(1, count + 1))
        + "\n\n"
    )
    table = np.hstack([oriented(xyz, up, unit) for xyz in tracks.values()])
    for at, (time, row) in enumerate(zip(times, table, strict=True)):
        text += "\t".join([str(at + 1), f"{time:.6f}", *_cells(row, 6)]) + "\n"
    path.write_text(text.replace("\t", separator))


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
    names, frames = list(tracks), len(np.asarray(seconds))
    first_frame = round(float(np.asarray(seconds, np.float64)[0]) * rate_hz) + 1
    scale = -1.0 if is_float else 1e-4 / UNITS_M[unit]  # of units for each step of whole numbers
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
    for at, track in enumerate(tracks.values()):
        xyz = oriented(track, up, unit)
        is_seen = np.isfinite(xyz[:, :1])
        rows[:, 4 * at : 4 * at + 3] = np.where(is_seen, xyz, 0) / (scale if scale > 0 else 1)
        rows[:, 4 * at + 3] = np.where(is_seen[:, 0], 0, -1)
    data = (
        np.round(rows).astype(f"{order}i2").tobytes()
        if scale > 0
        else _floats(processor, rows.ravel())
    )
    whole = header.ljust(512, b"\0") + section.ljust(512 * blocks, b"\0") + data
    path.write_bytes(whole + bytes(-len(whole) % 512))


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
