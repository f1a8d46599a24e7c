"""What is in the torques beside the payload, and which joints feel the payload."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.model_averaging import TWO_SIDED
from analysis.payload.fit_result import Nuisance, PayloadFit
from analysis.payload.review.story import PayloadReviewData
from analysis.review.colors import FITTED
from analysis.review.grid import WIDTH, chart_view, filled, log_grid, mixed, ticks
from analysis.review.sending import screen_radius
from tunenet_logs.arrays import Array

_PRIOR = (70, 74, 86)
_CAP = 0.015
_HEADROOM = 1.1
_MOST_MARKS = 16
_SMALLEST = 1e-3
"""Of the highest bar: a lower one is none."""
_BAR = 0.3
"""Half a bar's width, of a joint's place."""


@dataclass(frozen=True)
class _Chart:
    """Terms of one kind, one a joint or more.

    Attributes:
        endings: of their names, before the joint's number.
        title: with the unit.
        scale: from the fit's unit to the chart's.
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


def log_terms(stream: rr.RecordingStream, story: PayloadReviewData) -> None:
    """Send the entities of `term_views`."""
    _log_felt(stream, story)
    if story.fit is not None:
        words = rr.TextDocument(_words(story.fit), media_type="text/markdown")
        stream.log("terms", words, static=True)
    for number, (chart, terms) in enumerate(_filled_charts(story.fit)):
        _log_chart(stream, f"sheets/terms_{number}", chart, terms)


def term_views(story: PayloadReviewData) -> list[rrb.View]:
    """A chart for each kind of term, by joint; first what a kilogram does to each joint."""
    felt = "what 1 kg does, dots: what is left [N·m]"
    if story.fitted is None:
        felt = "what 1 kg does to each joint [N·m]"
    charts = [
        chart_view(f"terms_{number}", chart.title)
        for number, (chart, _) in enumerate(_filled_charts(story.fit))
    ]
    words = [rrb.TextDocumentView(origin="/terms", name="in words")] if story.fit else []
    return [chart_view("felt", felt), *words, *charts]


def _words(fit: PayloadFit) -> str:
    """What no chart shows."""
    whose = "the joint's own" if fit.convention.sign > 0 else "the load's (the sign is turned)"
    weight = "with" if fit.convention.has_gravity else "without"
    lines = [
        "Dots and bars: by the log, 95 %. Boxes: before it, 95 %.",
        f"The driver's torques are {whose}, {weight} the arm's weight in them; this leads by a "
        f"log evidence of {fit.convention_odds:.0f}.",
        f"{_sentence(fit.told_apart)}.",
    ]
    lags = [
        f"{one.name} {round(1000 * one.value)} ± {1000 * TWO_SIDED * one.sd:.0f} ms"
        for one in fit.nuisances
        if one.group == "lag"
    ]
    lines.append(f"Torques behind positions: {', '.join(lags)}.")
    lines.append(
        f"Standard deviation of the mass: {fit.sd_kg:.4f} kg; the least that such torques allow: "
        f"{fit.bound_kg:.4f} kg."
    )
    return "\n\n".join(lines)


def _sentence(words: str) -> str:
    return words[:1].upper() + words[1:]


def _filled_charts(fit: PayloadFit | None) -> list[tuple[_Chart, list[list[Nuisance]]]]:
    """Those of which a fit has terms, with these, a list an ending."""
    named = [(one.name.rpartition(" ")[0], one) for one in (fit.nuisances if fit else ())]
    found = [
        (chart, [[one for name, one in named if name == ending] for ending in chart.endings])
        for chart in _CHARTS
    ]
    return [(chart, terms) for chart, terms in found if all(terms)]


def _log_chart(
    stream: rr.RecordingStream, sheet: str, chart: _Chart, terms: list[list[Nuisance]]
) -> None:
    numbers = [[(one.value, one.sd, one.prior_sd) for one in some] for some in terms]
    values, sds, priors = chart.scale * np.moveaxis(np.array(numbers), -1, 0)
    ends = TWO_SIDED * np.array([-sds, sds]) + values
    reach = _HEADROOM * max(float(np.abs(ends).max()), TWO_SIDED * float(priors.max()), 1e-9)

    def up(value: Array | float) -> Array:
        return -0.5 - np.asarray(value) / (2 * reach)

    count = len(terms[0])
    x, marks = _places(count)
    rows = [(float(up(value)), f"{value:g}") for value in ticks(-reach, reach, 4)]
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
    low, high = (up(one).ravel() for one in ends)
    cap = min(_CAP, half / len(terms))
    strips = [
        strip
        for place in zip(across.tolist(), low.tolist(), high.tolist(), strict=True)
        for strip in _bar(*place, cap)
    ]
    bars = rr.LineStrips2D(strips, colors=[FITTED], radii=screen_radius(0.9))
    stream.log(f"{sheet}/intervals", bars, static=True)
    dots = rr.Points2D(
        np.column_stack([across, up(values).ravel()]),
        colors=[FITTED],
        radii=screen_radius(3.5 if len(terms) == 1 else 2.5),
        draw_order=40.0,
    )
    stream.log(f"{sheet}/values", dots, static=True)


def _log_felt(stream: rr.RecordingStream, story: PayloadReviewData) -> None:
    felt = story.felt_nm_per_kg
    x, marks = _places(len(felt))
    top = _HEADROOM * max(float(felt.max()), 1e-9)
    rows = [(-value / top, f"{value:g}") for value in ticks(0.0, top, 4)]
    log_grid(stream, "sheets/felt", WIDTH, rows, marks)
    half = _BAR * WIDTH / len(felt)
    slabs = [
        filled(at - half, at + half, -value / top, 0.0)
        for at, value in zip(x, felt, strict=True)
        if value > _SMALLEST * top
    ]
    bars = rr.LineStrips2D(
        [strip for strips, _ in slabs for strip in strips],
        colors=[mixed(story.result.color, 0.6)],
        radii=[radius for strips, radius in slabs for _ in strips],
        draw_order=10.0,
    )
    stream.log("sheets/felt/values", bars, static=True)
    if story.fitted is not None:
        left = np.sqrt(np.mean((story.fitted.effort_nm - story.observed_nm) ** 2, axis=0))
        dots = rr.Points2D(
            np.column_stack([x, -np.minimum(left / top, 1.0)]),
            colors=[FITTED],
            radii=screen_radius(4.0),
            draw_order=40.0,
        )
        stream.log("sheets/felt/left", dots, static=True)


def _places(count: int) -> tuple[Array, list[tuple[float, str]]]:
    """Across, for each joint; and the marks below."""
    x = (np.arange(count) + 0.5) / count * WIDTH
    every = -(-count // _MOST_MARKS)
    return x, [(float(x[index]), str(index + 1)) for index in range(0, count, every)]


def _bar(x: float, low: float, high: float, cap: float) -> list[list[list[float]]]:
    caps = [[[x - cap, y], [x + cap, y]] for y in (low, high)]
    return [[[x, low], [x, high]], *caps]
