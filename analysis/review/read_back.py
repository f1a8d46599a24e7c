"""Read back what a review has and its JSON lacks: images with their track, torques."""

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

_MAX_BYTES = 512 * 1024 * 1024  # of a review file; ours keep under 50 MB of pictures
_MAX_PICTURES, _MAX_JOINTS, _MAX_SAMPLES = 20_000, 16, 1_000_000  # that are taken from one file
_CORNER_PX = 0.5  # from Rerun's origin, the corner of the first pixel, to ours, its middle
_MIN_CORNERS = 4  # of what stands for a circle
_JOINT = re.compile(r"/torque/joint_(\d{1,2})/(observed|fit|iterations)")

_PLACES = ("/film/path", "/film/track", "/film/impacts")  # entities that stand still


@dataclass(frozen=True, eq=False)
class ReviewedFilm:
    """Images of a filmed ball, and its track.

    Attributes:
        seconds: Of each image on the log's time, increasing [s], shape (P,).
        pictures: JPEG, P of them.
        track_s: Stamps of the track [s], shape (T,).
        centers_px: From the middle of an image's first pixel, shape (T, 2).
        radii_px: Of the circle around it, in pixels of an image, shape (T,).
        paths_px: The tuned ball's path, or the segments of a refused track, shape (N, 2) each.
        impacts_px: Points of impact, shape (I, 2).
        is_refused: Whether the track shows no drop.
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
    """Torque of one joint.

    Attributes:
        joint: Its number, from 1.
        seconds: On the log's time [s], shape (T,).
        observed_nm: As measured [N·m], shape (T,).
        simulated_nm: Of the rigid arm with the tuned payload [N·m], shape (T,).
        fitted_nm: With friction, offsets and other nuisance terms [N·m]; None without.
    """

    joint: int
    seconds: Array
    observed_nm: Array
    simulated_nm: Array
    fitted_nm: Array | None


@dataclass(frozen=True, eq=False)
class ReviewedLog:
    """Contents of one review.

    Attributes:
        film: None if it shows none.
        torques: Joint by joint; none for a ball.
    """

    film: ReviewedFilm | None = None
    torques: tuple[ReviewedTorque, ...] = ()


def read_back(path: Path, log_sha256: str) -> ReviewedLog:
    """Read the review of the log with this SHA-256.

    Raises:
        LogError: It does not exist, cannot be read, or is of another log.
    """
    if not path.is_file():
        raise LogError(f"{path.name} is not beside the JSON")
    if path.stat().st_size > _MAX_BYTES:
        raise LogError(f"{path.name} is larger than {_MAX_BYTES // 1_000_000} MB")
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
        if chunk.num_rows > _MAX_SAMPLES:
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
    seconds = _seconds(shown)[:_MAX_PICTURES]
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
    """Return time [s], centre and radius [px of the video] of each polygon around the ball."""
    cells = [] if track is None else track["LineStrips2D:strips"].to_pylist()
    polygons = [_points(cell) for cell in cells]
    rows = [
        row
        for row, one in enumerate(polygons)
        if len(one) > _MIN_CORNERS and np.isfinite(one).all()
    ]
    seconds: Array = np.zeros(0) if track is None else _seconds(track)[rows]
    centers: Array = np.zeros((len(rows), 2))
    radii: Array = np.zeros(len(rows))
    for place, row in enumerate(rows):
        centers[place] = polygons[row][:-1].mean(axis=0)  # it ends where it begins
        radii[place] = np.hypot(*(polygons[row][0] - centers[place]))
    return seconds, centers, radii


def _only(cell: Any) -> Any:
    """Return the single value of a cell of one row."""
    return cell[0] if isinstance(cell, list) and len(cell) == 1 else cell


def _points(strips: Any) -> Array:
    """Return the single strip of a cell, shape (N, 2); N is 0 without."""
    return np.array(strips[0] if strips else [], np.float64).reshape(-1, 2)


def _strips(column: Any) -> list[Array]:
    rows = [] if column is None else column.to_pylist()
    return [np.array(strip, np.float64).reshape(-1, 2) for strip in (rows[0] if rows else [])]


def _in_picture(points: Array, scale: float) -> Array:
    """Convert pixels of the video to those of its images, which may be smaller."""
    return points / scale - _CORNER_PX


def _torques(moving: dict[str, Any]) -> tuple[ReviewedTorque, ...]:
    joints = sorted({int(found[1]) for name in moving if (found := _JOINT.fullmatch(name))})
    torques: list[ReviewedTorque] = []
    for joint in joints[:_MAX_JOINTS]:
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
    """Return the last value of each row, shape (T,): the last iteration's."""
    return np.array([row[-1] if row else np.nan for row in column.to_pylist()], np.float64)
