"""Charts of the nuisance terms, and of how much each joint feels the payload."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.payload.fit_result import Nuisance, PayloadFit
from analysis.payload.review.review_data import PayloadReviewData
from analysis.review.drawing import (
    FITTED,
    WIDTH,
    chart_view,
    filled,
    log_grid,
    mixed,
    screen_radius,
    ticks,
)
from analysis.statistics import TWO_SIDED
from tunenet_logs.arrays import Array

_PRIOR = (70, 74, 86)  # a grey behind the values: how large such terms usually are
_CAP = 0.015  # half the width of an interval's ends, in heights of a chart
_HEADROOM = 1.1  # of a chart's axis, over the largest value
_MAX_MARKS = 16  # numbers of joints below a chart: more would overlap
_MIN_SIZE = 1e-3  # of the highest bar: a lower one is none
_BAR = 0.3  # half a bar's width, of the width that a joint has


@dataclass(frozen=True)
class _Chart:
    """Chart of terms of one kind, one per joint or more.

    Attributes:
        endings: Of their names, before the joint's number.
        title: With the unit.
        scale: From the fit's unit to the chart's.
    """

    endings: tuple[str, ...]
    title: str
    scale: float = 1.0


_CHARTS = (
    _Chart(("offset of joint",), "offset by joint [N·m]"),
    _Chart(("viscous friction of joint",), "viscous friction by joint [N·m s/rad]"),
    _Chart(("dry friction of joint",), "dry friction by joint [N·m]"),
    _Chart(("gain of joint",), "gain error by joint [%]", 100.0),
    _Chart(("mass of link",), "link heavier than the model's [%]", 100.0),
    _Chart(
        tuple(f"centre {axis} of link" for axis in "xyz"),
        "link's centre off the model's, x y z [mm]",
        1000.0,
    ),
    _Chart(("drift of joint",), "drift of the zero since the tare [N·m]"),
)


def log_terms(stream: rr.RecordingStream, data: PayloadReviewData) -> list[rrb.View]:
    """Log a chart by joint of the torque per kilogram, and of each kind of term."""
    _log_felt(stream, data)
    felt = "what 1 kg does, dots: what is left [N·m]"
    if data.fitted is None:
        felt = "what 1 kg does to each joint [N·m]"
    views: list[rrb.View] = [chart_view("felt", felt)]
    if data.fit is not None:
        words = rr.TextDocument(_words(data.fit), media_type="text/markdown")
        stream.log("terms", words, static=True)
        views.append(rrb.TextDocumentView(origin="/terms", name="in words"))
    named = [
        (term.name.rpartition(" ")[0], term) for term in (data.fit.nuisances if data.fit else ())
    ]
    number = 0
    for chart in _CHARTS:
        terms = [[term for name, term in named if name == ending] for ending in chart.endings]
        if all(terms):
            _log_chart(stream, f"sheets/terms_{number}", chart, terms)
            views.append(chart_view(f"terms_{number}", chart.title))
            number += 1
    return views


def _words(fit: PayloadFit) -> str:
    """Describe what no chart shows."""
    whose = "the joint's own" if fit.convention.sign > 0 else "the load's (the sign is turned)"
    sentence = fit.identifiability[:1].upper() + fit.identifiability[1:]
    weight = "with" if fit.convention.has_gravity else "without"
    lines = [
        "Dots and bars: by the log, 95 %. Boxes: before it, 95 %.",
        f"The driver's torques are {whose}, {weight} the arm's weight in them; this leads by a "
        f"log evidence of {fit.convention_odds:.0f}.",
        f"{sentence}.",
    ]
    lags = [
        f"{term.name} {round(1000 * term.value)} ± {1000 * TWO_SIDED * term.sd:.0f} ms"
        for term in fit.nuisances
        if term.group == "lag"
    ]
    lines.append(f"Torques behind positions: {', '.join(lags)}.")
    lines.append(
        f"Standard deviation of the mass: {fit.held.sd_kg:.4f} kg; the least that such torques "
        f"allow: {fit.bound_kg:.4f} kg."
    )
    return "\n\n".join(lines)


def _log_chart(
    stream: rr.RecordingStream, sheet: str, chart: _Chart, terms: list[list[Nuisance]]
) -> None:
    """Log each term with its 95 % interval over that of its prior."""
    numbers = [[(term.value, term.sd, term.prior_sd) for term in row] for row in terms]
    values, sds, priors = chart.scale * np.moveaxis(np.array(numbers), -1, 0)
    ends = TWO_SIDED * np.array([-sds, sds]) + values
    reach = _HEADROOM * max(float(np.abs(ends).max()), TWO_SIDED * float(priors.max()), 1e-9)
    count = len(terms[0])
    x, marks = _joint_marks(count)
    rows = [(-0.5 - value / (2 * reach), f"{value:g}") for value in ticks(-reach, reach, 2)]
    log_grid(stream, sheet, WIDTH, rows, marks)
    half = _BAR * WIDTH / count
    boxes = rr.Boxes2D(
        centers=np.column_stack([x, np.full(count, -0.5)]),
        half_sizes=np.column_stack([np.full(count, half), TWO_SIDED * priors[0] / (2 * reach)]),
        colors=[_PRIOR],
        radii=screen_radius(0.6),
    )
    stream.log(f"{sheet}/prior", boxes, static=True)
    aside = (np.arange(len(terms)) - (len(terms) - 1) / 2) * 2 * half / len(terms)
    across = (x + aside[:, None]).ravel()
    low, high = (-0.5 - ends / (2 * reach)).reshape(2, -1)
    cap = min(_CAP, half / len(terms))
    strips = []
    for at, bottom, top in zip(across.tolist(), low.tolist(), high.tolist(), strict=True):
        strips.append([[at, bottom], [at, top]])
        strips += [[[at - cap, end], [at + cap, end]] for end in (bottom, top)]
    bars = rr.LineStrips2D(strips, colors=[FITTED], radii=screen_radius(0.9))
    stream.log(f"{sheet}/intervals", bars, static=True)
    dots = rr.Points2D(
        np.column_stack([across, -0.5 - values.ravel() / (2 * reach)]),
        colors=[FITTED],
        radii=screen_radius(3.5 if len(terms) == 1 else 2.5),
        draw_order=40.0,
    )
    stream.log(f"{sheet}/values", dots, static=True)


def _log_felt(stream: rr.RecordingStream, data: PayloadReviewData) -> None:
    """Log the torque per kilogram of each joint as bars, the fit's residual as dots."""
    felt = data.felt_nm_per_kg
    x, marks = _joint_marks(len(felt))
    top = _HEADROOM * max(float(felt.max()), 1e-9)
    rows = [(-value / top, f"{value:g}") for value in ticks(0.0, top, 2)]
    log_grid(stream, "sheets/felt", WIDTH, rows, marks)
    half = _BAR * WIDTH / len(felt)
    slabs = [
        filled(at - half, at + half, -value / top, 0.0)
        for at, value in zip(x, felt, strict=True)
        if value > _MIN_SIZE * top
    ]
    bars = rr.LineStrips2D(
        [strip for strips, _ in slabs for strip in strips],
        colors=[mixed(data.result.color, 0.6)],
        radii=[radius for strips, radius in slabs for _ in strips],
        draw_order=10.0,
    )
    stream.log("sheets/felt/values", bars, static=True)
    if data.fitted is not None:
        rms_nm = np.sqrt(np.mean((data.fitted.effort_nm - data.observed_nm) ** 2, axis=0))
        dots = rr.Points2D(
            np.column_stack([x, -np.minimum(rms_nm / top, 1.0)]),
            colors=[FITTED],
            radii=screen_radius(4.0),
            draw_order=40.0,
        )
        stream.log("sheets/felt/left", dots, static=True)


def _joint_marks(count: int) -> tuple[Array, list[tuple[float, str]]]:
    """Return positions across a chart, shape (J,), and the marks below."""
    x = (np.arange(count) + 0.5) / count * WIDTH
    every = -(-count // _MAX_MARKS)
    return x, [(float(x[index]), str(index + 1)) for index in range(0, count, every)]
