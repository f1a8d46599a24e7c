"""Review of a drop: heights and residuals, the ball in 3D, the iterations, and their layout.

The video, the sound and the chart of bounces, which not every tuning has, come first. A drop that
was only heard has a review of its own (`log_times`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from tunenet_logs.analysis.drop.bounce_model import DRAG, RESTITUTION, SLOPE
from tunenet_logs.analysis.drop.checks import DROP, off_s
from tunenet_logs.analysis.drop.detection import AnyDetection, FilmDetection
from tunenet_logs.analysis.drop.film import ConvertedFilm, FilmedDrop
from tunenet_logs.analysis.drop.motion import last_bounce_s, matched, simulated_m
from tunenet_logs.analysis.drop.times.detection import TimesDetection, heard_heights_m
from tunenet_logs.analysis.estimators.base import Step
from tunenet_logs.analysis.experiment import Tuning, record_of
from tunenet_logs.analysis.onsets import onsets
from tunenet_logs.analysis.presentation import markdown_table, quantity
from tunenet_logs.analysis.record import Rebound
from tunenet_logs.analysis.review import drawing as draw
from tunenet_logs.episode import Array, Episode, Frame, Sound
from tunenet_logs.errors import LogError
from tunenet_logs.recorders.simulators.ball import Bounce
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

# ---- Data of a review, taken from its tuning once: curves over the log's time


@dataclass(frozen=True, eq=False)
class Curve:
    """Height over the log's time."""

    name: str  # "observed", "k=3", "refined"
    label: str  # the same with its values, for a legend
    color: draw.Color  # of its line, its ball and its label
    width: float  # of its line, in points of the screen
    values: Mapping[str, float]  # it was simulated with, by parameter; none for the observed one
    seconds: Array  # since the log's first sample [s], shape (T,)
    heights_m: Array  # above the table, of a residual above the observed height [m], shape (T,)


@dataclass(frozen=True, eq=False)
class TunedBall:
    """Tuned ball in closed form, between the samples too."""

    bounce: Bounce  # the ball, with its own air
    impact_s: float  # its first impact, on the log's time
    fall_time_s: float  # of a fall from the same height without air
    impacts_s: Array  # those of hops that do not look like rest, on the log's time, shape (I,)
    rest_s: float | None  # when the last of these hops ends; None if the log ends first

    def heights(self, seconds: Array) -> Array:
        """Return heights above contact at times on the log's clock, shape (T,) [drop heights]."""
        return self.bounce.heights((seconds - self.impact_s) / self.fall_time_s)


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
    end_s: float  # when little more is to be seen
    # First and last moment of the plots: until the last bounce that counts ends, and a little.
    shown_s: tuple[float, float]
    # Of the result's ball, on the log's time, those that are apart; shape (I,) [s].
    impacts_s: Array
    # The result's; None where no ball was fitted, as with the paper's simulator.
    ball: TunedBall | None = None
    # Each impact's own restitution; empty if they cannot be determined.
    bounces: tuple[Rebound, ...] = ()
    interval95: tuple[float, float] | None = None  # of the result; None where none is honest


