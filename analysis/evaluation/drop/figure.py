"""Plot the paper's figure: mean error against rollouts, Easy and Hard side by side."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.evaluation.drop.curves import FLOOR, PANELS, ErrorCurve, error_curves
from analysis.evaluation.drop.results import DropResults
from analysis.optional_dependencies import needed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ROOM = 1.3  # factor between the outermost errors and the ends of the axis
_TICKS = (0, 1, 2, 5, 10, 20, 40, 100)
_MAX = 100  # rollouts: the paper's last, where no limit was given


def write_figure(results: DropResults, path: Path, made: str) -> None:
    """Write the figure as PNG, for a page's width, with the mark by which it is known.

    Raises:
        UsageError: matplotlib is not installed.
        OSError: `path` cannot be written.
    """
    needed("matplotlib")
    figure = draw_figure(results)
    figure.savefig(path, format="png", dpi=120, metadata={"Software": made})


def draw_figure(results: DropResults) -> Figure:
    """Draw the figure without writing it; every curve and point is inside its axes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 6.2), layout="constrained")
    FigureCanvasAgg(figure)
    panels = [panel for panel in PANELS if error_curves(results, panel)]
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    handles: dict[str, Any] = {}
    for axis, panel in zip(axes, panels, strict=True):
        for curve in error_curves(results, panel):
            handles[curve.label] = _draw(axis, curve)
        _dress(axis, panel, results.rollouts or _MAX)
    axes[0].set_ylim(*_limits([one for panel in panels for one in error_curves(results, panel)]))
    axes[0].set_ylabel(f"mean absolute error of the restitution (drawn from {FLOOR:g} up)")
    handles["the paper's"] = axes[0].plot([], [], "D", color="0.3", ms=5, mew=0)[0]
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=4)
    return figure


def _limits(curves: Iterable[ErrorCurve]) -> tuple[float, float]:
    """Return the lowest and highest error of all panels, which share the axis, with a margin."""
    shown = [np.concatenate([one.low, one.high, [y for _, y in one.paper]]) for one in curves]
    errors = np.concatenate(shown)
    return max(FLOOR, float(errors.min()) / _ROOM), float(errors.max()) * _ROOM


def _draw(axis: Any, curve: ErrorCurve) -> Any:
    color = tuple(part / 255 for part in curve.color)
    axis.fill_between(curve.rollouts, curve.low, curve.high, color=color, alpha=0.15, lw=0)
    for rollouts, error in curve.paper:
        axis.plot(rollouts, error, "D", color=color, ms=5, mew=0, zorder=4)
    style = {"lw": 2.6, "zorder": 5} if curve.is_ours else {"lw": 1.5}
    return axis.plot(
        curve.rollouts, curve.mean, "--" if curve.is_users else "-", color=color, **style
    )[0]


def _dress(axis: Any, panel: str, most: int) -> None:
    """Format the axes up to `most` rollouts."""
    ticks = [tick for tick in _TICKS if tick <= most]
    axis.set_title(f"GT {panel}")
    axis.set_xlabel("rollouts")
    axis.set_yscale("log")
    axis.set_xscale("symlog", linthresh=2)
    axis.set_xlim(0, 1.05 * most)
    axis.set_xticks(ticks, [str(tick) for tick in ticks])
    axis.set_xticks([], minor=True)
    axis.grid(alpha=0.25)
