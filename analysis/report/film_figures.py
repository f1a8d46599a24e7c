"""Figures of a filmed ball: a strobe image and single frames, with the track."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle

from analysis.campaign.small_film import strobe
from analysis.record import Record
from analysis.report.style import (
    COLUMN_IN,
    SIMULATED,
    WIDE_IN,
    Drawing,
    new_figure,
    styled,
)
from analysis.review.read_back import ReviewedFilm
from tunenet_logs.arrays import Array, Picture
from tunenet_logs.errors import LogError
from tunenet_logs.images import decode_image

# Of what was found, and where it hits; the simulated path has the simulated curve's colour.
_TRACK, _IMPACT = "#ffffff", "#56b4e9"

_STROBES, _FRAMES = 20, 8  # pictures in the strobe picture; single frames
_ROOM = 0.18  # around the ball's way, of its longer side
# Width over height of what is cut out: a ball that falls straight is still seen in its place.
_NARROWEST = 0.45

_TALLEST_IN = 4.6

# Height of a single frame at most, of the time above it, and how many stand side by side: on a
# phone they are still seen.
_FRAME_IN, _TITLE_IN, _COLUMNS = 2.6, 0.17, 4

# Height over width of a frame from which all of them stand in one row; width of a time [in].
_SLIM, _TIME_IN = 4.0, 0.5

_MIN_PX = 24

_MAX_PX = 1280  # longer side of a picture in memory: a figure shows no more


@dataclass(frozen=True, eq=False)
class _Frame:
    """Image, perhaps reduced, shape (H, W, 3); its time [s] and original size."""

    at_s: float
    picture: Picture
    size_px: tuple[int, int]


@styled
def strobe_drawing(film: ReviewedFilm) -> Drawing | None:
    """Draw a strobe image of the ball with its track; None if no image can be read."""
    frames = _frames(film, np.linspace(*_span(film), _STROBES))
    if not frames:
        return None
    picture = strobe([frame.picture for frame in frames])
    box = _box(film, frames[0].size_px)
    height_in, width_in = _fitting(box)
    figure = new_figure(width_in, height_in)
    figure.set_layout_engine("none")
    axes = figure.add_axes((0, 0, 1, 1))
    _show(axes, picture, frames[0].size_px, box)
    thickness = 0.9
    for path in film.paths_px:
        axes.plot(*path.T, color=SIMULATED, linewidth=thickness)
    for frame in frames:
        _circle(axes, film, frame.at_s, thickness)
    if len(film.impacts_px):
        axes.plot(*film.impacts_px.T, "x", color=_IMPACT, markersize=5, markeredgewidth=1.3)
    line = "the track" if film.is_refused else "the tuned ball's way"
    seen = f"{len(frames)} pictures from {frames[0].at_s:.2f} to {frames[-1].at_s:.2f} s in one"
    circles = f", circles where {_found(film)}" if len(film.track_s) else ""
    caption = f"{seen}{circles}, as a line {line}." if film.paths_px else f"{seen}{circles}."
    if len(film.impacts_px):
        caption += " Crosses mark impacts."
    return Drawing("film", "What the camera saw", caption, caption, figure, is_photo=True)


@styled
def frames_drawing(film: ReviewedFilm, record: Record) -> Drawing | None:
    """Draw frames at the key times; None if fewer than two can be read."""
    frames = _frames(film, key_times(film, record))
    if len(frames) < 2:
        return None
    box = _box(film, frames[0].size_px)
    left, right, bottom, top = box
    ratio = (bottom - top) / (right - left)
    columns = min(len(frames), _COLUMNS if ratio < _SLIM else _FRAMES)
    rows = -(-len(frames) // columns)
    wide_in = max(min(WIDE_IN / columns, _FRAME_IN / ratio), _TIME_IN)
    figure = new_figure(wide_in * columns, (wide_in * ratio + _TITLE_IN) * rows)
    grid: Any = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat:
        axes.set_axis_off()
    for axes, frame in zip(grid.flat, frames, strict=False):
        _show(axes, frame.picture, frame.size_px, box)
        _circle(axes, film, frame.at_s, 1.1)
        axes.set_title(f"{frame.at_s:.3f} s", pad=2)
    times = ", ".join(f"{frame.at_s:.2f}" for frame in frames)
    which = "at the release, impacts and highest points" if record.rebounds else "evenly in time"
    circles = f", with a circle where {_found(film)}" if len(film.track_s) else ""
    caption = f"Single pictures, {which}{circles}."
    alt = f"Pictures of the recording at {times} s{circles}."
    return Drawing("frames", "Frame by frame", caption, alt, figure, is_photo=True)


def _found(film: ReviewedFilm) -> str:
    return "something was taken for the ball" if film.is_refused else "the ball was found"


def key_times(film: ReviewedFilm, record: Record) -> Array:
    """Return the first time, impacts and the apexes between; even times without impacts."""
    first_s, last_s = _span(film)
    impacts = [one.impact_s for one in record.rebounds if first_s < one.impact_s < last_s]
    if not impacts:
        return np.linspace(first_s, last_s, _FRAMES)
    times = [first_s, (first_s + impacts[0]) / 2, impacts[0]]
    for before_s, at_s in zip(impacts, [*impacts[1:], last_s], strict=True):
        times += [(before_s + at_s) / 2, at_s]
    return np.array(times[:_FRAMES])


def _span(film: ReviewedFilm) -> tuple[float, float]:
    """Return first and last time at which there is something to see."""
    seconds = film.track_s if len(film.track_s) > 1 else film.seconds
    return float(seconds[0]), float(seconds[-1])


def _frames(film: ReviewedFilm, times: Array) -> list[_Frame]:
    """Read the frames nearest to some times, each once, those of equal size."""
    count = min(len(film.pictures), len(film.seconds))
    if not count:
        return []
    nearest = {int(np.argmin(np.abs(film.seconds[:count] - at_s))) for at_s in times}
    frames: list[_Frame] = []
    for index in sorted(nearest):
        with suppress(LogError):
            frame = _frame(film, index)
            if not frames or frame.size_px == frames[0].size_px:
                frames.append(frame)
    return frames


def _frame(film: ReviewedFilm, index: int) -> _Frame:
    """Read one frame, downsampled to what a figure shows.

    Raises:
        LogError: It cannot be read.
    """
    import cv2

    picture = decode_image(film.pictures[index], "jpeg")
    height, width = picture.shape[:2]
    scale = min(1.0, _MAX_PX / max(width, height))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return _Frame(float(film.seconds[index]), np.asarray(small, np.uint8), (width, height))


def _box(film: ReviewedFilm, size_px: tuple[int, int]) -> tuple[float, float, float, float]:
    """Return the crop around the ball's path: left, right, bottom, top [px]."""
    width, height = size_px
    whole = (-0.5, width - 0.5, height - 0.5, -0.5)
    if len(film.centers_px) < 2:
        return whole
    reach = float(np.median(film.radii_px))
    low = film.centers_px.min(axis=0) - reach
    high = film.centers_px.max(axis=0) + reach
    longer = max(float((high - low).max()), _MIN_PX)
    half = (high - low) / 2 + _ROOM * longer
    half[0] = max(half[0], _NARROWEST * half[1])
    middle = (low + high) / 2
    left, top = np.maximum(middle - half, -0.5).tolist()
    right, bottom = np.minimum(middle + half, (width - 0.5, height - 0.5)).tolist()
    if right - left < _MIN_PX or bottom - top < _MIN_PX:
        return whole
    return left, right, bottom, top


