"""Files as systems of motion capture export them, written from their documentation.

Each writer takes the same track, so that what reads one layout can be judged against another. It
imports nothing of the project: a mistake here must not cancel out against the same one there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tests.c3d_writer import c3d_bytes

# Where bodies or markers were, by name: metres, z up, NaN where unseen, shape (T, 3) each.
Tracks = Mapping[str, ArrayLike]

# What each unit of length is in metres.
UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}

# Which of a z-up world's axes stand in x, y and z: a turn, so that right hands stay right.
_AXES = {
    "x": (2, 0, 1),
    "y": (1, 2, 0),
    "z": (0, 1, 2),
}


def oriented(xyz: ArrayLike, up: str = "z", unit: str = "m") -> NDArray[np.float64]:
    """A track in a file's axes and unit.

    Args:
        xyz: metres, z up, shape (T, 3).
        up: the file's axis that points up: "x", "y", "z", or "-x", "-y", "-z" for down.
        unit: one of `UNITS_M`.
    """
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
    """OptiTrack Motive CSV.

    Args:
        path: of the file.
        seconds: of the frames, shape (T,).
        tracks: rigid bodies.
        rate_hz: of the frames.
        unit: one of `UNITS_M`.
        up: see `oriented`.
        version: of the format; rows above the columns have no labels before 1.22, a parent from
            1.25 on.
        markers: of bodies, by `Body:Marker1`.
        unlabeled: that no one named, by `Unlabeled 1234`.
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
    """Qualisys QTM TSV; the file never names its unit.

    Args:
        path: of the file.
        seconds: of the frames, shape (T,).
        tracks: markers, or rigid bodies where `bodies` is.
        rate_hz: of the frames.
        unit: QTM's own is mm.
        up: see `oriented`.
        has_columns: whether frame, time and the names of columns were asked for.
        unseen: how a coordinate is written that was not seen: "", "0.000" or "NULL".
        bodies: whether it is a 6DOF export.
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

    Args:
        path: of the file.
        seconds: of the frames, shape (T,); they begin at frame 1 plus what passed before them.
        tracks: points.
        rate_hz: of the frames.
        unit: named in it.
        up: see `oriented`.
        processor: "intel", "dec" or "mips".
        is_float: whether data are floating, not whole numbers of a tenth of a millimetre.
        analogs: channels of other sensors, sampled once a frame.
    """
    scale = -1.0 if is_float else 1e-4 / UNITS_M[unit]
    points = {name: oriented(xyz, up, unit) for name, xyz in tracks.items()}
    first = round(float(np.asarray(seconds, np.float64)[0]) * rate_hz) + 1
    path.write_bytes(
        c3d_bytes(points, first, rate_hz, unit, processor=processor, scale=scale, analogs=analogs)
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
