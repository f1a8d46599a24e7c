"""Zero-order-hold commands, held until the next one is obeyed, as steps see them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tunenet_logs.arrays import Array


@dataclass(frozen=True, eq=False)
class HeldCommands:
    """Commands as they are given.

    Attributes:
        seconds: when, increasing, shape (K,).
        values: each held until the next, the first from ever on, shape (K, C).
    """

    seconds: Array
    values: Array

    def over_steps(self, step_s: float, count: int, delay_s: float) -> Array:
        """Average what is obeyed in each step from 0 on, shape (count, C).

        A mean changes smoothly with the delay; what is held at the steps' starts would jump.
        """
        edges: Array = np.arange(count + 1, dtype=np.float64) * step_s - delay_s
        return np.diff(self._integral(edges), axis=0) / step_s

    def _integral(self, seconds: Array) -> Array:
        """Integrate from the first command on, shape (T, C); negative before it."""
        lengths = np.diff(self.seconds)[:, None]
        sums = np.concatenate([np.zeros((1, self.values.shape[1])), self.values[:-1] * lengths])
        last = np.maximum(np.searchsorted(self.seconds, seconds, "right") - 1, 0)
        held_s = (seconds - self.seconds[last])[:, None]
        return np.cumsum(sums, axis=0)[last] + self.values[last] * held_s
