"""Drawing primitives of all reviews in Rerun: colours, timelines, charts, a legend, images.

`read_back` reads from a finished review what its JSON lacks: images with their track, torques.
"""

from __future__ import annotations

import math
import re
import uuid
import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.presentation import quantity
from tunenet_logs.analysis.result_files import review_name
from tunenet_logs.analysis.tracking.frames import kept_film, readable_frames
from tunenet_logs.episode import Array, Episode, Frame
from tunenet_logs.errors import LogError
from tunenet_logs.terminal import short_name

# ---- Camera: place that of a 3D view so that the whole scene is visible.

_UP_RAD = 0.35  # of the camera, from the level: links hide each other less
_TAN_ACROSS, _TAN_UP = 0.36, 0.5  # tangents of half of what the camera sees


def eye_controls(points_m: Array, azimuth_rad: float, margin_m: float) -> rrb.EyeControls3D:
    """Return a camera far enough away to see all points.

    Args:
        points_m: Shape (P, 3).
        azimuth_rad: Direction to the camera, from x to y.
        margin_m: Around each point.
    """
    middle = (points_m.min(axis=0) + points_m.max(axis=0)) / 2
    level = math.cos(_UP_RAD)
    towards = np.array(
        [level * math.cos(azimuth_rad), level * math.sin(azimuth_rad), math.sin(_UP_RAD)]
    )
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    off = points_m - middle
    distances_m = [
        (np.abs(off @ across) + margin_m) / half + off @ towards
        for across, half in ((right, _TAN_ACROSS), (np.cross(towards, right), _TAN_UP))
    ]
    eye = middle + float(np.max(distances_m)) * towards
    return rrb.EyeControls3D(
        position=eye.tolist(), look_target=middle.tolist(), eye_up=(0.0, 0.0, 1.0)
    )


# ---- Colours, timelines, and sizes on the screen.

Color = tuple[int, int, int]  # red, green and blue, 0 to 255 each
# One colour for one meaning in every review; white, the most legible, is what was recorded.
GROUND: Color = (16, 18, 24)  # behind charts and scenes: nearly black, as Rerun's own views are
OBSERVED: Color = (255, 255, 255)
MUTED: Color = (140, 140, 140)
SUCCESS: Color = (60, 190, 130)
FAILURE: Color = (235, 95, 75)
FITTED: Color = (255, 95, 165)
IMPACT: Color = (255, 90, 90)

# Cold to warm: readable on a dark ground, and apart for the colour-blind.
_RAMP: tuple[Color, ...] = (
    (112, 100, 190),
    (66, 120, 220),
    (40, 165, 200),
    (60, 190, 130),
    (160, 205, 60),
    (255, 165, 40),
)

LOG_TIME = "log_time_s"  # the timeline that plays: seconds since the log's first sample
ITERATION = "iteration"  # the timeline that is scrubbed: k of the tuning


def ramp(k: int, count: int) -> Color:
    """Return the colour of iteration `k` of `count`, interpolated linearly."""
    place = k / max(count - 1, 1) * (len(_RAMP) - 1)
    low = min(int(place), len(_RAMP) - 2)
    pairs = zip(_RAMP[low], _RAMP[low + 1], strict=True)
    red, green, blue = (round(a + (place - low) * (b - a)) for a, b in pairs)
    return red, green, blue


def entity_of(*parts: str) -> str:
    """Return the path of an entity whose parts may be any text; slashes split them further."""
    return rr.new_entity_path([name for part in parts for name in part.split("/") if name])


def application_id(kind: str) -> str:
    """Return a unique application id for each review that is written.

    Rerun shows another recording of the same id in the layout that it saw first, on disk until it
    is reset, no matter what blueprint that recording has.
    """
    return f"tunenet {kind} {uuid.uuid4().hex[:16]}"


