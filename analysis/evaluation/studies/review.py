"""Plot the paper's figure in Rerun: error against rollouts, a view for Easy and one for Hard.

Rerun's plots have no logarithmic axis, so what is plotted is log10 of the error, and the views are
named so.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from tunenet_logs.analysis.evaluation.studies.drop_methods import (
    PANELS,
    DropResults,
    ErrorCurve,
    error_curves,
)
from tunenet_logs.analysis.review.drawing import entity_of, log_words, written

ROLLOUTS = "rollouts"  # its timeline: what a method has been allowed so far


def write_convergence(results: DropResults, markdown: str, path: Path) -> None:
    """Write the recording of an experiment, with its tables, to `path` (.rrd).

    Raises:
        OSError: `path` cannot be written.
    """
    content = f"{results.seeds} {results.targets}".encode()
    content += b"".join(
        outcome.method.encode() + outcome.errors.tobytes() for outcome in results.outcomes
    )
    identity = hashlib.sha256(content).hexdigest()[:16]
    with written(path, "eval drop", identity, "restitution by rollouts") as stream:
        views: list[rrb.View] = []
        for panel in PANELS:
            curves = error_curves(results, panel)
            if not curves:
                continue
            for curve in curves:
                _log_curve(stream, panel, curve)
            lowest = min(float(curve.mean.min()) for curve in curves)
            longest = max(len(curve.mean) - 1 for curve in curves)
            # half as long again as the curves: the legend stands beside them
            start, end = (rr.TimeRangeBoundary.absolute(seq=at) for at in (0, round(1.5 * longest)))
            view = rrb.TimeSeriesView(
                origin=entity_of("error", panel),
                name=f"GT {panel}: log10 of the mean absolute error, by rollouts",
                axis_x=rrb.TimeAxis(
                    link="Independent", view_range=rr.TimeRange(start=start, end=end)
                ),
                axis_y=rrb.ScalarAxis(range=(float(np.log10(lowest)) - 0.3, 0.0)),
                plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
            )
            views.append(view)
        log_words(stream, "results", markdown)
        words = rrb.TextDocumentView(origin="/results", name="results")
        plots = rrb.Horizontal(*views)
        blueprint = rrb.Blueprint(
            rrb.Vertical(plots, words, row_shares=[3, 2]) if views else words,
            rrb.BlueprintPanel(state="hidden"),
            rrb.SelectionPanel(state="hidden"),
            rrb.TimePanel(state="collapsed", timeline=ROLLOUTS),
            auto_views=False,
            auto_layout=False,
        )
        stream.send_blueprint(blueprint)


def _log_curve(stream: rr.RecordingStream, panel: str, curve: ErrorCurve) -> None:
    entity = entity_of("error", panel, curve.method)
    width = 3.5 if curve.is_ours else 1.8
    lines = rr.SeriesLines(
        colors=[curve.color], names=[curve.label], widths=[width], aggregation_policy="Off"
    )
    stream.log(entity, lines, static=True)
    _send(stream, entity, curve.rollouts, curve.mean)
    if curve.paper:
        marks = entity_of("error", panel, f"{curve.method} published")
        points = rr.SeriesPoints(
            colors=[curve.color],
            names=[f"{curve.label} (paper)"],
            markers=["diamond"],
            marker_sizes=[5.0],
        )
        stream.log(marks, points, static=True)
        rollouts, errors = np.array(curve.paper).T
        _send(stream, marks, rollouts, errors)


def _send(
    stream: rr.RecordingStream, entity: str, rollouts: np.ndarray, errors: np.ndarray
) -> None:
    index = rr.TimeColumn(ROLLOUTS, sequence=rollouts.astype(np.int64))
    stream.send_columns(
        entity, indexes=[index], columns=rr.Scalars.columns(scalars=np.log10(errors))
    )