def review_data(tuning: Tuning) -> ReviewData:
    """Collect the review of a tuning that found a drop."""
    detection: AnyDetection = tuning.detection
    drop = detection.drop
    posterior = detection.posterior if detection.physical else None
    # The samples' heights by the fitted camera, or the fitted table.
    if posterior is None:
        seconds = drop.seconds
        heights_m = drop.heights_m - (drop.contact_m if detection.physical else drop.table_m)
    else:
        seconds = detection.observed.seconds
        view = posterior.fit.projection()
        heights_m = view.heights(detection.observed.positions, seconds) * drop.drop_height_m
    shown = seconds >= drop.release_s - 0.25 * drop.fall_time_s  # not with a ball that is held
    seconds, heights_m = seconds[shown], heights_m[shown]
    observed = Curve("observed", "observed", draw.OBSERVED, 2.5, {}, seconds, heights_m)
    first_s, last_s = (float(at_s) for at_s in seconds[[0, -1]])
    # The rollouts, as long as something is observed, and their residuals.
    steps = tuning.trace.steps if tuning.trace else ()
    fit = tuning.trace.fit if tuning.trace else None
    names = [parameter.name for parameter in tuning.parameters]
    simulated: list[Curve] = []
    residuals: list[Curve] = []
    for k, step in enumerate(steps):
        seconds, heights_m = simulated_m(detection, step)
        inside = (seconds > first_s - 1e-6) & (seconds < last_s + 1e-6)
        is_last = k == len(steps) - 1
        name = "refined" if fit is not None and is_last else f"k={k}"
        values = dict(zip(names, step.values.tolist(), strict=True))
        label, color = f"{name}  {values_words(values)}", draw.ramp(k, len(steps))
        width = 3.0 if is_last else 1.2
        curve = Curve(name, label, color, width, values, seconds[inside], heights_m[inside])
        simulated.append(curve)
        # Sample by sample where both have the same stamps, as all but the paper's do.
        at, rows = matched(observed.seconds, curve.seconds)
        if len(at) > 1:
            off = curve.heights_m[rows] - observed.heights_m[at]
            residuals.append(replace(curve, seconds=observed.seconds[at], heights_m=off))
        else:
            off = np.interp(observed.seconds, curve.seconds, curve.heights_m) - observed.heights_m
            residuals.append(replace(curve, seconds=observed.seconds, heights_m=off))
    ball = _ball(detection, steps[-1], last_s) if steps else None
    seen_s = last_s
    if posterior is not None:
        noise = drop.noise_m / drop.drop_height_m
        seen_s = last_bounce_s(posterior.fit.projection(), last_s, noise)
        seen_s = float(min(last_s, seen_s + 0.5 * drop.fall_time_s))
    interval = None if tuning.interval95 is None else tuning.interval95[0].tolist()
    return ReviewData(
        observed=observed,
        simulated=tuple(simulated),
        residuals=tuple(residuals),
        drop_height_m=float(drop.drop_height_m),
        release_s=float(drop.release_s),
        end_s=float(min(last_s, drop.impact_s + 5 * drop.fall_time_s)),
        shown_s=(first_s, seen_s),
        impacts_s=np.array([drop.impact_s]) if ball is None else ball.impacts_s,
        ball=ball,
        bounces=record_of(tuning).rebounds if fit and fit.detail else (),
        interval95=None if interval is None else (interval[0], interval[1]),
    )


def values_words(values: Mapping[str, float]) -> str:
    """Format parameters as a legend has room for them: "e=.752 p=.03 k=.11/m"."""
    symbols = {"restitution": "e", "restitution_slope": "p", "drag": "k"}
    alone = len(values) == 1
    parts: list[str] = []
    for name, value in values.items():
        digits = 4 if alone else 3
        number = f"{round(value, digits) + 0.0:.{digits}f}"  # no -0
        number = number if alone else number.replace("0.", ".", 1)
        unit = "/m" if name == "drag" else ""
        parts.append(f"{symbols.get(name, name)}={number}{unit}")
    return " ".join(parts)


def _ball(detection: AnyDetection, last: Step, until_s: float) -> TunedBall | None:
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
    if drop.launched:  # its release is where it is first seen
        impact_s = drop.impact_s
    starts, speeds = bounce.flights((until_s - float(impact_s)) / float(drop.fall_time_s))
    hard = speeds > 0.1 * speeds[0]  # slower ones look like rest (1 % as high)
    hard[0] = True
    impacts_s = float(impact_s) + float(drop.fall_time_s) * starts[hard]
    impacts_s = impacts_s[impacts_s <= until_s]
    after = int(np.flatnonzero(hard)[-1]) + 1
    rest_s = None
    if after < len(starts):
        rest_s = float(impact_s) + float(drop.fall_time_s) * float(starts[after])
        rest_s = rest_s if rest_s <= until_s else None
    return TunedBall(bounce, float(impact_s), float(drop.fall_time_s), impacts_s, rest_s)


# ---- Chart of bounces: restitution against impact speed, with intervals

_CAP = 0.025  # half the width of the caps at a bar's ends, in chart heights


