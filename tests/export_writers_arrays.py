"""Tracks as sensors' programs and programs of one's own write them, by no code of ours.

Each writer takes the same track: `(path, seconds, xyz, unit)` with the places in metres, z up,
NaN where not seen, shape (T, 3), and the unit of the file. What was not seen is left out.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.export_writers import UNITS_M

Floats = NDArray[np.float64]


def _seen(seconds: Floats, xyz: Floats, unit: str) -> tuple[Floats, Floats]:
    keep = np.isfinite(xyz).all(axis=1)
    return seconds[keep], xyz[keep] / UNITS_M[unit]


def pasco(path: Path, seconds: Floats, xyz: Floats, unit: str = "m") -> None:
    """Capstone's table of a motion sensor over the ball: how far it is below, and its speed."""
    times, places = _seen(seconds, xyz, unit)
    below = places[:, 2].max() + 0.2 / UNITS_M[unit] - places[:, 2]
    names = ("Time (s)", f"Position ({unit})", f"Velocity ({unit}/s)")
    lines = [",".join(f'"{name} Run #1"' for name in names)]
    for time, place, speed in zip(times, below, np.gradient(below, times), strict=True):
        lines.append(f"{time:.6f},{place:.7g},{speed:.4g}")
    path.write_text("\ufeff" + "\n".join(lines) + "\n")


def vernier(path: Path, seconds: Floats, xyz: Floats, unit: str = "m") -> None:
    """Graphical Analysis, a sensor below that sees heights."""
    times, places = _seen(seconds, xyz, unit)
    lines = [f"Run 1: Time (s),Run 1: Position ({unit})"]
    lines += [f"{time:.6f},{place:.7g}" for time, place in zip(times, places[:, 2], strict=True)]
    path.write_text("\n".join(lines) + "\n")


def parquet(path: Path, seconds: Floats, xyz: Floats, unit: str = "m") -> None:
    """Columns of doubles with their unit in the name; "timestamp" in seconds."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    times, places = _seen(seconds, xyz, unit)
    columns = {f"{name}_{unit}": places[:, at] for at, name in enumerate("xyz")}
    pq.write_table(pa.table({"timestamp": times, **columns}), path)


def numpy_archive(path: Path, seconds: Floats, xyz: Floats, unit: str = "") -> None:
    """Arrays `t` and `position`; nothing says the unit."""
    times, places = _seen(seconds, xyz, unit or "m")
    np.savez(path, t=times, position=places)


def matlab(path: Path, seconds: Floats, xyz: Floats, unit: str = "") -> None:
    """Columns `t`, `x`, `y`, `z` in a workspace; nothing says the unit."""
    from scipy.io import savemat

    times, places = _seen(seconds, xyz, unit or "m")
    columns = {name: places[:, at : at + 1] for at, name in enumerate("xyz")}
    savemat(path, {"t": times[:, None], **columns})


def json_lines(path: Path, seconds: Floats, xyz: Floats, unit: str = "") -> None:
    """A record a line, places in an object; nothing says the unit."""
    times, places = _seen(seconds, xyz, unit or "m")
    lines = [
        json.dumps({"t": float(time), "position": dict(zip("xyz", map(float, place), strict=True))})
        for time, place in zip(times, places, strict=True)
    ]
    path.write_text("\n".join(lines) + "\n")


# By the name of the file that each of them writes.
WRITERS: dict[str, Callable[..., None]] = {
    "pasco.csv": pasco,
    "vernier.csv": vernier,
    "track.parquet": parquet,
    "track.npz": numpy_archive,
    "track.mat": matlab,
    "track.jsonl": json_lines,
}
