"""Review of a drop: heights and residuals, the ball in 3D, the iterations, and their layout.

The video, the sound and the chart of bounces, which not every tuning has, come first. A drop that
was only heard has a review of its own (`log_times`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from tunenet_logs.analysis.drop.bounce_model import DRAG, RESTITUTION, SLOPE
from tunenet_logs.analysis.drop.checks import DROP, off_s
from tunenet_logs.analysis.drop.detection import AnyDetection, FilmDetection
from tunenet_logs.analysis.drop.film import FilmedDrop
from tunenet_logs.analysis.drop.motion import last_bounce_s, matched, simulated_m
from tunenet_logs.analysis.drop.times.detection import TimesDetection, heard_heights_m
from tunenet_logs.analysis.estimators.base import Step
from tunenet_logs.analysis.experiment import Tuning, record_of
from tunenet_logs.analysis.onsets import onsets
from tunenet_logs.analysis.presentation import markdown_table, quantity
from tunenet_logs.analysis.record import Rebound
from tunenet_logs.analysis.review.drawing import (
    GROUND,
    IMPACT,
    ITERATION,
    LOG_TIME,
    MUTED,
    OBSERVED,
    WIDTH,
    Color,
    Iterates,
    at_seconds,
    by_iteration,
    chart_view,
    frames_to_show,
    iterates_view,
    log_grid,
    log_iterates,
    plainly,
    ramp,
    reduced,
    screen_radius,
    send_pictures,
    send_scalars,
    ticked,
    ticks,
)
from tunenet_logs.episode import Array, Episode, Frame, Sound
from tunenet_logs.errors import LogError
from tunenet_logs.recorders.simulators.ball import Bounce
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

# ---- Curves and marks of a plot over the log's time, and its view


def line(
    color: Color, name: str, width: float, policy: Literal["Off", "Max"] = "Off"
) -> rr.SeriesLines:
    """Style a line of a plot."""
    return rr.SeriesLines(colors=[color], names=[name], widths=[width], aggregation_policy=policy)


def dots(color: Color, name: str, size: float) -> rr.SeriesPoints:
    """Style dots of a plot."""
    return rr.SeriesPoints(colors=[color], names=[name], marker_sizes=[size])


def diamonds(color: Color, name: str, size: float = 6.0) -> rr.SeriesPoints:
    """Style diamonds of a plot: they mark impacts, and what may be some."""
    return rr.SeriesPoints(colors=[color], names=[name], markers=["diamond"], marker_sizes=[size])


def log_series(
    stream: rr.RecordingStream,
    entity: str,
    style: rr.SeriesLines | rr.SeriesPoints,
    seconds: Array,
    values: Array,
) -> None:
    """Send values over the log's time, drawn in one style."""
    stream.log(entity, style, static=True)
    send_scalars(stream, entity, seconds, values)


def _log_between(
    stream: rr.RecordingStream, entity: str, name: str, color: Color, ends_s: Array, off: float
) -> None:
    """Send two lines, that far above and below 0."""
    style = rr.SeriesLines(
        colors=[color] * 2, names=[name] * 2, widths=[1.0] * 2, aggregation_policy="Off"
    )
    log_series(stream, entity, style, ends_s, np.array([[off, -off]] * 2))


def plot(
    origin: str,
    name: str,
    shown_s: tuple[float, float] | None = None,
    values: tuple[float, float] | None = None,
    legend: rrb.PlotLegend | None = None,
) -> rrb.View:
    """Build a plot of this much of the log's time and of the values; no legend if none is given."""
    boundary = rrb.TimeRangeBoundary.absolute
    axes = {}
    if shown_s is not None:
        ends = (boundary(seconds=at_s) for at_s in shown_s)
        axes["axis_x"] = rrb.TimeAxis(view_range=rr.TimeRange(*ends))
    if values is not None:
        axes["axis_y"] = rrb.ScalarAxis(range=values)
    legend = legend or rrb.PlotLegend(visible=False)
    return rrb.TimeSeriesView(origin=origin, name=name, plot_legend=legend, **axes)


# ---- Data of a review, taken from its tuning once: curves over the log's time

_SAME_S = 1e-6  # stamps that differ by less are of one moment
# Of parameters, as a legend has room for them.
_SYMBOLS = {"restitution": "e", "restitution_slope": "p", "drag": "k"}


@dataclass(frozen=True, eq=False)
class Curve:
    """Height over the log's time."""

    name: str  # "observed", "k=3", "refined"
    label: str  # the same with its values, for a legend
    color: Color  # of its line, its ball and its label
    width: float  # of its line, in points of the screen
    values: Mapping[str, float]  # it was simulated with, by parameter; none for the observed one
    seconds: Array  # since the log's first sample [s], shape (T,)
    heights_m: Array  # above the table, of a residual above the observed height [m], shape (T,)


@dataclass(frozen=True)
class TunedBall:
    """Tuned ball in closed form, between the samples too."""

    bounce: Bounce  # the ball, with its own air
    impact_s: float  # its first impact, on the log's time
    fall_time_s: float  # of a fall from the same height without air

    def heights(self, seconds: Array) -> Array:
        """Return heights above contact at times on the log's clock, shape (T,) [drop heights]."""
        return self.bounce.heights((seconds - self.impact_s) / self.fall_time_s)

    def impacts_s(self, until_s: float) -> Array:
        """Return impacts on the log's clock, of hops that do not look like rest, shape (I,) [s]."""
        starts, speeds = self.bounce.flights((until_s - self.impact_s) / self.fall_time_s)
        hard = speeds > 0.1 * speeds[0]  # slower ones look like rest (1 % as high)
        hard[0] = True
        found = self.impact_s + self.fall_time_s * starts[hard]
        return found[found <= until_s]