def log_bounces(stream: rr.RecordingStream, data: ReviewData) -> rrb.View:
    """Send the bounces by impact speed, or by number where no speed is known; return their view.

    They are static, so that they stay in view on any timeline.
    """
    bounces, color = data.bounces, data.simulated[-1].color
    # The range of restitutions and intervals, with room for their figures.
    ends = [bounce.restitution for bounce in bounces]
    for bounce in bounces:
        ends += bounce.interval95 or ()
    low, high = min(ends), max(ends)
    more = max(0.0, 0.04 - (high - low)) / 2  # less would make noise look like a slope
    low, high = low - more, high + more
    low, high = low - 0.05 * (high - low), high + 0.2 * (high - low)
    speeds = [one.impact_speed_m_s for one in bounces if one.impact_speed_m_s is not None]
    if len(speeds) < len(bounces):
        by = "bounce"
        x = (np.arange(len(bounces)) + 0.5) / len(bounces) * draw.WIDTH
        marks = [(float(at), str(index + 1)) for index, at in enumerate(x)]
    else:
        by, most = "impact speed [m/s]", 1.08 * max(speeds)
        x = np.array(speeds) / most * draw.WIDTH
        marks = [(speed / most * draw.WIDTH, f"{speed:g}") for speed in draw.ticks(0.0, most)]
    levels = [(-(value - low) / (high - low), f"{value:.6g}") for value in draw.ticks(low, high, 3)]
    # Lower ones would overlap the labels of the speeds.
    rows = [(y, text) for y, text in levels if y < -0.08]
    draw.log_grid(stream, "sheets/bounces", draw.WIDTH, rows, marks)
    y = np.array([-(bounce.restitution - low) / (high - low) for bounce in bounces])
    draw.log_dots(stream, "sheets/bounces/values", np.column_stack([x, y]), [color], 4.0, 20.0)
    strips: list[list[list[float]]] = []
    figures: list[tuple[list[float], str]] = []
    for at, bounce in zip(x.tolist(), bounces, strict=True):
        ends = bounce.interval95 or (bounce.restitution,)
        bottom, top = (-(end - low) / (high - low) for end in (min(ends), max(ends)))
        if bounce.interval95 is not None:
            caps = [[[at - _CAP, end], [at + _CAP, end]] for end in (bottom, top)]
            strips += [[[at, bottom], [at, top]], *caps]
        if all(abs(at - place[0]) > 0.55 for place, _ in figures):  # or they would overlap
            figures.append(([at, top - 0.24], f"{bounce.restitution:.3f}"))
    places, texts = [place for place, _ in figures], [text for _, text in figures]
    draw.log_labels(stream, "sheets/bounces/figures", places, texts, [color])
    draw.log_strips(stream, "sheets/bounces/intervals", strips, [color], 0.9, 15.0)
    bars = ", bars: 95 %" if data.interval95 is not None else ""
    return draw.chart_view("bounces", f"restitution by {by}{bars}")


# ---- Video of the tracked ball and its trail, and over them the simulated balls and their path


def log_film(
    stream: rr.RecordingStream, tuning: Tuning, data: ReviewData
) -> tuple[rrb.View, float]:
    """Send the video with circles around all balls; return its view and width over height."""
    film: FilmedDrop = tuning.detection.film
    shown = film.drop.seconds >= data.shown_s[0]
    first_ns, last_ns = film.track.stamps_ns[film.used][shown][[0, -1]].tolist()
    log_pictures(stream, tuning, tuning.detection, (first_ns, last_ns), film.converted)
    seconds = film.drop.seconds[shown]
    observed = film.track.places_px[film.used][shown]
    radii = film.track.radius_px[film.used][shown]
    log_balls(stream, "film/observed", seconds, observed, radii, draw.OBSERVED, 1.6)
    # The trail of its last positions: a bounce's shape can be seen, older ones are out of the way.
    begin = np.searchsorted(seconds, seconds - 0.35)
    trails = [observed[first : index + 1] + 0.5 for index, first in enumerate(begin)]
    style = rr.LineStrips2D.from_fields(
        colors=[(*draw.OBSERVED, 150)], radii=draw.screen_radius(0.8), draw_order=8.0
    )
    columns = rr.LineStrips2D.columns(strips=[[trail] for trail in trails])
    draw.log_moving(stream, "film/trail", style, seconds, columns)
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


def log_balls(
    stream: rr.RecordingStream,
    entity: str,
    seconds: Array,
    positions_px: Array,
    radii_px: Array,
    color: draw.Color,
    width: float,
) -> None:
    """Send a circle around the ball at each time, none at NaN: a disc would hide the ball."""
    style = rr.LineStrips2D.from_fields(
        colors=[color], radii=draw.screen_radius(width / 2), draw_order=10.0 + width
    )
    turns = np.linspace(0, 2 * np.pi, 24 + 1)
    circle = np.column_stack([np.cos(turns), np.sin(turns)])
    drawn_px = np.maximum(radii_px, 3.0)  # a smaller circle would hide the ball
    # Rerun's (0, 0) is a corner of the first pixel, ours its middle.
    strips = positions_px[:, None] + drawn_px[:, None, None] * circle + 0.5
    columns = rr.LineStrips2D.columns(
        strips=[[strip] if np.isfinite(strip).all() else [] for strip in strips]
    )
    draw.log_moving(stream, entity, style, seconds, columns)


