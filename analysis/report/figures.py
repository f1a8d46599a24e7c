"""Draw a tuning's figures with matplotlib: curves, bounces, iterations, images and signals.

Those of a drop need its record alone; images and signals are read from its review. A `..._drawing`
is None where there is nothing to draw.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple, ParamSpec, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from tunenet_logs.analysis.campaign import (
    Campaign,
    ball_rates,
    overall_rates,
    reduced,
    restitutions_by_ball,
    strobe,
)
from tunenet_logs.analysis.compare import (
    ComparedGroup,
    ComparedValue,
    Comparison,
    moved,
    restitution_value,
)
from tunenet_logs.analysis.presentation import number_words, quantity
from tunenet_logs.analysis.record import Record
from tunenet_logs.analysis.review.drawing import ReviewedFilm, ReviewedSignal
from tunenet_logs.episode import Array, Picture, median_step
from tunenet_logs.errors import LogError
from tunenet_logs.images import decode_image
from tunenet_logs.terminal import short_name

# ---- Style: widths of a paper's column, colour-blind safe colours.

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

COLUMN_IN = 3.4  # width of a figure: a column of a paper with two [in]
WIDE_IN = 7.0  # width of both columns with what is between them [in]
# What was recorded, the tuned simulator, and a third thing (Okabe and Ito 2008).
OBSERVED, SIMULATED, THIRD = "#1a1a1a", "#d55e00", "#0072b2"

MUTED, BAND = "#767676", "#e6e6e6"
# One log after the other; after the last colour, the lines' pattern changes.
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#1a1a1a")
PATTERNS = ("-", "--", "-.", ":")

_FONT = "DejaVu Sans"  # comes with matplotlib, so figures look the same everywhere
_SETTINGS = {
    "font.family": _FONT,
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e3e3e3",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "lines.linewidth": 1.2,
    "legend.frameon": False,
    "legend.handlelength": 1.4,
    "figure.dpi": 100,
    "savefig.dpi": 300,
    "pdf.fonttype": 42,  # TrueType: text that can be searched, and no fonts that journals refuse
    "svg.fonttype": "path",  # looks alike on a machine without the font
    "svg.hashsalt": "tunenet-logs",  # the same figure is the same bytes
    "text.parse_math": False,  # a dollar in a log's name is a dollar
    "text.usetex": False,
    "axes.formatter.use_mathtext": False,
    "axes.unicode_minus": True,
}


@dataclass(frozen=True, eq=False)
class Drawing:
    """Figure with its texts."""

    name: str  # short, for a file's name
    title: str  # above it
    caption: str  # what it shows; numbers in it are the record's
    alt: str  # alternative text
    figure: Figure  # drawn, not saved yet
    is_photo: bool = False  # whether it is images rather than lines


def styled(draw: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Decorate a function to draw or save with these settings instead of the user's."""

    @functools.wraps(draw)
    def inside(*arguments: Arguments.args, **named: Arguments.kwargs) -> Result:
        with mpl.rc_context():
            mpl.rcdefaults()
            mpl.rcParams.update(_SETTINGS)  # pyright: ignore[reportArgumentType, reportCallIssue]
            return draw(*arguments, **named)

    return inside


def new_figure(width_in: float, height_in: float) -> Figure:
    """Create an empty figure without pyplot, so that the user's open figures stay."""
    return Figure(figsize=(width_in, height_in), layout="constrained")


def drawable(text: str, most: int = 28) -> str:
    """Replace letters that the font lacks, and shorten."""
    known = get_font(findfont(FontProperties(family=_FONT))).get_charmap()
    return "".join(
        letter if ord(letter) in known else "\u25a1" for letter in short_name(text, most)
    )


# ---- Drop: heights, bounces and iterations, from the record alone.

_MAX_BOUNCES = 60  # drawn


def in_metres(record: Record) -> bool:
    """Return whether heights are in metres; else in drop heights, for want of a scale."""
    return "drag" not in record.motion.unknown