@dataclass(frozen=True, eq=False)
class ReviewData:
    """Curves of one tuning."""

    observed: Curve  # the recorded heights
    # One an iteration, at the observation's own stamps; the last is the result.
    simulated: tuple[Curve, ...]
    # Of each simulated curve, less the observed one at the observed times.
    residuals: tuple[Curve, ...]
    drop_height_m: float  # what the views are scaled by
    release_s: float  # when the ball was let go, on the log's time
    impact_s: float  # the first impact
    end_s: float  # when little more is to be seen
    seen_s: float  # when the last bounce that counts ends, and a little
    # Of the result's ball, on the log's time, those that are apart; shape (I,) [s].
    impacts_s: Array
    # The result's; None where no ball was fitted, as with the paper's simulator.
    ball: TunedBall | None = None
    # Each impact's own restitution; empty if they cannot be determined.
    bounces: tuple[Rebound, ...] = ()
    interval95: tuple[float, float] | None = None  # of the result; None where none is honest

    @property
    def shown_s(self) -> tuple[float, float]:
        """First and last moment of the plots, on the log's time."""
        return float(self.observed.seconds[0]), self.seen_s


def review_data(tuning: Tuning) -> ReviewData:
    """Collect the review of a tuning that found a drop."""
    detection: AnyDetection = tuning.detection
    drop = detection.drop
    steps = tuning.trace.steps if tuning.trace else ()
    fit = tuning.trace.fit if tuning.trace else None
    observed = _observed(detection)
    curves = tuple(_simulated(tuning, k) for k in range(len(steps)))
    residuals = tuple(_residual(curve, observed) for curve in curves)
    ball = _ball(detection, steps[-1]) if steps else None
    last_s = float(observed.seconds[-1])
    impacts_s = np.array([drop.impact_s]) if ball is None else ball.impacts_s(last_s)
    interval95 = None
    if tuning.interval95 is not None:
        low, high = tuning.interval95[0]
        interval95 = float(low), float(high)
    return ReviewData(
        observed=observed,
        simulated=curves,
        residuals=residuals,
        drop_height_m=float(drop.drop_height_m),
        release_s=float(drop.release_s),
        impact_s=float(drop.impact_s),
        end_s=float(min(last_s, drop.impact_s + 5 * drop.fall_time_s)),
        seen_s=_seen_s(detection, last_s),
        impacts_s=impacts_s,
        ball=ball,
        bounces=record_of(tuning).rebounds if fit and fit.detail else (),
        interval95=interval95,
    )


def _observed(detection: AnyDetection) -> Curve:
    """Return the samples' heights by the fitted camera, or the fitted table."""
    drop = detection.drop
    posterior = detection.posterior if detection.physical else None
    if posterior is None:
        seconds = drop.seconds
        heights_m = drop.heights_m - (drop.contact_m if detection.physical else drop.table_m)
    else:
        seconds = detection.observed.seconds
        view = posterior.fit.projection()
        heights = view.heights(detection.observed.positions, seconds)
        heights_m = heights * drop.drop_height_m
    shown = seconds >= begin_s(detection)
    return Curve("observed", "observed", OBSERVED, 2.5, {}, seconds[shown], heights_m[shown])


def begin_s(detection: AnyDetection) -> float:
    """Return when the plots of a drop begin, on the log's clock [s]."""
    drop = detection.drop
    # It should not begin with a ball that is held.
    return float(drop.release_s - 0.25 * drop.fall_time_s)


def _simulated(tuning: Tuning, k: int) -> Curve:
    """Return the rollout of iterate `k`, as long as something is observed."""
    assert tuning.trace is not None
    detection, steps = tuning.detection, tuning.trace.steps
    first_s, last_s = _observed(detection).seconds[[0, -1]]
    seconds, heights_m = simulated_m(detection, steps[k])
    inside = (seconds > first_s - _SAME_S) & (seconds < last_s + _SAME_S)
    is_last = k == len(steps) - 1
    name = "refined" if tuning.trace.fit is not None and is_last else f"k={k}"
    names = [parameter.name for parameter in tuning.parameters]
    values = dict(zip(names, steps[k].values.tolist(), strict=True))
    return Curve(
        name=name,
        label=f"{name}  {values_words(values)}",
        color=ramp(k, len(steps)),
        width=3.0 if is_last else 1.2,
        values=values,
        seconds=seconds[inside],
        heights_m=heights_m[inside],
    )


def values_words(values: Mapping[str, float]) -> str:
    """Format parameters as a legend has room for them: "e=.752 p=.03 k=.11/m"."""
    alone = len(values) == 1
    parts: list[str] = []
    for name, value in values.items():
        digits = 4 if alone else 3
        number = f"{round(value, digits) + 0.0:.{digits}f}"  # no -0
        number = number if alone else number.replace("0.", ".", 1)
        unit = "/m" if name == "drag" else ""
        parts.append(f"{_SYMBOLS.get(name, name)}={number}{unit}")
    return " ".join(parts)


def _residual(curve: Curve, observed: Curve) -> Curve:
    """Subtract sample by sample where both have the same stamps, as all but the paper's do."""
    at, rows = matched(observed.seconds, curve.seconds)
    if len(at) > 1:
        off = curve.heights_m[rows] - observed.heights_m[at]
        return replace(curve, seconds=observed.seconds[at], heights_m=off)
    off = np.interp(observed.seconds, curve.seconds, curve.heights_m) - observed.heights_m
    return replace(curve, seconds=observed.seconds, heights_m=off)


