"""What rollouts show beside one place: slopes, how rough they are, and where the cost falls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tunenet_logs.arrays import Array

_NEAR = 0.5
"""Differences within which slopes stay as they are."""


@dataclass(frozen=True, eq=False)
class Differences:
    """Finite differences about one place, each parameter moved alone: P of them.

    Attributes:
        place: values, shape (P,).
        residuals: there, shape (M,).
        moved: by how much each parameter was moved to one side, shape (P,).
        beside: residuals there, shape (P, M).
        back: by how much to the other, below 0 where `moved` is above; 0 where a bound is in the
            way; shape (P,). None of differences to one side alone.
        behind: residuals there, shape (P, M).
    """

    place: Array
    residuals: Array
    moved: Array
    beside: Array
    back: Array | None = None
    behind: Array | None = None

    @property
    def is_central(self) -> bool:
        """Whether they go to both sides."""
        return self.back is not None

    def is_near(self, values: Array, steps: Array) -> bool:
        """Whether their slopes hold at other values, where differences would be as wide as steps.

        Both of shape (P,).
        """
        return bool(np.all(np.abs(values - self.place) <= _NEAR * steps))

    @cached_property
    def slopes(self) -> Array:
        """Of the residuals by the parameters, shape (M, P)."""
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
        """Where the cost itself should be lowest along one parameter, shape (P,).

        A parabola goes through it on both sides; the one that promises most counts. Slopes over a
        kink may point uphill where this does not.

        Args:
            cost: of residuals, shape (M,), and values, shape (P,).
            least: that a parabola has to promise; None where none does.
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
    """Rollouts beside a place, all at once.

    Args:
        residuals_at: at values of shape (N, P), shape (N, M).
        place: shape (P,), within the bounds.
        residuals: there, shape (M,).
        steps: above 0, shape (P,).
        bounds: lower and upper, shape (2, P); no step goes beyond, the other way instead.
        is_central: whether to go to both sides, where the bounds let it.
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
