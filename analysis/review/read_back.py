"""What a review has that the JSON has not: the pictures with their track, the torques."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rerun.chunk import RrdReader

from analysis.result_files import review_name
from tunenet_logs.arrays import Array
from tunenet_logs.errors import LogError
from tunenet_logs.terminal import short_name

_MOST_BYTES = 512 * 1024 * 1024
"""Of a review file; ours keep under 50 MB of pictures."""

_MOST_PICTURES, _MOST_JOINTS, _MOST_SAMPLES = 20_000, 16, 1_000_000
"""That are taken from one file."""

_CORNER_PX = 0.5
"""From Rerun's origin, the corner of the first pixel, to ours, its middle."""

_FEWEST_CORNERS = 4
"""Of what stands for a circle."""

_JOINT = re.compile(r"/torque/joint_(\d{1,2})/(observed|fit|iterations)")

_PLACES = ("/film/path", "/film/track", "/film/impacts")
"""Entities that stand still."""


@dataclass(frozen=True, eq=False)
class ReviewedFilm:
    """The pictures of a filmed ball and where it was found in them.

    Attributes:
        seconds: of each picture on the log's time, rising [s], shape (P,).
        pictures: JPEG, P of them.
        track_s: when the ball was found [s], shape (T,).
        centers_px: where, from the middle of the first pixel of a picture, shape (T, 2).
        radii_px: of the circle around it, in pixels of a picture, shape (T,).
        paths_px: the tuned ball's way, or the parts of a refused track, shape (N, 2) each.
        impacts_px: where it hits, shape (I, 2).
        is_refused: whether what was tracked makes no drop.
    """

    seconds: Array
    pictures: tuple[bytes, ...]
    track_s: Array
    centers_px: Array
    radii_px: Array
    paths_px: tuple[Array, ...]
    impacts_px: Array
    is_refused: bool


@dataclass(frozen=True, eq=False)
class ReviewedTorque:
    """The torque of one joint.

    Attributes:
        joint: its number, from 1.
        seconds: on the log's time [s], shape (T,).
        observed_nm: as it was measured [N·m], shape (T,).
        simulated_nm: of the rigid arm with the tuned payload [N·m], shape (T,).
        fitted_nm: with friction, offsets and what else is in torques [N·m]; None without.
    """

    joint: int
    seconds: Array
    observed_nm: Array
    simulated_nm: Array
    fitted_nm: Array | None


@dataclass(frozen=True, eq=False)
class ReviewedLog:
    """What was read of one file.

    Attributes:
        film: None where it shows none.
        torques: joint by joint; none for a ball.
    """

    film: ReviewedFilm | None = None
    torques: tuple[ReviewedTorque, ...] = ()


def read_back(path: Path, log_sha256: str) -> ReviewedLog:
    """Read the review of a log.

    Args:
        path: the .rrd.
        log_sha256: of the log whose review it must be.

    Raises:
        LogError: it is not there, cannot be read, or is of another log.
    """
    if not path.is_file():
        raise LogError(f"{path.name} is not beside the JSON")
    if path.stat().st_size > _MOST_BYTES:
        raise LogError(f"{path.name} is larger than {_MOST_BYTES // 1_000_000} MB")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of an unfinished file: what is in it is said below
            reader = RrdReader(path)
            names = {entry.recording_id for entry in reader.recordings()}
            if not log_sha256 or names != {review_name(log_sha256)}:
                raise LogError(f"{path.name} is the review of another log")
            return _read(reader)
    except (RuntimeError, ValueError, LookupError, TypeError, OSError) as error:
        raise LogError(f"{path.name} cannot be read ({short_name(error, 80)})") from error


def _read(reader: RrdReader) -> ReviewedLog:
    moving: dict[str, dict[str, Any]] = {}
    still: dict[str, dict[str, Any]] = {}
    for chunk in reader.stream():
        entity = str(chunk.entity_path)
        if not (entity.startswith("/film/") or _JOINT.fullmatch(entity)):
            continue
        if not chunk.is_static and "log_time_s" not in chunk.timeline_names:
            continue
        if chunk.num_rows > _MOST_SAMPLES:
            raise LogError("the review has more samples than any log")
        batch = chunk.to_record_batch()
        columns = dict(zip(batch.schema.names, batch.columns, strict=True))
        (still if chunk.is_static else moving).setdefault(entity, {}).update(columns)
    return ReviewedLog(_film(moving, still), _torques(moving))