def at_seconds(seconds: Array) -> rr.TimeColumn:
    """Return the index of rows at these times on `LOG_TIME`, shape (T,) [s]."""
    return rr.TimeColumn(LOG_TIME, duration=seconds)


def by_iteration(count: int, first_s: float) -> list[tuple[rr.TimeColumn, range]]:
    """Return each timeline's index of what is drawn per iteration, and the iterations it shows.

    On `ITERATION` these are all of them; on `LOG_TIME` it is the last one, the result, from
    `first_s` on.
    """
    return [
        (rr.TimeColumn(ITERATION, sequence=np.arange(count)), range(count)),
        (at_seconds(np.array([first_s])), range(count - 1, count)),
    ]


def plainly(value: float) -> str:
    """Format with two significant digits and no power of ten: "5.5", "260"."""
    return f"{float(f'{value:.2g}'):.10g}"


# Steps between ticks that a low plot has room for; margin beyond its values, of their span.
_MAX_TICKS, _AXIS_MARGIN = 5, 0.04


def ticked(low: float, high: float) -> tuple[float, float]:
    """Widen [low, high] to a plot's axis with at least two ticks.

    Rerun marks only multiples of powers of ten, where there is room for them. An axis that is
    symmetric about 0 stays so.
    """
    span = high - low
    step = 10.0 ** math.floor(math.log10(span))
    if span > _MAX_TICKS * step:
        step *= 10
    below, above = math.floor(low / step) * step, math.ceil(high / step) * step
    inside = math.floor(high / step) - math.ceil(low / step) + 1
    if inside == 0 or (inside == 1 and low == -high):
        low, high = below, above
    elif inside == 1 and (below == low or 0 < above - high <= low - below):
        high = above
    elif inside == 1:
        low = below
    room = _AXIS_MARGIN * (high - low)
    return low - room, high + room


def screen_radius(points: float) -> Any:
    """Return a radius in points of the screen, independent of the zoom."""
    return [rr.Radius.ui_points(points)]


def send_scalars(stream: rr.RecordingStream, entity: str, seconds: Array, values: Array) -> None:
    """Send a series over the log's time.

    Args:
        stream: The recording.
        entity: Path of the series.
        seconds: On `LOG_TIME`, shape (T,) [s].
        values: Shape (T,); or (T, S) for S series.
    """
    stream.send_columns(
        entity, indexes=[at_seconds(seconds)], columns=rr.Scalars.columns(scalars=values)
    )


# ---- Charts on any timeline: grid, filled areas, a parameter by iteration.

WIDTH = 2.8  # of a chart, in its heights: about the shape of the views that charts are given
_GRID_COLOR: Color = (60, 62, 70)  # just above the ground
# Lines that fill a rectangle: so thin that its corners, round by their radius, look square.
_STRIPS = 12

_FIGURE_WIDTH = 0.62  # chart heights; figures that would overlap are left out
_FIGURE_RISE = 0.2  # chart heights from a dot up to the place that its figure hangs from
_MAX_RISEN = 1.6  # times that, in a chart whose figures are wide
_MIN_BAND = 0.008  # chart heights: a narrower interval would not be seen
_BAND_SHARE = 0.35  # of the result's colour, above the ground: the band must not hide dots and grid
# Room under and over the values, of what they span; figures stand over them.
_BELOW, _OVER = 0.15, 0.4


def chart_view(name: str, title: str, width: float = WIDTH) -> rrb.View:
    """Return the view of the chart `name`, with margins for the grid's labels."""
    return rrb.Spatial2DView(
        origin=f"/sheets/{name}",
        name=title,
        background=GROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=(-0.2, width + 0.12), y_range=(-1.2, 0.36)),
    )


