"""Compute the curves of the paper's figure: error against rollouts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from analysis.evaluation.drop.published import ROLLOUTS, published_error
from analysis.evaluation.drop.results import Cell, DropResults, MethodErrors
from tunenet_logs.arrays import Array

Color = tuple[int, int, int]

PANELS = ("Easy", "Hard")  # the paper's left and right
FLOOR = 1e-6  # of restitution: a smaller error is drawn here, for a logarithm
_MAX = 100  # rollouts: the last column of the paper's table 2
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
_OURS: Sequence[Color] = ((220, 40, 40), (240, 110, 90))


@dataclass(frozen=True, eq=False)
class ErrorCurve:
    """Error curve of a method.

    Attributes:
        mean: mean over the seeds of the mean absolute error after 0, 1, ... rollouts, shape (R,).
        low: of the best seed, shape (R,).
        high: of the worst, shape (R,).
        paper: (rollouts, error) of the published points.
    """

    method: str
    label: str
    is_ours: bool
    is_users: bool
    color: Color
    mean: Array
    low: Array
    high: Array
    paper: tuple[tuple[int, float], ...]

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
    published = tuple(n for n in ROLLOUTS if n <= (results.rollouts or _MAX))
    curves = [_curve(one, max(most, 1), colors[one.method], published) for one in outcomes]
    last = {curve.paper: curve.method for curve in curves}
    return [
        curve if last[curve.paper] == curve.method else replace(curve, paper=()) for curve in curves
    ]


def _curve(one: MethodErrors, most: int, color: Color, budgets: tuple[int, ...]) -> ErrorCurve:
    """Return a method's curve; `budgets` are those whose published points are shown."""
    reach = [n for n in range(min(most, _MAX) + 1) if one.knows(n)]
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
        colors.setdefault(method, _OURS[index % len(_OURS)])
    return colors