def _fitting(box: Sequence[float]) -> tuple[float, float]:
    """Return height and width of a figure with this box [in]."""
    left, right, bottom, top = box
    ratio = (bottom - top) / (right - left)
    width_in = min(COLUMN_IN, _TALLEST_IN / ratio)
    return width_in * ratio, width_in


def _show(
    axes: Axes,
    picture: Picture,
    size_px: tuple[int, int],
    box: tuple[float, float, float, float],
) -> None:
    width, height = size_px
    whole = (-0.5, width - 0.5, height - 0.5, -0.5)
    axes.imshow(picture, interpolation="antialiased", extent=whole)
    left, right, bottom, top = box
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_axis_off()


def _circle(axes: Axes, film: ReviewedFilm, at_s: float, thickness: float) -> None:
    """Circle the ball as found at a time, with a dark edge: visible on any background."""
    if not len(film.track_s):
        return
    index = int(np.argmin(np.abs(film.track_s - at_s)))
    usual_s = float(np.median(np.diff(film.track_s))) if len(film.track_s) > 1 else 0.0
    if abs(float(film.track_s[index]) - at_s) > usual_s:
        return
    center, radius = film.centers_px[index].tolist(), float(film.radii_px[index])
    for color, wider in (("#000000", 1.0), (_TRACK, 0.0)):
        ring = Circle(center, radius, fill=False, color=color, linewidth=thickness + wider)
        axes.add_patch(ring)