def _ball(detection: AnyDetection, last: Step) -> TunedBall | None:
    """Return the ball of an iterate, let go where and when its rollout was."""
    posterior = detection.posterior if detection.physical else None
    if posterior is None:
        return None
    drop, fit = detection.drop, posterior.fit
    height_m = GRAVITY_M_S2 * drop.fall_time_s**2 / 2
    restitution, slope, drag_1_m = (*last.values.tolist(), 0.0, 0.0)[:3]
    unknowns = fit.unknowns.copy()
    unknowns[[RESTITUTION, SLOPE, DRAG]] = restitution, slope, drag_1_m * height_m
    bounce = fit.samples.bounce(unknowns)
    impact_s = drop.release_s + drop.fall_time_s * bounce.fall_time
    if bounce.starts_in_flight:  # its release is where it is first seen
        impact_s = drop.impact_s
    return TunedBall(bounce, float(impact_s), float(drop.fall_time_s))


def _seen_s(detection: AnyDetection, last_s: float) -> float:
    """Return when the last bounce in view ends, and half a fall time later."""
    drop = detection.drop
    posterior = detection.posterior if detection.physical else None
    if posterior is None:
        return last_s
    noise = drop.noise_m / drop.drop_height_m
    seen_s = last_bounce_s(posterior.fit.projection(), last_s, noise)
    return float(min(last_s, seen_s + 0.5 * drop.fall_time_s))


# ---- Chart of bounces: restitution against impact speed, with intervals

_CAP = 0.025  # half the width of the caps at a bar's ends, in chart heights