def log_pictures(
    stream: rr.RecordingStream,
    tuning: Tuning,
    found: FilmDetection,
    span_ns: tuple[int, int],
    converted: ConvertedFilm | None = None,
) -> None:
    """Send the pictures of this time as recorded; bare pixels, or far too many, draw.reduced."""
    assert tuning.episode is not None
    shown: list[Frame] = []
    for recorded in draw.frames_to_show(tuning.episode, found.topic):
        stamp_ns = found.taken_ns.get(recorded.stamp_ns, recorded.stamp_ns)
        if converted is not None and converted.is_sure:
            stamp_ns = int(converted.how.placed_ns(np.array([stamp_ns]))[0])
            if shown and shown[-1].stamp_ns == stamp_ns:  # the same picture, doubled
                continue
        frame = replace(recorded, stamp_ns=stamp_ns)
        if not span_ns[0] <= frame.stamp_ns <= span_ns[1]:
            continue
        try:
            picture = frame if frame.encoding == "jpeg" else draw.reduced(frame)
            picture.size_px()
        except LogError:
            continue
        shown.append(picture)
    # So that the review can be loaded soon.
    if sum(len(frame.data) for frame in shown) > (48 * 1024 * 1024):
        shown = [draw.reduced(frame) for frame in shown]
    if shown:
        draw.send_pictures(stream, shown, found.start_ns)
        scale = found.track.size_px[0] / shown[0].size_px()[0]
        stream.log("film/picture", rr.Transform3D(scale=scale), static=True)


def _log_path(stream: rr.RecordingStream, film: FilmedDrop, data: ReviewData) -> None:
    """Send the path of the result through the picture, its impacts, and the latest one's name."""
    color = (*data.simulated[-1].color, 170)
    draw.log_strips(stream, "film/path", [model_path(film, data)], [color], 0.7, 6.0)
    impacts = data.impacts_s
    positions = film_positions(film, impacts, np.zeros(len(impacts)), impacts) + 0.5
    draw.log_dots(stream, "film/impacts", positions, [draw.IMPACT], 2.5, 7.0)
    latest = rr.Points2D.from_fields(
        colors=[draw.IMPACT], radii=draw.screen_radius(4.0), show_labels=True, draw_order=14.0
    )
    names = [f"bounce {k + 1}" for k in range(len(impacts))]
    for k, bounce in enumerate(data.bounces[: len(names)]):
        names[k] += f": {bounce.restitution:.3f}"
    columns = rr.Points2D.columns(positions=positions, labels=names)
    nothing_yet = [0] + [1] * len(impacts)
    seconds = np.concatenate([data.observed.seconds[:1], impacts])
    draw.log_moving(stream, "film/impact", latest, seconds, columns.partition(nothing_yet))


def model_path(film: FilmedDrop, data: ReviewData) -> Array:
    """Project the way of the result's ball, with all its impacts, shape (N, 2) [px].

    From the corner of the first pixel, as Rerun counts.
    """
    curve, impacts = data.simulated[-1], data.impacts_s
    # Four points for each picture: it is drawn as a curve where pictures are far apart.
    count = 4 * (len(curve.seconds) - 1) + 1
    fine = np.interp(np.arange(count) / 4, np.arange(len(curve.seconds)), curve.seconds)
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
    # Both ends, and the impacts between flights of four samples or more.
    clock = film.drop.seconds
    knots = [float(clock[0])]
    for at in () if impacts_s is None else impacts_s:
        before = np.count_nonzero((clock > knots[-1]) & (clock <= at))
        if before >= 4 and np.count_nonzero(clock > at) >= 4:
            knots.append(float(at))
    knots.append(float(clock[-1]))
    design = np.column_stack([np.interp(clock, knots, hat) for hat in np.eye(len(knots))])
    ways, *_ = np.linalg.lstsq(design, observed, rcond=None)
    across = np.interp(seconds, knots, ways)
    along = film.projection.positions(heights, seconds)
    return np.outer(-along, film.down_px) + np.outer(across, sideways)


# ---- Sound over the log's time: its envelope, and its onsets, marked

_RATE_HZ = 250.0  # points of an envelope in a second: a knock and its echo are apart
_MAX = 30_000  # points of an envelope: two minutes of sound at that rate


