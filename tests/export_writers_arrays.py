"""Tracks as sensors' programs and programs of one's own write them, by no code of ours.

Each writer takes the same track: `(path, seconds, xyz, unit)` with the places in metres, z up,
NaN where not seen, shape (T, 3), and the unit of the file. What was not seen is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.export_writers import UNITS_M
from tests.library_writers import ARRAYS

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


def _arrays(kind: str, path: Path, seconds: Floats, xyz: Floats, unit: str = "") -> None:
    """Arrays by their names, of which those in Parquet say the unit."""
    times, places = _seen(seconds, xyz, unit or "m")
    axes = dict(zip("xyz", places.T, strict=True))
    named = {
        "a.parquet": {f"{name}_{unit or 'm'}": one for name, one in axes.items()},
        "a.npz": {"position": places},
        "a.mat": {name: one[:, None] for name, one in axes.items()},
        "a.jsonl": {"position": [dict(zip("xyz", one, strict=True)) for one in places.tolist()]},
    }[kind]
    is_table, is_column = kind == "a.parquet", kind == "a.mat"
    clock = {"timestamp" if is_table else "t": times[:, None] if is_column else times}
    ARRAYS[kind](path, {**clock, **named})


# By the name of the file that each of them writes.
WRITERS: dict[str, Callable[..., None]] = {
    "pasco.csv": pasco,
    "vernier.csv": vernier,
    **{f"track.{suffix}": partial(_arrays, f"a.{suffix}")
       for suffix in ("parquet", "npz", "mat", "jsonl")},
}  # fmt: skip