def log_bounces(stream: rr.RecordingStream, data: ReviewData) -> None:
    """Send the entities of `bounce_view`; static, so that they stay in view on any timeline."""
    bounces, color = data.bounces, data.simulated[-1].color
    # The range of restitutions and intervals, with room for their figures.
    ends = [bounce.restitution for bounce in bounces]
    for bounce in bounces:
        ends += bounce.interval95 or ()
    low, high = min(ends), max(ends)
    more = max(0.0, 0.04 - (high - low)) / 2  # less would make noise look like a slope
    low, high = low - more, high + more
    low, high = low - 0.05 * (high - low), high + 0.2 * (high - low)
    speeds = _speeds(bounces)
    if speeds is None:
        x = (np.arange(len(bounces)) + 0.5) / len(bounces) * WIDTH
        marks = [(float(at), str(index + 1)) for index, at in enumerate(x)]
    else:
        most = 1.08 * max(speeds)
        x = np.array(speeds) / most * WIDTH
        marks = [(speed / most * WIDTH, f"{speed:g}") for speed in ticks(0.0, most)]
    levels = [(-(value - low) / (high - low), f"{value:.6g}") for value in ticks(low, high, 3)]
    # Lower ones would overlap the labels of the speeds.
    rows = [(y, text) for y, text in levels if y < -0.08]
    log_grid(stream, "sheets/bounces", WIDTH, rows, marks)
    y = np.array([-(bounce.restitution - low) / (high - low) for bounce in bounces])
    dots = rr.Points2D(
        np.column_stack([x, y]), colors=[color], radii=screen_radius(4.0), draw_order=20.0
    )
    stream.log("sheets/bounces/values", dots, static=True)
    strips: list[list[list[float]]] = []
    figures: list[tuple[list[float], str]] = []
    for at, bounce in zip(x.tolist(), bounces, strict=True):
        ends = bounce.interval95 or (bounce.restitution,)
        bottom, top = (-(end - low) / (high - low) for end in (min(ends), max(ends)))
        if bounce.interval95 is not None:
            caps = [[[at - _CAP, end], [at + _CAP, end]] for end in (bottom, top)]
            strips += [[[at, bottom], [at, top]], *caps]
        if all(abs(at - place[0]) > 0.55 for place, _ in figures):  # or they would overlap
            figures.append(([at, top - 0.2], f"{bounce.restitution:.3f}"))
    labels = rr.Points2D(
        [place for place, _ in figures],
        labels=[text for _, text in figures],
        colors=[color],
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log("sheets/bounces/figures", labels, static=True)
    bars = rr.LineStrips2D(strips, colors=[color], radii=screen_radius(0.9), draw_order=15.0)
    stream.log("sheets/bounces/intervals", bars, static=True)


def bounce_view(data: ReviewData) -> rrb.View:
    """Build the view of the bounces by impact speed, or by number where no speed is known."""
    by = "bounce" if _speeds(data.bounces) is None else "impact speed [m/s]"
    bars = ", bars: 95 %" if data.interval95 is not None else ""
    return chart_view("bounces", f"restitution by {by}{bars}")


def _speeds(bounces: tuple[Rebound, ...]) -> list[float] | None:
    """Return the impact speeds [m/s]; None unless all are known."""
    speeds = [bounce.impact_speed_m_s for bounce in bounces if bounce.impact_speed_m_s is not None]
    return speeds if len(speeds) == len(bounces) else None


# ---- Video of the tracked ball and its trail, and over them the simulated balls and their path

_MIN_COUNT = 4  # samples of a flight, at least, from which its own speed sideways is fitted
# Points of the path for each picture: it is drawn as a curve where pictures are far apart.
_FINE = 4


def log_film(
    stream: rr.RecordingStream, tuning: Tuning, data: ReviewData
) -> tuple[rrb.View, float]:
    """Send the video with circles around all balls; return its view and width over height."""
    film: FilmedDrop = tuning.detection.film
    shown = film.drop.seconds >= begin_s(tuning.detection)
    first_ns, last_ns = film.track.stamps_ns[film.used][shown][[0, -1]].tolist()
    log_pictures(stream, tuning, tuning.detection, (first_ns, last_ns))
    seconds = film.drop.seconds[shown]
    observed = film.track.places_px[film.used][shown]
    radii = film.track.radius_px[film.used][shown]
    log_balls(stream, "film/observed", seconds, observed, radii, OBSERVED, 1.6)
    log_trail(stream, seconds, observed)
    _log_path(stream, film, data)
    usual = np.full(len(seconds), float(np.nanmedian(radii)))
    for k, curve in enumerate(data.simulated):
        width = 1.8 if k == len(data.simulated) - 1 else 1.0
        heights = np.interp(seconds, curve.seconds, curve.heights_m) / data.drop_height_m
        positions = film_positions(film, seconds, heights, data.impacts_s)
        log_balls(stream, f"film/k{k}", seconds, positions, usual, curve.color, width)
    # The view has room around the ball's way, and is as wide as it is high.
    count = len(data.simulated)
    size = np.array(film.track.size_px, np.float64)
    low, high = np.nanmin(observed, axis=0), np.nanmax(observed, axis=0)
    half = np.minimum(0.7 * (high - low).max() + 10, size / 2)
    middle = np.clip((low + high) / 2, half, size - half)
    (left, top), (right, bottom) = (middle - half).tolist(), (middle + half).tolist()
    aspect = (right - left) / (bottom - top)
    name = f"video: observed white, k=0 to {count - 1} cold to warm"
    # No room for a longer name.
    view = rrb.Spatial2DView(
        origin="/film",
        name="video" if aspect < 0.6 else name,
        visual_bounds=rrb.VisualBounds2D(x_range=(left, right), y_range=(top, bottom)),
    )
    return view, aspect


def log_trail(stream: rr.RecordingStream, seconds: Array, places_px: Array) -> None:
    """Send the trail of the ball's last positions."""
    # A bounce's shape can be seen, older ones are out of the way.
    begin = np.searchsorted(seconds, seconds - 0.35)
    trails = [places_px[first : index + 1] + 0.5 for index, first in enumerate(begin)]
    style = rr.LineStrips2D.from_fields(
        colors=[(*OBSERVED, 150)], radii=screen_radius(0.8), draw_order=8.0
    )
    stream.log("film/trail", style, static=True)
    columns = rr.LineStrips2D.columns(strips=[[trail] for trail in trails])
    stream.send_columns("film/trail", indexes=[at_seconds(seconds)], columns=columns)


def log_balls(
    stream: rr.RecordingStream,
    entity: str,
    seconds: Array,
    positions_px: Array,
    radii_px: Array,
    color: Color,
    width: float,
) -> None:
    """Send a circle around the ball at each time, none at NaN: a disc would hide the ball."""
    style = rr.LineStrips2D.from_fields(
        colors=[color], radii=screen_radius(width / 2), draw_order=10.0 + width
    )
    stream.log(entity, style, static=True)
    turns = np.linspace(0, 2 * np.pi, 24 + 1)
    circle = np.column_stack([np.cos(turns), np.sin(turns)])
    drawn_px = np.maximum(radii_px, 3.0)  # a smaller circle would hide the ball
    # Rerun's (0, 0) is a corner of the first pixel, ours its middle.
    strips = positions_px[:, None] + drawn_px[:, None, None] * circle + 0.5
    columns = rr.LineStrips2D.columns(
        strips=[[strip] if np.isfinite(strip).all() else [] for strip in strips]
    )
    stream.send_columns(entity, indexes=[at_seconds(seconds)], columns=columns)


def log_pictures(
    stream: rr.RecordingStream, tuning: Tuning, found: FilmDetection, span_ns: tuple[int, int]
) -> None:
    """Send the pictures of this time as recorded; bare pixels, or far too many, reduced."""
    assert tuning.episode is not None
    shown: list[Frame] = []
    for recorded in frames_to_show(tuning.episode, found.topic):
        stamp_ns = found.taken_ns.get(recorded.stamp_ns, recorded.stamp_ns)
        frame = replace(recorded, stamp_ns=stamp_ns)
        if not span_ns[0] <= frame.stamp_ns <= span_ns[1]:
            continue
        try:
            picture = frame if frame.encoding == "jpeg" else reduced(frame)
            picture.size_px()
        except LogError:
            continue
        shown.append(picture)
    # So that the review can be loaded soon.
    if sum(len(frame.data) for frame in shown) > (48 * 1024 * 1024):
        shown = [reduced(frame) for frame in shown]
    if shown:
        send_pictures(stream, shown, found.start_ns)
        scale = found.track.size_px[0] / shown[0].size_px()[0]
        stream.log("film/picture", rr.Transform3D(scale=scale), static=True)


def _log_path(stream: rr.RecordingStream, film: FilmedDrop, data: ReviewData) -> None:
    """Send the path of the result through the picture, its impacts, and the latest one's name."""
    line = rr.LineStrips2D(
        [model_path(film, data)],
        colors=[(*data.simulated[-1].color, 170)],
        radii=screen_radius(0.7),
        draw_order=6.0,
    )
    stream.log("film/path", line, static=True)
    impacts = data.impacts_s
    positions = film_positions(film, impacts, np.zeros(len(impacts)), impacts) + 0.5
    marks = rr.Points2D(positions, colors=[IMPACT], radii=screen_radius(2.5), draw_order=7.0)
    stream.log("film/impacts", marks, static=True)
    latest = rr.Points2D.from_fields(
        colors=[IMPACT], radii=screen_radius(4.0), show_labels=True, draw_order=14.0
    )
    stream.log("film/impact", latest, static=True)
    names = [f"bounce {k + 1}" for k in range(len(impacts))]
    for k, bounce in enumerate(data.bounces[: len(names)]):
        names[k] += f": {bounce.restitution:.3f}"
    columns = rr.Points2D.columns(positions=positions, labels=names)
    nothing_yet = [0] + [1] * len(impacts)
    index = at_seconds(np.concatenate([data.observed.seconds[:1], impacts]))
    stream.send_columns("film/impact", indexes=[index], columns=columns.partition(nothing_yet))


def model_path(film: FilmedDrop, data: ReviewData) -> Array:
    """Project the way of the result's ball, with all its impacts, shape (N, 2) [px].

    From the corner of the first pixel, as Rerun counts.
    """
    curve, impacts = data.simulated[-1], data.impacts_s
    count = _FINE * (len(curve.seconds) - 1) + 1
    fine = np.interp(np.arange(count) / _FINE, np.arange(len(curve.seconds)), curve.seconds)
    seconds = np.unique(np.concatenate([fine, impacts]))
    if data.ball is None:
        heights = np.interp(seconds, curve.seconds, curve.heights_m) / data.drop_height_m
    else:
        heights = data.ball.heights(seconds)
    return film_positions(film, seconds, heights, impacts) + 0.5


def film_positions(
    film: FilmedDrop, seconds: Array, heights: Array, impacts_s: Array | None = None
) -> Array:
    """Project a ball at these heights [drop heights] into the picture, shape (T, 2) [px].

    The projection knows the image's vertical alone; sideways the ball goes as the observed one: a
    piecewise linear least-squares fit with one speed, or one for each flight between `impacts_s`.
    """
    sideways = np.array([film.down_px[1], -film.down_px[0]])
    observed = film.track.places_px[film.used] @ sideways
    knots = _knots(film.drop.seconds, np.array([]) if impacts_s is None else impacts_s)
    hats = np.eye(len(knots))
    design = np.column_stack([np.interp(film.drop.seconds, knots, hat) for hat in hats])
    ways, *_ = np.linalg.lstsq(design, observed, rcond=None)
    across = np.interp(seconds, knots, ways)
    along = film.projection.positions(heights, seconds)
    return np.outer(-along, film.down_px) + np.outer(across, sideways)


def _knots(seconds: Array, impacts_s: Array) -> Array:
    """Return the impacts between flights of enough samples, and both ends, shape (K,) [s]."""
    knots = [float(seconds[0])]
    for at in impacts_s:
        before = np.count_nonzero((seconds > knots[-1]) & (seconds <= at))
        if before >= _MIN_COUNT and np.count_nonzero(seconds > at) >= _MIN_COUNT:
            knots.append(float(at))
    return np.array([*knots, float(seconds[-1])])


# ---- Sound over the log's time: its envelope, and its onsets, marked

_ENVELOPE: Color = (120, 170, 255)
_RATE_HZ = 250.0  # points of an envelope in a second: a knock and its echo are apart
_MAX = 30_000  # points of an envelope: two minutes of sound at that rate
_AROUND_S = 0.5  # of sound before and after what is shown: the background that its knocks rise from


@dataclass(frozen=True)
class Marks:
    """Marked moments of a sound."""

    entity: str  # last part of their paths
    name: str  # in words
    color: Color  # of them
    seconds: Array  # on the log's clock, shape (N,)
    size: float = 6.0  # of a mark, in points of the screen


def sound_of(episode: Episode | None, topic: str | None = None) -> Sound | None:
    """Return the sound to show; None if there is none, it is silent, or pictures have no clock."""
    if episode is None or not episode.sound_topics or episode.frames_untimed:
        return None
    try:
        sound = episode.sounds(topic if topic in episode.sound_topics else None)
    except LogError:
        return None
    return sound if sound is not None and np.any(sound.samples) else None


def log_beside(
    stream: rr.RecordingStream,
    sound: Sound,
    start_ns: int,
    span_s: tuple[float, float],
    last_s: float,
    impacts_s: Array | None = None,
    offset_s: float = 0.0,
    reason: str = "",
) -> rrb.View | None:
    """Send a sound beside pictures or positions, its knocks at `height` too; None if it is silent.

    Times are on the log's, which `start_ns` begins; other views end at `last_s`. `impacts_s` are
    those heard in a sound that is `offset_s` late; without any, there may be a `reason`.
    """
    begin_s = (sound.start_ns - start_ns) * 1e-9 - offset_s
    around_s = span_s[0] - _AROUND_S - begin_s, span_s[1] + _AROUND_S - begin_s
    # What sounds then, on the sound's clock.
    last = len(sound.samples)
    begin, end = (round(min(max(at * sound.rate_hz, 0.0), float(last))) for at in around_s)
    samples = sound.samples[begin:end]
    if not np.any(samples):
        piece = None
    else:
        later_ns = round(1e9 * begin / sound.rate_hz)
        piece = replace(sound, start_ns=sound.start_ns + later_ns, samples=samples)
    if piece is None:
        return None
    knocks_s = onsets(piece).times_s + (piece.start_ns - start_ns) * 1e-9 - offset_s
    heard_s = np.zeros(0) if impacts_s is None else impacts_s
    # An onset within 2 ms of an impact that was heard is that impact.
    known = np.abs(knocks_s[:, None] - heard_s).min(axis=1, initial=np.inf) < 0.002
    marks = (
        Marks("knock", "not used", MUTED, _inside(knocks_s[~known], span_s), 4.0),
        Marks("touch", "impact heard", OBSERVED, _inside(heard_s, span_s), 4.0),  # over "impact"
    )
    said = f"not used: {reason}" if reason else "not used"
    if impacts_s is not None:
        earlier = "earlier" if offset_s >= 0 else "later"
        said = f"drawn {1000 * abs(offset_s):.0f} ms {earlier}, white: heard"
    view = log_sound(stream, sound, begin_s, span_s, marks, said, (span_s[0], last_s))
    if view is not None:
        log_on_table(stream, marks)
    return view


def log_sound(
    stream: rr.RecordingStream,
    sound: Sound,
    begin_s: float,
    span_s: tuple[float, float],
    marks: Sequence[Marks],
    said: str,
    sent_s: tuple[float, float] = (-np.inf, np.inf),
) -> rrb.View | None:
    """Send the envelope of `span_s`, `begin_s` the first sample on the log's time, and marks on it.

    What is outside of `sent_s` cannot be scrolled to. None where nothing sounds in what is shown.
    """
    seconds, levels_db = envelope(sound, (span_s[0] - begin_s, span_s[1] - begin_s))
    seconds = seconds + begin_s
    sent = (seconds >= sent_s[0]) & (seconds <= sent_s[1])
    seconds, levels_db = seconds[sent], levels_db[sent]
    shown = (seconds >= span_s[0]) & (seconds <= span_s[1])
    if not np.isfinite(levels_db[shown]).any():
        return None
    loudest_db = float(levels_db[shown].max())
    # What is softer is drawn there, so that the axis has its ticks.
    low_db = max(float(levels_db[shown].min()), loudest_db - 45.0)
    levels_db = np.maximum(levels_db, low_db)
    style = line(_ENVELOPE, "sound", 1.0, "Max")
    log_series(stream, "sound/envelope", style, seconds, levels_db)
    for one in marks:  # at the largest level soon after each
        first = np.clip(np.searchsorted(seconds, one.seconds) - 1, 0, len(seconds) - 1)
        last = np.searchsorted(seconds, one.seconds + 0.01)
        pairs = zip(first.tolist(), last.tolist(), strict=True)
        highest = [levels_db[begin : max(end, begin + 1)].max() for begin, end in pairs]
        _log_marks(stream, "sound", one, np.array(highest))
    levels = ticked(low_db, max(loudest_db, low_db + 1.0) + 3.0)
    return plot("/sound", f"sound [dBFS], {said}", span_s, levels)


def log_on_table(stream: rr.RecordingStream, marks: Sequence[Marks]) -> None:
    """Send the same marks among the heights, at 0."""
    for one in marks:
        _log_marks(stream, "height", one, np.zeros(len(one.seconds)))


def envelope(sound: Sound, span_s: tuple[float, float]) -> tuple[Array, Array]:
    """Compute the envelope: the largest sample about each of at most `_MAX` moments.

    Of a long sound, two minutes about the span are given, or the span: times on the sound's clock
    [s] and levels [dB of full scale], -inf of silence.
    """
    more_s = max(_MAX / _RATE_HZ - (span_s[1] - span_s[0]), 0.0) / 2
    ends = ((span_s[0] - more_s) * sound.rate_hz, (span_s[1] + more_s) * sound.rate_hz)
    first, last = (round(min(max(at, 0.0), float(len(sound.samples)))) for at in ends)
    wide = max(round(sound.rate_hz / _RATE_HZ), -(-(last - first) // _MAX), 1)
    count = (last - first) // wide
    pieces = sound.samples[first : first + count * wide].reshape(count, wide)
    most = np.maximum(pieces.max(axis=1), -pieces.min(axis=1))
    most = np.nan_to_num(most, posinf=0.0, neginf=0.0)
    with np.errstate(divide="ignore"):
        levels_db: Array = 20 * np.log10(most.astype(np.float64))
    middles = first + (np.arange(count, dtype=np.float64) + 0.5) * wide
    return middles / sound.rate_hz, levels_db


def _inside(seconds: Array, span_s: tuple[float, float]) -> Array:
    return seconds[(seconds >= span_s[0]) & (seconds <= span_s[1])]


def _log_marks(stream: rr.RecordingStream, place: str, marks: Marks, values: Array) -> None:
    """Send diamonds; nothing where there are none."""
    if not len(marks.seconds):
        return
    style = diamonds(marks.color, marks.name, marks.size)
    log_series(stream, f"{place}/{marks.entity}", style, marks.seconds, values)


# ---- Drop that was only heard: the simulated height, and the impacts on the table

NOT_OURS: Color = (235, 95, 75)  # of times that are no impacts
_MS = 1000.0


def log_times(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container:
    """Send heights, impacts and how far these are apart; return the layout that shows them."""
    detection: TimesDetection = tuning.detection
    assert tuning.trace is not None
    heard, last = detection.heard, tuning.trace.steps[-1]
    seconds, heights_m = heard_heights_m(detection, last)
    color = ramp(1, 2)
    style = line(color, "simulated", 2.0)
    log_series(stream, "height/simulated", style, seconds, heights_m)
    others_s = np.setdiff1d(detection.times_s, heard.times_s)
    missed = np.setdiff1d(np.arange(int(heard.numbers.max()) + 1), heard.numbers)
    marks = (
        Marks("noise", "not its impact", NOT_OURS, others_s),
        Marks("missed", "impact not heard", MUTED, heard.predicted_s[missed]),
        Marks("heard", "impact heard", OBSERVED, heard.times_s),
    )
    log_on_table(stream, marks)
    off_ms = _MS * off_s(detection, last)
    told_s = heard.predicted_s[heard.told :]
    known = np.isfinite(off_ms)
    style = dots(color, "simulated - heard", 5.0)
    log_series(stream, "residual/impacts", style, told_s[known], off_ms[known])
    jitter_ms = _MS * heard.jitter_s
    reach_ms = 1.3 * max(float(np.abs(off_ms[known]).max(initial=0.0)), 2 * jitter_ms)
    _log_between(stream, "residual/jitter", "jitter", MUTED, seconds[[0, -1]], jitter_ms)
    begin_s, end_s = float(min(seconds[0], heard.times_s[0])), float(seconds[-1])
    begin_s -= 0.02 * (end_s - begin_s)  # or the first mark would be cut
    most_m = float(heights_m.max())
    height_view = plot(
        "/height",
        "simulated height [m], and impacts heard (at 0)",
        (begin_s, end_s),
        (-0.05 * most_m, 1.1 * most_m),
        rrb.PlotLegend(rrb.Corner2D.RightTop),
    )
    residual_view = plot(
        "/residual",
        "impacts: simulated - heard [ms], grey: the times' jitter",
        (begin_s, end_s),
        ticked(-reach_ms, reach_ms),
    )
    result = rrb.TextDocumentView(origin="/result", name="result")
    curves = rrb.Vertical(height_view, residual_view, row_shares=[3, 2])
    if detection.listened is not None:
        said = "white: its impacts, red: other knocks"
        sound = detection.listened.sound
        sound_view = log_sound(stream, sound, 0.0, (begin_s, end_s), marks, said)
        if sound_view is not None:
            curves = rrb.Vertical(height_view, sound_view, residual_view, row_shares=[5, 4, 3])
    return rrb.Horizontal(curves, result, column_shares=[3, 2])


# ---- Drop that was seen: plots, 3D scene, iterations, and the layout of all

_MM = 1000.0  # millimetres in a metre: an axis does not show numbers as small as residuals in m
_LIMIT: Color = (190, 70, 70)
_TABLE: Color = (70, 70, 78)
_PITCH = 4.5  # from ball to ball, in radii: room for their labels
# Of the chart of heights, in its heights: it fills a larger and squarer view than others.
_HEIGHTS_WIDTH = 1.7


def log_drop(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container:
    """Send all that is drawn of a drop; return the layout that shows it.

    Two tabs, to play and to scrub; with the video first where there is one.
    """
    data = review_data(tuning)
    iterates = Iterates(
        parameter="restitution",
        unit="1",
        names=tuple(curve.name for curve in data.simulated),
        values=tuple(next(iter(curve.values.values())) for curve in data.simulated),
        colors=tuple(curve.color for curve in data.simulated),
        span=(0.0, 1.0),
        interval95=data.interval95,
    )
    height_view, residual_view = _log_plots(stream, data)
    sound_view = _log_sound(stream, tuning, data)
    sounds = [] if sound_view is None else [sound_view]
    curves = rrb.Vertical(
        *(_log_scene(stream, data), height_view, *sounds, residual_view),
        row_shares=[4, 4, *[3.0] * len(sounds), 3],
    )
    height_chart = _log_height_chart(stream, data)
    log_iterates(stream, iterates, float(data.observed.seconds[0]))
    if data.bounces:
        log_bounces(stream, data)
    charts = [iterates_view(iterates), *([bounce_view(data)] if data.bounces else [])]
    result = rrb.TextDocumentView(origin="/result", name="result")
    name = f"overlay (timeline {LOG_TIME})"
    if tuning.detection.film is None:
        overlay = rrb.Horizontal(curves, result, column_shares=[3, 2], name=name)
    else:
        video, aspect = log_film(stream, tuning, data)
        share = min(max(3 * aspect, 1.2), 3.5)
        overlay = rrb.Horizontal(video, curves, result, column_shares=[share, 3, 3], name=name)
    step = rrb.TextDocumentView(origin="/step", name="iteration")
    scrub = rrb.Horizontal(
        height_chart,
        rrb.Vertical(step, *charts, row_shares=[3.6, *[2.8] * len(charts)]),
        column_shares=[5, 4],
        name=f"scrub (timeline {ITERATION})",
    )
    return rrb.Tabs(overlay, scrub, active_tab=0)


def _log_plots(stream: rr.RecordingStream, data: ReviewData) -> tuple[rrb.View, rrb.View]:
    """Send observed dots, the lines of all iterations and the residuals, over the log's time.

    The title is the legend: one in the plot would hide curves on a small screen.
    """
    for k, (curve, residual) in enumerate(zip(data.simulated, data.residuals, strict=True)):
        style = line(curve.color, curve.label, curve.width)
        log_series(stream, f"height/k{k}", style, curve.seconds, curve.heights_m)
        log_series(stream, f"residual/k{k}", style, residual.seconds, _MM * residual.heights_m)
    seen, height_m = data.observed, data.drop_height_m
    size = 1.0 if len(seen.seconds) > 200 else 2.0  # larger dots would hide the lines
    log_series(
        stream, "height/observed", dots(OBSERVED, "observed", size), seen.seconds, seen.heights_m
    )
    at_0 = np.zeros(len(data.impacts_s))
    log_series(stream, "height/impact", diamonds(IMPACT, "impacts"), data.impacts_s, at_0)
    title = "height [m]: observed white, iterations cold to warm"
    height_view = plot("/height", title, data.shown_s, ticked(0.0, 1.05 * height_m))
    most_percent = DROP["simulation fits"].limit.value
    # Between the limits a difference cannot be seen with the eye.
    limit_mm = _MM * most_percent / 100 * height_m
    _log_between(stream, "residual/limit", "limit", _LIMIT, seen.seconds[[0, -1]], limit_mm)
    # The axis shows the limit and the result's residuals: earlier iterates run off.
    last = data.residuals[-1]
    inside = (last.seconds >= data.release_s) & (last.seconds <= data.seen_s)
    off_mm = _MM * np.abs(last.heights_m[inside])
    usual_mm = float(np.quantile(off_mm, 0.98)) if len(off_mm) else 0.0
    reach_mm = 1.3 * max(usual_mm, limit_mm)
    title = f"simulated - observed [mm], red: ±{plainly(limit_mm)} is {most_percent:g} %"
    return height_view, plot("/residual", title, data.shown_s, ticked(-reach_mm, reach_mm))


def _log_sound(stream: rr.RecordingStream, tuning: Tuning, data: ReviewData) -> rrb.View | None:
    """Send the sound beside the ball; None where there is none, or it is silent."""
    sound = sound_of(tuning.episode)
    if sound is None:
        return None
    detection: AnyDetection = tuning.detection
    place = detection.start_ns, data.shown_s, float(data.observed.seconds[-1])
    ear = detection.ear
    if ear is None or ear.touches is None or ear.offset_s is None:
        return log_beside(stream, sound, *place, reason="" if ear is None else ear.reason)
    impacts_s = ear.touches.times_s - ear.offset_s
    return log_beside(stream, sound, *place, impacts_s, ear.offset_s)


def _log_scene(stream: rr.RecordingStream, data: ReviewData) -> rrb.View:
    """Send the observed ball and those of all iterations, falling side by side in 3D."""
    curves = [data.observed, *data.simulated]
    # Larger than life, to be seen.
    height_m, radius = data.drop_height_m, 0.045 * data.drop_height_m
    across = (np.arange(len(curves)) - (len(curves) - 1) / 2) * _PITCH * radius
    # What was seen and the result stand apart.
    across[[0, -1]] += np.array([-0.4, 0.4]) * _PITCH * radius
    half, thick = 2.5 * radius - across[0], 0.2 * radius
    stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    table = rr.Boxes3D(
        centers=[[0, 0, -thick]],
        half_sizes=[[half, 3 * radius, thick]],
        colors=[_TABLE],
        fill_mode="solid",
    )
    stream.log("scene/table", table, static=True)
    # Numbers alone: longer names would overlap on a small screen.
    labels = rr.Points3D(
        [[x, -3.2 * radius, 0] for x in across],
        labels=[
            "seen",
            *(curve.name.removeprefix("k=") for curve in data.simulated[:-1]),
            "result",
        ],
        colors=[curve.color for curve in curves],
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log("scene/labels", labels, static=True)
    for x, curve in zip(across, curves, strict=True):
        entity = f"scene/{curve.name.replace('=', '')}"
        ball = rr.Ellipsoids3D.from_fields(
            half_sizes=[[radius] * 3], colors=[curve.color], fill_mode="solid"
        )
        stream.log(entity, ball, static=True)
        # All at the observed times, or the balls would take their steps one after the other.
        heights = np.interp(data.observed.seconds, curve.seconds, curve.heights_m)
        centers = np.column_stack([np.full_like(heights, x), 0 * heights, heights + radius])
        columns = rr.Ellipsoids3D.columns(centers=centers)
        stream.send_columns(entity, indexes=[at_seconds(data.observed.seconds)], columns=columns)
    return rrb.Spatial3DView(
        origin="/scene",
        name="the ball as seen, and of each iteration",
        background=GROUND,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(  # from where the whole drop fills the view
            position=(0.0, -1.42 * height_m, 0.62 * height_m),
            look_target=(0.0, 0.0, 0.42 * height_m),
            eye_up=(0.0, 0.0, 1.0),
        ),
    )


def _log_height_chart(stream: rr.RecordingStream, data: ReviewData) -> rrb.View:
    """Send the observed curve, the iteration's over it, and the iteration in words at `step`."""
    start_s = data.release_s - 0.05 * (data.end_s - data.release_s)
    width_s, height_m = data.end_s - start_s, data.drop_height_m
    rows = [(-height / height_m, f"{height:g} m") for height in ticks(0.0, height_m)]
    marks = [
        ((second - start_s) / width_s * _HEIGHTS_WIDTH, f"{second:g} s")
        for second in ticks(start_s, data.end_s)
    ]
    log_grid(stream, "sheets/heights", _HEIGHTS_WIDTH, rows, marks, hang=0.035)
    drawn = []
    for curve in (data.observed, *data.simulated):
        inside = (curve.seconds >= start_s) & (curve.seconds <= data.end_s)
        x = (curve.seconds[inside] - start_s) / width_s * _HEIGHTS_WIDTH
        drawn.append(np.column_stack([x, -curve.heights_m[inside] / height_m]))
    observed, *simulated = drawn
    dots = rr.Points2D(observed, colors=[OBSERVED], radii=screen_radius(1.8))
    stream.log("sheets/heights/observed", dots, static=True)
    style = rr.LineStrips2D.from_fields(radii=screen_radius(0.8), draw_order=40.0)  # over dots
    stream.log("sheets/heights/simulated", style, static=True)
    stream.log("step", rr.TextDocument.from_fields(media_type="text/markdown"), static=True)
    words = [_step_words(k, data) for k in range(len(data.residuals))]
    for index, shown in by_iteration(len(simulated), float(data.observed.seconds[0])):
        strips = rr.LineStrips2D.columns(
            strips=[simulated[k] for k in shown], colors=[data.simulated[k].color for k in shown]
        )
        stream.send_columns("sheets/heights/simulated", indexes=[index], columns=strips)
        columns = rr.TextDocument.columns(text=[words[k] for k in shown])
        stream.send_columns("step", indexes=[index], columns=columns)
    title = "height above the table: observed (dots), simulated (line)"
    return chart_view("heights", title, _HEIGHTS_WIDTH)


def _step_words(k: int, data: ReviewData) -> str:
    """Describe an iteration: its vector, and how far its curve is from the observed one."""
    curve = data.residuals[k]
    inside = (curve.seconds >= data.release_s) & (curve.seconds <= data.seen_s)
    rms_mm = _MM * float(np.sqrt(np.mean(curve.heights_m[inside] ** 2)))
    units = {"drag": "1/m"}
    rows = [
        (quantity(name.replace("_", " "), units.get(name, "1")), f"**{value:.4f}**")
        for name, value in curve.values.items()
    ]
    return "\n\n".join(
        [
            f"# {curve.name}",
            markdown_table(("parameter", "value"), rows),
            f"{rms_mm:.2f} mm rms from the observed curve, from the release to the last bounce",
        ]
    )
