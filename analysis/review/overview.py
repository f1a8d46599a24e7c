"""Overview of a ledger in Rerun: estimates with their intervals, outliers, reasons.

Each timeline is an order of the logs: as tuned, by an estimate, by its uncertainty. Choosing one
sorts the curves; the table has its own choice, in the selection panel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from analysis.review.drawing import application_id
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import one_line

Columns = Mapping[str, Sequence[Any]]

_ORDER = "as_tuned"  # the timeline of the logs as they were tuned
_COLOURS = {"ok": (80, 200, 120), "suspect": (240, 170, 50), "rejected": (230, 80, 80)}
_KEY = "green ok, amber suspect, red rejected, grey 95 %, pink unlike the others"
_OUTLIER, _END = (255, 60, 200), (130, 130, 150)

_TABLES = ("table/log", "table/numbers")  # entities of the table's columns, from left to right
_LOG_HEAD = "name_of_the_log_file"
# Rerun makes a column as wide as its head.
_TOLD_HEADS = {
    "verdict": "verdict_of_it",
    "reason": "reason_of_the_verdict",
    "error": "error_in_short",
}

_DECIMALS = 5  # of figures in the table: more do not fit
_FAR = 5.0  # robust standard deviations from the median: such an estimate is pointed at
_MIN_COUNT = 8  # estimates that tell what is unlike them
_MAX_SHOWN = 6  # estimates with a view of their own
_WIDE = 10  # largest intervals by name, in the text


def write_overview(columns: Columns, path: Path) -> None:
    """Write the overview of a ledger as a Rerun recording.

    Args:
        columns: The ledger's, all of one length: "log", "verdict", "reason", and for each estimate
            its value and the ends of its interval, `NAME_low` and `NAME_high`.
        path: Of the recording.
    """
    verdicts = np.array([str(one) for one in columns["verdict"]])
    logs = [one_line(Path(str(one)).name) for one in columns["log"]]
    values = {name: _numbers(columns[name]) for name in _estimates(columns)}
    names = [name for name, its in values.items() if np.isfinite(its).any()][:_MAX_SHOWN]
    values = {name: values[name] for name in names}
    orders = _orders(columns, values, len(logs))
    outliers = {name: _unlike(values[name]) for name in names}
    recording = rr.RecordingStream(application_id("overview"), recording_id="overview")
    memory = recording.memory_recording()  # its own file sink waits for ever on a full disk
    for name in names:
        _draw(recording, name, columns, verdicts, outliers[name], orders)
    excess = _numbers(columns.get("fit_excess_percent", ()))
    is_known = np.isfinite(excess)
    _points(recording, "fit/excess_percent", excess, is_known, _END, orders)
    recording.send_blueprint(_blueprint(names, has_fit=bool(is_known.any())))
    _table(recording, columns, names, logs, orders)
    text = _words(logs, columns, verdicts, values, outliers)
    document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
    recording.log("summary", document, static=True)
    recording.flush()
    path.write_bytes(memory.drain_as_bytes())
    recording.disconnect()


def _estimates(columns: Columns) -> list[str]:
    """List the estimates that have intervals, those of most logs first."""
    names = [name for name in columns if f"{name}_low" in columns]
    counts = {name: sum(one is not None for one in columns[name]) for name in names}
    return sorted(names, key=lambda name: -counts[name])


def _orders(columns: Columns, values: Mapping[str, Array], count: int) -> dict[str, NDArray[Any]]:
    """Return the rank of each log by the name of the order."""
    keys: dict[str, Array] = {}
    for name, its in values.items():
        keys[f"by_{name}"] = its
        ends = _numbers(columns[f"{name}_high"]) - _numbers(columns[f"{name}_low"])
        keys[f"by_{name}_interval"] = ends
    if "fit_excess_percent" in columns:
        keys["by_fit_excess"] = _numbers(columns["fit_excess_percent"])
    orders: dict[str, NDArray[Any]] = {_ORDER: np.arange(count)}
    for name, key in keys.items():
        places = np.empty(count, np.int64)
        places[np.argsort(key, kind="stable")] = np.arange(count)  # those without a value are last
        orders[name] = places
    return orders


def _unlike(values: Array) -> NDArray[np.bool_]:
    """Return which values are outliers by the median absolute deviation."""
    known = values[np.isfinite(values)]
    if len(known) < _MIN_COUNT:
        return np.zeros(len(values), bool)
    middle = np.median(known)
    spread = 1.4826 * np.median(np.abs(known - middle))
    with np.errstate(invalid="ignore"):
        return np.abs(values - middle) > _FAR * max(float(spread), 1e-12)


def _draw(
    recording: rr.RecordingStream,
    name: str,
    columns: Columns,
    verdicts: NDArray[Any],
    outliers: NDArray[np.bool_],
    orders: Mapping[str, NDArray[Any]],
) -> None:
    """Log one estimate of all logs: points by verdict, ends of intervals, outliers."""
    values = _numbers(columns[name])
    for end in ("low", "high"):
        ends = _numbers(columns[f"{name}_{end}"])
        _points(recording, f"{name}/{end}", ends, np.isfinite(ends), _END, orders, size=1.0)
    for verdict, colour in _COLOURS.items():
        there = np.isfinite(values) & (verdicts == verdict)
        _points(recording, f"{name}/{verdict}", values, there, colour, orders)
    _points(recording, f"{name}/unlike_others", values, outliers, _OUTLIER, orders, size=5.0)


def _points(
    recording: rr.RecordingStream,
    entity: str,
    values: Array,
    there: NDArray[np.bool_],
    colour: tuple[int, int, int],
    orders: Mapping[str, NDArray[Any]],
    size: float = 2.0,
) -> None:
    if not np.any(there):
        return
    style = rr.SeriesPoints(colors=colour, markers="circle", marker_sizes=size, names=entity)
    recording.log(entity, style, static=True)
    recording.send_columns(entity, _times(orders, there), rr.Scalars.columns(scalars=values[there]))


def _times(orders: Mapping[str, NDArray[Any]], there: NDArray[np.bool_]) -> list[rr.TimeColumn]:
    return [rr.TimeColumn(name, sequence=places[there]) for name, places in orders.items()]


def _table(
    recording: rr.RecordingStream,
    columns: Columns,
    names: Sequence[str],
    logs: Sequence[str],
    orders: Mapping[str, NDArray[Any]],
) -> None:
    """Send a table row per log: its identity, then its figures."""
    times = _times(orders, np.ones(len(logs), bool))
    told: dict[str, Any] = {_LOG_HEAD: list(logs)}
    for name, head in _TOLD_HEADS.items():
        if name in columns:
            told[head] = ["" if one is None else one_line(one) for one in columns[name]]
    recording.send_columns(_TABLES[0], times, rr.AnyValues.columns(**told))
    ends = [f"{name}_{end}" for name in names for end in ("low", "high")]
    wanted = (*names, *ends, "fit_excess_percent", "seconds")
    figures: dict[str, Any] = {
        f"{name}_value" if name in names else name: np.round(_numbers(columns[name]), _DECIMALS)
        for name in wanted
        if name in columns
    }
    if figures:
        recording.send_columns(_TABLES[1], times, rr.AnyValues.columns(**figures))


def _words(
    logs: Sequence[str],
    columns: Columns,
    verdicts: NDArray[Any],
    values: Mapping[str, Array],
    outliers: Mapping[str, NDArray[np.bool_]],
) -> str:
    """Describe the ledger: counts, outliers, largest uncertainties."""
    counts = ", ".join(f"{_count(verdicts, one)} {one}" for one in _COLOURS)
    lines = [f"# {len(logs)} logs", "", f"{counts}.", "", f"Curves: {_KEY}."]
    for name, its in values.items():
        known = its[np.isfinite(its)]
        if not len(known):
            continue
        low, middle, high = np.percentile(known, (5, 50, 95))
        lines += ["", f"## {name}", "", f"median {middle:.4g}; 90 % from {low:.4g} to {high:.4g}"]
        which = np.flatnonzero(outliers[name])
        if len(which):
            shown = ", ".join(f"`{logs[at]}` {its[at]:.4g}" for at in which[:_WIDE])
            more = f" and {len(which) - _WIDE} more" if len(which) > _WIDE else ""
            lines += ["", f"unlike the others: {shown}{more}"]
        widths = _numbers(columns[f"{name}_high"]) - _numbers(columns[f"{name}_low"])
        widest = [at for at in np.argsort(-widths)[:_WIDE] if np.isfinite(widths[at])]
        shown = ", ".join(f"`{logs[at]}` ± {widths[at] / 2:.2g}" for at in widest)
        lines += ["", f"widest intervals: {shown}"] if shown else []
    lines += [
        "",
        "Choose a timeline below to sort the curves by it; the table's is in the selection panel.",
    ]
    return "\n".join(lines)


def _blueprint(names: Sequence[str], *, has_fit: bool) -> rrb.Blueprint:
    legend = rrb.PlotLegend(visible=False)  # it would hide what is unlike the others
    plots: list[Any] = [
        rrb.TimeSeriesView(origin=name, name=name, plot_legend=legend) for name in names
    ]
    if has_fit:
        plots.append(
            rrb.TimeSeriesView(origin="fit", name="misfit beyond the noise [%]", plot_legend=legend)
        )
    table = rrb.DataframeView(
        origin="table",
        name="table: the logs in the order they were tuned",
        query=rrb.archetypes.DataframeQuery(
            timeline=_ORDER, entity_order=[f"/{entity}" for entity in _TABLES]
        ),
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(*([rrb.Tabs(*plots)] if plots else []), table),
            rrb.TextDocumentView(origin="summary", name="summary"),
            column_shares=[3, 1],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=_ORDER),
        collapse_panels=False,
    )


def _numbers(cells: Sequence[Any]) -> Array:
    """Convert cells to numbers, NaN where there is none."""
    return np.array([np.nan if one is None else float(one) for one in cells])


def _count(verdicts: NDArray[Any], verdict: str) -> int:
    return int(np.sum(verdicts == verdict))