@dataclass(frozen=True)
class Marks:
    """Marked moments of a sound."""

    entity: str  # last part of their paths
    name: str  # in words
    color: draw.Color  # of them
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
    # What sounds then, and half a second around: the background that its knocks rise from.
    around_s = span_s[0] - 0.5 - begin_s, span_s[1] + 0.5 - begin_s
    last = len(sound.samples)
    begin, end = (round(min(max(at * sound.rate_hz, 0.0), float(last))) for at in around_s)
    if not np.any(sound.samples[begin:end]):
        return None
    later_ns = round(1e9 * begin / sound.rate_hz)
    piece = replace(sound, start_ns=sound.start_ns + later_ns, samples=sound.samples[begin:end])
    knocks_s = onsets(piece).times_s + (piece.start_ns - start_ns) * 1e-9 - offset_s
    heard_s = np.zeros(0) if impacts_s is None else impacts_s
    # An onset within 2 ms of an impact that was heard is that impact.
    known = np.abs(knocks_s[:, None] - heard_s).min(axis=1, initial=np.inf) < 0.002
    shown = [
        times_s[(times_s >= span_s[0]) & (times_s <= span_s[1])]
        for times_s in (knocks_s[~known], heard_s)
    ]
    marks = (
        Marks("knock", "not used", draw.MUTED, shown[0], 4.0),
        Marks("touch", "impact heard", draw.OBSERVED, shown[1], 4.0),  # over "impact"
    )
    said = f"not used: {reason}" if reason else "not used"
    if impacts_s is not None:
        earlier = "earlier" if offset_s >= 0 else "later"
        said = f"drawn {1000 * abs(offset_s):.0f} ms {earlier}, white: heard"
    view = log_sound(stream, sound, begin_s, span_s, marks, said, (span_s[0], last_s))
    for one in marks if view is not None else ():
        _log_marks(stream, "height", one, np.zeros(len(one.seconds)))
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
    # What is softer is drawn there, so that the axis has its draw.ticks.
    low_db = max(float(levels_db[shown].min()), loudest_db - 45.0)
    levels_db = np.maximum(levels_db, low_db)
    style = rr.SeriesLines(
        colors=[(120, 170, 255)], names=["sound"], widths=[1.0], aggregation_policy="Max"
    )
    columns = rr.Scalars.columns(scalars=levels_db)
    draw.log_moving(stream, "sound/envelope", style, seconds, columns)
    for one in marks:  # at the largest level soon after each
        first = np.clip(np.searchsorted(seconds, one.seconds) - 1, 0, len(seconds) - 1)
        last = np.searchsorted(seconds, one.seconds + 0.01)
        pairs = zip(first.tolist(), last.tolist(), strict=True)
        highest = [levels_db[begin : max(end, begin + 1)].max() for begin, end in pairs]
        _log_marks(stream, "sound", one, np.array(highest))
    levels = draw.ticked(low_db, max(loudest_db, low_db + 1.0) + 3.0)
    return draw.plot_view("sound", f"sound [dBFS], {said}", levels, span_s)


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


def _log_marks(stream: rr.RecordingStream, place: str, marks: Marks, values: Array) -> None:
    entity = f"{place}/{marks.entity}"
    style = marks.name, marks.color, marks.size
    draw.log_marks(stream, entity, *style, marks.seconds, values, "diamond")


# ---- Drop that was only heard: the simulated height, and the impacts on the table