def thinned(count: int, most: int = 700) -> slice:
    """Return a slice that decimates so many samples to at most `most`; more make a page large."""
    return slice(None, None, max(1, -(-count // most)))


@styled
def curves_drawing(record: Record) -> Drawing | None:
    """Plot observed and simulated heights, and the residual; None without curves."""
    curves, fit = record.motion.curves, record.motion.fit
    if curves is None:
        return None
    unit, factor, small = ("m", 1e3, "mm") if in_metres(record) else ("drop heights", 100.0, "%")
    part = thinned(len(curves.seconds))
    seconds = curves.seconds[part]
    observed, simulated = curves.observed_m[part], curves.simulated_m[part]
    figure = new_figure(COLUMN_IN, 2.9)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1.2])
    upper.plot(seconds, observed, ".", color=OBSERVED, markersize=2.6, label="observed")
    upper.plot(seconds, simulated, color=SIMULATED, linewidth=1.1, label="simulated")
    impacts_s = [one.impact_s for one in record.rebounds[:_MAX_BOUNCES]]
    dotted = {"color": MUTED, "linewidth": 0.5, "linestyle": (0, (2, 2)), "zorder": 0.5}
    for axes in (upper, lower):
        for at_s in impacts_s:
            if curves.seconds[0] <= at_s <= curves.seconds[-1]:
                axes.axvline(at_s, **dotted)
    upper.set_ylabel(f"height [{unit}]")
    seen = observed[np.isfinite(observed)]
    least, extent = (float(seen.min()), float(np.ptp(seen))) if len(seen) else (0.0, 1.0)
    upper.set_ylim(bottom=min(0.0, least) - 0.03 * extent)
    figure.legend(loc="outside upper right", ncols=2)
    off = factor * (simulated - observed)
    lower.axhline(0, color=MUTED, linewidth=0.5)
    lower.plot(seconds, off, color=THIRD, linewidth=0.7)
    known = np.abs(off[np.isfinite(off)])
    reach = 1.4 * float(np.quantile(known, 0.98)) if len(known) else 1.0
    lower.set_ylim(-max(reach, 1e-3), max(reach, 1e-3))
    lower.set_ylabel(f"sim. − obs.\n[{small}]")
    lower.set_xlabel("time [s]")
    span_s = float(curves.seconds[-1] - curves.seconds[0])
    caption = f"Height over the table at the recording's own {len(curves.seconds)} samples"
    caption += f" (every {part.step}th is drawn)" if part.step and part.step > 1 else ""
    caption += "; below, what the simulated ball is higher by."
    alt = f"Two curves of height over {span_s:.2f} s: observed points and the simulated line"
    if fit is not None:
        caption += (
            f" Apart by {fit.rms_percent:.2f} % of the drop height, rms, of which the noise of the "
            f"observation makes {fit.noise_percent:.2f} %; at worst {fit.worst_percent:.2f} %."
        )
        alt += f", {fit.rms_percent:.2f} % of the drop height apart, rms"
    return Drawing("curves", "Observed and simulated", caption, alt + ".", figure)


@styled
def bounces_drawing(record: Record) -> Drawing | None:
    """Plot restitution over impact speed with the tuned law; None for one impact."""
    rebounds = record.rebounds[:_MAX_BOUNCES]
    tuned = record.estimate("restitution")
    if len(rebounds) < 2 or tuned is None or not isinstance(tuned.value, float):
        return None
    has_speed = all((one.impact_speed_m_s or 0) > 0 for one in rebounds)
    places = [
        float(one.impact_speed_m_s or 0) if has_speed else float(number)
        for number, one in enumerate(rebounds, 1)
    ]
    figure = new_figure(COLUMN_IN, 2.2)
    axes = figure.subplots()
    ends = tuned.interval95
    law = restitution_value(
        ComparedValue("", tuned.value, ends, record.verdict),  # pyright: ignore[reportArgumentType]
        record,
    )
    if has_speed and law.slope is not None and law.speed_m_s is not None:
        # e (v / v_1)^-p; its band has e's own error at its speed and p's beside it.
        at_m_s = np.linspace(min(places), max(places), 60)
        if law.slope_half is not None and law.interval95 is not None:
            along = [moved(law, float(one)).interval95 or (0.0, 0.0) for one in at_m_s]
            lows, highs = zip(*along, strict=True)
            axes.fill_between(at_m_s, lows, highs, color=SIMULATED, alpha=0.18, linewidth=0)
        tuned_law = law.value * (at_m_s / law.speed_m_s) ** -law.slope
        axes.plot(at_m_s, tuned_law, color=SIMULATED, label="tuned law")
    values = [one.restitution for one in rebounds]
    alone = [one.interval95 or (one.restitution, one.restitution) for one in rebounds]
    below = [max(value - low, 0.0) for value, (low, _) in zip(values, alone, strict=True)]
    above = [max(high - value, 0.0) for value, (_, high) in zip(values, alone, strict=True)]
    axes.errorbar(
        places, values, (below, above), fmt="o", color=OBSERVED, markersize=3, capsize=2,
        elinewidth=0.8, label="each impact alone",
    )  # fmt: skip
    axes.set_xlabel("impact speed [m/s]" if has_speed else "bounce")
    if not has_speed:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylabel("restitution")
    least = 0.02 - float(np.ptp([*axes.get_ylim()]))
    if least > 0:  # a scale on which noise would look like a law
        low, high = axes.get_ylim()
        axes.set_ylim(low - least / 2, high + least / 2)
    figure.legend(loc="outside upper right", ncols=2)
    count = len(record.rebounds)
    caption = f"Restitution of {len(rebounds)} impacts, each by itself, with 95 % intervals"
    caption += f" (of {count})" if count > len(rebounds) else ""
    caption += "; the line is the tuned law over speed with its interval." if has_speed else "."
    alt = f"Points of restitution from {min(values):.3f} to {max(values):.3f}"
    alt += f" at {min(places):.2f} to {max(places):.2f} m/s." if has_speed else " by bounce."
    return Drawing("bounces", "Bounce by bounce", caption, alt, figure)


@styled
def iterations_drawing(record: Record) -> Drawing | None:
    """Plot the first parameter over the iterations, with the result's interval.

    None for one step, and without a result: the last of them would look like one.
    """
    steps = record.iterations
    if len(steps) < 2 or not steps[0] or not record.estimates:
        return None
    name = next(iter(steps[0]))
    values = [step[name] for step in steps if name in step]
    figure = new_figure(COLUMN_IN, 2.0)
    axes = figure.subplots()
    known = record.estimate(name)
    if known is not None and known.interval95 is not None and isinstance(known.value, float):
        low, high = known.interval95
        axes.axhspan(low, high, color=BAND, zorder=0.4)  # pyright: ignore[reportArgumentType]
    axes.plot(range(len(values)), values, "o-", color=THIRD, markersize=3.5)
    if record.is_fitted:
        axes.plot(len(values) - 1, values[-1], "D", color=SIMULATED, markersize=5)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    unit = "" if known is None or known.unit == "1" else f" [{known.unit}]"
    axes.set_xlabel("iteration k")
    axes.set_ylabel(drawable(name.replace("_", " ") + unit))
    last = " The diamond is the fit to all samples, the result." if record.is_fitted else ""
    ends = number_words(values[0]), number_words(values[-1])
    caption = f"From the first guess, {ends[0]}, to {ends[1]}.{last}"
    alt = f"{name} by iteration, from {ends[0]} to {ends[1]}."
    return Drawing("iterations", "Iterations", caption, alt, figure)


# ---- Several logs: their curves over each other, their values with intervals.


@styled
def overlay_drawing(comparison: Comparison) -> Drawing | None:
    """Plot observed and simulated heights of several drops from their first impact."""
    pairs = zip(comparison.labels, comparison.records, strict=True)
    numbered = [
        (number, label, record, record.motion.curves)
        for number, (label, record) in enumerate(pairs, 1)
        if record.motion.curves is not None and record.rebounds and record.estimates
    ]
    metres = [one for one in numbered if in_metres(one[2])]
    shown = (metres or numbered)[:14]  # more cannot be told apart
    if len(shown) < 2:
        return None
    figure = new_figure(WIDE_IN, 3.0)
    axes = figure.subplots()
    for place, (number, label, record, curves) in enumerate(shown):
        color = SERIES[place % len(SERIES)]
        pattern = PATTERNS[place // len(SERIES) % len(PATTERNS)]
        part = thinned(len(curves.seconds), 300)
        first_s = (record.window or {}).get("impact_s", record.rebounds[0].impact_s)
        seconds, name = curves.seconds[part] - first_s, f"{number}  {drawable(label)}"
        axes.plot(seconds, curves.observed_m[part], ".", color=color, markersize=2, alpha=0.5)
        line = {"color": color, "linestyle": pattern, "linewidth": 1.0}
        axes.plot(seconds, curves.simulated_m[part], **line, label=name)
    axes.axvline(0, color=MUTED, linewidth=0.5)
    axes.set_xlabel("time from the first impact [s]")
    axes.set_ylabel("height [m]" if metres else "height [drop heights]")
    figure.legend(loc="outside right upper")
    left = len(numbered) - len(shown)
    caption = "Heights from the first impact on: points as observed, lines as tuned."
    caption += f" {left} more drops are not drawn." if left else ""
    labels = ", ".join(f"{number} {label}" for number, label, *_ in shown)
    alt = f"Curves of height over time of {len(shown)} drops: {labels}."
    return Drawing("curves", "Curves over each other", caption, alt, figure)


@styled
def values_drawing(comparison: Comparison, group: ComparedGroup) -> Drawing | None:
    """Plot a group's values with their intervals, a chart each; None for a single log."""
    charts = [one for one in group.quantities if len(one.values) > 1][:6]
    if not charts:
        return None
    labels = group.labels[:40]
    columns = min(3, len(charts))
    rows = -(-len(charts) // columns)
    width_in = WIDE_IN if columns > 1 else COLUMN_IN
    figure = new_figure(width_in, (0.55 + 0.19 * len(labels)) * rows + 0.1)
    grid = np.ravel(figure.subplots(rows, columns, squeeze=False))
    for axes in grid[len(charts) :]:
        axes.set_axis_off()
    numbers = {label: number for number, label in enumerate(comparison.labels, 1)}
    places = {label: place for place, label in enumerate(labels)}
    words: list[str] = []
    for index, (axes, one) in enumerate(zip(grid, charts, strict=False)):
        for value in one.values:
            place = places.get(value.label)
            if place is None:
                continue
            if value.interval95 is not None:
                axes.plot(value.interval95, [place, place], color=SERIES[0], linewidth=1.2)
            is_sure = value.verdict == "ok" and value.interval95 is not None
            dot = {"color": SERIES[0], "markerfacecolor": SERIES[0] if is_sure else "white"}
            axes.plot([value.value], [place], "o", **dot, markersize=4)
        names = [str(numbers[label]) for label in labels]
        if index % columns == 0:
            names = [f"{drawable(label, 22)}  {numbers[label]}" for label in labels]
        _named_rows(axes, names)
        axes.set_title(drawable(quantity(one.name, one.unit)), pad=3)
        values = [value.value for value in one.values]
        ends = f"from {number_words(min(values))} to {number_words(max(values))}"
        words.append(f"{one.name} {ends} in {len(values)} logs")
    caption = "Values with 95 % intervals; hollow: suspect, or without an interval."
    if len(group.labels) > len(labels):
        caption += f" {len(group.labels) - len(labels)} more logs are not drawn."
    return Drawing("values", f"Values: {group.title}", caption, "; ".join(words), figure)


def comparison_drawings(comparison: Comparison) -> list[Drawing]:
    """Make all figures of a comparison, the curves first."""
    drawings = [overlay_drawing(comparison)]
    drawings += [values_drawing(comparison, group) for group in comparison.groups]
    return [drawing for drawing in drawings if drawing is not None]


# ---- Campaign: outcomes, and restitutions by ball.


@styled
def campaign_drawings(campaign: Campaign) -> list[Drawing]:
    """Plot success rates with their intervals, and each ball's restitutions."""
    rates = [
        one
        for one in (*overall_rates(campaign.attempts), *ball_rates(campaign.attempts))
        if one.count
    ][:20]
    balls = restitutions_by_ball(campaign.attempts)[:20]
    drawings: list[Drawing] = []
    if rates:
        figure = new_figure(COLUMN_IN, 0.55 + 0.22 * len(rates))
        axes = figure.subplots()
        for row, rate in enumerate(rates):
            axes.plot([100 * end for end in rate.interval95], [row, row], color=SERIES[2])
            axes.plot([100 * rate.fraction], [row], "o", color=SERIES[2], markersize=4)
            if rate.published is not None:
                axes.plot([100 * rate.published], [row], "|", color=MUTED, markersize=9)
        names = [f"{drawable(rate.name, 22)}  {rate.successes}/{rate.count}" for rate in rates]
        _named_rows(axes, names)
        axes.set_xlim(-2, 102)
        axes.set_xlabel("success [%]")
        caption = "Success with 95 % intervals (Wilson); grey marks: TuneNet's paper."
        alt = "; ".join(f"{rate.name} {100 * rate.fraction:.0f} %" for rate in rates)
        drawings.append(Drawing("outcomes", "Outcomes", caption, alt, figure))
    if balls:
        figure = new_figure(COLUMN_IN, 0.55 + 0.26 * len(balls))
        axes = figure.subplots()
        for row, ball in enumerate(balls):
            count = len(ball.values)
            places = row + 0.3 * (np.arange(count) - (count - 1) / 2) / max(count - 1, 1)
            for place, value, ends in zip(places, ball.values, ball.intervals95, strict=True):
                if ends is not None:
                    axes.plot(ends, [place, place], color=SERIES[1], linewidth=0.9)
                axes.plot([value], [place], "o", color=SERIES[1], markersize=3)
        _named_rows(axes, [drawable(ball.name, 22) for ball in balls])
        axes.set_xlabel("coefficient of restitution")
        caption = "Each drop's restitution with its 95 % interval."
        alt = "; ".join(f"{ball.name} {ball.mean:.4f}" for ball in balls)
        drawings.append(Drawing("balls", "Restitution by ball", caption, alt, figure))
    return drawings


def _named_rows(axes: Axes, names: Sequence[str]) -> None:
    """Name the rows of a chart, the first on top."""
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")


# ---- Filmed ball: a strobe image and single frames, with the track.

# Colours of the found ball and its impacts; the simulated path has the simulated curve's.
_TRACK, _IMPACT = "#ffffff", "#56b4e9"

_STROBES, _MAX_FRAMES = 20, 8  # pictures in the strobe picture; single frames
_FRAME_IN, _TITLE_IN, _TIME_IN = 2.6, 0.17, 0.5  # highest frame; the time above it, and its width
_MIN_PX = 24  # sides of a crop


class _Frame(NamedTuple):
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
    ratio = (box[2] - box[3]) / (box[1] - box[0])
    width_in = min(COLUMN_IN, 4.6 / ratio)  # of the strobe picture
    height_in = width_in * ratio
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
    circles = _circles(film, "circles")
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
    ratio = (box[2] - box[3]) / (box[1] - box[0])
    # Four side by side are still seen on a phone; slim crops stand in one row.
    columns = min(len(frames), 4 if ratio < 4.0 else _MAX_FRAMES)
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
    circles = _circles(film, "with a circle")
    caption = f"Single pictures, {which}{circles}."
    alt = f"Pictures of the recording at {times} s{circles}."
    return Drawing("frames", "Frame by frame", caption, alt, figure, is_photo=True)


def _circles(film: ReviewedFilm, before: str) -> str:
    """Say what the circles mean; "" without any."""
    found = "something was taken for the ball" if film.is_refused else "the ball was found"
    return f", {before} where {found}" if len(film.track_s) else ""


def key_times(film: ReviewedFilm, record: Record) -> Array:
    """Return the first time, impacts and the apexes between; even times without impacts."""
    first_s, last_s = _span(film)
    impacts = [one.impact_s for one in record.rebounds if first_s < one.impact_s < last_s]
    if not impacts:
        return np.linspace(first_s, last_s, _MAX_FRAMES)
    times = [first_s, (first_s + impacts[0]) / 2, impacts[0]]
    for before_s, at_s in zip(impacts, [*impacts[1:], last_s], strict=True):
        times += [(before_s + at_s) / 2, at_s]
    return np.array(times[:_MAX_FRAMES])


def _span(film: ReviewedFilm) -> tuple[float, float]:
    """Return first and last time at which there is something to see."""
    seconds = film.track_s if len(film.track_s) > 1 else film.seconds
    return float(seconds[0]), float(seconds[-1])


def _frames(film: ReviewedFilm, times: Array) -> list[_Frame]:
    """Read the frames nearest to some times, each once, those of equal size that can be read."""
    count = min(len(film.pictures), len(film.seconds))
    if not count:
        return []
    frames: list[_Frame] = []
    for index in sorted({int(np.argmin(np.abs(film.seconds[:count] - at_s))) for at_s in times}):
        with suppress(LogError):
            picture = decode_image(film.pictures[index], "jpeg")
            height, width = picture.shape[:2]
            if frames and (width, height) != frames[0].size_px:
                continue
            at_s = float(film.seconds[index])
            # A figure shows no more pixels.
            frames.append(_Frame(at_s, reduced(picture, 1280), (width, height)))
    return frames


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
    half = (high - low) / 2 + 0.18 * longer  # around the ball's path, of its longer side
    # Wide enough that what a ball falls beside is still seen.
    half[0] = max(half[0], 0.45 * half[1])
    middle = (low + high) / 2
    left, top = np.maximum(middle - half, -0.5).tolist()
    right, bottom = np.minimum(middle + half, (width - 0.5, height - 0.5)).tolist()
    if right - left < _MIN_PX or bottom - top < _MIN_PX:
        return whole
    return left, right, bottom, top


def _show(
    axes: Axes, picture: Picture, size_px: tuple[int, int], box: tuple[float, float, float, float]
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
    usual_s = median_step(film.track_s) if len(film.track_s) > 1 else 0.0
    if abs(float(film.track_s[index]) - at_s) > usual_s:
        return
    center, radius = film.centers_px[index].tolist(), float(film.radii_px[index])
    for color, wider in (("#000000", 1.0), (_TRACK, 0.0)):
        ring = Circle(center, radius, fill=False, color=color, linewidth=thickness + wider)
        axes.add_patch(ring)


# ---- Arm or model: signals with what simulators show in their place, from the review.

# Of each curve its words, and its style.
_CURVES: dict[str, tuple[str, dict[str, Any]]] = {
    "rigid": ("rigid arm with the payload", {"color": SIMULATED}),
    "fitted": ("with friction, offsets and the rest", {"color": THIRD}),
    "given": ("simulated as given", {"color": MUTED, "linestyle": (0, (3, 1.5))}),
    "tuned": ("tuned", {"color": SIMULATED}),
    "closest": ("rejected", {"color": SIMULATED}),
    "predicted": ("predicted by a fit to the rest", {"color": THIRD}),
}
_BAND = 2.0  # standard deviations of the noise that are drawn around no residual


@styled
def signals_drawing(signals: Sequence[ReviewedSignal], more: int) -> Drawing | None:
    """Plot observed and simulated signals, a chart each, of a model with its residual below.

    None without any; `more` are not among them.
    """
    if not signals:
        return None
    is_arm = all("rigid" in one.curves for one in signals)
    rows, columns = -(-len(signals) // 2), min(2, len(signals))
    shares = [1.0] if is_arm else [1.0, 0.5]  # heights of a signal's charts
    heights = shares * rows
    figure = new_figure(WIDE_IN, 1.15 * sum(heights) + 0.5)
    grid: Any = figure.subplots(
        len(heights), columns, squeeze=False, sharex="all" if is_arm else "none",
        height_ratios=heights,
    )  # fmt: skip
    for axes in grid.flat:
        axes.set_axis_off()
    lines: dict[str, Any] = {}
    for number, one in enumerate(signals):
        row, column = divmod(number, columns)
        charts = grid[len(shares) * row : len(shares) * (row + 1), column]
        for axes in charts:
            axes.set_axis_on()
        part = thinned(len(one.seconds), 250)
        lines |= _signal(charts[0], one, part)
        if not is_arm:
            lines |= _residual(charts[1], one, part)
            charts[0].xaxis.set_tick_params(labelbottom=False)
            charts[1].set_xlim(charts[0].get_xlim())
        if is_arm and number + columns >= len(signals):
            charts[0].xaxis.set_tick_params(labelbottom=True)
    figure.supxlabel("time [s]", fontsize=8)
    figure.align_ylabels()
    figure.legend(lines.values(), lines, loc="outside upper right", ncols=3)
    spans = ", ".join(
        f"{one.name} {np.nanmin(one.observed):.3g} to {np.nanmax(one.observed):.3g}"
        + f" {one.unit}".rstrip()
        for one in signals
    )
    if is_arm:
        caption = (
            f"Torques of {len(signals)} joints that the payload is felt in or that were measured: "
            "dots as measured, one line for the rigid arm with the tuned payload"
        )
        has_rest = any("fitted" in one.curves for one in signals)
        caption += ", one for all that was fitted." if has_rest else "."
        alt = f"A chart for each joint of torque over time. Measured: {spans}."
        return Drawing("torques", "Measured and simulated torques", caption, alt, figure)
    caption = "Signals, that first of which most is left, with what is simulated less observed."
    if more > 0:
        caption += f" {more} more, of which less is left, are not drawn."
    if held := [one for one in signals if np.isfinite(one.held_out_s)]:
        caption += (
            " Shaded is what was held out: its prediction is fitted to the rest, and saw of it no "
            "more than where a piece begins"
        )
        caption += "; what is tuned saw it." if any("tuned" in one.curves for one in held) else "."
    if any(np.isfinite(one.noise) for one in signals):
        caption += f" The band is ± {_BAND:g} standard deviations of the signal's own noise."
    if unknown := [one.name for one in signals if not np.isfinite(one.noise)]:
        caption += f" None where what moves is as fast as noise: {', '.join(unknown)}."
    alt = f"Two charts for each signal, its values over time and the residual. Observed: {spans}."
    return Drawing("signals", "Observed and simulated", caption, alt, figure)


def _signal(axes: Axes, one: ReviewedSignal, part: slice) -> dict[str, Any]:
    """Plot a signal; return its lines by their names."""
    seconds, is_arm = one.seconds[part], "rigid" in one.curves
    dots = {"color": OBSERVED, "markersize": 1.8}
    lines = {
        "measured" if is_arm else "observed": axes.plot(seconds, one.observed[part], ".", **dots)[0]
    }
    shown = [one.observed[part]]
    for name, values in one.curves.items():
        if name in _CURVES:
            said, style = _CURVES[name]
            lines[said] = axes.plot(seconds, values[part], linewidth=0.9, **style)[0]
            shown += [values[part]] if name != "given" else []
    unit = f" [{drawable(one.unit, 12)}]" if one.unit else ""
    axes.set_title(f"{drawable(one.name, 34)}{unit}", pad=2)
    if "given" in one.curves:  # it may run off
        known = np.concatenate(shown)
        low, high = np.nanmin(known), np.nanmax(known)
        reach = max(high - low, 4.0 * np.nan_to_num(one.noise), 1e-9)
        given = np.clip(one.curves["given"][part], low - 0.5 * reach, high + 0.5 * reach)
        low, high = np.nanmin([low, *given]), np.nanmax([high, *given])
        axes.set_ylim(low - 0.05 * reach, high + 0.05 * reach)
    _shade(axes, one)
    return lines


def _residual(axes: Axes, one: ReviewedSignal, part: slice) -> dict[str, Any]:
    """Plot what is simulated less observed over the band of noise; return the band by its name."""
    lines: dict[str, Any] = {}
    usual = [_BAND * np.nan_to_num(one.noise), 1e-9]
    if np.isfinite(one.noise):
        band = axes.axhspan(-_BAND * one.noise, _BAND * one.noise, color=BAND, zorder=0.4)
        lines["noise"] = band
    for name in ("tuned", "closest", "predicted"):
        if name in one.curves:
            off = one.curves[name][part] - one.observed[part]
            axes.plot(one.seconds[part], off, linewidth=0.7, color=_CURVES[name][1]["color"])
            known = np.abs(off[np.isfinite(off)])
            usual += [float(np.quantile(known, 0.98))] if len(known) else []
    axes.set_ylim(-1.3 * max(usual), 1.3 * max(usual))
    axes.yaxis.set_major_locator(MaxNLocator(2, symmetric=True))
    _shade(axes, one)
    return lines


def _shade(axes: Axes, one: ReviewedSignal) -> None:
    """Shade what was held out."""
    if np.isfinite(one.held_out_s):
        axes.axvspan(one.held_out_s, one.seconds[-1], color=THIRD, alpha=0.07, linewidth=0)
