"""Draw the figure of the drop's experiment: error against rollouts, Easy and Hard side by side."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tunenet_logs.analysis.evaluation.studies.drop_methods import (
    MAX_ROLLOUTS,
    PUBLISHED_ROLLOUTS,
    Cell,
    DropResults,
    MethodErrors,
    published_error,
)
from tunenet_logs.analysis.registry import needed
from tunenet_logs.episode import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# ---- Curves of the figure: error against rollouts.


Color = tuple[int, int, int]

PANELS = ("Easy", "Hard")  # the paper's left and right
FLOOR = 1e-6  # of restitution: a smaller error is drawn here, for a logarithm
_COLORS: dict[str, Color] = {
    "mean": (140, 140, 140),
    "entropy-search": (148, 103, 189),
    "cma-es": (140, 86, 75),
    "direct": (227, 119, 194),
    "tunenet-paper": (127, 176, 222),
    "tunenet-paper-code": (31, 119, 210),
    "secant": (23, 170, 150),
    "brent": (120, 170, 30),
    "least-squares": (188, 160, 34),
    "tpe": (255, 150, 40),
    "npe": (140, 0, 120),
}
_OUR_COLORS: Sequence[Color] = ((220, 40, 40), (240, 110, 90))


@dataclass(frozen=True, eq=False)
class ErrorCurve:
    """Error curve of a method."""

    method: str
    label: str
    is_ours: bool
    is_users: bool
    color: Color
    # mean over the seeds of the mean absolute error after 0, 1, ... rollouts, shape (R,)
    mean: Array
    low: Array  # of the best seed, shape (R,)
    high: Array  # of the worst, shape (R,)
    paper: tuple[tuple[int, float], ...]  # (rollouts, error) of the published points

    @property
    def rollouts(self) -> Array:
        """0, 1, ..., shape (R,)."""
        return np.arange(len(self.mean), dtype=np.float64)


def error_curves(results: DropResults, panel: str) -> list[ErrorCurve]:
    """Return the curves of a target set's clean cell; beyond a budget a line goes on.

    Points that the paper gives for two methods of ours are the last one's.
    """
    outcomes = results.of(Cell("drop", "paper", panel, 0.0))
    colors = _colors(outcomes)
    most = max((one.allowed for one in outcomes), default=0)
    published = tuple(n for n in PUBLISHED_ROLLOUTS if n <= (results.rollouts or MAX_ROLLOUTS))
    curves = [_curve(one, max(most, 1), colors[one.method], published) for one in outcomes]
    last = {curve.paper: curve.method for curve in curves}
    return [
        curve if last[curve.paper] == curve.method else replace(curve, paper=()) for curve in curves
    ]


def _curve(one: MethodErrors, most: int, color: Color, budgets: tuple[int, ...]) -> ErrorCurve:
    """Return a method's curve; `budgets` are those whose published points are shown."""
    reach = [n for n in range(min(most, MAX_ROLLOUTS) + 1) if one.knows(n)]
    means = np.column_stack([one.errors_after(n).mean(axis=1) for n in reach])
    published = [(n, published_error(one.cell.which, one.method, n)) for n in budgets]
    return ErrorCurve(
        one.method,
        one.label,
        one.group == "ours",
        one.group == "user",
        color,
        np.maximum(means.mean(axis=0), FLOOR),
        np.maximum(means.min(axis=0), FLOOR),
        np.maximum(means.max(axis=0), FLOOR),
        tuple((n, error) for n, error in published if error is not None),
    )


def _colors(outcomes: Iterable[MethodErrors]) -> dict[str, Color]:
    colors = dict(_COLORS)
    ours = [one.method for one in outcomes if one.group == "ours"]
    for index, method in enumerate(ours):
        colors.setdefault(method, _OUR_COLORS[index % len(_OUR_COLORS)])
    return colors


# ---- The figure as PNG: Easy and Hard side by side.


_ROOM = 1.3  # factor between the outermost errors and the ends of the axis
_TICKS = (0, 1, 2, 5, 10, 20, 40, 100)


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
        _dress(axis, panel, results.rollouts or MAX_ROLLOUTS)
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
