"""Finite differences of rollouts: slopes, second differences, and the cost's minimum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tunenet_logs.arrays import Array

_NEAR = 0.5  # differences within which slopes stay as they are


@dataclass(frozen=True, eq=False)
class Differences:
    """Finite differences about one place, each of P parameters moved alone.

    Attributes:
        place: Values, shape (P,).
        residuals: There, shape (M,).
        moved: Step of each parameter to one side, shape (P,).
        beside: Residuals there, shape (P, M).
        back: Step to the other side, below 0 where `moved` is above; 0 at a bound; shape (P,). None
            for one-sided differences.
        behind: Residuals there, shape (P, M).
    """

    place: Array
    residuals: Array
    moved: Array
    beside: Array
    back: Array | None = None
    behind: Array | None = None

    @property
    def is_central(self) -> bool:
        """Whether they are central."""
        return self.back is not None

    def is_near(self, values: Array, steps: Array) -> bool:
        """Return whether their slopes hold at other values, (P,), for these steps, (P,)."""
        return bool(np.all(np.abs(values - self.place) <= _NEAR * steps))

    @cached_property
    def slopes(self) -> Array:
        """Jacobian of the residuals by the parameters, shape (M, P)."""
        if self.back is None or self.behind is None:
            return ((self.beside - self.residuals) / self.moved[:, None]).T
        return ((self.beside - self.behind) / (self.moved - self.back)[:, None]).T

    @cached_property
    def bends(self) -> Array:
        """Second differences of the residuals, shape (P, M); 0 where one side is missing."""
        if self.back is None or self.behind is None:
            return np.zeros_like(self.beside)
        bends = self.beside + self.behind - 2 * self.residuals
        return np.where(self.back[:, None] != 0, bends, 0.0)

    def lowest(self, cost: Callable[[Array, Array], float], least: float) -> Array | None:
        """Minimise the cost along one parameter by a parabola through three rollouts, shape (P,).

        The most promising parabola counts. Slopes over a kink may point uphill where it does not.

        Args:
            cost: Of residuals, shape (M,), and values, shape (P,).
            least: Decrease that a parabola must promise; None is returned if none does.
        """
        if self.back is None or self.behind is None:
            return None
        middle = cost(self.residuals, self.place)
        best: Array | None = None
        for number in np.flatnonzero(self.back).tolist():
            sides: list[tuple[float, float]] = []
            for by, seen in ((self.moved, self.beside), (self.back, self.behind)):
                there = self.place.copy()
                there[number] += by[number]
                sides.append((float(by[number]), cost(seen[number], there)))
            (down, low), (up, high) = sorted(sides)
            falls, rises = (middle - low) / -down, (high - middle) / up
            bend = 2 * (rises - falls) / (up - down)
            slope = (falls * up - rises * down) / (up - down)
            if bend <= 0 or slope**2 / (2 * bend) <= least:
                continue
            least = slope**2 / (2 * bend)
            best = self.place.copy()
            best[number] += np.clip(-slope / bend, down, up)
        return best


def differences(
    residuals_at: Callable[[Array], Array],
    place: Array,
    residuals: Array,
    steps: Array,
    bounds: Array,
    *,
    is_central: bool,
) -> Differences:
    """Roll out beside a place, all at once.

    Args:
        residuals_at: At values of shape (N, P), shape (N, M).
        place: Shape (P,), within the bounds.
        residuals: There, shape (M,).
        steps: Above 0, shape (P,).
        bounds: Lower and upper, shape (2, P); a step beyond goes the other way instead.
        is_central: Whether to go to both sides, within the bounds.
    """
    low, high = bounds
    moved = np.where(place + steps > high, -steps, steps)
    count = len(place)
    if not is_central:
        return Differences(place, residuals, moved, residuals_at(place + np.diag(moved)))
    inside = (place - moved >= low) & (place - moved <= high)
    back = np.where(inside, -moved, 0.0)
    off = residuals_at(np.concatenate([place + np.diag(moved), place + np.diag(back)]))
    return Differences(place, residuals, moved, off[:count], back, off[count:])