def log_grid(
    stream: rr.RecordingStream,
    sheet: str,
    width: float,
    rows: list[tuple[float, str]],
    marks: list[tuple[float, str]],
    hang: float = 0.085,
) -> None:
    """Log lines across at the rows, ticks below at the marks, and the labels of both.

    Args:
        stream: The recording.
        sheet: Path of the chart's entity.
        width: Of the chart, in its heights.
        rows: (y, label) of each.
        marks: (x, label) of each.
        hang: How far a row's label is raised to be beside its line, as Rerun hangs it from its
            point. Less in a larger view, where text is smaller.
    """
    lines = [[[0, y], [width, y]] for y, _ in rows] + [[[x, 0.02], [x, 0]] for x, _ in marks]
    grid = rr.LineStrips2D(lines, colors=[_GRID_COLOR], radii=screen_radius(0.5))
    stream.log(f"{sheet}/grid", grid, static=True)
    labels = rr.Points2D(
        [[-0.09, y - hang] for y, _ in rows] + [[x, 0.04] for x, _ in marks],
        labels=[text for _, text in rows + marks],
        colors=[MUTED],
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log(f"{sheet}/labels", labels, static=True)


def filled(
    left: float, right: float, top: float, bottom: float
) -> tuple[list[list[list[float]]], float]:
    """Fill a rectangle with lines, and return their radius: Rerun's 2D boxes have outlines only."""
    width, height = right - left, bottom - top
    radius = min(width, height) / (_STRIPS + 1)  # each line covers half of the one before
    steps = [radius * (1 + k) for k in range(_STRIPS)]
    if width > height:
        ends = left + radius, right - radius
        return [[[x, top + step] for x in ends] for step in steps], radius
    ends = top + radius, bottom - radius
    return [[[left + step, y] for y in ends] for step in steps], radius


def mixed(color: Color, fraction: float) -> Color:
    """Blend this fraction of `color` into the background."""
    pairs = zip(GROUND, color, strict=True)
    red, green, blue = (round(low + fraction * (high - low)) for low, high in pairs)
    return red, green, blue


def ticks(low: float, high: float, count: int = 5) -> list[float]:
    """Return about `count` ticks in [low, high], multiples of 1, 2 or 5 times a power of 10."""
    raw = (high - low) / count
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * min((1, 2, 5, 10), key=lambda factor: abs(factor * power - raw))
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [round(k * step, 6) for k in range(first, last + 1)]


@dataclass(frozen=True)
class Iterates:
    """One parameter at each iteration.

    Attributes:
        parameter: In words.
        unit: "1" if it has none.
        names: Of the iterations, "k=3", "refined".
        values: Of the parameter, in `unit`.
        colors: Of the iterations.
        span: Range of the chart.
        interval95: Of the result; None if no valid one exists.
        chart: Name of the chart that shows them.
        title: Of the chart; "" for the parameter's.
        figures: Number format.
        figure_width: Width of a number, in heights of the chart.
    """

    parameter: str
    unit: str
    names: tuple[str, ...]
    values: tuple[float, ...]
    colors: tuple[Color, ...]
    span: tuple[float, float]
    interval95: tuple[float, float] | None
    chart: str = "convergence"
    title: str = ""
    figures: str = ".4f"
    figure_width: float = _FIGURE_WIDTH


def span_of(values: Sequence[float], least: float) -> tuple[float, float]:
    """Return a chart's range for these values, at least `least`, with room for labels."""
    low, high = min(values), max(values)
    reach = max(high - low, least)
    middle = (low + high) / 2
    return middle - (0.5 + _BELOW) * reach, middle + (0.5 + _OVER) * reach


def log_iterates(stream: rr.RecordingStream, iterates: Iterates, first_s: float) -> None:
    """Log the entities of `iterates_view`; the log's time begins at `first_s`."""
    low, high = iterates.span
    count = len(iterates.values)
    sheet, wide = f"sheets/{iterates.chart}", iterates.figure_width
    rise = _FIGURE_RISE * min(wide / _FIGURE_WIDTH, _MAX_RISEN)

    def y(value: float) -> float:
        return -(value - low) / (high - low)

    margin = max(WIDTH / (2 * count), wide / 2)
    x = np.linspace(margin, WIDTH - margin, count)
    dots = np.column_stack([x, [y(value) for value in iterates.values]])
    every = math.ceil(wide * (count - 1) / (WIDTH - 2 * margin)) if count > 1 else 1
    labelled = range(count - 1, -1, -every)  # backwards, so that the result is among them
    rows = [(y(value), f"{value:g}") for value in ticks(low, high, 2)]
    marks = [(float(x[k]), iterates.names[k]) for k in labelled]
    log_grid(stream, sheet, WIDTH, rows, marks)
    if iterates.interval95 is not None:
        ends = [y(end) for end in iterates.interval95]
        half = max(ends[0] - ends[1], _MIN_BAND) / 2
        middle = sum(ends) / 2
        strips, radius = filled(0.0, WIDTH, middle - half, middle + half)
        color = mixed(iterates.colors[-1], _BAND_SHARE)
        band = rr.LineStrips2D(strips, colors=[color], radii=[radius], draw_order=1.0)
        stream.log(f"{sheet}/interval", band, static=True)
    line = rr.LineStrips2D([dots], colors=[MUTED], radii=screen_radius(0.8))
    stream.log(f"{sheet}/line", line, static=True)
    values = rr.Points2D(dots, colors=iterates.colors, radii=screen_radius(5.0), draw_order=20.0)
    stream.log(f"{sheet}/values", values, static=True)
    figures = rr.Points2D(
        [dots[k] - [0, rise] for k in labelled],
        labels=[f"{iterates.values[k]:{iterates.figures}}" for k in labelled],
        colors=[iterates.colors[k] for k in labelled],
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log(f"{sheet}/figures", figures, static=True)
    ring = rr.Points2D.from_fields(colors=[OBSERVED], radii=screen_radius(8.0), draw_order=10.0)
    stream.log(f"{sheet}/current", ring, static=True)
    for index, shown in by_iteration(count, first_s):
        columns = rr.Points2D.columns(positions=dots[shown])
        stream.send_columns(f"{sheet}/current", indexes=[index], columns=columns)


def iterates_view(iterates: Iterates) -> rrb.View:
    """Return the view of the parameter by iteration, with the result's interval as a band."""
    words = f"{quantity(iterates.parameter, iterates.unit)} by iteration"
    title = iterates.title or words
    return chart_view(iterates.chart, title + (", band: 95 %" if iterates.interval95 else ""))


# ---- Legend: a strip above curves, where it hides none of them.

_KEY_LINE = 0.3  # length of an entry's line, of what the entry takes up
KEY_SHARES = (0.6, 8.0)  # heights of a key and of what is below it


def log_key(
    stream: rr.RecordingStream, entries: Sequence[tuple[str, Sequence[Color]]], entity: str = "key"
) -> rrb.View:
    """Log a legend of each entry's text and line colours, and return its view."""
    strips, colors = [], []
    for entry, (_, line_colors) in enumerate(entries):
        width = _KEY_LINE / len(line_colors)
        for number, color in enumerate(line_colors):
            begin = entry - _KEY_LINE / 2 + number * width
            strips.append([[begin, 0.0], [begin + width, 0.0]])
            colors.append(color)
    lines = rr.LineStrips2D(strips, colors=colors, radii=screen_radius(2.0))
    stream.log(f"{entity}/lines", lines, static=True)
    words = rr.Points2D(
        [[float(entry), 0.02] for entry in range(len(entries))],
        labels=[text for text, _ in entries],
        colors=[MUTED],
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log(f"{entity}/words", words, static=True)
    return rrb.Spatial2DView(
        origin=f"/{entity}",
        name="key",
        titlebar=False,
        visual_bounds=rrb.VisualBounds2D(x_range=(-0.5, len(entries) - 0.5), y_range=(-0.06, 0.18)),
    )


# ---- Recorded images: those of a log, reduced where that is enough.

_REDUCED_PX = 640  # longer side of a reduced picture: about what a view on a screen shows
_JPEG_QUALITY = 85  # 0 to 100: what the eye cannot tell from the original
_FONT = 0  # OpenCV's number of its plain sans serif
_MAX_RECORDED_PICTURES = 240  # where nothing was found: enough to see why, and soon loaded


def log_recorded_film(stream: rr.RecordingStream, tuning: Tuning) -> bool:
    """Log the images of a log without a drop; return False if there are none."""
    episode = tuning.episode
    if episode is None or episode.signals or not episode.picture_topics:
        return False
    total = sum(
        channel.messages
        for channel in episode.channels
        if channel.topic == episode.picture_topics[0]
    )
    every = max(1, -(-total // _MAX_RECORDED_PICTURES))
    frames: list[Frame] = []
    for index, frame in enumerate(frames_to_show(episode, episode.picture_topics[0])):
        if index % every == 0:
            with suppress(LogError):
                frames.append(reduced(frame))
    if frames:
        start_ns = frames[0].stamp_ns
        send_pictures(stream, frames, start_ns)
    return bool(frames)


def frames_to_show(episode: Episode, topic: str) -> Iterator[Frame]:
    """Yield a topic's frames as recorded; raw ones reduced, if that was done."""
    film = kept_film(episode, topic)
    if film is not None and film.is_bare and not film.is_part and film.pictures:
        return film.frames()
    return readable_frames(episode, topic)


def send_pictures(stream: rr.RecordingStream, frames: list[Frame], start_ns: int) -> None:
    """Send JPEG images on the log's time, which is 0 at `start_ns`."""
    seconds = np.array([(frame.stamp_ns - start_ns) * 1e-9 for frame in frames])
    columns = rr.EncodedImage.columns(
        blob=[frame.data for frame in frames], media_type=["image/jpeg"] * len(frames)
    )
    stream.send_columns("film/picture", indexes=[at_seconds(seconds)], columns=columns)


def reduced(frame: Frame) -> Frame:
    """Downsample a frame to a small JPEG."""
    import cv2

    picture = frame.decode()
    height, width = picture.shape[:2]
    scale = min(1.0, _REDUCED_PX / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    bgr = cv2.cvtColor(small, cv2.COLOR_RGB2BGR)
    _, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return Frame(frame.stamp_ns, "jpeg", data.tobytes())


def blank_picture(size_px: tuple[int, int], words: str) -> bytes:
    """Make a JPEG of the background's colour with these words in the middle."""
    import cv2

    width, height = size_px
    sheet = np.full((height, width, 3), GROUND[::-1], np.uint8)
    (across, up), _ = cv2.getTextSize(words, _FONT, 1.0, 1)
    scale = 0.4 * width / across
    corner = round((width - scale * across) / 2), round((height + scale * up) / 2)
    cv2.putText(sheet, words, corner, _FONT, scale, MUTED[::-1], 1, cv2.LINE_AA)
    return cv2.imencode(".jpg", sheet, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()


# ---- Reading a review back.

_MAX_REVIEW_BYTES = 512 * 1024 * 1024  # of a review; ours keep under 50 MB of pictures
_MAX_PICTURES, _MAX_JOINTS, _MAX_SAMPLES = 20_000, 16, 1_000_000  # of one review
_CORNER_PX = 0.5  # from Rerun's origin, the corner of the first pixel, to ours, its middle
_MIN_CORNERS = 4  # of what stands for a circle
_JOINT = re.compile(r"/torque/joint_(\d{1,2})/(observed|fit|iterations)")
_STILL_ENTITIES = ("/film/path", "/film/track", "/film/impacts")


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
    if path.stat().st_size > _MAX_REVIEW_BYTES:
        raise LogError(f"{path.name} is larger than {_MAX_REVIEW_BYTES // 1_000_000} MB")
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
        for entity in _STILL_ENTITIES[:2]
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