def log_times(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container:
    """Send heights, impacts and how far these are apart; return the layout that shows them."""
    detection: TimesDetection = tuning.detection
    assert tuning.trace is not None
    heard, last = detection.heard, tuning.trace.steps[-1]
    seconds, heights_m = heard_heights_m(detection, last)
    color = draw.ramp(1, 2)
    style = [("simulated", color, 2.0)]
    draw.log_lines(stream, "height/simulated", seconds, heights_m, style)
    others_s = np.setdiff1d(detection.times_s, heard.times_s)
    missed = np.setdiff1d(np.arange(int(heard.numbers.max()) + 1), heard.numbers)
    marks = (
        Marks("noise", "not its impact", draw.FAILURE, others_s),
        Marks("missed", "impact not heard", draw.MUTED, heard.predicted_s[missed]),
        Marks("heard", "impact heard", draw.OBSERVED, heard.times_s),
    )
    for one in marks:
        _log_marks(stream, "height", one, np.zeros(len(one.seconds)))
    off_ms = 1000 * off_s(detection, last)
    known = np.isfinite(off_ms)
    off_ms, told_s = off_ms[known], heard.predicted_s[heard.told :][known]
    draw.log_marks(stream, "residual/impacts", "simulated - heard", color, 5.0, told_s, off_ms)
    jitter_ms = 1000 * heard.jitter_s
    reach_ms = 1.3 * max(float(np.abs(off_ms).max(initial=0.0)), 2 * jitter_ms)
    ends, style = np.array([[jitter_ms, -jitter_ms]] * 2), [("jitter", draw.MUTED, 1.0)] * 2
    draw.log_lines(stream, "residual/jitter", seconds[[0, -1]], ends, style)
    begin_s, end_s = float(min(seconds[0], heard.times_s[0])), float(seconds[-1])
    begin_s -= 0.02 * (end_s - begin_s)  # or the first mark would be cut
    most_m = float(heights_m.max())
    height_view = draw.plot_view(
        "height",
        "simulated height [m], and impacts heard (at 0)",
        (-0.05 * most_m, 1.1 * most_m),
        (begin_s, end_s),
        rrb.PlotLegend(rrb.Corner2D.RightTop),
    )
    title = "impacts: simulated - heard [ms], grey: jitter"
    if heard.scatter > 0:  # which adds up from one to the next
        title += f"; each bounce varies by {100 * heard.scatter:.2g} %"
    span = draw.ticked(-reach_ms, reach_ms)
    residual_view = draw.plot_view("residual", title, span, (begin_s, end_s))
    result = draw.result_view()
    curves = rrb.Vertical(height_view, residual_view, row_shares=[3, 2])
    if detection.listened is not None:
        said = "white: its impacts, red: other knocks"
        sound = detection.listened.sound
        sound_view = log_sound(stream, sound, 0.0, (begin_s, end_s), marks, said)
        if sound_view is not None:
            curves = rrb.Vertical(height_view, sound_view, residual_view, row_shares=[5, 4, 3])
    return rrb.Horizontal(curves, result, column_shares=[3, 2])


# ---- Drop that was seen: plots, 3D scene, iterations, and the layout of all


def log_drop(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container:
    """Send all that is drawn of a drop; return the layout that shows it.

    Two tabs, to play and to scrub; with the video first where there is one.
    """
    data = review_data(tuning)
    height_view, residual_view = _log_plots(stream, data)
    # The sound beside the ball, where there is one that is not silent.
    heard: rrb.View | None = None
    detection: AnyDetection = tuning.detection
    if (sound := sound_of(tuning.episode)) is not None:
        place = detection.start_ns, data.shown_s, float(data.observed.seconds[-1])
        ear = detection.ear
        if ear is None or ear.touches is None or ear.offset_s is None:
            reason = "" if ear is None else ear.reason
            heard = log_beside(stream, sound, *place, reason=reason)
        else:
            impacts_s = ear.touches.times_s - ear.offset_s
            heard = log_beside(stream, sound, *place, impacts_s, ear.offset_s)
    sounds = [] if heard is None else [heard]
    curves = rrb.Vertical(
        *(_log_scene(stream, data), height_view, *sounds, residual_view),
        row_shares=[4, 4, *[3.0] * len(sounds), 3],
    )
    height_chart, step = _log_heights(stream, data)
    iterates = draw.log_iterates(
        stream,
        "restitution by iteration",
        [curve.name for curve in data.simulated],
        [next(iter(curve.values.values())) for curve in data.simulated],
        [curve.color for curve in data.simulated],
        (0.0, 1.0),
        data.interval95,
        data.shown_s[0],
    )
    charts = [iterates]
    charts += [log_bounces(stream, data)] if data.bounces else []
    result = rrb.Vertical(draw.result_view(), _log_phases(stream, data), row_shares=[5, 1])
    name = f"overlay (timeline {draw.LOG_TIME})"
    if detection.film is None:
        overlay = rrb.Horizontal(curves, result, column_shares=[3, 2], name=name)
    else:
        video, aspect = log_film(stream, tuning, data)
        share = min(max(3 * aspect, 1.2), 3.5)
        overlay = rrb.Horizontal(video, curves, result, column_shares=[share, 3, 3], name=name)
    scrub = rrb.Horizontal(
        rrb.Vertical(height_chart, _log_residuals(stream, data), row_shares=[3, 2]),
        rrb.Vertical(step, *charts, row_shares=[2.4, *[3.2] * len(charts)]),
        column_shares=[5, 4],
        name=draw.SCRUB,
    )
    return rrb.Tabs(overlay, scrub, active_tab=0)


def _log_plots(stream: rr.RecordingStream, data: ReviewData) -> tuple[rrb.View, rrb.View]:
    """Send observed dots, the lines of all iterations and the residuals, over the log's time.

    The title is the legend: one in the plot would hide curves on a small screen.
    """
    for k, (curve, residual) in enumerate(zip(data.simulated, data.residuals, strict=True)):
        style = [(curve.label, curve.color, curve.width)]
        draw.log_lines(stream, f"height/k{k}", curve.seconds, curve.heights_m, style)
        off_mm = 1000 * residual.heights_m
        draw.log_lines(stream, f"residual/k{k}", residual.seconds, off_mm, style)
    seconds, heights_m = data.observed.seconds, data.observed.heights_m
    size = 1.0 if len(seconds) > 200 else 2.0  # larger dots would hide the lines
    observed = "observed", draw.OBSERVED, size
    draw.log_marks(stream, "height/observed", *observed, seconds, heights_m)
    impacts, at_0 = ("impacts", draw.IMPACT, 6.0), np.zeros(len(data.impacts_s))
    draw.log_marks(stream, "height/impact", *impacts, data.impacts_s, at_0, "diamond")
    title = "height [m]: observed white, iterations cold to warm"
    span = draw.ticked(0.0, 1.05 * data.drop_height_m)
    # With room for what is marked at either end.
    more_s = 0.006 * (data.shown_s[1] - data.shown_s[0])
    shown_s = data.shown_s[0] - more_s, data.shown_s[1] + more_s
    height_view = draw.plot_view("height", title, span, shown_s)
    most_percent = DROP["simulation fits"].limit.value
    # Between the limits a difference cannot be seen with the eye.
    limit_mm = 1000 * most_percent / 100 * data.drop_height_m
    ends, style = np.array([[limit_mm, -limit_mm]] * 2), [("limit", (190, 70, 70), 1.0)] * 2
    draw.log_lines(stream, "residual/limit", seconds[[0, -1]], ends, style)
    # The axis shows the limit and the result's residuals: earlier iterates run off.
    last = data.residuals[-1]
    inside = (last.seconds >= data.release_s) & (last.seconds <= data.shown_s[1])
    off_mm = 1000 * np.abs(last.heights_m[inside])
    usual_mm = float(np.quantile(off_mm, 0.98)) if len(off_mm) else 0.0
    reach_mm = 1.3 * max(usual_mm, limit_mm)
    plain = f"{float(f'{limit_mm:.2g}'):.10g}"  # two significant digits and no power of ten
    title = f"simulated - observed [mm], red: ±{plain} is {most_percent:g} %"
    span = draw.ticked(-reach_mm, reach_mm)
    return height_view, draw.plot_view("residual", title, span, shown_s)


_REST = "rests"  # or hops a hundredth as high as the first
_HELD, _FALLS, _FLIES = (95, 100, 115), (66, 120, 220), ((40, 140, 150), (50, 110, 125))


def _log_phases(stream: rr.RecordingStream, data: ReviewData) -> rrb.View:
    """Send what the ball does as states: in the hand, falling, each flight, rest."""
    begins = {"in the hand": data.shown_s[0], "falls": max(data.release_s, data.shown_s[0])}
    if data.ball is None:  # later impacts are not known
        begins |= {"bounces": float(data.impacts_s[0])}
    else:
        begins |= {f"flight {n}": at for n, at in enumerate(data.impacts_s.tolist(), 1)}
        begins |= {} if data.ball.rest_s is None else {_REST: data.ball.rest_s}
    if begins["falls"] <= data.shown_s[0]:
        del begins["in the hand"]
    colors = {"in the hand": _HELD, "falls": _FALLS, _REST: _HELD}
    # Numbers, and no words where they would be cut: a letter takes up a 60th of the strip.
    labels = [name.removeprefix("flight ") for name in begins]
    lasts_s = np.diff([*begins.values(), float(data.observed.seconds[-1])])
    letter_s = (float(data.observed.seconds[-1]) - data.shown_s[0]) / 60
    labels = [
        name if name.isdigit() or lasts > letter_s * len(name) else " "
        for name, lasts in zip(labels, lasts_s.tolist(), strict=True)
    ]
    style = rr.StateConfiguration(
        values=list(begins),
        labels=labels,
        colors=[colors.get(name, _FLIES[number % 2]) for number, name in enumerate(begins)],
    )
    seconds = np.array(list(begins.values()))
    draw.log_moving(stream, "phase", style, seconds, rr.StateChange.columns(state=list(begins)))
    return rrb.StateTimelineView(contents=["+ /phase"], name="what the ball does; numbers: flights")


def _log_scene(stream: rr.RecordingStream, data: ReviewData) -> rrb.View:
    """Send the observed ball and those of all iterations, falling side by side in 3D."""
    curves = [data.observed, *data.simulated]
    # Larger than life, to be seen.
    height_m, radius = data.drop_height_m, 0.045 * data.drop_height_m
    pitch = 4.5  # from ball to ball, in radii: room for their labels
    across = (np.arange(len(curves)) - (len(curves) - 1) / 2) * pitch * radius
    # What was seen and the result stand apart.
    across[[0, -1]] += np.array([-0.4, 0.4]) * pitch * radius
    half, thick = 2.5 * radius - across[0], 0.2 * radius
    stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    table = rr.Boxes3D(
        centers=[[0, 0, -thick]],
        half_sizes=[[half, 3 * radius, thick]],
        colors=[(70, 70, 78)],
        fill_mode="solid",
    )
    stream.log("scene/table", table, static=True)
    # Numbers alone: longer names would overlap on a small screen.
    names = ["seen", *(one.name.removeprefix("k=") for one in data.simulated[:-1]), "result"]
    places = [[x, -3.2 * radius, 0] for x in across]
    draw.log_labels(stream, "scene/labels", places, names, [curve.color for curve in curves])
    for x, curve in zip(across, curves, strict=True):
        entity = f"scene/{curve.name.replace('=', '')}"
        ball = rr.Ellipsoids3D.from_fields(
            half_sizes=[[radius] * 3], colors=[curve.color], fill_mode="solid"
        )
        # All at the observed times, or the balls would take their steps one after the other.
        heights = np.interp(data.observed.seconds, curve.seconds, curve.heights_m)
        centers = np.column_stack([np.full_like(heights, x), 0 * heights, heights + radius])
        columns = rr.Ellipsoids3D.columns(centers=centers)
        draw.log_moving(stream, entity, ball, data.observed.seconds, columns)
    # From where the whole drop fills the view.
    eye_m, target_m = height_m * np.array([[0.0, -1.42, 0.62], [0.0, 0.0, 0.42]])
    return draw.scene_view("the ball as seen, and of each iteration", eye_m, target_m)


def _log_residuals(stream: rr.RecordingStream, data: ReviewData) -> rrb.View:
    """Send each iteration's residuals over the drop, and the line of none."""
    seconds = data.residuals[-1].seconds
    inside = (seconds >= data.release_s) & (seconds <= data.shown_s[1])
    seconds = seconds[inside]
    each = [np.interp(seconds, one.seconds, one.heights_m) for one in data.residuals]
    curves_mm = 1000 * np.column_stack(each)
    usual_mm = float(np.nanquantile(np.abs(curves_mm[:, -1]), 0.98)) if len(seconds) else 0.0
    reach_mm = max(4.0 * usual_mm, 5.0)
    shown_mm = np.clip(curves_mm, -reach_mm, reach_mm)  # earlier iterates run along the border
    colors = [curve.color for curve in data.simulated]
    none = np.zeros(len(seconds))
    drawn = stream, "sheets/residuals", seconds, none, shown_mm, colors
    draw.log_sheet(*drawn, (-reach_mm, reach_mm), first_s=data.shown_s[0])
    return draw.chart_view("residuals", "simulated - observed [mm], along the border: beyond it")


def _log_heights(stream: rr.RecordingStream, data: ReviewData) -> tuple[rrb.View, rrb.View]:
    """Send the observed curve, the iteration's over it, and the iteration in words."""
    start_s = data.release_s - 0.05 * (data.end_s - data.release_s)
    width_s, height_m = data.end_s - start_s, data.drop_height_m
    wide = 2.1  # it fills a larger and squarer view than other charts
    rows = [(-height / height_m, f"{height:g} m") for height in draw.ticks(0.0, height_m)]
    marks = [
        ((second - start_s) / width_s * wide, f"{second:g} s")
        for second in draw.ticks(start_s, data.end_s)
    ]
    draw.log_grid(stream, "sheets/heights", wide, rows, marks, hang=0.035)
    drawn = []
    for curve in (data.observed, *data.simulated):
        inside = (curve.seconds >= start_s) & (curve.seconds <= data.end_s)
        x = (curve.seconds[inside] - start_s) / width_s * wide
        drawn.append(np.column_stack([x, -curve.heights_m[inside] / height_m]))
    draw.log_dots(stream, "sheets/heights/observed", drawn[0], [draw.OBSERVED], 1.8)
    style = rr.LineStrips2D.from_fields(radii=draw.screen_radius(0.8), draw_order=40.0)  # over dots
    draw.log_by_iteration(
        stream,
        "sheets/heights/simulated",
        style,
        data.shown_s[0],
        rr.LineStrips2D.columns,
        strips=drawn[1:],
        colors=[curve.color for curve in data.simulated],
    )
    # Its vector, and how far its curve is from the observed one.
    words: list[str] = []
    for curve in data.residuals:
        inside = (curve.seconds >= data.release_s) & (curve.seconds <= data.shown_s[1])
        rms_mm = 1000 * float(np.sqrt(np.mean(curve.heights_m[inside] ** 2)))
        head = [
            quantity(name.replace("_", " "), "1/m" if name == "drag" else "1")
            for name in curve.values
        ]
        figures = (f"**{value:.4f}**" for value in curve.values.values())
        table = markdown_table(("", *head), [(curve.name, *figures)])
        off = f"{rms_mm:.2f} mm rms from the observed curve, from the release to the last bounce"
        words.append(f"{table}\n\n{off}")
    title = "height above the table: observed (dots), simulated (line)"
    view = draw.chart_view("heights", title, wide)
    return view, draw.log_steps(stream, words, data.shown_s[0])
