"""Damped least-squares step: Levenberg-Marquardt's rule of acceptance, shared by the fits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

Moved = TypeVar("Moved")


@dataclass(frozen=True)
class Damping:
    """How damping changes from step to step (Levenberg 1944, Marquardt 1963)."""

    tries: int  # steps that are tried from one place
    raised_by: float  # factor after a step that does not lower the cost
    lowered_by: float  # divisor after one that does
    least: float  # below which a step is Gauss-Newton's
    raised_from: float = 0.0  # least damping that is raised: less would waste tries

    def lowered(self, damping: float) -> float:
        """Return the damping to begin the next step with."""
        return max(damping / self.lowered_by, self.least)


def damped_step(
    tried: Callable[[float], tuple[Moved, float] | None], cost: float, damping: float, rule: Damping
) -> tuple[Moved | None, float, float]:
    """Take the first step that lowers the cost, each with more damping than the one before.

    `tried` leads from a damping (a fraction of the normal matrix's diagonal) to where its step ends
    and the cost there, or to None where the step is too short to matter. Returns where the step
    ends, the cost there and the next damping; None and the cost as it was where none lowers it.
    """
    for _ in range(rule.tries):
        step = tried(damping)
        if step is None:
            break
        if step[1] < cost:
            return *step, rule.lowered(damping)
        damping = max(damping, rule.raised_from) * rule.raised_by
    return None, cost, damping
