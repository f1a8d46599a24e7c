"""Figures of a drop, from its record alone: heights, bounces, iterations."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from analysis.motion import Curves
from analysis.record import Record
from analysis.report.style import (
    BAND,
    COLUMN_IN,
    MUTED,
    OBSERVED,
    SIMULATED,
    THIRD,
    Drawing,
    drawable,
    mark_impacts,
    new_figure,
    styled,
)
from analysis.speed_transport import ComparedValue, moved, restitution_value
from tunenet_logs.arrays import Array

# Samples drawn of one curve: more cannot be told apart in a column, and make a page large.
_MAX_POINTS = 700

_MAX_BOUNCES = 60

_MM = 1000.0


def in_metres(record: Record) -> bool:
    """Return whether heights are in metres; else in drop heights, for want of a scale."""
    return "drag" not in record.motion.unknown


def thinned(count: int, most: int = _MAX_POINTS) -> slice:
    """Return a slice that decimates so many samples to at most `most`."""
    return slice(None, None, max(1, -(-count // most)))


@styled
def curves_drawing(record: Record) -> Drawing | None:
    """Plot observed and simulated heights, and the residual; None without curves."""
    curves = record.motion.curves
    if curves is None:
        return None
    unit = "m" if in_metres(record) else "drop heights"
    part = thinned(len(curves.seconds))
    figure = new_figure(COLUMN_IN, 2.9)
    _draw_curves(figure, record, curves, part, unit)
    fit = record.motion.fit
    span_s = float(curves.seconds[-1] - curves.seconds[0])
    caption = f"Height over the table at the recording's own {len(curves.seconds)} samples"
    if part.step and part.step > 1:
        caption += f" (every {part.step}th is drawn)"
    caption += "; below, what the simulated ball is higher by."
    if fit is not None:
        caption += (
            f" Apart by {fit.rms_percent:.2f} % of the drop height, rms, of which the noise of the "
            f"observation makes {fit.noise_percent:.2f} %; at worst {fit.worst_percent:.2f} %."
        )
    alt = f"Two curves of height over {span_s:.2f} s: observed points and the simulated line"
    if fit is not None:
        alt += f", {fit.rms_percent:.2f} % of the drop height apart, rms"
    return Drawing("curves", "Observed and simulated", caption, alt + ".", figure)


def _draw_curves(figure: Figure, record: Record, curves: Curves, part: slice, unit: str) -> None:
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1.2])
    seconds = curves.seconds[part]
    observed, simulated = curves.observed_m[part], curves.simulated_m[part]
    upper.plot(seconds, observed, ".", color=OBSERVED, markersize=2.6, label="observed")
    upper.plot(seconds, simulated, color=SIMULATED, linewidth=1.1, label="simulated")
    impacts = [one.impact_s for one in record.rebounds[:_MAX_BOUNCES]]
    inside = [at_s for at_s in impacts if curves.seconds[0] <= at_s <= curves.seconds[-1]]
    for axes in (upper, lower):
        mark_impacts(axes, inside)
    upper.set_ylabel(f"height [{unit}]")
    upper.set_ylim(bottom=min(0.0, _least(observed)) - 0.03 * _span(observed))
    figure.legend(loc="outside upper right", ncols=2)
    factor, small = (_MM, "mm") if unit == "m" else (100.0, "%")
    off = factor * (simulated - observed)
    lower.axhline(0, color=MUTED, linewidth=0.5)
    lower.plot(seconds, off, color=THIRD, linewidth=0.7)
    known = np.abs(off[np.isfinite(off)])
    reach = 1.4 * float(np.quantile(known, 0.98)) if len(known) else 1.0
    lower.set_ylim(-max(reach, 1e-3), max(reach, 1e-3))
    lower.set_ylabel(f"sim. − obs.\n[{small}]")
    lower.set_xlabel("time [s]")


def _least(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.min()) if len(known) else 0.0


def _span(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.ptp(known)) if len(known) else 1.0


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
    if has_speed:
        _draw_law(figure, record, np.array(places))
    values = [one.restitution for one in rebounds]
    ends = [one.interval95 or (one.restitution, one.restitution) for one in rebounds]
    below = [max(value - low, 0.0) for value, (low, _) in zip(values, ends, strict=True)]
    above = [max(high - value, 0.0) for value, (_, high) in zip(values, ends, strict=True)]
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


def _draw_law(figure: Figure, record: Record, speeds_m_s: Array) -> None:
    """Plot e (v / v_1)^-p; its band has e's own error at its speed and p's beside it."""
    tuned = record.estimate("restitution")
    assert tuned is not None
    assert isinstance(tuned.value, float)
    ends = tuned.interval95
    value = restitution_value(
        ComparedValue("", tuned.value, ends, record.verdict),  # pyright: ignore[reportArgumentType]
        record,
    )
    if value.slope is None or value.speed_m_s is None:
        return
    at_m_s = np.linspace(speeds_m_s.min(), speeds_m_s.max(), 60)
    axes = figure.axes[0]
    along = [moved(value, float(one)) for one in at_m_s] if value.slope_half is not None else []
    if along and value.interval95 is not None:
        lows, highs = zip(*(one.interval95 or (0.0, 0.0) for one in along), strict=True)
        axes.fill_between(at_m_s, lows, highs, color=SIMULATED, alpha=0.18, linewidth=0)
    law = value.value * (at_m_s / value.speed_m_s) ** -value.slope
    axes.plot(at_m_s, law, color=SIMULATED, label="tuned law")


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
    caption = f"From the first guess, {values[0]:.4f}, to {values[-1]:.4f}.{last}"
    alt = f"{name} by iteration, from {values[0]:.4f} to {values[-1]:.4f}."
    return Drawing("iterations", "Iterations", caption, alt, figure)