def _seconds(columns: dict[str, Any]) -> Array:
    return columns["log_time_s"].cast("int64").to_numpy().astype(np.float64) * 1e-9


def _film(moving: dict[str, Any], still: dict[str, Any]) -> ReviewedFilm | None:
    shown = moving.get("/film/picture")
    if shown is None:
        return None
    seconds = _seconds(shown)[:_MOST_PICTURES]
    pictures = tuple(bytes(_only(cell)) for cell in shown["EncodedImage:blob"].to_pylist())
    scale = still.get("/film/picture", {}).get("Transform3D:scale")
    scale = 1.0 if scale is None else float(_only(scale.to_pylist()[0])[0])
    if not (np.isfinite(scale) and scale > 0):
        raise LogError("the review's pictures have no size")
    track_s, centers, radii = _circles(moving.get("/film/observed"))
    paths = tuple(
        _in_picture(strip, scale)
        for entity in _PLACES[:2]
        for strip in _strips(still.get(entity, {}).get("LineStrips2D:strips"))
    )
    marks = still.get("/film/impacts", {}).get("Points2D:positions")
    impacts = np.zeros((0, 2)) if marks is None else np.array(marks.to_pylist()[0], np.float64)
    return ReviewedFilm(
        seconds=seconds,
        pictures=pictures[: len(seconds)],
        track_s=track_s,
        centers_px=_in_picture(centers, scale),
        radii_px=radii / scale,
        paths_px=paths,
        impacts_px=_in_picture(impacts.reshape(-1, 2), scale),
        is_refused="/film/track" in still,
    )


def _circles(track: dict[str, Any] | None) -> tuple[Array, Array, Array]:
    """Of each polygon around the ball its time [s], middle and radius [px of the film]."""
    cells = [] if track is None else track["LineStrips2D:strips"].to_pylist()
    polygons = [_points(cell) for cell in cells]
    rows = [
        row
        for row, one in enumerate(polygons)
        if len(one) > _FEWEST_CORNERS and np.isfinite(one).all()
    ]
    seconds: Array = np.zeros(0) if track is None else _seconds(track)[rows]
    centers: Array = np.zeros((len(rows), 2))
    radii: Array = np.zeros(len(rows))
    for place, row in enumerate(rows):
        centers[place] = polygons[row][:-1].mean(axis=0)  # it ends where it begins
        radii[place] = np.hypot(*(polygons[row][0] - centers[place]))
    return seconds, centers, radii


def _only(cell: Any) -> Any:
    """The one value of a cell of one row."""
    return cell[0] if isinstance(cell, list) and len(cell) == 1 else cell


def _points(strips: Any) -> Array:
    """The one strip of a cell, shape (N, 2); N is 0 without."""
    return np.array(strips[0] if strips else [], np.float64).reshape(-1, 2)


def _strips(column: Any) -> list[Array]:
    rows = [] if column is None else column.to_pylist()
    return [np.array(strip, np.float64).reshape(-1, 2) for strip in (rows[0] if rows else [])]


def _in_picture(points: Array, scale: float) -> Array:
    """From the film's pixels to those of its pictures, which may be smaller."""
    return points / scale - _CORNER_PX


def _torques(moving: dict[str, Any]) -> tuple[ReviewedTorque, ...]:
    joints = sorted({int(found[1]) for name in moving if (found := _JOINT.fullmatch(name))})
    torques: list[ReviewedTorque] = []
    for joint in joints[:_MOST_JOINTS]:
        observed = moving.get(f"/torque/joint_{joint}/observed")
        simulated = moving.get(f"/torque/joint_{joint}/iterations")
        if observed is None or simulated is None:
            continue
        seconds = _seconds(observed)
        fit = moving.get(f"/torque/joint_{joint}/fit")
        curves = [
            None if columns is None else _last(columns["Scalars:scalars"])
            for columns in (observed, simulated, fit)
        ]
        if any(curve is not None and curve.shape != seconds.shape for curve in curves):
            raise LogError("the review's torques have different lengths")
        measured, rigid, fitted = curves
        assert measured is not None
        assert rigid is not None
        torques.append(ReviewedTorque(joint, seconds, measured, rigid, fitted))
    return tuple(torques)


def _last(column: Any) -> Array:
    """The last value of each row, shape (T,): the last iteration's."""
    return np.array([row[-1] if row else np.nan for row in column.to_pylist()], np.float64)
