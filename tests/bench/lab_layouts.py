"""Write one drop in the layouts that motion capture, trackers, sensors and programs export."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests import export_writers as capture
from tests import export_writers_arrays as arrays
from tests import export_writers_video as video
from tests.bench.lab_drops import LabDrop
from tunenet_logs.episode import Array


@dataclass(frozen=True)
class Written:
    """File of a layout."""

    path: Path  # of it
    how: str  # unit, orientation and what else was drawn, in words
    # Whether a reader can know metres and seconds, from names or from gravity.
    tells_metres: bool = True


def write_plain(path: Path, drop: LabDrop) -> None:
    """Write the plain table: seconds and metres, both named; unseen rows left out."""
    rows = ["t [s],x [m],y [m],z [m]"]
    for time, place in zip(drop.seconds[drop.seen], drop.xyz_m[drop.seen], strict=True):
        rows.append(f"{time:.9f}," + ",".join(f"{one:.9f}" for one in place))
    path.write_text("\n".join(rows) + "\n")


def write_layout(
    layout: str,
    rng: np.random.Generator,
    drop: LabDrop,
    folder: Path,
    bodies: Mapping[str, Array] | None = None,
) -> Written:
    """Write the drop in one of `LAYOUTS`, its unit and orientation drawn."""
    return LAYOUTS[layout](layout, rng, drop, folder, bodies or {"A": drop.xyz_m})


_Bodies = Mapping[str, Array]


def _capture(
    layout: str, rng: np.random.Generator, drop: LabDrop, folder: Path, bodies: _Bodies
) -> Written:
    """Write Motive, Nexus, QTM, TRC or C3D; QTM names no unit."""
    path = folder / f"{layout}{capture.SUFFIXES[layout]}"
    units = {"nexus": ("mm",), "qualisys": ("mm",), "c3d": ("mm", "m")}
    unit = str(rng.choice(units.get(layout, ("m", "mm", "cm"))))
    up = str(rng.choice(["z", "y", "x", "-z", "-y"]))
    more: dict[str, object] = {}
    if layout == "motive":
        unit = str(rng.choice(["m", "cm", "mm", "in", "ft"]))
        more["version"] = str(rng.choice(["1.21", "1.23", "1.25"]))
    elif layout == "qualisys":
        more["unseen"] = str(rng.choice(["", "0.000", "NULL"]))
    elif layout == "trc":
        more["separator"] = str(rng.choice(["\t", ","]))
    elif layout == "c3d":
        more["processor"] = str(rng.choice(["intel", "dec", "mips"]))
        more["is_float"] = bool(rng.random() < 0.7)
        more["analogs"] = int(rng.choice([0, 6]))
    write = capture.WRITERS[layout]
    write(path, drop.seconds, bodies, rate_hz=drop.rate_hz, unit=unit, up=up, **more)
    return Written(path, f"{unit}, {up} up, {more}")


def _video(
    layout: str, rng: np.random.Generator, drop: LabDrop, folder: Path, bodies: _Bodies
) -> Written:
    """Write trackers of film, calibrated or in pixels; some count frames and give no rate."""
    path = folder / layout
    names = {1.0: "m", 100.0: "cm", 1000.0: "mm"}
    is_calibrated = bool(rng.random() < 0.6)
    scale = float(rng.choice(list(names))) if is_calibrated else float(rng.uniform(150.0, 3000.0))
    is_y_down = bool(rng.random() < 0.5)
    separator, decimal = (",", ".") if rng.random() < 0.6 else (";", ",")
    track = video.FilmedTrack(
        drop.seconds,
        bodies,
        scale=scale,
        is_y_down=is_y_down,
        origin=(float(rng.uniform(0.0, 500.0)), float(rng.uniform(0.0, 500.0))),
        rate_hz=drop.rate_hz,
        unit=names.get(scale, "pixel"),
        separator=separator,
        decimal=decimal,
    )
    video.WRITERS[layout](path, track)
    counts_frames = layout in ("mtrack2.txt", "manual_tracking.xls", "imagej_results.csv")
    how = f"{track.unit}, {scale:.0f} a metre, y {'down' if is_y_down else 'up'}, {separator!r}"
    return Written(path, how, is_calibrated and not counts_frames)


def _arrays(
    layout: str, rng: np.random.Generator, drop: LabDrop, folder: Path, bodies: _Bodies
) -> Written:
    """Write sensors' programs and arrays of one's own; the ball alone."""
    path = folder / layout
    unit, up = str(rng.choice(["m", "cm", "mm"])), str(rng.choice(["z", "-z", "y", "x"]))
    if layout in ("pasco.csv", "vernier.csv"):
        up = "z"
    xyz = capture.oriented(next(iter(bodies.values())), up)
    arrays.WRITERS[layout](path, drop.seconds, xyz, unit)
    return Written(path, f"{unit}, {up} up")


# By name; each is drawn as often as the others.
LAYOUTS: Mapping[str, Callable[[str, np.random.Generator, LabDrop, Path, _Bodies], Written]] = {
    **dict.fromkeys(capture.WRITERS, _capture),
    **dict.fromkeys(video.WRITERS, _video),
    **dict.fromkeys(arrays.WRITERS, _arrays),
}

# Layouts that hold several bodies.
OF_BODIES = tuple(
    name
    for name in LAYOUTS
    if name not in arrays.WRITERS and name not in ("tracker.txt", "imagej_results.csv")
)
